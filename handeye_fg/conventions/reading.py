"""A way in which the numbers of poses may have been meant: ``Reading``."""

from collections.abc import Callable
from dataclasses import dataclass

from handeye_fg.frames import Array
from handeye_fg.types import RobotPoses

Conversion = Callable[[RobotPoses], Array]

AXES = "xyz"


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A way in which poses may have been meant.

    Attributes:
        name: its name, as for ``--convention``.
        words: what the poses are then, to follow "your poses look".
        rank: how far-fetched it is; of readings that fit alike the lowest is named first.
        fixable: whether the data say how to convert the poses.
        flags: what to do about it, for the message; "": the name as ``--convention``.
    """

    name: str
    words: str
    rank: float
    convert: Conversion
    fixable: bool = True
    flags: str = ""
