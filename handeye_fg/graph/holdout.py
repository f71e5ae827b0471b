"""Robot poses that are kept out of the estimation of X, and what X then says of them.

The images of held-out poses are placed with all others, but their robot poses are used nowhere in the
refinement. X, Z and the scale predict them; the errors of all predictions together have a covariance
``S = N + J C J'``, N the robot's noise and C the covariance of the unknowns, so that ``e' S^-1 e / n`` is F
distributed with n and the noise levels' degrees of freedom where the uncertainty is right.

A pose that is off by e moves the image of a point by ``K e``, from where it is seen with the camera as the
images have it. Residuals of a fit are independent of what it estimates, so that the points' errors have the
covariance ``K S K' + Q``, Q that of the images' residuals.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.noise import Solution, solve
from handeye_fg.graph.reduced import Linearised, predicted_together
from handeye_fg.graph.reprojection import derivatives, reprojection_errors
from handeye_fg.graph.variables import State
from handeye_fg.types import Tracks

_FEWEST_USED = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HeldOut:
    """How well X predicts robot poses that had no part in it.

    Attributes:
        poses: which (h,).
        errors: reported poses against predicted ones (h, 6), radians and metres.
        expected: root mean squares (2,) that the uncertainty lets expect: of the length of the rotation's
            error, radians, and of the translation's, metres.
        normalised: mean square of the errors in their own standard deviations: 1 on average where the
            uncertainty is right.
        probability: of a larger one by chance.
        reprojection_rms: (r,) of each pose the errors of its images' points, seen from where the robot
            pose and X have the camera, pixels; NaN for poses without points.
        expected_reprojection: (r,) the same as the uncertainty lets expect; NaN for poses that are not
            held out.
        within: part of the held-out poses' points that are in their ellipse of 95 %; NaN without points.
    """

    poses: NDArray[np.int64]
    errors: Array
    expected: Array
    normalised: float
    probability: float
    reprojection_rms: Array
    expected_reprojection: Array
    within: float


def chosen(base_T_gripper: Array, share: float, seed: int) -> NDArray[np.bool_]:
    """Which poses (n,) to hold out: along a chain from pose to nearest pose, every so many.

    Args:
        base_T_gripper: the poses (n, 4, 4).
        share: part to hold out.
        seed: where the chain and the counting start.

    Raises:
        InputDataError: too few poses would be left.
    """
    n, rng = len(base_T_gripper), np.random.default_rng(seed)
    count = max(1, round(share * n))
    if n - count < _FEWEST_USED:
        raise InputDataError(
            f"--holdout {share:g} keeps {count} of {n} poses out, but {_FEWEST_USED} at least must be left to "
            "calibrate from; hold fewer out, or add images"
        )
    rows = base_T_gripper[:, :3].reshape(n, 12).copy()
    extent = float(np.sqrt(np.var(rows[:, 3::4], axis=0).sum()))
    rows[:, 3::4] /= max(extent, 1e-9)
    distance = np.linalg.norm(rows[:, None] - rows[None], axis=2)
    chain = [int(rng.integers(n))]
    while len(chain) < n:
        rest = np.setdiff1d(np.arange(n), chain)
        chain.append(int(rest[np.argmin(distance[chain[-1], rest])]))
    places = (np.arange(count) + rng.uniform()) * n / count
    held = np.zeros(n, dtype=bool)
    held[np.array(chain)[places.astype(int)]] = True
    return held


def held_out(
    held: NDArray[np.bool_],
    linearised: Linearised,
    solution: Solution,
    state: State,
    tracks: Tracks,
    sigma_scale: Array,
    base_T_gripper: Array,
    residuals: Array,
) -> HeldOut:
    """The errors of the held-out poses, and what is to be expected of them.

    Args:
        held: which (n,).
        linearised: the problem at its optimum, without them.
        solution: its solution.
        state: the optimum.
        tracks: the observations.
        sigma_scale: their relative standard deviations (m,).
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        residuals: of all robot poses (n, 6).
    """
    if linearised.held is not None:
        linearised = replace(linearised, held=None)
        solution = solve(linearised, solution.noise)
    rows, noise, poses = linearised.reported.only(held), solution.noise, np.flatnonzero(held)
    sigmas = np.tile(np.repeat([noise.robot_rotation, noise.robot_translation], 3), len(poses))
    covariance = np.diag(sigmas**2) + predicted_together(rows, solution.covariance)
    errors = residuals[held]
    whitened = np.linalg.solve(covariance / np.outer(sigmas, sigmas), errors.ravel() / sigmas)
    normalised = float(whitened @ (errors.ravel() / sigmas)) / errors.size
    freedom = float(sum(solution.redundancy[1:3])) if noise.estimated else 1e9
    variances = np.diag(covariance).reshape(-1, 2, 3).sum(axis=2).mean(axis=0)
    errors_px = reprojection_errors(_placed_by_robot(state, base_T_gripper), tracks)
    n = len(base_T_gripper)
    by_pose = np.zeros((n, 6, 6))
    by_pose[poses] = np.einsum("iaib->iab", covariance.reshape(len(poses), 6, len(poses), 6))
    seen = held[state.rig.pose[tracks.image_index]]
    variances_px = np.zeros((len(seen), 2, 2))
    variances_px[seen] = _pixel_covariances(
        by_pose, linearised, noise, state, tracks, sigma_scale, base_T_gripper, seen
    )
    whitened_px = np.linalg.solve(variances_px[seen], errors_px[seen][..., None])[..., 0]
    squares = np.sum(whitened_px * errors_px[seen], axis=1)
    limit = 2.0 * special.fdtri(2.0, max(freedom, 1.0), 0.95)
    expected = _rms_by_pose(np.trace(variances_px, axis1=1, axis2=2), state, tracks, n)
    return HeldOut(
        poses=poses,
        errors=errors,
        expected=np.sqrt(variances),
        normalised=normalised,
        probability=float(special.fdtrc(errors.size, max(freedom, 1.0), normalised)),
        reprojection_rms=_rms_by_pose(np.sum(errors_px**2, axis=1), state, tracks, n),
        expected_reprojection=np.where(held, expected, np.nan),
        within=float(np.mean(squares <= limit)) if seen.any() else np.nan,
    )


def _placed_by_robot(state: State, base_T_gripper: Array) -> State:
    """The state with the cameras where robot and X have them."""
    metric = frames.inverse(state.base_T_world) @ base_T_gripper @ state.gripper_T_camera
    return replace(state, world_T_camera=frames.scaled(metric, float(np.exp(-state.log_scale))))


def _pixel_covariances(
    of_poses: Array,
    linearised: Linearised,
    noise: NoiseLevels,
    state: State,
    tracks: Tracks,
    sigma_scale: Array,
    base_T_gripper: Array,
    seen: NDArray[np.bool_],
) -> Array:
    """Covariances (k, 2, 2) of the errors of some observations, seen (m,), from robot and X.

    Args:
        of_poses: covariances (n, 6, 6) of the errors of the robot poses.
        linearised: the problem.
        noise: the levels.
        state: the optimum.
        tracks: the observations.
        sigma_scale: their relative standard deviations (m,).
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        seen: which of the observations.
    """
    image, point = tracks.image_index[seen], tracks.point_index[seen]
    by_pose = derivatives(state, image, point, tracks.pixels[seen]).by_pose
    by_pose[:, :, 3:] *= np.exp(-state.log_scale)  # by metres
    # The camera, seen from the frame in which a pose's error is: the gripper, or with inverse poses the base.
    camera, pose = state.rig.camera, state.rig.pose
    levers = state.gripper_T_cameras[camera]
    levers = base_T_gripper[pose] @ levers if linearised.inverted else levers
    by_error = by_pose @ frames.adjoint(frames.inverse(levers))[image]
    # What the fit takes of the residuals: 3 components of each point, 6 of each image.
    of_point = np.bincount(tracks.point_index, minlength=len(state.points_world))[point]
    of_image = np.bincount(tracks.image_index, minlength=len(pose))[image]
    known = point < linearised.layout.n_known
    left = 1.0 - np.where(known, 0.0, 1.5 / of_point) - 3.0 / of_image
    level = np.where(known, noise.corner or 0.0, noise.pixel) * sigma_scale[seen]
    own = level**2 * np.maximum(left, 0.0)
    return np.asarray(
        by_error @ of_poses[pose[image]] @ np.swapaxes(by_error, 1, 2)
        + own[:, None, None] * np.eye(2)
    )


def _rms_by_pose(squares: Array, state: State, tracks: Tracks, n: int) -> Array:
    """Root mean squares (n,) of what observations (m,) have, by robot pose; NaN where there are none."""
    pose = state.rig.pose[tracks.image_index]
    counts = np.bincount(pose, minlength=n)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.sqrt(np.bincount(pose, squares, minlength=n) / counts))
