"""Whether an arm's errors are white, and how certain X is then; entry point ``arm_errors``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.findings import RobotErrors
from handeye_fg.graph.certainty import Certainty
from handeye_fg.graph.determined import Determined
from handeye_fg.graph.systematic import Systematic, systematic
from handeye_fg.graph.variables import State
from handeye_fg.graph.whiteness import Whiteness, whiteness

_TRACE = 2.0  # standard deviations above what independent noise leaves


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmErrors:
    """What is known of the arm's errors.

    Attributes:
        certainties: of (X, ln scale) of each camera.
        found: the test of the robot's noise, and what was done; figures of the first camera.
    """

    certainties: tuple[Certainty, ...]
    found: RobotErrors


def arm_errors(
    white: Determined, state: State, trusted: NDArray[np.bool_], spread_metres: float
) -> ArmErrors:
    """Test the robot's noise, and enlarge the certainties of X where it is not white.

    Args:
        white: the certainties with white noise.
        state: the optimum.
        trusted: (r,) which robot poses are used.
        spread_metres: root mean square distance of the camera centres from their mean.
    """
    metric = frames.scaled(state.world_T_camera, float(np.exp(state.log_scale)))
    reported = state.base_T_world @ metric @ frames.inverse(state.gripper_T_camera)
    base_T_gripper = frames.inverse(reported) if white.linearised.inverted else reported
    base_T_gripper = base_T_gripper[trusted]
    test = whiteness(base_T_gripper, white.linearised, white.solution)
    if not test.rejected:
        return ArmErrors(certainties=white.certainties, found=_white(test))
    found = [
        systematic(
            base_T_gripper,
            white.linearised,
            white.solution,
            certainty,
            derivative,
            X,
            spread_metres,
        )
        for certainty, derivative, X in zip(
            white.certainties, white.derivatives, state.gripper_T_cameras, strict=True
        )
    ]
    return ArmErrors(
        certainties=tuple(one.certainty for one in found), found=_not_white(test, found[0])
    )


def _white(test: Whiteness) -> RobotErrors:
    return RobotErrors(
        white=True,
        probability=test.probability,
        resampled_ratio=None,
        hidden_rotation=None,
        hidden_translation=None,
        reason=(
            f"The robot's errors may be independent noise (p = {test.probability:.2g}): the covariance is "
            "that of the model."
        ),
    )


def _not_white(test: Whiteness, found: Systematic) -> RobotErrors:
    traces = []
    if test.coupled >= test.alike or test.coupled > _TRACE:
        traces.append("the rotation and the position error of a pose belong together")
    if test.alike > test.coupled or test.alike > _TRACE:
        traces.append("neighbouring poses have similar errors")
    ratio = found.resampled_ratio
    blocks = (
        f"Leaving out blocks of poses moves X up to {ratio:.2g} times as much as such noise would, and the "
        "larger covariance is given"
        if ratio > 1.0
        else "Leaving out blocks of poses moves X no more than such noise would"
    )
    return RobotErrors(
        white=False,
        probability=test.probability,
        resampled_ratio=ratio,
        hidden_rotation=found.hidden_rotation,
        hidden_translation=found.hidden_translation,
        reason=(
            f"The robot's errors are not independent noise (p = {test.probability:.2g}): "
            f"{' and '.join(traces)}, as with an arm whose links are not as its controller believes. "
            f"{blocks}. For errors of the last link, which move all poses alike and show in no residual, "
            f"{np.rad2deg(found.hidden_rotation):.2g} deg and {1e3 * found.hidden_translation:.2g} mm an "
            "axis were added."
        ),
    )
