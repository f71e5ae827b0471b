"""Images that had no part in the calibration, and how X predicts them; entry point ``predicted``.

Robot and X say where the camera of a new image is, c = Z^-1 B X (translations over the scale), and the scene's
points, where its features should be. With D the derivatives of a feature's place by the camera's pose, P those
by its point, x the shared unknowns (covariance C), V the information on the point if these were known, and
N the robot's noise, the errors of the features of an image have the covariance::

    G C G' + D L N L' D' + (sigma^2 + P V^-1 P'),   G = D dc/dx + P dp/dx

L carries the robot's error to the camera. The robot pose that fits its images best, weighted by the bracket, is
a linear function of these errors; so is its distance from the reported one, which is the error of that. Several
cameras have an image each of a pose. Where intrinsics are unknowns, the features move with them as well. What two new images share through V^-1 is left aside: it is small beside their pixels.
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
from handeye_fg.graph.reprojection import Derivatives, derivatives
from handeye_fg.graph.rig import image_poses
from handeye_fg.graph.summary import Refinement
from handeye_fg.graph.threads import one_blas_thread
from handeye_fg.graph.variables import BASE_T_WORLD, LOG_SCALE, State
from handeye_fg.types import Indices, KnownPoints, Rig


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NewImages:
    """What new images show of the scene.

    Attributes:
        base_T_gripper: reported robot poses (r, 4, 4), metres, in the form of the equations.
        rig: which camera took an image, and at which of these poses.
        image_index: which image an observation is of (m,).
        point_index: which point of the refined scene it shows (m,), none of the known ones.
        pixels: where (m, 2).
    """

    base_T_gripper: Array
    rig: Rig
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
    there = _placed(state, new)
    found = derivatives(
        there, new.image_index, new.point_index, new.pixels, linearised.layout.intrinsics
    )
    by_pose = found.by_pose
    by_pose[:, :, 3:] *= np.exp(-state.log_scale)  # by metres
    seen, number = np.unique(new.point_index, return_inverse=True)
    of_points = np.linalg.inv(_point_information(final, seen, noise.image_sigma))[number]
    own = found.by_point @ of_points @ np.swapaxes(found.by_point, 1, 2)
    weights = np.linalg.inv(own + noise.image_sigma**2 * np.eye(2))
    half = _by_shared(there, new, seen, number, found, linearised, solution)

    pose = new.rig.pose[new.image_index]
    levers = state.gripper_T_cameras[new.rig.camera]
    levers = new.base_T_gripper[new.rig.pose] @ levers if linearised.inverted else levers
    # By an error of the robot, in the gripper, or with inverse poses in the base.
    by_robot = by_pose @ frames.adjoint(frames.inverse(levers))[new.image_index]
    robot = np.repeat([noise.robot_rotation, noise.robot_translation], 3) ** 2
    # Predicted poses against reported ones, of base_T_gripper.
    sign = 1.0 if linearised.inverted else -1.0
    errors, halves = np.zeros((n, 6)), np.zeros((n, 6, half.shape[2]))
    covariance = np.zeros((6 * n, 6 * n))
    for i in range(n):
        rows = pose == i
        weighted = np.swapaxes(by_robot[rows], 1, 2) @ weights[rows]
        of_pose = np.linalg.inv((weighted @ by_robot[rows]).sum(axis=0))
        gain = sign * of_pose @ weighted
        errors[i] = np.einsum("mij,mj->i", gain, found.errors[rows])
        halves[i] = np.einsum("mij,mjd->id", gain, half[rows])
        block = slice(6 * i, 6 * i + 6)
        covariance[block, block] = np.diag(robot) + of_pose
    flat = halves.reshape(6 * n, -1)
    covariance += flat @ flat.T
    sigmas = np.tile(np.sqrt(robot), n)
    whitened = np.linalg.solve(covariance / np.outer(sigmas, sigmas), errors.ravel() / sigmas)
    normalised = float(whitened @ (errors.ravel() / sigmas)) / errors.size
    freedom = max(float(sum(solution.redundancy[1:3])) if noise.estimated else 1e9, 1.0)
    moved = by_robot * np.sqrt(robot)
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


def _placed(state: State, new: NewImages) -> State:
    """The state with the first camera where robot and X have it at each new pose."""
    metric = frames.inverse(state.base_T_world) @ new.base_T_gripper @ state.gripper_T_camera
    return replace(
        state,
        world_T_camera=frames.scaled(metric, float(np.exp(-state.log_scale))),
        rig=new.rig,
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
    found: Derivatives,
    linearised: Linearised,
    solution: Solution,
) -> Array:
    """How the features move (m, 2, d) with the shared unknowns, times a root of these' covariance (d, d)."""
    layout = linearised.layout
    values, vectors = np.linalg.eigh(solution.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    # Each image's camera, metres, by its X, Z and the logarithm of the scale.
    metric = frames.scaled(image_poses(there), float(np.exp(there.log_scale)))
    by_scale = np.einsum("nji,nj->ni", metric[:, :3, :3], metric[:, :3, 3])
    of_x = np.array([root[layout.x_columns(k)] for k in range(layout.n_cameras)])
    cameras = of_x[new.rig.camera] - np.einsum(
        "nij,jd->nid", frames.adjoint(frames.inverse(metric)), root[layout.columns(BASE_T_WORLD)]
    )
    cameras[:, 3:] -= by_scale[:, :, None] * root[layout.columns(LOG_SCALE)]
    half = np.einsum("mij,mjd->mid", found.by_pose, cameras[new.image_index])
    half += found.by_intrinsics @ root[layout.intrinsics_columns]
    unknown = seen - layout.n_known
    rest = linearised.point_steps(np.zeros(layout.dim))[unknown]
    for column in range(layout.dim):
        steps = linearised.point_steps(root[:, column])[unknown] - rest
        half[:, :, column] += np.einsum("mij,mj->mi", found.by_point, steps[number])
    return np.asarray(half)


def _rms(squares: Array, new: NewImages) -> Array:
    """Root mean squares (r,) by robot pose."""
    pose, n = new.rig.pose[new.image_index], len(new.base_T_gripper)
    return np.asarray(
        np.sqrt(np.bincount(pose, squares, minlength=n) / np.bincount(pose, minlength=n))
    )
