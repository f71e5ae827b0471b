"""Robot poses as careless programs write them, each way with what is to be found; ``WAYS``."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.frames import Array, inverse, pose, scaled

Way = Callable[[Array], Array]


def _turned(poses: Array, rotation: Rotation) -> Array:
    return pose(rotation.as_matrix(), poses[:, :3, 3])


def _quaternions(change: Way) -> Way:
    """Quaternions x, y, z, w changed."""

    def convert(poses: Array) -> Array:
        q = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        return _turned(poses, Rotation.from_quat(change(q)))

    return convert


def _angles(written: str, read: str) -> Way:
    """Angles about three axes taken for others."""

    def convert(poses: Array) -> Array:
        numbers = Rotation.from_matrix(poses[:, :3, :3]).as_euler(written)  # type: ignore[call-overload]  # literals
        return _turned(poses, Rotation.from_euler(read, numbers))

    return convert


def _radians_as_degrees(poses: Array) -> Array:
    vectors = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    return _turned(poses, Rotation.from_rotvec(np.deg2rad(vectors)))


def _mirrored(axis: int) -> Way:
    mirror = np.eye(4)
    mirror[axis, axis] = -1.0
    return lambda poses: np.asarray(mirror @ poses @ mirror)


def _negated(axis: int) -> Way:
    signs = np.ones(3)
    signs[axis] = -1.0
    return lambda poses: pose(poses[:, :3, :3], poses[:, :3, 3] * signs)


def _another_tool(metres: float, degrees: float) -> Way:
    """From the middle on the pose of another tool."""
    offset = np.eye(4)
    offset[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    offset[2, 3] = metres

    def convert(poses: Array) -> Array:
        changed = np.array(poses)
        changed[len(poses) // 2 :] = changed[len(poses) // 2 :] @ offset
        return changed

    return convert


def _one_lost(poses: Array) -> Array:
    row = len(poses) // 2
    return np.concatenate([poses[:row], poses[row + 1 :], poses[-1:]])


WAYS: Mapping[str, tuple[Way, str]] = MappingProxyType(
    {
        "millimetres": (lambda p: scaled(p, 1e3), "mm"),
        "centimetres": (lambda p: scaled(p, 1e2), "cm"),
        "metres as millimetres": (lambda p: scaled(p, 1e-3), "metres"),
        "w first": (_quaternions(lambda q: np.roll(q, 1, axis=1)), "wxyz"),
        "w last": (_quaternions(lambda q: np.roll(q, -1, axis=1)), "xyzw"),
        "conjugate": (_quaternions(lambda q: q * [-1, -1, -1, 1]), "transposed"),
        "sign of qy": (_quaternions(lambda q: q * [1, -1, 1, 1]), "negated-qy"),
        "inverse": (inverse, "inverted"),
        "inverse in mm": (lambda p: scaled(inverse(p), 1e3), "inverted,mm"),
        "mirrored y": (_mirrored(1), "mirrored"),
        "mirrored z": (_mirrored(2), "mirrored"),
        "y negated": (_negated(1), "negated-y"),
        "z negated": (_negated(2), "negated-z"),
        "angles in the other order": (_angles("XYZ", "ZYX"), "euler-ZYX-XYZ"),
        "KUKA as Fanuc": (_angles("ZYX", "xyz"), "euler-ZYX-xyz"),
        "radians as degrees": (_radians_as_degrees, "radians"),
        "shifted": (lambda p: np.roll(p, 1, axis=0), "shifted+1"),
        "shifted up": (lambda p: np.roll(p, -2, axis=0), "shifted-2"),
        "reversed": (lambda p: p[::-1], "reversed"),
        "tool changed": (_another_tool(0.12, 45.0), "parts"),
        "tool moved": (_another_tool(0.12, 0.0), "parts"),
        "one lost": (_one_lost, "shifted-1-from-"),
    }
)
"""Conversions of right poses (n, 4, 4) into wrong ones, and the name of the diagnosis: a ``--convention``, its
beginning where it ends with a hyphen, or "parts"."""
