"""From pose pairs to X: the rows that agree, a closed form, and the pose graph; entry ``answer_of``."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handeye_fg.errors import ConvergenceError, InputDataError, UnobservableError
from handeye_fg.findings import LinearStart, NoiseLevels
from handeye_fg.from_poses.answer import Answer
from handeye_fg.known import OfXAndScale
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.observability import analyse
from handeye_fg.options import RobotNoise
from handeye_fg.solvers import (
    METHODS,
    Solution,
    first_order_covariance,
    only,
    partial,
    start_of,
    trusted_rows,
)

Rows = NDArray[np.bool_]

# Robot and camera that differ by more than this contradict each other: other conventions, units or
# rows; the noise of poses that are of any use is smaller. Radians, and a part of the camera's own
# motion (root mean squares over motions).
_CONTRADICTION_ROTATION = math.radians(15.0)
_CONTRADICTION_TRANSLATION = 0.5
# Logarithm of a scale that no inaccurate board or map explains.
_OTHER_UNIT = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Method:
    """How X is to be found.

    Attributes:
        name: a closed form, or "pose_graph".
        frame: the parent of X.
        scale_known: whether the camera's translations are in metres.
        inverted: whether the robot's poses are inverses, as for eye-to-hand.
        camera_noise: of the pose graph; None: the data tell.
        noise: the robot's noise levels, where they are known.
        priors: in terms of X and the scale.
        robust: whether rows that disagree with the majority are left out.
        seed: of the samples that tell wrong rows from right ones.
    """

    name: str
    frame: str
    scale_known: bool
    inverted: bool
    camera_noise: Literal["independent", "odometry"] | None
    noise: RobotNoise | None
    priors: Sequence[OfXAndScale]
    robust: bool
    seed: int

    @property
    def closed_form(self) -> str:
        """That which answers, or which the pose graph starts from."""
        if self.name != "pose_graph":
            return self.name
        return "shah" if self.scale_known else "andreff_scale"


def answer_of(data: PosePairs | MotionPairs, method: Method) -> Answer:
    """X of the rows that agree, or what they determine of it.

    Raises:
        InputDataError: robot and camera follow different conventions, or the camera's unit is not the metre.
        UnobservableError: the robot or the camera did not move.
        ConvergenceError: robot and camera contradict each other.
    """
    trusted = _trusted(data, method)
    answer = _closed_form(data, trusted, method)
    return _refined(data, answer, method) if method.name == "pose_graph" else answer


def _trusted(data: PosePairs | MotionPairs, method: Method) -> Rows:
    """The rows (n,) that are used: those with a weight, less those that disagree with the others."""
    trusted = np.asarray(data.weights) > 0.0
    if method.robust and trusted.any():
        rows = only(data, trusted)
        trusted[trusted] = trusted_rows(rows, scale_known=method.scale_known, seed=method.seed)
    return trusted


def _closed_form(data: PosePairs | MotionPairs, trusted: Rows, method: Method) -> Answer:
    """The method's answer; with priors, or where the motions leave something free, that of ``partial``."""
    rows, scale_known, name = only(data, trusted), method.scale_known, method.closed_form

    def found(solution: Solution, name: str, priors: Sequence[OfXAndScale]) -> Answer:
        start = start_of(rows, solution, name)
        if scale_known:
            _require_metres(rows, start)
        _require_agreement(rows, start)
        covariance = first_order_covariance(rows, solution, scale_known=scale_known, priors=priors)
        return Answer(
            method="least squares" if name == "partial" else name,
            start=start,
            gripper_T_camera=start.gripper_T_camera,
            base_T_world=start.base_T_world,
            metres_per_world_unit=start.metres_per_world_unit,
            observability=analyse(covariance, start.gripper_T_camera, method.frame),
            trusted=trusted,
            note="The covariance is approximate: first order, with the noise of the residuals.",
        )

    answer: Answer | None = None
    with suppress(UnobservableError):
        answer = found(METHODS[name].solve(rows), name, ())
    if answer is None or answer.observability.free_directions or method.priors:
        solution = partial(rows, scale_known=scale_known, priors=method.priors)
        answer = found(solution, "partial", method.priors)
    return answer


def _refined(data: PosePairs | MotionPairs, closed: Answer, method: Method) -> Answer:
    """The pose graph's answer, from a closed form; it judges the rows again."""
    from handeye_fg.graph.poses import pose_graph  # noqa: PLC0415  # GTSAM is for this method alone

    graph = pose_graph(
        data,
        closed.start,
        scale_known=method.scale_known,
        inverted=method.inverted,
        camera_noise=method.camera_noise,
        trusted=closed.trusted,
        noise=method.noise,
        priors=method.priors,
        free=closed.observability.free_basis,
    )
    X, scale = graph.gripper_T_camera, graph.metres_per_world_unit
    levels = {str(name): sigma for name, sigma in graph.noise.items()}
    drifts = graph.model.scale == "drifting"
    errors = "accumulate along the rows" if graph.model.camera == "odometry" else "are independent"
    return replace(
        closed,
        method="pose_graph",
        gripper_T_camera=X,
        base_T_world=graph.base_T_world if isinstance(data, PosePairs) else None,
        metres_per_world_unit=scale,
        observability=analyse(graph.covariance, X, method.frame),
        trusted=(np.asarray(data.weights) > 0.0) & ~graph.outliers,
        note=f"The errors of the camera poses {errors}."
        + (" Their unit drifts; the scale is that of the first." if drifts else "")
        + ("" if graph.converged else " The refinement stopped before it converged."),
        noise=NoiseLevels(
            pixel=math.nan,
            robot_rotation=levels["robot_rotation"],
            robot_translation=levels["robot_translation"],
            estimated=method.noise is None or method.noise.estimated,
        ),
        figures={
            "degrees_of_freedom": graph.degrees_of_freedom,
            **_camera_noise(levels, scale),
        },
    )


def _camera_noise(levels: Mapping[str, float], metres_per_world_unit: float) -> dict[str, float]:
    """Noise levels of the camera poses, in the units of reports."""
    figures = {}
    for name, sigma in levels.items():
        if name.startswith("robot"):
            continue
        if name.endswith("rotation"):
            figures[f"{name}_deg"] = math.degrees(sigma)
        elif name.endswith("drift"):
            figures[f"{name}_percent"] = 100.0 * sigma
        else:
            figures[f"{name}_mm"] = 1e3 * metres_per_world_unit * sigma
    return figures


def _require_metres(data: PosePairs | MotionPairs, start: LinearStart) -> None:
    """Refuse camera translations in another unit: a wrong X absorbs much of a wrong scale.

    Raises:
        InputDataError: they fit much better with another scale.
    """
    with suppress(UnobservableError):
        other = start_of(data, METHODS["andreff_scale"].solve(data), "andreff_scale")
        unit = other.metres_per_world_unit
        if (
            abs(math.log(unit)) > _OTHER_UNIT
            and other.residual_translation < 0.5 * start.residual_translation
        ):
            raise InputDataError(
                f"the camera's translations are not in metres: they fit the robot's with {unit:.4g} "
                "metres per unit; convert them, or use andreff_scale or pose_graph, which find the unit"
            )


def _require_agreement(data: PosePairs | MotionPairs, start: LinearStart) -> None:
    """Refuse an answer in which robot and camera contradict each other.

    Raises:
        ConvergenceError: they differ by more than the noise of any poses.
    """
    moved = np.linalg.norm(as_motions(data).ci_T_cj[:, :3, 3], axis=1)
    motion = start.metres_per_world_unit * float(np.sqrt(np.mean(moved**2)))
    if (
        start.residual_rotation > _CONTRADICTION_ROTATION
        or start.residual_translation > _CONTRADICTION_TRANSLATION * motion
    ):
        raise ConvergenceError(
            f"robot and camera contradict each other: over the motions they differ by "
            f"{math.degrees(start.residual_rotation):.2g} deg and "
            f"{1e3 * start.residual_translation:.3g} mm, and the camera moved by {1e3 * motion:.3g} "
            "mm; check the conventions, and that rows belong together"
        )
