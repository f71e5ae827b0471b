"""Joint refinement of points, camera poses, X, Z, scale and intrinsics; entry point ``refine``."""

from dataclasses import dataclass, fields, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from handeye_fg.errors import ConvergenceError, ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.graph import measurements as m
from handeye_fg.graph.noise import Solution, estimate_noise, relative_change
from handeye_fg.graph.optimise import optimise
from handeye_fg.graph.outliers import disagreeing
from handeye_fg.graph.reduced import (
    Layout,
    Linearised,
    eliminate_points,
    priors,
    robot_rows,
)
from handeye_fg.graph.summary import (
    Refinement,
    reprojection_errors,
    robot_residuals,
    summarise,
)
from handeye_fg.graph.variables import (
    INTRINSICS,
    State,
    from_values,
    ordering,
    to_values,
)
from handeye_fg.options import GraphOptions, NoiseOptions
from handeye_fg.progress import Progress
from handeye_fg.types import LinearStart, NoiseLevels, SfmModel, Tracks

# Observations further than this from their prediction are mismatches: of Gaussian ones 0.03 % are.
_REJECTION_SIGMAS = 4.0
# Two lines of sight that meet at 1.2 degrees; a smaller angle leaves the depth to the noise.
_MIN_PARALLAX = 0.01
_MAX_ROUNDS = 8
_NOISE_CONVERGED = 0.01  # relative; the sigmas' own uncertainty is larger


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntrinsicsPrior:
    """Intrinsics as unknowns with a prior.

    Attributes:
        params: OPENCV parameters (8,), centre of the prior.
        sigmas: standard deviations (8,).
    """

    params: Array
    sigmas: Array


def start_state(model: SfmModel, opencv_params: Array, linear: LinearStart) -> State:
    """The SfM model and the linear start as first values.

    Raises:
        ValueError: the linear start is of motions, without base_T_world.
    """
    if linear.base_T_world is None:
        raise ValueError(f"{linear.base_T_world=} but expected a pose")
    return State(
        world_T_camera=model.world_T_camera,
        points_world=model.tracks.points_world,
        gripper_T_camera=linear.gripper_T_camera,
        base_T_world=linear.base_T_world,
        log_scale=float(np.log(linear.metres_per_world_unit)),
        opencv_params=opencv_params,
    )


def _parallax(state: State, tracks: Tracks, kept: Array) -> Array:
    """Root mean square angle (p,) of each point's lines of sight to their mean direction, radians.

    Zero for a point that is seen once or never.
    """
    points = tracks.point_index[kept]
    lines = state.points_world[points] - state.world_T_camera[tracks.image_index[kept], :3, 3]
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    n_points = len(state.points_world)
    total = np.stack([np.bincount(points, axis, n_points) for axis in lines.T], axis=1)
    mean = total / np.maximum(np.bincount(points, minlength=n_points), 1)[:, None]
    cosine_squared = np.sum(mean**2, axis=1)
    return np.where(cosine_squared > 0, np.sqrt(np.clip(1.0 - cosine_squared, 0.0, None)), 0.0)


def _require_finite(start: State) -> None:
    """Refuse values that GTSAM would return unchanged and in silence."""
    values = (getattr(start, field.name) for field in fields(start))
    if not all(np.isfinite(value).all() for value in values):
        raise ConvergenceError(
            "the joint refinement cannot start: the reconstruction or the linear start has values "
            "that are not finite; check the robot poses and the reconstruction"
        )


def _without_mismatches(
    state: State, tracks: Tracks, sigma_scale: Array
) -> tuple[State, Tracks, Array, float]:
    """Leave out mismatches, and the points whose depth is then no longer determined.

    Returns:
        State, tracks and relative sigmas of what is left, and their robust sigma in pixels.

    Raises:
        ReconstructionError: too few are left to determine cameras and points.
    """
    errors = reprojection_errors(state, tracks) / sigma_scale[:, None]
    finite = np.isfinite(errors).all(axis=1)
    sigma = float(1.4826 * np.median(np.abs(errors[finite])))
    kept = finite & (np.linalg.norm(errors, axis=1) <= _REJECTION_SIGMAS * max(sigma, 1e-6))
    kept &= (_parallax(state, tracks, kept) >= _MIN_PARALLAX)[tracks.point_index]
    used, point_index = np.unique(tracks.point_index[kept], return_inverse=True)
    points = state.points_world[used]
    left = Tracks(
        points_world=points,
        image_index=tracks.image_index[kept],
        point_index=point_index,
        pixels=tracks.pixels[kept],
    )
    n_images = len(state.world_T_camera)
    if 2 * len(left.pixels) < 3 * len(points) + 6 * n_images:
        raise ReconstructionError(
            f"only {len(left.pixels)} observations of {len(points)} points are left in {n_images} "
            "images, too few to refine; take sharper, more textured or more overlapping images"
        )
    return replace(state, points_world=points), left, sigma_scale[kept], max(sigma, 1e-6)


def _first_noise(state: State, base_T_gripper: Array, pixel: float) -> NoiseLevels:
    """Levels from the residuals at the start."""
    residuals = robot_residuals(state, base_T_gripper)
    rms = np.sqrt(np.mean(residuals.reshape(-1, 2, 3) ** 2, axis=(0, 2)))
    return NoiseLevels(
        pixel=pixel,
        robot_rotation=float(max(rms[0], 1e-6)),
        robot_translation=float(max(rms[1], 1e-7)),
        estimated=True,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
    """One choice of observations, their part of the graph (built once), and what does not change.

    The sigmas of the observations have the unit ``pixel_unit_px``. When the noise levels change, the
    graph is not built again: only the ratios of the levels matter to the optimum, so the metric
    measurements are scaled instead.
    """

    tracks: Tracks
    reprojections: gtsam.NonlinearFactorGraph
    gauge: gtsam.NonlinearFactorGraph
    base_T_gripper: Array
    trusted: NDArray[np.bool_]
    intrinsics: IntrinsicsPrior | None
    pixel_unit_px: float
    layout: Layout

    def robot(self, noise: NoiseLevels, unit: float = 1.0) -> gtsam.NonlinearFactorGraph:
        sigmas = m.pose_sigmas(noise.robot_rotation, noise.robot_translation)
        return m.robot_graph(self.base_T_gripper, unit * sigmas, self.trusted)

    def priors(self, unit: float = 1.0) -> gtsam.NonlinearFactorGraph:
        if self.intrinsics is None:
            return self.gauge
        prior = self.intrinsics
        return m.joined([self.gauge, m.intrinsics_graph(prior.params, unit * prior.sigmas)])

    def graph(self, noise: NoiseLevels) -> gtsam.NonlinearFactorGraph:
        unit = self.pixel_unit_px / noise.pixel
        return m.joined([self.reprojections, self.robot(noise, unit), self.priors(unit)])

    def linearised(self, values: gtsam.Values, noise: NoiseLevels) -> Linearised:
        points = len(self.tracks.points_world)
        sigmas = m.pose_sigmas(noise.robot_rotation, noise.robot_translation)
        return Linearised(
            reprojections=eliminate_points(
                self.reprojections.linearize(values), points, self.layout
            ),
            robot=robot_rows(self.robot(noise).linearize(values), sigmas, self.layout),
            prior=priors(self.priors().linearize(values), self.layout),
            pixel_unit_px=self.pixel_unit_px,
            pixel_redundancy=2 * len(self.tracks.pixels) - 3 * points,
            layout=self.layout,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """An optimum with noise levels that agree with it."""

    state: State
    problem: _Problem
    linearised: Linearised
    solution: Solution
    iterations: int
    converged: bool


def _problem(
    state: State,
    tracks: Tracks,
    sigma_scale: Array,
    sigma: float,
    base_T_gripper: Array,
    gauge: m.Gauge,
    intrinsics: IntrinsicsPrior | None,
    trusted: NDArray[np.bool_] | None = None,
) -> _Problem:
    with_intrinsics = intrinsics is not None
    return _Problem(
        tracks=tracks,
        reprojections=m.reprojection_graph(
            tracks, sigma * sigma_scale, state.opencv_params, with_intrinsics=with_intrinsics
        ),
        gauge=m.joined([m.gauge_graph(state, gauge), m.wide_prior_graph(state)]),
        base_T_gripper=base_T_gripper,
        trusted=np.ones(len(base_T_gripper), dtype=bool) if trusted is None else trusted,
        intrinsics=intrinsics,
        pixel_unit_px=sigma,
        layout=Layout(n_cameras=len(state.world_T_camera), with_intrinsics=with_intrinsics),
    )


def _fitted(
    problem: _Problem,
    start: State,
    levels: NoiseLevels,
    rounds: int,
    noise: NoiseOptions,
    options: GraphOptions,
    progress: Progress,
    done: int = 0,
) -> _Fit:
    """Optimise and estimate the noise in turn until the levels stay the same."""
    with_intrinsics = problem.layout.with_intrinsics
    order = ordering(
        problem.layout.n_cameras,
        len(problem.tracks.points_world),
        with_intrinsics=with_intrinsics,
    )
    values = to_values(start, with_intrinsics=with_intrinsics)
    iterations = 0
    while True:
        optimum = optimise(
            problem.graph(levels),
            values,
            order,
            max_iterations=options.max_iterations,
            progress=progress,
            done=done + iterations,
        )
        values, iterations, rounds = optimum.values, iterations + optimum.iterations, rounds - 1
        linearised = problem.linearised(values, levels)
        solution = estimate_noise(linearised, levels, noise)
        change, levels = relative_change(levels, solution.noise), solution.noise
        if change < _NOISE_CONVERGED or rounds == 0:
            return _Fit(
                state=from_values(values, start, with_intrinsics=with_intrinsics),
                problem=problem,
                linearised=linearised,
                solution=solution,
                iterations=iterations,
                converged=optimum.converged,
            )


def intrinsics_pull(base_T_gripper: Array, kept: Refinement, prior: IntrinsicsPrior) -> float:
    """How far the images would move intrinsics that were kept: a chi-square of 8.

    It is the score test: one linear step from the optimum with the intrinsics as unknowns, against
    the covariance of that step.

    Args:
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        kept: the optimum with the intrinsics at the centre of ``prior``.
        prior: of the intrinsics, wide.
    """
    problem = _problem(
        kept.state,
        kept.tracks,
        kept.sigma_scale,
        kept.noise.pixel,
        base_T_gripper,
        "base",
        prior,
        ~kept.outliers,
    )
    values = to_values(kept.state, with_intrinsics=True)
    solution = estimate_noise(problem.linearised(values, kept.noise), kept.noise, NoiseOptions())
    columns = np.delete(problem.layout.columns(INTRINSICS), 2)  # without the skew
    step = solution.step[columns]
    covariance = solution.covariance[np.ix_(columns, columns)]
    scale = np.sqrt(np.diag(covariance))
    shaped = covariance / np.outer(scale, scale)
    return float(step / scale @ np.linalg.solve(shaped, step / scale))


def refine(
    model: SfmModel,
    base_T_gripper: Array,
    start: State,
    *,
    intrinsics: IntrinsicsPrior | None,
    sigma_scale: Array | None = None,
    noise: NoiseOptions,
    options: GraphOptions,
    progress: Progress,
    gauge: m.Gauge = "base",
    frame: str = "gripper",
) -> Refinement:
    """Refine everything together and estimate the noise levels with it.

    Args:
        model: tracks, and the SfM poses that define the world's unit.
        base_T_gripper: reported robot poses (n, 4, 4), metres, one for each image of the model.
        start: first values; its ``opencv_params`` describe the view in which the tracks are.
        intrinsics: prior of the intrinsics, None to keep them fixed.
        sigma_scale: relative standard deviation (m,) of each observation; None: all the same.
        noise: the levels that the user knows.
        options: of the optimiser.
        progress: told the number of iterations.
        gauge: what holds the world; no reported figure depends on it.
        frame: parent frame of X, for messages.

    Raises:
        ReconstructionError: too few observations are left.
        ConvergenceError: no finite optimum.
    """
    _require_finite(start)
    scales = np.ones(len(model.tracks.pixels)) if sigma_scale is None else sigma_scale
    state, tracks, scales, sigma = _without_mismatches(start, model.tracks, scales)
    problem = _problem(state, tracks, scales, sigma, base_T_gripper, gauge, intrinsics)
    levels = _first_noise(state, base_T_gripper, sigma)
    first = _fitted(problem, state, levels, 1, noise, options, progress)

    # Mismatches that hid behind a wrong start show now.
    state, tracks, scales, sigma = _without_mismatches(first.state, tracks, scales)
    problem = _problem(state, tracks, scales, sigma, base_T_gripper, gauge, intrinsics)
    fit = _fitted(problem, state, first.solution.noise, _MAX_ROUNDS, noise, options, progress)
    iterations = first.iterations + fit.iterations
    while (bad := disagreeing(fit.linearised, fit.solution, noise)).any():
        trusted = problem.trusted.copy()
        trusted[np.flatnonzero(trusted)[bad]] = False
        problem = replace(problem, trusted=trusted)
        fit = _fitted(
            problem,
            fit.state,
            fit.solution.noise,
            _MAX_ROUNDS,
            noise,
            options,
            progress,
            iterations,
        )
        iterations += fit.iterations
    return summarise(
        model,
        tracks,
        scales,
        fit.state,
        fit.linearised,
        fit.solution,
        robot_residuals(fit.state, base_T_gripper),
        problem.trusted,
        iterations=iterations,
        converged=fit.converged,
        frame=frame,
    )
