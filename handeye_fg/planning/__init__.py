"""Which poses of the arm make X most certain, and how certain it is going to be.

Entry points: ``plan`` (after a calibration) and ``plan_first`` (before the first image).
"""

from handeye_fg.planning.arm import Arm, read_arm
from handeye_fg.planning.expected import Expected
from handeye_fg.planning.next_poses import USUAL_NOISE, plan, plan_first
from handeye_fg.planning.planned import KeptOut, Plan
from handeye_fg.planning.reach import Both, Reach, Workspace

__all__ = [
    "USUAL_NOISE",
    "Arm",
    "Both",
    "Expected",
    "KeptOut",
    "Plan",
    "Reach",
    "Workspace",
    "plan",
    "plan_first",
    "read_arm",
]
