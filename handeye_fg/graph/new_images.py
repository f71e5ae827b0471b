"""Images that had no part in the calibration, and how X predicts them; entry point ``predicted``.

Robot and X say where the camera of a new image is, c = Z^-1 B X (translations over the scale), and the scene's
points, where its features should be. With D the derivatives of a feature's place by the camera's pose, P those
by its point, x the shared unknowns (covariance C), V the information on the point if these were known, and
N the robot's noise, the errors of the features of an image have the covariance::

    G C G' + D L N L' D' + (sigma^2 + P V^-1 P'),   G = D dc/dx + P dp/dx

L carries the robot's error to the camera. The pose that fits the image best, weighted by the bracket, is a
linear function of these errors; so is its distance from the predicted one, which is the error of the
reported robot pose. What two new images share through V^-1 is left aside: it is small beside their pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.graph.holdout import HeldOut
from handeye_fg.graph.known import Known
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.noise import Solution, solve
from handeye_fg.graph.problem import IntrinsicsPrior, make_problem
from handeye_fg.graph.reduced import Linearised
from handeye_fg.graph.reprojection import derivatives
from handeye_fg.graph.summary import Refinement
from handeye_fg.graph.threads import one_blas_thread
from handeye_fg.graph.variables import BASE_T_WORLD, GRIPPER_T_CAMERA, LOG_SCALE, State
from handeye_fg.types import Indices, KnownPoints, Rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NewImages:
    """What new images of the first camera show of the scene.

    Attributes:
        base_T_gripper: reported robot poses (n, 4, 4), metres, in the form of the equations.
        image_index: which image an observation is of (m,).
        point_index: which point of the refined scene it shows (m,), none of the known ones.
        pixels: where (m, 2).
    """

    base_T_gripper: Array
    image_index: Indices
    point_index: Indices
    pixels: Array


@one_blas_thread()
def predicted(
    new: NewImages,
    base_T_gripper: Array,
    final: Refinement,
    beliefs: Sequence[IntrinsicsPrior],
    known: KnownPoints | None = None,
    priors: Sequence[Known] = (),
    *,
    inverted: bool = False,
) -> HeldOut:
    """The errors of new images, and what is to be expected of them.

    Args:
        new: the images.
        base_T_gripper: reported robot poses (r, 4, 4) of the calibration, metres.
        final: the calibration.
        beliefs: the prior of each camera's intrinsics in it.
        known: known points, as there.
        priors: what else was known beforehand.
        inverted: the robot poses are gripper_T_base.
    """
    problem = make_problem(
        Kept(
            state=final.state,
            tracks=final.tracks,
            sigma_scale=final.sigma_scale,
            pixel=final.noise.pixel,
            corner=final.noise.corner or 1.0,
        ),
        base_T_gripper,
        "base",
        beliefs if any(belief.unknown for belief in beliefs) else (),
        known,
        priors,
        final.used,
        inverted=inverted,
    )
    linearised = problem.linearised(final.state)
    solution = solve(linearised, final.noise)
    state, noise, n = final.state, solution.noise, len(new.base_T_gripper)
    there = _placed(state, new.base_T_gripper)
    found = derivatives(there, new.image_index, new.point_index, new.pixels)
    by_pose = found.by_pose
    by_pose[:, :, 3:] *= np.exp(-state.log_scale)  # by metres
    seen, number = np.unique(new.point_index, return_inverse=True)
    of_points = np.linalg.inv(_point_information(final, seen, noise.image_sigma))[number]
    own = found.by_point @ of_points @ np.swapaxes(found.by_point, 1, 2)
    weights = np.linalg.inv(own + noise.image_sigma**2 * np.eye(2))
    half = _by_shared(there, new, seen, number, by_pose, found.by_point, linearised, solution)

    levers = np.broadcast_to(state.gripper_T_camera, (n, 4, 4))
    levers = new.base_T_gripper @ levers if linearised.inverted else levers
    to_gripper, to_camera = frames.adjoint(levers), frames.adjoint(frames.inverse(levers))
    robot = np.repeat([noise.robot_rotation, noise.robot_translation], 3) ** 2
    # Predicted poses against reported ones, of base_T_gripper.
    sign = 1.0 if linearised.inverted else -1.0
    errors, halves = np.zeros((n, 6)), np.zeros((n, 6, half.shape[2]))
    covariance = np.zeros((6 * n, 6 * n))
    for i in range(n):
        rows = new.image_index == i
        weighted = np.swapaxes(by_pose[rows], 1, 2) @ weights[rows]
        of_pose = np.linalg.inv((weighted @ by_pose[rows]).sum(axis=0))
        gain = sign * to_gripper[i] @ of_pose @ weighted
        errors[i] = np.einsum("mij,mj->i", gain, found.errors[rows])
        halves[i] = np.einsum("mij,mjd->id", gain, half[rows])
        block = slice(6 * i, 6 * i + 6)
        covariance[block, block] = np.diag(robot) + to_gripper[i] @ of_pose @ to_gripper[i].T
    flat = halves.reshape(6 * n, -1)
    covariance += flat @ flat.T
    sigmas = np.tile(np.sqrt(robot), n)
    whitened = np.linalg.solve(covariance / np.outer(sigmas, sigmas), errors.ravel() / sigmas)
    normalised = float(whitened @ (errors.ravel() / sigmas)) / errors.size
    freedom = max(float(sum(solution.redundancy[1:3])) if noise.estimated else 1e9, 1.0)
    moved = by_pose @ to_camera[new.image_index] * np.sqrt(robot)
    of_pixels = own + noise.pixel**2 * np.eye(2) + half @ np.swapaxes(half, 1, 2)
    of_pixels += moved @ np.swapaxes(moved, 1, 2)
    squares = np.einsum(
        "mi,mi->m", found.errors, np.linalg.solve(of_pixels, found.errors[..., None])[..., 0]
    )
    return HeldOut(
        poses=np.arange(n),
        errors=errors,
        expected=np.sqrt(np.diag(covariance).reshape(-1, 2, 3).sum(axis=2).mean(axis=0)),
        normalised=normalised,
        probability=float(special.fdtrc(errors.size, freedom, normalised)),
        reprojection_rms=_rms(np.sum(found.errors**2, axis=1), new),
        expected_reprojection=_rms(np.trace(of_pixels, axis1=1, axis2=2), new),
        within=float(np.mean(squares <= 2.0 * special.fdtri(2.0, freedom, 0.95))),
    )


def _placed(state: State, base_T_gripper: Array) -> State:
    """The state with the first camera where robot and X have it at each new pose."""
    metric = frames.inverse(state.base_T_world) @ base_T_gripper @ state.gripper_T_camera
    return replace(
        state,
        world_T_camera=frames.scaled(metric, float(np.exp(-state.log_scale))),
        gripper_T_cameras=state.gripper_T_cameras[:1],
        cameras=state.cameras[:1],
        rig=Rig.of_one_camera(len(base_T_gripper)),
    )


def _point_information(final: Refinement, points: Indices, sigma: float) -> Array:
    """What the calibration's images say of points (p, 3, 3) if all else were known."""
    tracks = final.tracks
    used = np.isin(tracks.point_index, points)
    point = tracks.point_index[used]
    by_point = derivatives(
        final.state, tracks.image_index[used], point, tracks.pixels[used]
    ).by_point
    by_point /= (sigma * final.sigma_scale[used])[:, None, None]
    information = np.zeros((len(points), 3, 3))
    np.add.at(information, np.searchsorted(points, point), np.swapaxes(by_point, 1, 2) @ by_point)
    return information


def _by_shared(
    there: State,
    new: NewImages,
    seen: Indices,
    number: NDArray[np.int64],
    by_pose: Array,
    by_point: Array,
    linearised: Linearised,
    solution: Solution,
) -> Array:
    """How the features move (m, 2, d) with the shared unknowns, times a root of these' covariance (d, d)."""
    layout = linearised.layout
    values, vectors = np.linalg.eigh(solution.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # The camera's tangent, metres, by X, Z and the logarithm of the scale.
    metric = frames.scaled(there.world_T_camera, float(np.exp(there.log_scale)))
    by_scale = np.einsum("nji,nj->ni", metric[:, :3, :3], metric[:, :3, 3])
    cameras = root[layout.columns(GRIPPER_T_CAMERA)] - np.einsum(
        "nij,jd->nid", frames.adjoint(frames.inverse(metric)), root[layout.columns(BASE_T_WORLD)]
    )
    cameras[:, 3:] -= by_scale[:, :, None] * root[layout.columns(LOG_SCALE)]
    half = np.einsum("mij,mjd->mid", by_pose, cameras[new.image_index])
    unknown = seen - layout.n_known
    rest = linearised.point_steps(np.zeros(layout.dim))[unknown]
    for column in range(layout.dim):
        steps = linearised.point_steps(root[:, column])[unknown] - rest
        half[:, :, column] += np.einsum("mij,mj->mi", by_point, steps[number])
    return np.asarray(half)


def _rms(squares: Array, new: NewImages) -> Array:
    """Root mean squares (n,) by image."""
    counts = np.bincount(new.image_index, minlength=len(new.base_T_gripper))
    return np.asarray(np.sqrt(np.bincount(new.image_index, squares) / counts))
