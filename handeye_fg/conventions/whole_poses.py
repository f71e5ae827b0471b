"""Faults of whole poses and of positions: direction, axes, units; ``of_poses``.

Of mirror images only the fact shows, not the axis: any two differ by a fixed turn of the base's and the gripper's
axes.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from handeye_fg.conventions.reading import AXES, Conversion, Reading
from handeye_fg.frames import Array, inverse, pose
from handeye_fg.types import RobotPoses

UNITS: Mapping[str, float] = MappingProxyType(
    {"mm": 1e-3, "cm": 1e-2, "inch": 0.0254, "metres": 1e3}
)


def of_poses() -> list[Reading]:
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
    for axis, letter in enumerate(AXES):
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
        letters = AXES[i] + AXES[j]
        words = f"to have {AXES[i]} and {AXES[j]} of the positions exchanged"
        found.append(
            Reading(name=f"swapped-{letters}", words=words, rank=2.0, convert=_moved(swap))
        )
    return found


def mirrors() -> list[Reading]:
    """Mirror images by their axis, which a user may know."""
    return [
        Reading(name=f"mirrored-{letter}", words="mirrored", rank=1.0, convert=_mirrored(axis))
        for axis, letter in enumerate(AXES)
    ]


def units() -> list[Reading]:
    """Units of the positions; ``conventions.sizes`` says when. "metres": they were read as millimetres."""
    return [
        Reading(name=name, words=f"to be in {name}", rank=1.0, convert=_moved(factor * np.eye(3)))
        for name, factor in UNITS.items()
    ]


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
