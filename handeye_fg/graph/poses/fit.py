"""One noise model of poses fitted: the graph's optimum and its noise levels in turn; ``fitted``."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L
from numpy.typing import NDArray

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse, log, scaled
from handeye_fg.graph.certainty import Certainty
from handeye_fg.graph.measurements import joined
from handeye_fg.graph.optimise import optimise
from handeye_fg.graph.poses.components import Estimate, Guess, certainty_of, estimate
from handeye_fg.graph.poses.measurements import (
    Columns,
    Component,
    Measurement,
    NoiseModel,
    camera_measurements,
    graph_of,
    odometry_measurements,
    robot_measurements,
    rows_of,
    scale_measurements,
    tie,
)
from handeye_fg.graph.variables import BASE_T_WORLD, GRIPPER_T_CAMERA, camera_key, matrix_of

Rows = NDArray[np.bool_]

_MAX_ROUNDS = 12
_CONVERGED = 0.02  # of a standard deviation: change of X by another round
_MAX_ITERATIONS = 50
# Part of the first motion residuals' mean square that each component is first taken to cause.
_SHARE = 0.3
_MEDIAN_SQUARE = 0.455  # median of a chi-square of one
_FIRST_DRIFT = 1e-3  # of the logarithm of the scale from one pose to the next
# Residuals of poses below this (radians or metres) are rounding, or simulated: the noise is taken as
# so large and not estimated. Smaller ones leave nothing of the weak priors in double precision.
_EXACT = 1e-6
# Deviance by which accumulating errors must beat independent ones, and a drifting scale a constant
# one: the order of a few poses tells them apart badly, and drift is one more unknown variance.
_ODOMETRY_HANDICAP = 10.0
_DRIFT_HANDICAP = 4.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of all unknowns; the scale by pose, the camera poses in metres of the first scale."""

    world_T_camera: Array
    gripper_T_camera: Array
    base_T_world: Array
    log_scale: Array

    def only(self, rows: Rows) -> "State":
        """The state with some of its poses."""
        return replace(
            self, world_T_camera=self.world_T_camera[rows], log_scale=self.log_scale[rows]
        )

    def moved_by(self, values: gtsam.Values) -> Array:
        """Twist (6,) from this X to that of the values."""
        return log(inverse(self.gripper_T_camera) @ values.atPose3(GRIPPER_T_CAMERA).matrix())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """An optimum of one noise model over some of the poses."""

    state: State
    estimate: Estimate
    certainty: Certainty
    model: NoiseModel
    converged: bool

    @property
    def deviance(self) -> float:
        """The deviance, with the handicap of the models that must prove themselves."""
        handicap = _ODOMETRY_HANDICAP if self.model.camera == "odometry" else 0.0
        handicap += _DRIFT_HANDICAP if self.model.scale == "drifting" else 0.0
        return self.estimate.deviance + handicap

    @property
    def sigmas(self) -> dict[Component, float]:
        """Standard deviation of each component."""
        return _named(self.model, self.estimate.variances)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """The poses, in metres of the start's scale, their weights, and what does not change."""

    base_T_gripper: Array
    world_T_camera: Array
    weights: Array
    are_motions: bool
    inverted: bool
    scale_known: bool
    priors: gtsam.NonlinearFactorGraph
    held: gtsam.NonlinearFactorGraph
    given: Mapping[Component, float]

    def only(self, rows: Rows) -> "Problem":
        """The problem with some of its rows."""
        return replace(
            self,
            base_T_gripper=self.base_T_gripper[rows],
            world_T_camera=self.world_T_camera[rows],
            weights=self.weights[rows],
        )

    def measurements(self, model: NoiseModel) -> list[Measurement]:
        """All that a noise model measures."""
        camera = (
            camera_measurements(self.world_T_camera, self.weights)
            if model.camera == "independent"
            else odometry_measurements(self.world_T_camera)
        )
        return [
            *robot_measurements(
                self.base_T_gripper, self.weights, model.scale, inverted=self.inverted
            ),
            *camera,
            *scale_measurements(len(self.base_T_gripper), model.scale),
            *([tie()] if self.are_motions else []),
        ]


def fitted(problem: Problem, first: State, rows: Rows, model: NoiseModel) -> Fit:
    """Optimum and noise levels in turn, until X stays the same."""
    part, first = problem.only(rows), first.only(rows)
    n = len(part.base_T_gripper)
    _require_enough(n, problem)
    measurements = part.measurements(model)
    columns = Columns(n_poses=n, scale=model.scale)
    sigmas = _named(model, _guess(part, first, model).variances)
    values, before, rounds = _values(first, model), np.zeros(6), _MAX_ROUNDS
    while True:
        optimum = optimise(
            graph_of(measurements, joined([part.priors, part.held]), sigmas),
            values,
            columns.ordering,
            max_iterations=_MAX_ITERATIONS,
        )
        values = optimum.values
        linear = rows_of(measurements, part.priors, values, columns, model.components)
        guess = _guess(part, _state(values, columns), model)
        start = np.array([sigmas[name] ** 2 for name in model.components])
        found = estimate(linear, guess, start, columns.wanted)
        sigmas = _named(model, found.variances)
        now = first.moved_by(values)
        # What is still to come, or (what is held does not know of it) what the last round brought.
        std = np.sqrt(np.diag(found.covariance)[:6])
        steps = [found.step[columns.wanted[:6]] / std, (now - before) / std]
        still = min(float(np.abs(step).max()) for step in steps) < _CONVERGED
        converged = optimum.converged and still
        before, rounds = now, rounds - 1
        if converged or rounds == 0:
            return Fit(
                state=_state(values, columns),
                estimate=found,
                certainty=certainty_of(linear, guess, found.variances, columns.wanted),
                model=model,
                converged=converged,
            )


def _require_enough(n: int, problem: Problem) -> None:
    fewest = 2 if problem.are_motions else 3
    if n < fewest:
        raise InputDataError(
            f"{n} {'motions' if problem.are_motions else 'poses'} are too few for the pose graph: "
            f"at least {fewest} are needed, ten or more are advised"
        )


def _named(model: NoiseModel, variances: Array) -> dict[Component, float]:
    """Standard deviations by component."""
    return dict(zip(model.components, np.sqrt(variances).tolist(), strict=True))


def _guess(problem: Problem, state: State, model: NoiseModel) -> Guess:
    """Rough variance of each component at some X, Z and scale, and whether it is the user's.

    From motions to the next pose, which accumulated errors do not spoil; by their median, which a
    few wrong ones do not.
    """
    A, B = problem.base_T_gripper, scaled(problem.world_T_camera, np.exp(state.log_scale)[:, None])
    predicted = state.base_T_world @ B @ inverse(state.gripper_T_camera)
    if problem.are_motions:
        residuals = log(inverse(A) @ predicted)
    else:
        moved = inverse(A[:-1]) @ A[1:]
        residuals = log(inverse(moved) @ inverse(predicted[:-1]) @ predicted[1:])
    squares = np.median(residuals.reshape(-1, 2, 3) ** 2, axis=(0, 2)) / _MEDIAN_SQUARE
    rotation, translation = np.maximum(_SHARE * squares, _EXACT**2)
    variances = {
        name: _FIRST_DRIFT**2
        if name == "scale_drift"
        else float(rotation if name.endswith("rotation") else translation)
        for name in model.components
    }
    given = {name: sigma**2 for name, sigma in problem.given.items()}
    if max(rotation, translation) <= _EXACT**2:
        given = variances | given
    variances |= given
    return Guess(
        variances=np.array([variances[name] for name in model.components]),
        given=np.array([name in given for name in model.components]),
    )


def _values(state: State, model: NoiseModel) -> gtsam.Values:
    """The unknowns as GTSAM's values."""
    values = gtsam.Values()
    for i, matrix in enumerate(state.world_T_camera):
        values.insert(camera_key(i), gtsam.Pose3(matrix))
    values.insert(GRIPPER_T_CAMERA, gtsam.Pose3(state.gripper_T_camera))
    values.insert(BASE_T_WORLD, gtsam.Pose3(state.base_T_world))
    scales = state.log_scale if model.scale == "drifting" else np.zeros(1)
    for i, value in enumerate(scales):
        values.insert(L(i), float(value))
    return values


def _state(values: gtsam.Values, columns: Columns) -> State:
    """The values of the unknowns."""
    n, drifting = columns.n_poses, columns.scale == "drifting"
    scales = [values.atDouble(L(i if drifting else 0)) for i in range(n)]
    return State(
        world_T_camera=np.array([matrix_of(values.atPose3(camera_key(i))) for i in range(n)]),
        gripper_T_camera=matrix_of(values.atPose3(GRIPPER_T_CAMERA)),
        base_T_world=matrix_of(values.atPose3(BASE_T_WORLD)),
        log_scale=np.array(scales),
    )
