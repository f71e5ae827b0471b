"""In what other ways the numbers of a pose may have been meant: named conversions; ``readings``.

A reading takes poses as they were read to poses as they may have been meant. Conventions that differ
by a fixed turn of the base's or the gripper's axes cannot be told apart by any motion, and do no harm
where they are used consistently: X is then in those axes. Of mirror images only the fact shows, not
the axis: any two differ by such a turn.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse, pose
from handeye_fg.types import RobotPoses

Conversion = Callable[[RobotPoses], Array]

AS_GIVEN = "as-given"
# Angles about three axes, as scipy names them: capitals for axes that turn along.
_MOVING = ("ZYX", "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYZ")
_FIXED = tuple(order.lower() for order in _MOVING)
# Those that controllers and programs write; the others are far-fetched.
USUAL_ANGLES = ("vector", "rotation-vector", "ZYX", "XYZ", "zyx", "xyz", "ZYZ")
_AXES = "xyz"


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


def readings(poses: RobotPoses) -> tuple[Reading, ...]:
    """All readings of poses by their matrices, first that as they are given."""
    single = (*_of_poses(), *_of_quaternions(), *_of_angles(), *_of_rows(poses))
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
    known = {reading.name: reading for reading in (*readings(poses), *_mirrors(), *_units())}
    if name not in known:
        shown = [
            other for other in known if not re.search(r",|euler|shifted|radians-|mirrored$", other)
        ]
        raise InputDataError(
            f"convention {name!r} is not known; give one or more, separated by commas, of "
            f"{', '.join(shown)}, shifted+N, shifted-N, or euler-FROM-TO such as euler-ZYX-XYZ"
        )
    return known[name]


def _same(poses: RobotPoses) -> Array:
    return np.asarray(poses.base_T_gripper)


def _inverted(poses: RobotPoses) -> Array:
    return inverse(poses.base_T_gripper)


def _transposed(poses: RobotPoses) -> Array:
    T = poses.base_T_gripper
    return pose(np.swapaxes(T[:, :3, :3], 1, 2), T[:, :3, 3])


def _base_in_gripper(poses: RobotPoses) -> Array:
    T = poses.base_T_gripper
    return pose(T[:, :3, :3], -(T[:, :3, :3] @ T[:, :3, 3:])[..., 0])


def _moved(matrix: Array) -> Conversion:
    """Positions in other axes than orientations."""

    def convert(poses: RobotPoses) -> Array:
        T = poses.base_T_gripper
        return pose(T[:, :3, :3], T[:, :3, 3] @ matrix.T)

    return convert


def _mirrored(axis: int) -> Conversion:
    """Whole poses in mirrored axes."""
    mirror = np.eye(4)
    mirror[axis, axis] = -1.0
    return lambda poses: np.asarray(mirror @ poses.base_T_gripper @ mirror)


def _quaternion_order(order: Sequence[int]) -> Conversion:
    """Quaternions x, y, z, w that stand in another order."""

    def convert(poses: RobotPoses) -> Array:
        q = Rotation.from_matrix(poses.base_T_gripper[:, :3, :3]).as_quat()
        return pose(Rotation.from_quat(q[:, order]).as_matrix(), poses.base_T_gripper[:, :3, 3])

    return convert


def _then(*conversions: Conversion) -> Conversion:
    """One conversion after the other."""

    def convert(poses: RobotPoses) -> Array:
        for conversion in conversions:
            poses = RobotPoses(names=poses.names, base_T_gripper=conversion(poses))
        return np.asarray(poses.base_T_gripper)

    return convert


def _quaternion_sign(component: int) -> Conversion:
    """Quaternions of which one component has the wrong sign."""
    signs = np.ones(4)
    signs[component] = -1.0

    def convert(poses: RobotPoses) -> Array:
        q = Rotation.from_matrix(poses.base_T_gripper[:, :3, :3]).as_quat()
        return pose(Rotation.from_quat(q * signs).as_matrix(), poses.base_T_gripper[:, :3, 3])

    return convert


_WXYZ = _quaternion_order((1, 2, 3, 0))
_XYZW = _quaternion_order((3, 0, 1, 2))


def _of_poses() -> list[Reading]:
    """Faults of whole poses and of positions."""
    found = [
        Reading(name="inverted", words="inverted (gripper_T_base)", rank=1.0, convert=_inverted),
        Reading(
            name="transposed",
            words="to have transposed rotations (column-major matrices, or conjugate quaternions)",
            rank=1.0,
            convert=_transposed,
        ),
        Reading(
            name="mirrored",
            words="mirrored (left-handed axes; which axis has the wrong sign no image tells)",
            rank=1.0,
            convert=_mirrored(1),
            fixable=False,
            flags="run again with --convention mirrored-x, mirrored-y or mirrored-z, whichever axis it is",
        ),
        Reading(
            name="base-in-gripper",
            words="to have positions of the base in the gripper beside orientations of the gripper in the base",
            rank=2.0,
            convert=_base_in_gripper,
        ),
    ]
    for axis, letter in enumerate(_AXES):
        turn = -np.eye(3)
        turn[axis, axis] = 1.0
        found += [
            Reading(
                name=f"negated-{letter}",
                words=f"left-handed: {letter} of the positions has the wrong sign",
                rank=1.5,
                convert=_moved(-turn),
            ),
            Reading(
                name=f"turned-{letter}",
                words=f"to have positions in a base that is turned by 180 degrees about {letter}",
                rank=2.0,
                convert=_moved(turn),
            ),
        ]
    for i, j in ((0, 1), (1, 2), (0, 2)):
        swap = np.eye(3)
        swap[[i, j]] = swap[[j, i]]
        letters = _AXES[i] + _AXES[j]
        words = f"to have {_AXES[i]} and {_AXES[j]} of the positions exchanged"
        found.append(
            Reading(name=f"swapped-{letters}", words=words, rank=2.0, convert=_moved(swap))
        )
    return found


def _of_quaternions() -> list[Reading]:
    signs = [
        Reading(
            name=f"negated-q{letter}",
            words=f"to have quaternions whose q{letter} has the wrong sign",
            rank=1.5,
            convert=_quaternion_sign(component),
        )
        for component, letter in enumerate(_AXES)
    ]
    return [
        *signs,
        Reading(
            name="wxyz",
            words="to have quaternions with w first that were read with w last",
            rank=1.0,
            convert=_WXYZ,
        ),
        Reading(
            name="xyzw",
            words="to have quaternions with w last that were read with w first",
            rank=1.0,
            convert=_XYZW,
        ),
    ]


def _angles_of(kind: str, rotation: Rotation) -> Array:
    if kind == "vector":
        return np.asarray(rotation.as_rotvec())
    return np.asarray(rotation.as_euler(kind, suppress_warnings=True))  # type: ignore[call-overload]  # literals


def _of_angles() -> list[Reading]:
    """Angles taken for others; each reading from the rotations alone."""
    found = [
        Reading(
            name="radians",
            words="to have angles in radians that were read as degrees",
            rank=1.0,
            convert=_angles("vector", "vector", 180.0 / np.pi),
        )
    ]
    found += [
        Reading(
            name=f"radians-{kind}",
            words="to have angles in radians that were read as degrees",
            rank=1.0,
            convert=_angles(kind, kind, 180.0 / np.pi),
        )
        for kind in ("XYZ", "ZYX")
    ]
    for first, second in product(("vector", *_MOVING), ("vector", *_MOVING, *_FIXED)):
        if first == second:
            continue
        usual = first in USUAL_ANGLES and second in USUAL_ANGLES
        found.append(
            Reading(
                name=f"euler-{first}-{second}",
                words=f"to have {angle_words(second)} that were read as {angle_words(first)}",
                rank=1.2 if usual else 3.0,
                convert=_angles(first, second),
            )
        )
    return found


def angle_words(kind: str) -> str:
    """What angles about three axes stand for."""
    if kind == "vector":
        return "rotation vectors"
    order = kind if kind.isupper() else kind[::-1]
    numbers = "123" if kind.isupper() else "321"
    turns = " ".join(f"R{axis.lower()}({n})" for axis, n in zip(order, numbers, strict=True))
    return f"angles {turns}"


def _angles(first: str, second: str, factor: float = 1.0) -> Conversion:
    """Rotations whose numbers were taken as angles of the first kind, but are of the second."""

    def convert(poses: RobotPoses) -> Array:
        T = poses.base_T_gripper
        numbers = factor * _angles_of(first, Rotation.from_matrix(T[:, :3, :3]))
        if second == "vector":
            rotation = Rotation.from_rotvec(numbers)
        else:
            rotation = Rotation.from_euler(second, numbers)
        return pose(rotation.as_matrix(), T[:, :3, 3])

    return convert


def _of_rows(poses: RobotPoses) -> list[Reading]:
    """Rows that belong to other images."""
    n = len(poses.names)

    def taken(rows: Sequence[int]) -> Conversion:
        return lambda poses: np.asarray(poses.base_T_gripper[list(rows)])

    found = [
        Reading(
            name="reversed",
            words="to stand in the reverse order of the images",
            rank=1.0,
            convert=taken(range(n)[::-1]),
        )
    ]
    numeric = sorted(range(n), key=lambda k: _by_number(poses.names[k]))
    plain = sorted(range(n), key=lambda k: poses.names[k])
    if numeric != plain:
        # The k-th name in one order has the pose of the k-th name in the other.
        for name, one, other in (("as-text", plain, numeric), ("as-numbers", numeric, plain)):
            rows = [0] * n
            for a, b in zip(one, other, strict=True):
                rows[b] = a
            found.append(
                Reading(
                    name=f"sorted-{name}",
                    words="to be sorted otherwise than the images (1, 10, 2 against 1, 2, 10)",
                    rank=1.0,
                    convert=taken(rows),
                )
            )
    for k in range(-(n // 2), n // 2 + 1):
        if k:
            rows = [(i + k) % n for i in range(n)]
            by = f"{abs(k)} row{'' if abs(k) == 1 else 's'}"
            where = "below" if k > 0 else "above"
            found.append(
                Reading(
                    name=f"shifted{k:+d}",
                    words=f"shifted against the images: each image's pose stands {by} {where} its own",
                    rank=1.0 if abs(k) <= 2 else 1.5,
                    convert=taken(rows),
                )
            )
    for k, first in product((-1, 1), range(2, n - 2)):
        rows = [i + k * (i >= first) for i in range(n)]
        found.append(
            Reading(
                name=f"shifted{k:+d}-from-{first}",
                words=f"shifted by one row from {poses.names[first]} on (an image or a pose was lost there)",
                rank=1.5,
                convert=taken([min(row, n - 1) for row in rows]),
            )
        )
    return found


def _by_number(name: str) -> tuple[tuple[int, int, str], ...]:
    """A name with its numbers as numbers, for sorting."""
    parts = re.findall(r"\d+|\D+", name)
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)


def _double() -> list[Reading]:
    """Two faults at once."""
    one = {reading.name: reading for reading in (*_of_poses(), *_of_quaternions())}
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


def _mirrors() -> list[Reading]:
    """Mirror images by their axis, which a user may know."""
    return [
        Reading(name=f"mirrored-{letter}", words="mirrored", rank=1.0, convert=_mirrored(axis))
        for axis, letter in enumerate(_AXES)
    ]


UNITS: Mapping[str, float] = MappingProxyType(
    {"mm": 1e-3, "cm": 1e-2, "inch": 0.0254, "metres": 1e3}
)


def _units() -> list[Reading]:
    """Units of the positions; ``sizes`` says when. "metres": they were read as millimetres."""
    return [
        Reading(name=name, words=f"to be in {name}", rank=1.0, convert=_moved(factor * np.eye(3)))
        for name, factor in UNITS.items()
    ]
