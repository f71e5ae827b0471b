"""What the numbers of a pose mean: kind of rotation, units, direction; numbers to poses and back."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse, orthonormalised, pose
from handeye_fg.io.fields import shown
from handeye_fg.options import RotationKind

Unit = Literal["m", "mm"]
AngleUnit = Literal["rad", "deg"]

QUATERNION_TOLERANCE = 1e-3  # components printed with three decimals put the norm off by less
ROTATION_TOLERANCE = 1e-4  # entries printed with five decimals put R'R off by less

_SIZES = {"xyzw": 4, "wxyz": 4, "rotation-vector": 3, "matrix": 9, "matrix-transposed": 9}
_LARGEST_ANGLE = 1e4  # degrees or radians: 27 turns; more is no angle but another column
_LARGEST_COORDINATE = 1e9  # of any unit
_TEXTS = {
    "xyzw": "quaternion x,y,z,w",
    "wxyz": "quaternion w,x,y,z",
    "rotation-vector": "rotation vector",
    "matrix": "rotation matrix by rows",
    "matrix-transposed": "rotation matrix by columns",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Convention:
    """What the numbers of a pose mean.

    Attributes:
        rotation: "xyzw" and "wxyz": Hamilton quaternion in this order; "rotation-vector"; "matrix": nine
            entries by rows; "matrix-transposed": by columns; or angles about three axes as scipy
            names them: capitals for axes that turn along ("ZYX": R = Rz(1st) Ry(2nd) Rx(3rd)), small
            letters for axes that stay ("xyz": R = Rz(3rd) Ry(2nd) Rx(1st)).
        unit: of the position.
        angles: unit of angles and rotation vectors.
        inverted: whether the pose is the inverse: gripper_T_base.
    """

    rotation: RotationKind = "xyzw"  # never "auto"
    unit: Unit = "m"
    angles: AngleUnit = "rad"
    inverted: bool = False

    @property
    def size(self) -> int:
        """How many numbers the rotation has."""
        return _SIZES.get(self.rotation, 3)

    @property
    def has_angles(self) -> bool:
        """Whether the unit of angles matters."""
        return self.size == 3

    def __str__(self) -> str:
        kind = _TEXTS.get(self.rotation) or _euler_text(self.rotation)
        angles = f", {self.angles}" if self.has_angles else ""
        return f"{kind}, {self.unit}{angles}{', inverted' if self.inverted else ''}"


def to_poses(
    positions: Array,
    rotations: Array,
    convention: Convention,
    places: Sequence[str],
    columns: str = "",
) -> Array:
    """Poses (n, 4, 4) in metres, base_T_gripper, from numbers.

    Quaternions whose norm is 1 within 1e-3, and matrices that are orthonormal within 1e-4, are taken as
    rounded in print and replaced by the nearest rotation; others are refused.

    Args:
        positions: (n, 3) as they are written.
        rotations: (n, k) as they are written, k as the convention says.
        convention: what they mean.
        places: where each pose stands, as the start of an error message.
        columns: names of the rotation's columns, for the same; "" for none.

    Raises:
        InputDataError: a pose is none under this convention.
    """
    _check_size(positions, _LARGEST_COORDINATE, "position", places)
    where = [f"{place}, columns {columns}" for place in places] if columns else places
    matrices = pose(
        _rotations(rotations, convention, where),
        positions * (1e-3 if convention.unit == "mm" else 1.0),
    )
    return inverse(matrices) if convention.inverted else matrices


def from_poses(base_T_gripper: Array, convention: Convention) -> tuple[Array, Array]:
    """Positions (n, 3) and rotations (n, k) as a file with this convention has them."""
    matrices = inverse(base_T_gripper) if convention.inverted else base_T_gripper
    positions = matrices[:, :3, 3] * (1e3 if convention.unit == "mm" else 1.0)
    kind: Any = convention.rotation  # as scipy has it for angles
    if convention.size == 9:
        by_rows = matrices[:, :3, :3]
        by_rows = by_rows if kind == "matrix" else np.swapaxes(by_rows, 1, 2)
        return positions, by_rows.reshape(-1, 9)
    rotation = Rotation.from_matrix(matrices[:, :3, :3])
    if convention.size == 4:
        return positions, rotation.as_quat(canonical=True, scalar_first=kind == "wxyz")
    degrees = convention.angles == "deg"
    if kind == "rotation-vector":
        return positions, rotation.as_rotvec(degrees=degrees)
    # Where two axes align only the sum of their angles counts: any will do.
    return positions, rotation.as_euler(kind, degrees=degrees, suppress_warnings=True)


def _rotations(numbers: Array, convention: Convention, places: Sequence[str]) -> Array:
    """Rotation matrices (n, 3, 3)."""
    kind = convention.rotation
    if convention.size == 9:
        matrices = numbers.reshape(-1, 3, 3)
        matrices = matrices if kind == "matrix" else np.swapaxes(matrices, 1, 2)
        for matrix, place in zip(matrices, places, strict=True):
            check_rotation(matrix, place)
        return orthonormalised(matrices)
    if convention.size == 4:
        for quaternion, place in zip(numbers, places, strict=True):
            norm = math.hypot(*quaternion)
            if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
                raise InputDataError(
                    f"{place}: the quaternion's norm is {norm:.6g}, but must be 1 within"
                    f" {QUATERNION_TOLERANCE:g}; export unit quaternions"
                )
        return Rotation.from_quat(numbers, scalar_first=kind == "wxyz").as_matrix()
    _check_size(numbers, _LARGEST_ANGLE, "angle", places)
    degrees = convention.angles == "deg"
    if kind == "rotation-vector":
        return Rotation.from_rotvec(numbers, degrees=degrees).as_matrix()
    return Rotation.from_euler(kind, numbers, degrees=degrees).as_matrix()


def check_rotation(rotation: Array, where: str) -> None:
    """Refuse a matrix (3, 3) that is no rotation, even rounded in print.

    Raises:
        InputDataError: it has scale or shear, or is a mirror image.
    """
    bounded = np.abs(rotation).max() <= 2.0  # else its square may overflow
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max() if bounded else math.inf
    if deviation > ROTATION_TOLERANCE:
        raise InputDataError(
            f"{where}: the rotation is not orthonormal (R R' differs from the identity by"
            f" {deviation:.3g}, at most {ROTATION_TOLERANCE:g} is allowed); give a rotation without"
            " scale or shear, with all its digits"
        )
    if np.linalg.det(rotation) < 0.0:
        raise InputDataError(
            f"{where}: the determinant of the rotation is -1, a mirror image, but must be +1; check"
            " the handedness of the axes"
        )


def _check_size(numbers: Array, largest: float, what: str, places: Sequence[str]) -> None:
    """Refuse numbers that are too large for what they are to be."""
    rows = np.argwhere(~(np.abs(numbers) <= largest))
    if len(rows):
        i, j = rows[0]
        raise InputDataError(
            f"{places[i]}: {shown(float(numbers[i, j]))} is no {what}, at most {largest:g} is; correct"
            " the value or leave the row out"
        )


def _euler_text(kind: str) -> str:
    """The product of rotations that the angles stand for."""
    turns = [f"R{axis.lower()}({i}.)" for i, axis in enumerate(kind, 1)]
    return f"angles, R = {' '.join(turns if kind.isupper() else turns[::-1])}"
