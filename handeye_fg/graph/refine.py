"""Joint refinement of points, camera poses, X, Z, scale and intrinsics; entry point ``refine``."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from handeye_fg.errors import ConvergenceError
from handeye_fg.findings import LinearStart, NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.correlation import inflation
from handeye_fg.graph.determined import determined
from handeye_fg.graph.holdout import held_out
from handeye_fg.graph.known import Known
from handeye_fg.graph.measurements import Gauge
from handeye_fg.graph.mismatches import Kept, without_mismatches
from handeye_fg.graph.noise import Solution, cost, estimate_noise
from handeye_fg.graph.outliers import agreeing
from handeye_fg.graph.problem import IntrinsicsPrior, Problem, make_problem
from handeye_fg.graph.reduced import Linearised
from handeye_fg.graph.rig import apart, first_camera_poses, is_plain
from handeye_fg.graph.second_start import second_start
from handeye_fg.graph.summary import Refinement, robot_residuals, summarise
from handeye_fg.graph.threads import one_blas_thread
from handeye_fg.graph.variables import LOG_SCALE, State
from handeye_fg.observability import free_basis
from handeye_fg.options import GraphOptions, NoiseOptions
from handeye_fg.progress import Progress
from handeye_fg.types import CameraModel, KnownPoints, Rig, SfmModel

# The first fit only tells which observations are mismatches: errors that are right to a part of 5e-4 do.
_FIRST_TOLERANCE = 1e-3
# After a step the cost may differ by this part from what the linearised problem promised. What is left
# to gain is less than the difference; with the cost near half the number of observations N, that is
# sqrt(1e-7 N) sigma in all directions together, and in fact about a hundredth of it.
_TOLERANCE = 1e-7
_LEAST_COST = 1e-4  # below it, without noise, a drop of the cost is rounding
_GOOD = 0.25  # part of a step's expected decrease that may be missing
_MOST_RESTARTS = 2  # from a better optimum; a second one was never seen
_MOST_ROUNDS = 5  # of leaving out mismatches
# Part of the observations: where no more go, the next round is the last one; where hardly any, this one is.
_FEW, _NEGLIGIBLE = 0.02, 1e-3
_MOST_SETS = 5  # of robot poses that agree; a second one is rare
_MOST_PARTS = 12  # the last one is a step of less than a hundredth


def start_state(
    model: SfmModel, cameras: Sequence[CameraModel], linear: LinearStart, rig: Rig | None = None
) -> State:
    """The SfM model, the intrinsics and the linear start as first values.

    Args:
        model: the SfM model.
        cameras: intrinsics of each camera.
        linear: the linear start.
        rig: which camera took an image of the model, and where; None: one camera.

    Raises:
        ValueError: the linear start is of motions, without base_T_world.
    """
    if linear.base_T_world is None:
        raise ValueError(f"{linear.base_T_world=} but expected a pose")
    others = np.eye(4)[None] if linear.first_T_cameras is None else linear.first_T_cameras
    state = State(
        world_T_camera=model.world_T_camera,
        points_world=model.tracks.points_world,
        gripper_T_cameras=linear.gripper_T_camera @ others,
        base_T_world=linear.base_T_world,
        log_scale=float(np.log(linear.metres_per_world_unit)),
        cameras=tuple(cameras),
        rig=rig or Rig.of_one_camera(len(model.names)),
    )
    return state if is_plain(state.rig) else first_camera_poses(state, model.world_T_camera)


def _require_finite(start: State) -> None:
    """Refuse values that GTSAM would return unchanged and in silence."""
    names = {field.name for field in fields(start)} - {"rig", "cameras"}
    values = [getattr(start, name) for name in names] + [camera.params for camera in start.cameras]
    if not all(np.isfinite(value).all() for value in values):
        raise ConvergenceError(
            "the joint refinement cannot start: the reconstruction or the linear start has values "
            "that are not finite; check the robot poses and the reconstruction"
        )


def _first_noise(kept: Kept, residuals: Array, *, with_corners: bool) -> NoiseLevels:
    """Levels from the robot residuals (n, 6) of the poses that are used, at the start."""
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
    """An optimum with noise levels that agree with it; ``linearised`` one small last step before it.

    ``path``: the first camera's X (4, 4) after each step so far.
    """

    state: State
    linearised_at: State
    linearised: Linearised
    solution: Solution
    path: tuple[Array, ...]
    converged: bool


def _fitted(
    problem: Problem,
    start: State,
    levels: NoiseLevels,
    noise: NoiseOptions,
    tolerance: float,
    max_iterations: int,
    progress: Progress,
    path: tuple[Array, ...] = (),
) -> _Fit:
    """Optimise, and find the noise levels of each linearised problem before its step.

    Along directions that the data leave free X stays where it starts: noise, which bends the cost a
    little, would otherwise carry it away, and the linearisation with it.
    """
    state, linearised, steps = start, problem.linearised(start), list(path)
    while True:
        bare = replace(linearised, held=None)
        solution = estimate_noise(bare, levels, noise)
        # The images tie the other cameras to the first, or the world that they share does.
        free = free_basis(determined(state, bare, solution, noise).joints[0, :6, :6])
        problem = problem.holding(start.gripper_T_camera, free)
        linearised = replace(bare, held=problem.held_at(state))
        if linearised.held is not None:
            solution = estimate_noise(linearised, solution.noise, noise)
        levels, converged = solution.noise, False
        if len(steps) - len(path) < max_iterations:
            expected = cost(linearised, levels) - solution.decrease
            enough = tolerance * max(expected, _LEAST_COST)
            moved, found = _stepped(problem, state, linearised, solution, expected, enough)
            steps.append(moved.gripper_T_camera)
            progress("iterations", len(steps), None)
            # A Hessian that is wrong by a part q along the step makes q times the decrease of the
            # difference, and leaves q^2 times it to the next step.
            converged = abs(found - expected) <= enough
            if not converged:
                state, linearised = moved, problem.linearised(moved)
                continue
        else:
            moved = state
        return _Fit(
            state=moved,
            linearised_at=state,
            linearised=linearised,
            solution=solution,
            path=tuple(steps),
            converged=converged,
        )


def _inflation(problem: Problem, fit: _Fit) -> float:
    """How much less the images say of all X and the scale than with independent errors."""
    columns = np.append(problem.layout.all_x_columns, problem.layout.columns(LOG_SCALE))
    return inflation(problem, fit.linearised_at, fit.solution, columns)


def _stepped(
    problem: Problem,
    state: State,
    linearised: Linearised,
    solution: Solution,
    expected: float,
    enough: float,
) -> tuple[State, float]:
    """A state with a lower cost, and this cost: the whole step, or a part of it if that is better.

    Where the problem is flat and bent, whole steps would go to and fro across the minimum.

    Args:
        problem: the problem.
        state: where the step starts.
        linearised: the problem there.
        solution: the step.
        expected: cost after the step if the linearised problem is right.
        enough: difference from ``expected`` that is good enough.

    Raises:
        ConvergenceError: no part of the step lowers the cost.
    """
    levels = solution.noise
    moved = problem.moved(state, linearised, solution.step)
    found = problem.cost(moved, levels)
    before = problem.cost(state, levels)
    gain, part = before - expected, 1.0
    if found - expected <= max(_GOOD * gain, enough):
        return moved, found
    for _ in range(_MOST_PARTS):
        # The parabola with the cost and the slope at the start, and the cost after the step.
        bend = max(found - before + 2.0 * gain * part, np.finfo(float).tiny)
        lowest = gain * part**2 / bend
        part = float(np.clip(np.nan_to_num(lowest), 0.1 * part, 0.9 * part))
        shorter = problem.moved(state, linearised, solution.step, part)
        there = problem.cost(shorter, levels)
        if min(found, there) <= before:
            return (moved, found) if found < there else (shorter, there)
        moved, found = shorter, there
    raise ConvergenceError(
        "the joint refinement diverged: no step lowers its cost; check the robot poses and the "
        "reconstruction"
    )


@one_blas_thread()
def refine(
    model: SfmModel,
    base_T_gripper: Array,
    start: State,
    *,
    intrinsics: Sequence[IntrinsicsPrior],
    noise: NoiseOptions,
    options: GraphOptions,
    progress: Progress,
    gauge: Gauge = "base",
    known: KnownPoints | None = None,
    priors: Sequence[Known] = (),
    frame: str = "gripper",
    inverted: bool = False,
    trusted: NDArray[np.bool_] | None = None,
    held: NDArray[np.bool_] | None = None,
) -> Refinement:
    """Refine everything together and estimate the noise levels with it.

    Args:
        model: tracks, and the SfM poses that define the world's unit.
        base_T_gripper: reported robot poses (n, 4, 4), metres, in the order of ``start.rig``.
        start: first values; its cameras are those that see the tracks.
        intrinsics: prior of each camera's intrinsics; empty to keep all fixed.
        noise: the levels that the user knows.
        options: of the optimiser.
        progress: told the number of iterations.
        gauge: what holds the world; no reported figure depends on it.
        known: positions of the first points, which hold the world instead; None: there are none.
        priors: what else is known beforehand.
        frame: parent frame of X, for messages.
        inverted: the robot poses are gripper_T_base; noise and residuals are those of base_T_gripper.
        trusted: (n,) which robot poses are believed at first; None: all. In the end every pose is
            judged by the others.
        held: (n,) which robot poses are kept out of everything, and predicted in the end; None: none.

    Raises:
        ReconstructionError: too few observations are left.
        ConvergenceError: no finite optimum.
    """
    _require_finite(start)
    scales = np.ones(len(model.tracks.pixels))
    n_known = 0 if known is None else len(known.points_world)
    believed = np.ones(len(base_T_gripper), dtype=bool) if trusted is None else trusted
    believed = believed if held is None else believed & ~held

    def build(kept: Kept, used: NDArray[np.bool_]) -> Problem:
        return make_problem(
            kept, base_T_gripper, gauge, intrinsics, known, priors, used, inverted=inverted
        )

    path: tuple[Array, ...] = ()
    restarts = 0
    while True:
        # Structure from motion placed each image by itself, which is where its mismatches show.
        seen = start if is_plain(start.rig) else apart(start, model.world_T_camera)
        kept = without_mismatches(seen, model.tracks, scales, n_known)
        kept = replace(kept, state=replace(start, points_world=kept.state.points_world))
        kept, problem, fit = _optimum(
            build,
            kept,
            n_known,
            believed,
            held,
            noise,
            options.max_iterations,
            progress,
            path,
        )
        path = fit.path
        result = summarise(
            model,
            kept.tracks,
            kept.sigma_scale,
            fit.state,
            fit.linearised,
            fit.solution,
            robot_residuals(fit.state, base_T_gripper, inverted=inverted),
            problem.trusted,
            noise,
            path=np.array(path).reshape(-1, 4, 4),
            converged=fit.converged,
            frame=frame,
        )
        if held is not None:
            predicted = held_out(
                held,
                fit.linearised,
                fit.solution,
                fit.state,
                kept.tracks,
                kept.sigma_scale,
                base_T_gripper,
                result.residuals,
            )
            result = replace(result, outliers=result.outliers & ~held, held_out=predicted)
        second, better = second_start(problem, fit.state, result.noise, result.observability, start)
        result = replace(result, second_start=replace(second, restarted=restarts > 0))
        if better is None or restarts == _MOST_RESTARTS:
            return result
        start, restarts = better, restarts + 1
        del fit, result  # large, and the next ones take as much again


def _optimum(
    build: Callable[[Kept, NDArray[np.bool_]], Problem],
    kept: Kept,
    n_known: int,
    used: NDArray[np.bool_],
    held: NDArray[np.bool_] | None,
    noise: NoiseOptions,
    limit: int,
    progress: Progress,
    path: tuple[Array, ...],
) -> tuple[Kept, Problem, _Fit]:
    """The optimum that a start leads to, without mismatches and without wrong robot poses.

    Args:
        build: makes the problem of certain observations and robot poses.
        kept: the start and the observations.
        n_known: number of known points.
        used: (n,) robot poses that are believed at first.
        held: (n,) those that are never used; None: there are none.
        noise: the levels that the user knows.
        limit: of iterations, in each round.
        progress: told the number of iterations.
        path: X after each step before.
    """
    problem = build(kept, used)
    residuals = robot_residuals(kept.state, problem.base_T_gripper, inverted=problem.inverted)
    levels = _first_noise(kept, residuals[used], with_corners=problem.known is not None)
    last, inflated = False, 1.0
    for rounds_left in reversed(range(_MOST_ROUNDS)):
        fit = _fitted(problem, kept.state, levels, noise, _FIRST_TOLERANCE, limit, progress, path)
        used, solution = agreeing(fit.linearised, fit.solution, used, noise, held)
        # Mismatches that hid behind a wrong start, or behind others, show now.
        left = without_mismatches(fit.state, kept.tracks, kept.sigma_scale, n_known)
        gone = 1.0 - len(left.tracks.pixels) / len(kept.tracks.pixels)
        last = last or gone < _NEGLIGIBLE or not (fit.converged and rounds_left)
        # What is left after leaving out looks more independent than its errors are.
        inflated = max(inflated, _inflation(problem, fit))
        levels = replace(solution.noise, image_inflation=inflated)
        kept, problem, path = left, build(left, used), fit.path
        del fit, solution  # large, and the next ones take as much again
        if last:
            break
        last = gone < _FEW
    fit = _fitted(problem, kept.state, levels, noise, _TOLERANCE, limit, progress, path)
    for _ in range(_MOST_SETS):
        used, solution = agreeing(fit.linearised, fit.solution, used, noise, held)
        if np.array_equal(used, problem.trusted):
            break
        problem, levels = replace(problem, trusted=used), solution.noise
        fit = _fitted(problem, fit.state, levels, noise, _TOLERANCE, limit, progress, fit.path)
    return kept, problem, fit
