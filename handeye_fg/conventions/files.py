"""The other ways in which the numbers of a pose file can be read; ``file_readings``.

Angles are read again from the file: a rotation that was made from degrees taken as radians does not tell
how often it went round.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import get_args

import numpy as np

from handeye_fg.conventions.reading import Conversion, Reading
from handeye_fg.conventions.rotations import USUAL_ANGLES, angle_words
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.poses import Convention, PoseFile
from handeye_fg.options import RotationKind
from handeye_fg.types import RobotPoses

_WORDS = {
    "xyzw": "quaternions with w last",
    "wxyz": "quaternions with w first",
    "matrix": "rotation matrices by rows",
    "matrix-transposed": "rotation matrices by columns (column-major)",
    "rotation-vector": "rotation vectors",
}


def file_readings(file: PoseFile) -> tuple[Reading, ...]:
    """Readings of a file's numbers under other conventions, with the flags that ask for them."""
    claimed = file.convention
    found = [
        Reading(
            name="inverted",
            words=(
                "to be those of the gripper in the base (not inverted)"
                if claimed.inverted
                else "inverted (gripper_T_base)"
            ),
            rank=1.0,
            convert=_of(file, replace(claimed, inverted=not claimed.inverted)),
            flags="run again without --inverted"
            if claimed.inverted
            else "run again with --inverted",
        )
    ]
    for other in _rotations(claimed):
        flags = [f"--rotation {other.rotation}"] if other.rotation != claimed.rotation else []
        flags += [f"--angles {other.angles}"] if other.angles != claimed.angles else []
        both = len(flags) == 2
        usual = other.rotation in USUAL_ANGLES or not other.has_angles
        found.append(
            Reading(
                name="-".join(flag.removeprefix("--").replace(" ", "-") for flag in flags),
                words=_words(claimed, other),
                rank=(1.0 if usual else 3.0) + both,
                convert=_of(file, other),
                flags=f"run again with {' '.join(flags)}",
            )
        )
    return tuple(found)


def _rotations(claimed: Convention) -> Iterator[Convention]:
    """Other conventions with as many numbers."""
    kinds = [kind for kind in get_args(RotationKind) if kind != "auto"]
    for kind in kinds:
        other = replace(claimed, rotation=kind)
        if other.size != claimed.size:
            continue
        if kind != claimed.rotation:
            yield other
        if claimed.has_angles:
            yield replace(other, angles="deg" if claimed.angles == "rad" else "rad")


def _words(claimed: Convention, other: Convention) -> str:
    parts = []
    if other.rotation != claimed.rotation:
        kinds = [_WORDS.get(one.rotation) or angle_words(one.rotation) for one in (other, claimed)]
        parts.append(f"{kinds[0]} that were read as {kinds[1]}")
    if other.angles != claimed.angles:
        units = {"deg": "degrees", "rad": "radians"}
        parts.append(f"angles in {units[other.angles]} that were read as {units[claimed.angles]}")
    return f"to have {' and '.join(parts)}"


def _of(file: PoseFile, convention: Convention) -> Conversion:
    """The file's poses under a convention; rows that are none then are as far off as can be."""

    def convert(poses: RobotPoses) -> Array:
        try:
            return np.asarray(file.poses(convention).base_T_gripper)
        except InputDataError:
            return np.tile(np.eye(4), (len(poses.names), 1, 1))

    return convert
