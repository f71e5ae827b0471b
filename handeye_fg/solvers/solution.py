"""What every solver of motion pairs returns."""

from dataclasses import dataclass

import numpy as np

from handeye_fg.frames import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionSolution:
    """X and the scale from motion pairs.

    Attributes:
        gripper_T_camera: X (4, 4), metres.
        metres_per_world_unit: the scale, positive; 1 for methods that take B in metres.
    """

    gripper_T_camera: Array
    metres_per_world_unit: float

    def __post_init__(self) -> None:
        X = np.array(self.gripper_T_camera, dtype=np.float64)
        if X.shape != (4, 4):
            raise ValueError(f"{X.shape=} but expected (4, 4)")
        X.setflags(write=False)
        object.__setattr__(self, "gripper_T_camera", X)
