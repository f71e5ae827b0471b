"""Whether an arm's errors are white, and how certain X is then; entry point ``arm_errors``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.graph.certainty import Certainty
from handeye_fg.graph.determined import Determined
from handeye_fg.graph.systematic import Systematic, systematic
from handeye_fg.graph.variables import State
from handeye_fg.graph.whiteness import Whiteness, whiteness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmErrors:
    """What is known of the arm's errors.

    Attributes:
        certainties: of (X, ln scale) of each camera.
        whiteness: the test of the robot's noise.
        systematic: of the first camera, where the noise is not white; else None.
    """

    certainties: tuple[Certainty, ...]
    whiteness: Whiteness
    systematic: Systematic | None


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
        return ArmErrors(certainties=white.certainties, whiteness=test, systematic=None)
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
        certainties=tuple(one.certainty for one in found), whiteness=test, systematic=found[0]
    )
