"""The best answer from poses alone: both noises modelled, estimated and told apart; ``pose_graph``.

Unknowns are the true poses, X, Z and the scale. The robot's poses are measurements with noise, and so
are the camera's: each with an error of its own (poses from a target, from structure from motion), or
each motion with one, so that errors accumulate (odometry); the scale may drift. Which of these it is
the restricted likelihood tells. Noise levels and the graph's optimum are found in turn.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L
from scipy import linalg, stats

from handeye_fg.errors import ConvergenceError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array, inverse, log, scaled
from handeye_fg.graph.measurements import held_graph, joined, known_graph
from handeye_fg.graph.poses.fit import Fit, Problem, Rows, State, fitted
from handeye_fg.graph.poses.measurements import (
    CameraNoise,
    Component,
    NoiseModel,
    Scale,
    camera_measurements,
    robot_measurements,
)
from handeye_fg.graph.variables import GRIPPER_T_CAMERA
from handeye_fg.known import OfXAndScale
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.observability import LIMITS, WIDE, feigned_information, without_feigned
from handeye_fg.options import RobotNoise
from handeye_fg.priors import ScalePrior

# A robot pose as improbable as this among n good ones (over n) disagrees.
_FALSE_ALARM = 1e-2
_MOST = 0.5  # of the poses that may be left out
_NORMAL = 1e6  # degrees of freedom of what is as good as a normal distribution
_ROUNDING = 1e-15  # relative: of the variances of the principal directions
_MAX_ROUNDS = 12
_CONCERNED = 0.1  # part of a free direction from which X is concerned
_HELD_SCALE = 1e-3  # of the logarithm of a scale that is kept where it is


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseGraph:
    """An optimum over poses.

    Attributes:
        gripper_T_camera, base_T_world: X and Z (4, 4), metres; Z = X where motions were given.
        metres_per_world_unit: the scale; where it drifts, at the first pose.
        covariance: (7, 7) of (X, ln scale), order (rotation, translation, ln scale), right
            perturbation: that of a t distribution with ``degrees_of_freedom``.
        degrees_of_freedom: effective, of the estimated noise levels.
        noise: standard deviation of each component: radians, metres (camera: world units), and of
            the logarithm of the scale from pose to pose.
        model: what kind of noise the camera has.
        residuals: (n, 6) of the robot poses in the gripper frame, camera poses taken as measured.
        outliers: whether each pose (n,) disagrees with the others and was left out.
        converged: whether rounds and optimisation ended before their limits.
    """

    gripper_T_camera: Array
    base_T_world: Array
    metres_per_world_unit: float
    covariance: Array
    degrees_of_freedom: float
    noise: Mapping[Component, float]
    model: NoiseModel
    residuals: Array
    outliers: Rows
    converged: bool


def pose_graph(
    data: PosePairs | MotionPairs,
    start: LinearStart,
    *,
    scale_known: bool = False,
    inverted: bool = False,
    camera_noise: CameraNoise | None = None,
    trusted: Rows | None = None,
    noise: RobotNoise | None = None,
    priors: Sequence[OfXAndScale] = (),
    free: Array | None = None,
) -> PoseGraph:
    """Refine X, Z, the scale and the true poses together, and estimate the noise with them.

    Args:
        data: poses of robot and camera, in the order in which they were taken; or motions, whose
            errors are taken as independent. A weight divides the variances of its row (of odometry:
            those of the robot's pose); rows of weight zero are left out.
        start: first values.
        scale_known: whether the camera's translations are in metres.
        inverted: the robot's poses are gripper_T_base (eye-to-hand).
        camera_noise: None: told from the data.
        trusted: rows (n,) to begin with; later each row that fits is used. None: all.
        noise: the robot's levels, where they are known.
        priors: what is known of X and, unless it is known to be 1, of the scale.
        free: orthonormal columns (7, k), in units of ``observability.LIMITS``: directions of
            (X, ln scale) that the motions leave free; there the start is kept.

    Raises:
        InputDataError: fewer poses than unknowns need.
        ConvergenceError: no finite optimum.
        ValueError: the start of poses has no base_T_world.
    """
    if isinstance(data, MotionPairs):
        A, B = data.gi_T_gj, data.ci_T_cj
    else:
        A, B = data.base_T_gripper, data.world_T_camera
    base_T_world = start.gripper_T_camera if isinstance(data, MotionPairs) else start.base_T_world
    if base_T_world is None:
        raise ValueError(f"{start.base_T_world=} but expected a pose")
    weights = np.asarray(data.weights)
    usable = weights > 0.0
    unit = start.metres_per_world_unit
    problem = Problem(
        base_T_gripper=A,
        world_T_camera=scaled(B, unit),
        weights=np.where(usable, weights, 1.0),
        are_motions=isinstance(data, MotionPairs),
        inverted=inverted,
        scale_known=scale_known,
        priors=joined([_wide_prior(start.gripper_T_camera), _known(priors, unit)]),
        held=_held(start.gripper_T_camera, np.zeros((7, 0)) if free is None else free),
        given=_given(noise or RobotNoise()),
    )
    first = State(
        world_T_camera=problem.world_T_camera,
        gripper_T_camera=start.gripper_T_camera,
        base_T_world=base_T_world,
        log_scale=np.zeros(len(A)),
    )
    rows = usable if trusted is None else usable & trusted
    best = _best(problem, first, rows, camera_noise)
    if best.model.camera == "independent":
        best, rows = _with_fitting_rows(problem, first, best, rows, usable)
    return _result(problem, best, rows, usable, unit)


def _best(problem: Problem, first: State, rows: Rows, camera_noise: CameraNoise | None) -> Fit:
    """The fit of the noise model that explains the poses best."""
    kinds: tuple[CameraNoise, ...] = ("independent", "odometry")
    if problem.are_motions:
        kinds = ("independent",)
    elif camera_noise is not None:
        kinds = (camera_noise,)
    constant: Scale = "known" if problem.scale_known else "free"
    freest: Scale = "drifting" if constant == "free" and not problem.are_motions else constant
    fits = _fits(problem, first, rows, [NoiseModel(camera=k, scale=freest) for k in kinds])
    if freest == "drifting":
        if fits:
            kinds = (min(fits, key=lambda fit: fit.deviance).model.camera,)
        fits += _fits(problem, first, rows, [NoiseModel(camera=k, scale=constant) for k in kinds])
    if not fits:
        raise ConvergenceError(
            "the poses do not determine the unknowns of the pose graph: robot and camera poses "
            "hold too little motion or do not belong together; check them, or add poses"
        )
    return min(fits, key=lambda fit: fit.deviance)


def _fits(problem: Problem, first: State, rows: Rows, models: Sequence[NoiseModel]) -> list[Fit]:
    """The fits of those noise models that have an optimum."""
    fits = []
    for model in models:
        with suppress(ConvergenceError):
            fits.append(fitted(problem, first, rows, model))
    return fits


def _given(noise: RobotNoise) -> dict[Component, float]:
    """The user's levels."""
    given: dict[Component, float] = {}
    if noise.robot_rotation_deg is not None:
        given["robot_rotation"] = float(np.deg2rad(noise.robot_rotation_deg))
    if noise.robot_translation_mm is not None:
        given["robot_translation"] = 1e-3 * noise.robot_translation_mm
    return given


def _with_fitting_rows(
    problem: Problem, first: State, fit: Fit, rows: Rows, usable: Rows
) -> tuple[Fit, Rows]:
    """The fit to all poses that agree with it, whatever rows it began with."""
    allowed = int(_MOST * np.count_nonzero(usable))
    for _ in range(_MAX_ROUNDS):
        squares = _squares(problem, fit, rows)
        freedom = min(fit.certainty.freedom, _NORMAL)
        limit = 6.0 * float(stats.f.isf(_FALSE_ALARM / len(usable), 6, freedom))
        best = np.sort(squares[usable])[-allowed - 1]
        fitting = usable & (squares <= max(limit, best))
        if np.array_equal(fitting, rows):
            break
        rows = fitting
        fit = fitted(problem, first, rows, fit.model)
    return fit, rows


def _residuals(problem: Problem, fit: Fit, rows: Rows) -> tuple[Array, Array]:
    """Residuals (n, 6) of all robot poses at the measured camera poses, and the scales (n,)."""
    state = fit.state
    scale = np.exp(np.interp(np.arange(len(rows)), np.flatnonzero(rows), state.log_scale))
    metric = np.array(problem.world_T_camera)
    metric[:, :3, 3] *= scale[:, None]
    predicted = state.base_T_world @ metric @ inverse(state.gripper_T_camera)
    return log(inverse(problem.base_T_gripper) @ predicted), scale


def _squares(problem: Problem, fit: Fit, rows: Rows) -> Array:
    """Mahalanobis squares (n,) of robot against camera poses, each with an error of its own."""
    residuals, scales = _residuals(problem, fit, rows)
    robot = robot_measurements(
        problem.base_T_gripper, problem.weights, fit.model.scale, inverted=problem.inverted
    )
    camera = camera_measurements(problem.world_T_camera, problem.weights)
    to_gripper = gtsam.Pose3(fit.state.gripper_T_camera).AdjointMap()
    squares = []
    for residual, scale, r, c in zip(residuals, scales, robot, camera, strict=True):
        seen = to_gripper * np.repeat([1.0, scale], 3)
        covariance = r.covariance(fit.sigmas) + seen @ c.covariance(fit.sigmas) @ seen.T
        squares.append(residual @ np.linalg.solve(covariance, residual))
    return np.array(squares)


def _result(problem: Problem, fit: Fit, rows: Rows, usable: Rows, unit: float) -> PoseGraph:
    """The optimum in the units of the input."""
    in_world_units = ("camera_across", "camera_along", "odometry_translation")
    return PoseGraph(
        gripper_T_camera=fit.state.gripper_T_camera,
        base_T_world=fit.state.base_T_world,
        metres_per_world_unit=unit
        * (1.0 if problem.scale_known else float(np.exp(fit.state.log_scale[0]))),
        covariance=_covariance(fit, int(np.count_nonzero(rows))),
        degrees_of_freedom=fit.certainty.freedom,
        noise={
            name: sigma / unit if name in in_world_units else sigma
            for name, sigma in fit.sigmas.items()
        },
        model=fit.model,
        residuals=_residuals(problem, fit, rows)[0],
        outliers=usable & ~rows,
        converged=fit.converged,
    )


def _covariance(fit: Fit, n: int) -> Array:
    """That of a t distribution, less the information that only noise feigns."""
    variances, vectors = np.linalg.eigh(fit.certainty.covariance / np.outer(LIMITS, LIMITS))
    variances = np.maximum(variances, _ROUNDING * variances[-1])
    # Robot and camera noise together are both the error of the motions and that of the residuals.
    rotations = [s for name, s in fit.sigmas.items() if name.endswith("rotation")]
    distances = [s for name, s in fit.sigmas.items() if not name.endswith(("rotation", "drift"))]
    std = np.array([np.linalg.norm(rotations), np.linalg.norm(distances)])
    feigned = feigned_information(fit.state.gripper_T_camera, n - 1, std, std)
    return without_feigned(1.0 / variances, vectors, feigned)


def _known(priors: Sequence[OfXAndScale], unit: float) -> gtsam.NonlinearFactorGraph:
    """What is known beforehand; the scale is relative to that of the start, ``unit``."""
    graph = known_graph([prior for prior in priors if not isinstance(prior, ScalePrior)])
    for prior in priors:
        if isinstance(prior, ScalePrior):
            noise = gtsam.noiseModel.Isotropic.Sigma(1, prior.std / prior.value)
            graph.addPriorDouble(L(0), float(np.log(prior.value / unit)), noise)
    return graph


def _wide_prior(gripper_T_camera: Array) -> gtsam.NonlinearFactorGraph:
    """Keeps X finite where the motions leave it free, without weight elsewhere."""
    graph = gtsam.NonlinearFactorGraph()
    model = gtsam.noiseModel.Diagonal.Sigmas(WIDE[:6])
    graph.addPriorPose3(GRIPPER_T_CAMERA, gtsam.Pose3(gripper_T_camera), model)
    return graph


def _held(gripper_T_camera: Array, free: Array) -> gtsam.NonlinearFactorGraph:
    """Keeps X, and where X is not concerned the scale, at the start along free directions."""
    graph = held_graph(gripper_T_camera, linalg.orth(free[:6], rcond=_CONCERNED))
    if np.any(np.linalg.norm(free[:6], axis=0) < _CONCERNED):
        graph.addPriorDouble(L(0), 0.0, gtsam.noiseModel.Isotropic.Sigma(1, _HELD_SCALE))
    return graph
