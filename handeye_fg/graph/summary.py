"""From the optimum to the figures that a result reports; none of them depends on the gauge."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg import frames
from handeye_fg.findings import LevelCertainty, NoiseLevels, SecondStart
from handeye_fg.frames import Array
from handeye_fg.graph.arm import ArmErrors, arm_errors
from handeye_fg.graph.deletion import deletions
from handeye_fg.graph.determined import determined, spread
from handeye_fg.graph.holdout import HeldOut
from handeye_fg.graph.levels import level_certainties
from handeye_fg.graph.noise import Solution
from handeye_fg.graph.reduced import Layout, Linearised
from handeye_fg.graph.reprojection import reprojection_errors
from handeye_fg.graph.rig import image_poses
from handeye_fg.graph.variables import LOG_SCALE, State, intrinsics_key
from handeye_fg.observability import Observability, analyse, on_determined
from handeye_fg.options import NoiseOptions
from handeye_fg.types import KnownPoints, SfmModel, Tracks

_FALSE_ALARM = 1e-3  # probability that a target of the right size is doubted


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refinement:
    """The optimum and its statistics; images in the order of the SfM model, robot poses in the rig's.

    Attributes:
        state: refined values.
        tracks: the observations that were used; ``points_world`` as they were before.
        sigma_scale: their relative standard deviations (m,).
        observabilities: for each camera the covariance of X, and what is free.
        interval_factors: for each camera (k, 7): half widths of the 95 % intervals of X's components and
            ln scale, in standard deviations.
        freedoms: for each camera (k, 7): degrees of freedom of these intervals.
        arm: whether the robot's noise is white, and what that makes of the covariances.
        first_T_cameras: each camera in the first (k, 4, 4), metres.
        first_T_camera_covariances: (k, 6, 6), of a right perturbation, on the determined subspace;
            zeros for the first.
        metres_per_world_unit, metres_per_world_unit_std: the refined cameras' root mean square
            distance from their centre in metres, over the same in the SfM model.
        log_scale_std: standard deviation of ``state.log_scale``, the noise levels taken as known.
        base_T_camera: refined camera poses of the images (n, 4, 4), metres.
        base_T_world: the SfM model's world in the base, metres.
        x_and_intrinsics: for each camera the covariance (6 + k, 6 + k) of X and of the k parameters of the
            camera; zeros where these are fixed.
        inflation: what the covariances were multiplied with, since they are those of t distributions.
        noise: levels found or given.
        level_certainties: of the noise levels, by their names in ``noise``.
        degrees_of_freedom: of the covariance of X, which is that of a t distribution; infinite
            where the noise levels are known.
        residuals: (r, 6) reported robot pose against the refined one, radians and metres.
        outliers: (r,) robot poses that disagree with the rest beyond its noise; they were left out.
        w_test: (r,) length of each reported pose's standardised residual against the solution without
            it: that of its rotation or of its translation, the larger. Its square is chi-square of
            3 degrees of freedom for a right pose; NaN where the others do not determine it.
        influence: (r, 6) how far the first camera's X would move without the pose, with these noise
            levels, radians and metres; NaN where it is not used, or X not determined without it.
        growth: (r,) by how much the standard deviation of the first camera's X in some direction would be larger
            without the pose, at most, relatively; NaN likewise.
        reprojection_rms: (n,) pixels.
        path: the first camera's X (k, 4, 4) after each step of the optimiser, in all rounds.
        converged: whether the last round did.
        second_start: whether another start leads to the same optimum; None: not tried.
        held_out: how well X predicts the robot poses that were kept out of it; None: there are none.
    """

    state: State
    tracks: Tracks
    sigma_scale: Array
    observabilities: tuple[Observability, ...]
    interval_factors: Array
    freedoms: Array
    arm: ArmErrors
    first_T_cameras: Array
    first_T_camera_covariances: Array
    metres_per_world_unit: float
    metres_per_world_unit_std: float
    log_scale_std: float
    base_T_camera: Array
    base_T_world: Array
    x_and_intrinsics: tuple[Array, ...]
    inflation: float
    noise: NoiseLevels
    level_certainties: Mapping[str, LevelCertainty]
    degrees_of_freedom: float
    residuals: Array
    outliers: NDArray[np.bool_]
    w_test: Array
    influence: Array
    growth: Array
    reprojection_rms: Array
    path: Array
    converged: bool
    second_start: SecondStart | None = None
    held_out: HeldOut | None = None

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which robot poses (r,) X rests on."""
        used = ~self.outliers
        if self.held_out is not None:
            used[self.held_out.poses] = False
        return used

    @property
    def intrinsics_covariances(self) -> tuple[Array, ...]:
        """For each camera that of its parameters (k, k); zeros where fixed."""
        return tuple(joint[6:, 6:] for joint in self.x_and_intrinsics)

    @property
    def iterations(self) -> int:
        """Steps of the optimiser."""
        return len(self.path)

    @property
    def observability(self) -> Observability:
        """That of the first camera."""
        return self.observabilities[0]


def robot_residuals(state: State, base_T_gripper: Array, *, inverted: bool = False) -> Array:
    """Reported robot poses (n, 4, 4) against those of the state: (n, 6), radians and metres.

    Where they are ``inverted``, gripper_T_base, the residuals are those of base_T_gripper all the same.
    """
    metric = frames.scaled(state.world_T_camera, float(np.exp(state.log_scale)))
    gripper = state.base_T_world @ metric @ frames.inverse(state.gripper_T_camera)
    return pose_residuals(gripper, base_T_gripper, inverted=inverted)


def pose_residuals(predicted: Array, reported: Array, *, inverted: bool) -> Array:
    """Reported robot poses (n, 4, 4) against predicted ones (..., n, 4, 4): (..., n, 6)."""
    if inverted:
        return frames.log(reported @ frames.inverse(predicted))
    return frames.log(frames.inverse(reported) @ predicted)


def median_depth(final: Refinement) -> float:
    """Of the scene's points, as the cameras see them, metres."""
    points = final.state.points_world[final.tracks.point_index]
    poses = image_poses(final.state)[final.tracks.image_index]
    depths = np.einsum("mi,mi->m", points - poses[:, :3, 3], poses[:, :3, 2])
    return float(np.exp(final.state.log_scale) * np.median(depths))


def corner_fit(final: Refinement, n_known: int) -> tuple[int, float]:
    """Observed corners of a target that were used, and the root mean square of their errors, pixels."""
    corners = final.tracks.point_index < n_known
    lengths = np.linalg.norm(reprojection_errors(final.state, final.tracks)[corners], axis=1)
    return int(np.count_nonzero(corners)), float(np.sqrt(np.mean(lengths**2)))


def scale_agrees(asked: Refinement, known: KnownPoints) -> bool:
    """Whether the robot agrees with the scale that known points give, by Student's t.

    Args:
        asked: the optimum without the points' say on the scale.
        known: the points.
    """
    pull = abs(asked.state.log_scale) / np.hypot(asked.log_scale_std, known.log_scale_sigma)
    return bool(2.0 * special.stdtr(asked.degrees_of_freedom, -pull) > _FALSE_ALARM)


def aligned(base_T_camera: Array, metric_T_camera: Array) -> Array:
    """The rigid transform base_T_metric that best carries one set of cameras to the other."""
    rotation = frames.orthonormalised(
        np.einsum("nij,nkj->ik", base_T_camera[:, :3, :3], metric_T_camera[:, :3, :3])
    )
    offsets = base_T_camera[:, :3, 3] - metric_T_camera[:, :3, 3] @ rotation.T
    return frames.pose(rotation, offsets.mean(axis=0))


def _image_rms(errors: Array, tracks: Tracks, n_images: int) -> Array:
    """Root mean square length of the reprojection errors by image, pixels."""
    squares = np.bincount(tracks.image_index, np.sum(errors**2, axis=1), minlength=n_images)
    counts = np.bincount(tracks.image_index, minlength=n_images)
    return np.asarray(np.sqrt(squares / np.maximum(counts, 1)))


def summarise(
    model: SfmModel,
    tracks: Tracks,
    sigma_scale: Array,
    state: State,
    linearised: Linearised,
    solution: Solution,
    residuals: Array,
    trusted: NDArray[np.bool_],
    options: NoiseOptions,
    *,
    path: Array,
    converged: bool,
    frame: str,
) -> Refinement:
    """Assemble the figures.

    Args:
        model: the SfM model, which defines the world's unit.
        tracks: the observations that were used.
        sigma_scale: their relative standard deviations (m,).
        state: the optimum.
        linearised: the problem there.
        solution: noise levels and covariance there.
        residuals: (r, 6) of all robot poses there.
        trusted: (r,) which robot poses were used.
        options: the noise levels that the user knows.
        path: X after each step of the optimiser.
        converged: whether it converged.
        frame: parent frame of X.
    """
    layout, poses = linearised.layout, image_poses(state)
    scale = float(np.exp(state.log_scale))
    base_T_camera = state.base_T_world @ frames.scaled(poses, scale)
    metres_per_unit = scale * spread(poses) / spread(model.world_T_camera)

    white = determined(state, linearised, solution, options)
    arm = arm_errors(white, state, trusted, scale * spread(poses))
    found = replace(white, certainties=arm.certainties)
    without = deletions(linearised, solution, trusted)
    observabilities = tuple(
        analyse(joint, X, frame)
        for joint, X in zip(found.joints, state.gripper_T_cameras, strict=True)
    )
    covariance = white.inflation * white.solution.covariance
    first_T_cameras = frames.inverse(state.gripper_T_camera) @ state.gripper_T_cameras
    first_T_cameras[0] = np.eye(4)
    return Refinement(
        state=state,
        tracks=tracks,
        sigma_scale=sigma_scale,
        observabilities=observabilities,
        interval_factors=np.array(
            [
                certainty.half_widths / np.sqrt(np.diag(certainty.covariance))
                for certainty in found.certainties
            ]
        ),
        freedoms=np.array([certainty.freedoms for certainty in found.certainties]),
        arm=arm,
        first_T_cameras=first_T_cameras,
        first_T_camera_covariances=_relative_covariances(first_T_cameras, layout, covariance),
        metres_per_world_unit=metres_per_unit,
        metres_per_world_unit_std=metres_per_unit * observabilities[0].log_scale_std,
        log_scale_std=float(np.sqrt(np.diag(solution.covariance)[layout.columns(LOG_SCALE)[0]])),
        base_T_camera=base_T_camera,
        base_T_world=aligned(base_T_camera, frames.scaled(model.world_T_camera, metres_per_unit)),
        x_and_intrinsics=tuple(
            _x_and_intrinsics(state, layout, covariance, k) for k in range(layout.n_cameras)
        ),
        inflation=white.inflation,
        noise=solution.noise,
        level_certainties=level_certainties(white.linearised, white.solution, white.spread),
        degrees_of_freedom=found.certainties[0].freedom,
        residuals=residuals,
        outliers=~trusted,
        w_test=without.lengths.max(axis=1),
        influence=without.x_step,
        growth=without.growth,
        reprojection_rms=_image_rms(reprojection_errors(state, tracks), tracks, len(poses)),
        path=path,
        converged=converged,
    )


def _x_and_intrinsics(state: State, layout: Layout, covariance: Array, camera: int) -> Array:
    """Covariance of X and all parameters of a camera, from that of the shared unknowns."""
    size = 6 + len(state.cameras[camera].params)
    result, columns = np.zeros((size, size)), layout.columns(intrinsics_key(camera))
    unknown = layout.intrinsics[camera] if len(columns) else ()
    rows = np.append(np.arange(6), 6 + np.array(unknown, dtype=np.int64))
    columns = np.append(layout.x_columns(camera), columns)
    result[np.ix_(rows, rows)] = covariance[np.ix_(columns, columns)]
    return result


def _relative_covariances(first_T_cameras: Array, layout: Layout, covariance: Array) -> Array:
    """Covariances (k, 6, 6) of the cameras' poses in the first, from that of the shared unknowns."""
    result = np.zeros((layout.n_cameras, 6, 6))
    for k in range(1, layout.n_cameras):
        to = np.zeros((6, layout.dim))
        to[:, layout.x_columns(k)] = np.eye(6)
        to[:, layout.x_columns()] = -frames.adjoint(frames.inverse(first_T_cameras[k]))
        result[k] = on_determined(to @ covariance @ to.T)
    return result
