"""Joint refinement of points, camera poses, X, Z, scale and intrinsics; entry point ``refine``."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array
from handeye_fg.graph import measurements as m
from handeye_fg.graph.determined import determined
from handeye_fg.graph.mismatches import Kept, without_mismatches
from handeye_fg.graph.noise import Solution, estimate_noise, relative_change
from handeye_fg.graph.optimise import optimise
from handeye_fg.graph.outliers import disagreeing
from handeye_fg.graph.problem import IntrinsicsPrior, Problem, make_problem
from handeye_fg.graph.reduced import Linearised
from handeye_fg.graph.summary import Refinement, robot_residuals, summarise
from handeye_fg.graph.variables import INTRINSICS, State, from_values, ordering, to_values
from handeye_fg.observability import free_basis
from handeye_fg.options import GraphOptions, NoiseOptions, Prior
from handeye_fg.progress import Progress
from handeye_fg.types import KnownPoints, LinearStart, NoiseLevels, SfmModel

_MAX_ROUNDS = 8
_NOISE_CONVERGED = 0.01  # relative; the sigmas' own uncertainty is larger


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


def _require_finite(start: State) -> None:
    """Refuse values that GTSAM would return unchanged and in silence."""
    values = (getattr(start, field.name) for field in fields(start))
    if not all(np.isfinite(value).all() for value in values):
        raise ConvergenceError(
            "the joint refinement cannot start: the reconstruction or the linear start has values "
            "that are not finite; check the robot poses and the reconstruction"
        )


def _first_noise(kept: Kept, base_T_gripper: Array, *, with_corners: bool) -> NoiseLevels:
    """Levels from the residuals at the start."""
    residuals = robot_residuals(kept.state, base_T_gripper)
    rms = np.sqrt(np.mean(residuals.reshape(-1, 2, 3) ** 2, axis=(0, 2)))
    return NoiseLevels(
        pixel=kept.pixel,
        robot_rotation=float(max(rms[0], 1e-6)),
        robot_translation=float(max(rms[1], 1e-7)),
        estimated=True,
        corner=kept.corner if with_corners else None,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """An optimum with noise levels that agree with it."""

    state: State
    problem: Problem
    linearised: Linearised
    solution: Solution
    iterations: int
    converged: bool


def _fitted(
    problem: Problem,
    start: State,
    levels: NoiseLevels,
    rounds: int,
    noise: NoiseOptions,
    options: GraphOptions,
    progress: Progress,
    done: int = 0,
) -> _Fit:
    """Optimise and estimate the noise in turn until the levels stay the same.

    Along directions that the data leave free X stays where it starts: noise, which bends the cost a
    little, would otherwise carry it away, and the linearisation with it.
    """
    with_intrinsics = problem.layout.with_intrinsics
    order = ordering(
        problem.layout.n_cameras,
        len(problem.tracks.points_world),
        with_intrinsics=with_intrinsics,
    )
    values = to_values(start, with_intrinsics=with_intrinsics)
    free = _free(start, problem.linearised(values, levels), levels, noise)
    iterations = 0
    while True:
        problem = replace(problem, held=m.held_graph(start.gripper_T_camera, free))
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
        state = from_values(values, start, with_intrinsics=with_intrinsics)
        before, free = free, _free(state, linearised, levels, noise)
        settled = change < _NOISE_CONVERGED and free.shape == before.shape
        if settled or rounds == 0:
            return _Fit(
                state=state,
                problem=problem,
                linearised=linearised,
                solution=solution,
                iterations=iterations,
                converged=optimum.converged,
            )


def _free(state: State, linearised: Linearised, levels: NoiseLevels, noise: NoiseOptions) -> Array:
    """Basis (6, k) of the free directions of X, in units of the limits."""
    solution = estimate_noise(replace(linearised, held=None), levels, noise)
    return free_basis(determined(state, linearised, solution).joint[:6, :6])


def intrinsics_pull(
    base_T_gripper: Array,
    kept: Refinement,
    prior: IntrinsicsPrior,
    known: KnownPoints | None = None,
    known_x: Sequence[Prior] = (),
) -> float:
    """How far the images would move intrinsics that were kept: a chi-square of 8.

    It is the score test: one linear step from the optimum with the intrinsics as unknowns, against
    the covariance of that step.

    Args:
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        kept: the optimum with the intrinsics at the centre of ``prior``.
        prior: of the intrinsics, wide.
        known: known points, as in the refinement.
        known_x: what is known of X beforehand, likewise.
    """
    observed = Kept(
        state=kept.state,
        tracks=kept.tracks,
        sigma_scale=kept.sigma_scale,
        pixel=kept.noise.pixel,
        corner=kept.noise.corner or 1.0,
    )
    problem = make_problem(observed, base_T_gripper, "base", prior, known, known_x, ~kept.outliers)
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
    known: KnownPoints | None = None,
    known_x: Sequence[Prior] = (),
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
        known: positions of the first points, which hold the world instead; None: there are none.
        known_x: what is known of X beforehand.
        frame: parent frame of X, for messages.

    Raises:
        ReconstructionError: too few observations are left.
        ConvergenceError: no finite optimum.
    """
    _require_finite(start)
    scales = np.ones(len(model.tracks.pixels)) if sigma_scale is None else sigma_scale
    n_known = 0 if known is None else len(known.points_world)
    kept = without_mismatches(start, model.tracks, scales, n_known)
    problem = make_problem(kept, base_T_gripper, gauge, intrinsics, known, known_x)
    levels = _first_noise(kept, base_T_gripper, with_corners=known is not None)
    first = _fitted(problem, kept.state, levels, 1, noise, options, progress)

    # Mismatches that hid behind a wrong start show now.
    kept = without_mismatches(first.state, kept.tracks, kept.sigma_scale, n_known)
    problem = make_problem(kept, base_T_gripper, gauge, intrinsics, known, known_x)
    levels = first.solution.noise
    fit = _fitted(problem, kept.state, levels, _MAX_ROUNDS, noise, options, progress)
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
        kept.tracks,
        kept.sigma_scale,
        fit.state,
        fit.linearised,
        fit.solution,
        robot_residuals(fit.state, base_T_gripper),
        problem.trusted,
        iterations=iterations,
        converged=fit.converged,
        frame=frame,
    )
