"""Where an arm can bring its gripper: a box, or the joints of a URDF."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array


class Reach(Protocol):
    """What tells which poses an arm reaches."""

    def reachable(self, base_T_gripper: Array) -> NDArray[np.bool_]:
        """Which of the poses (n, 4, 4), metres, it reaches (n,)."""
        ...


@dataclass(frozen=True, slots=True)
class Workspace:
    """A box for the gripper's position in the base, metres.

    Attributes:
        low, high: its corners (x, y, z).
    """

    low: tuple[float, ...]
    high: tuple[float, ...]

    def __post_init__(self) -> None:
        numbers = np.array([self.low, self.high], dtype=np.float64)
        if numbers.shape != (2, 3) or not np.isfinite(numbers).all():
            raise ValueError(f"the workspace is {self.low} to {self.high}, but must be 2 corners")
        if (numbers[0] >= numbers[1]).any():
            raise ValueError(
                f"the workspace goes from {self.low} to {self.high}, but each axis must go from the "
                "smaller to the larger number"
            )

    def reachable(self, base_T_gripper: Array) -> NDArray[np.bool_]:
        """Which of the poses (n, 4, 4) have the gripper in the box."""
        position = base_T_gripper[:, :3, 3]
        return np.asarray(((position >= self.low) & (position <= self.high)).all(axis=1))

    @staticmethod
    def around(base_T_gripper: Array) -> "Workspace":
        """The box that poses (n, 4, 4) span."""
        position = base_T_gripper[:, :3, 3]
        # A side of a millimetre at least: poses may lie in a plane.
        low, high = position.min(axis=0) - 5e-4, position.max(axis=0) + 5e-4
        return Workspace(tuple(low.tolist()), tuple(high.tolist()))


@dataclass(frozen=True, slots=True)
class Both:
    """What several reaches have in common.

    Attributes:
        reaches: of none, every pose is within reach.
    """

    reaches: tuple[Reach, ...]

    def reachable(self, base_T_gripper: Array) -> NDArray[np.bool_]:
        """Which of the poses (n, 4, 4) are within every one of them."""
        result = np.ones(len(base_T_gripper), dtype=bool)
        for reach in self.reaches:
            result[result] = reach.reachable(base_T_gripper[result])
        return result
