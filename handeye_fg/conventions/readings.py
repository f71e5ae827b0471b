"""In what other ways the numbers of a pose may have been meant: named conversions; ``readings``.

A reading takes poses as they were read to poses as they may have been meant. Conventions that differ
by a fixed turn of the base's or the gripper's axes cannot be told apart by any motion, and do no harm
where they are used consistently: X is then in those axes.
"""

import re
from itertools import product

import numpy as np

from handeye_fg.conventions.reading import Conversion, Reading
from handeye_fg.conventions.rotations import of_angles, of_quaternions
from handeye_fg.conventions.row_order import of_rows
from handeye_fg.conventions.whole_poses import mirrors, of_poses, units
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.types import RobotPoses

AS_GIVEN = "as-given"


def readings(poses: RobotPoses) -> tuple[Reading, ...]:
    """All readings of poses by their matrices, first that as they are given."""
    single = (*of_poses(), *of_quaternions(), *of_angles(), *of_rows(poses))
    return (
        Reading(name=AS_GIVEN, words="right as given", rank=0.0, convert=_same),
        *single,
        *_double(),
    )


def converted(poses: RobotPoses, convention: str) -> RobotPoses:
    """Poses as they are meant under named conventions.

    Args:
        poses: as they were read.
        convention: names of readings, separated by commas, applied in this order; "" or "as-given":
            none.

    Raises:
        InputDataError: there is no reading of such a name.
    """
    for name in (part.strip() for part in convention.split(",")):
        if not name:
            continue
        poses = RobotPoses(names=poses.names, base_T_gripper=_named(name, poses).convert(poses))
    return poses


def _named(name: str, poses: RobotPoses) -> Reading:
    if name == "mirrored":
        raise InputDataError(
            "convention 'mirrored' does not say which axis; give mirrored-x, mirrored-y or mirrored-z"
        )
    known = {reading.name: reading for reading in (*readings(poses), *mirrors(), *units())}
    if name not in known:
        shown = [
            other for other in known if not re.search(r",|euler|shifted|radians-|mirrored$", other)
        ]
        raise InputDataError(
            f"convention {name!r} is not known; give one or more, separated by commas, of "
            f"{', '.join(shown)}, shifted+N, shifted-N, or euler-FROM-TO such as euler-ZYX-XYZ"
        )
    return known[name]


def _double() -> list[Reading]:
    """Two faults at once."""
    one = {reading.name: reading for reading in (*of_poses(), *of_quaternions())}
    firsts = ("wxyz", "xyzw", "transposed")
    seconds = ("inverted", "transposed", "mirrored", "negated-x", "negated-y", "negated-z")
    pairs = [(a, b) for a, b in product(firsts, seconds) if a != b]
    # The inverse of what has a transposed rotation has the position of the base in the gripper.
    pairs.remove(("transposed", "inverted"))
    pairs.append(("inverted", "mirrored"))
    return [
        Reading(
            name=f"{a},{b}",
            words=f"{one[a].words}, and {one[b].words}",
            rank=one[a].rank + one[b].rank + 1.0,
            convert=_then(one[a].convert, one[b].convert),
            fixable=one[a].fixable and one[b].fixable,
        )
        for a, b in pairs
    ]


def _same(poses: RobotPoses) -> Array:
    return np.asarray(poses.base_T_gripper)


def _then(*conversions: Conversion) -> Conversion:
    """One conversion after the other."""

    def convert(poses: RobotPoses) -> Array:
        for conversion in conversions:
            poses = RobotPoses(names=poses.names, base_T_gripper=conversion(poses))
        return np.asarray(poses.base_T_gripper)

    return convert
