"""Rotations of which the numbers were taken for others: ``of_quaternions`` and ``of_angles``."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.conventions.reading import AXES, Conversion, Reading
from handeye_fg.frames import Array, pose
from handeye_fg.types import RobotPoses

# Angles about three axes, as scipy names them: capitals for axes that turn along.
_MOVING = ("ZYX", "XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYZ")
_FIXED = tuple(order.lower() for order in _MOVING)
# Those that controllers and programs write; the others are far-fetched.
USUAL_ANGLES = ("vector", "rotation-vector", "ZYX", "XYZ", "zyx", "xyz", "ZYZ")


def of_quaternions() -> list[Reading]:
    """Quaternions in another order, or with a component of the wrong sign."""
    signs = [
        Reading(
            name=f"negated-q{letter}",
            words=f"to have quaternions whose q{letter} has the wrong sign",
            rank=1.5,
            convert=_quaternion_sign(component),
        )
        for component, letter in enumerate(AXES)
    ]
    return [
        *signs,
        Reading(
            name="wxyz",
            words="to have quaternions with w first that were read with w last",
            rank=1.0,
            convert=_quaternion_order((1, 2, 3, 0)),
        ),
        Reading(
            name="xyzw",
            words="to have quaternions with w last that were read with w first",
            rank=1.0,
            convert=_quaternion_order((3, 0, 1, 2)),
        ),
    ]


def of_angles() -> list[Reading]:
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


def _quaternion_order(order: Sequence[int]) -> Conversion:
    """Quaternions x, y, z, w that stand in another order."""

    def convert(poses: RobotPoses) -> Array:
        q = Rotation.from_matrix(poses.base_T_gripper[:, :3, :3]).as_quat()
        return pose(Rotation.from_quat(q[:, order]).as_matrix(), poses.base_T_gripper[:, :3, 3])

    return convert


def _quaternion_sign(component: int) -> Conversion:
    """Quaternions of which one component has the wrong sign."""
    signs = np.ones(4)
    signs[component] = -1.0

    def convert(poses: RobotPoses) -> Array:
        q = Rotation.from_matrix(poses.base_T_gripper[:, :3, :3]).as_quat()
        return pose(Rotation.from_quat(q * signs).as_matrix(), poses.base_T_gripper[:, :3, 3])

    return convert


def _angles_of(kind: str, rotation: Rotation) -> Array:
    if kind == "vector":
        return np.asarray(rotation.as_rotvec())
    return np.asarray(rotation.as_euler(kind, suppress_warnings=True))  # type: ignore[call-overload]  # literals


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
