"""What every solver takes and returns."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from handeye_fg.frames import Array
from handeye_fg.motions import MotionPairs, PosePairs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """X, and what else the solver finds.

    Attributes:
        gripper_T_camera: X (4, 4), metres.
        metres_per_world_unit: the scale, positive; 1 for methods that take camera poses in metres.
        base_T_world: Z (4, 4), metres, from solvers of A X = Z B; else None.
    """

    gripper_T_camera: Array
    metres_per_world_unit: float = 1.0
    base_T_world: Array | None = None

    def __post_init__(self) -> None:
        for name in ("gripper_T_camera", "base_T_world"):
            if getattr(self, name) is None:
                continue
            matrix = np.array(getattr(self, name), dtype=np.float64)
            if matrix.shape != (4, 4):
                raise ValueError(f"{name}: {matrix.shape=} but expected (4, 4)")
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)


Solver = Callable[[PosePairs | MotionPairs], Solution]
