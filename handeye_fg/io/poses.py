"""Robot poses: the CSV of the contract, and mappings of matrices from Python."""

import io
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, orthonormalised, pose
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.files import read_text
from handeye_fg.types import RobotPoses

COLUMNS = ("image", "x", "y", "z", "qx", "qy", "qz", "qw")
QUATERNION_TOLERANCE = 1e-3  # components printed with three decimals put the norm off by less
ROTATION_TOLERANCE = 1e-4  # entries printed with five decimals put R'R off by less

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_RAGGED = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")


def read_poses(path: Path) -> RobotPoses:
    """Read a poses CSV with the header ``image,x,y,z,qx,qy,qz,qw``.

    Columns may come in any order; other columns, and lines without content, are ignored. Values are
    base_T_gripper: metres and a Hamilton quaternion. A quaternion whose norm is 1 within 1e-3 is
    taken as rounded in print and normalised; others are refused. A byte order mark and all usual
    line ends are accepted. Image names are kept as they are, but for unquoted spaces before them.

    Args:
        path: the file.

    Returns:
        The poses in the order of the file.

    Raises:
        InputDataError: the file is missing, empty, not text or not a CSV table; a column is missing
            or double; a cell is not a finite number; an image name is empty, double or leads out
            of the image folder; the norm of a quaternion is not 1.
    """
    frame = _table(path)
    header = _header(path, frame)
    names: dict[str, int] = {}
    translations: list[list[float]] = []
    quaternions: list[list[float]] = []
    for line, cells in _rows(frame):
        row = dict(zip(header, cells, strict=True))
        where = f"poses file {path}, line {line}"
        name = row["image"]
        _check_name(name, f"{where}, column image")
        if name in names:
            raise InputDataError(
                f"{where}, column image: {shown(name)} is already in line {names[name]}, but each"
                " image has one pose; remove one of the two rows"
            )
        names[name] = line
        numbers = [_number(row[column], where, column) for column in COLUMNS[1:]]
        norm = math.hypot(*numbers[3:])
        if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
            raise InputDataError(
                f"{where}, columns qx,qy,qz,qw: the quaternion's norm is {norm:.6g}, but must be 1"
                f" within {QUATERNION_TOLERANCE:g}; export unit quaternions"
            )
        translations.append(numbers[:3])
        quaternions.append(numbers[3:])
    if not names:
        raise InputDataError(
            f"poses file {path}: there is no row after the header; write one row for each image"
        )
    rotations = Rotation.from_quat(np.array(quaternions)).as_matrix()
    return RobotPoses(names=tuple(names), base_T_gripper=pose(rotations, np.array(translations)))


def poses_from_mapping(mapping: Mapping[str, Array]) -> RobotPoses:
    """Robot poses from a mapping of image names to matrices.

    Args:
        mapping: base_T_gripper (4, 4), metres, for each image name. A rotation that is orthonormal
            within 1e-4 is taken as rounded in print and replaced by the nearest rotation.

    Returns:
        The poses in the order of the mapping.

    Raises:
        InputDataError: there is no pose, or a name, shape, value, last row or rotation is wrong.
    """
    if not mapping:
        raise InputDataError("poses: the mapping is empty; give a 4x4 matrix for each image name")
    matrices = []
    for name, matrix in mapping.items():
        _check_name(name, "poses")
        matrices.append(_checked_pose(matrix, f"pose of image {shown(name)}"))
    return RobotPoses(names=tuple(mapping), base_T_gripper=np.array(matrices))


def _table(path: Path) -> pd.DataFrame:
    """The cells of the file as strings, the header in row 0; "" where a row is too short."""
    text = read_text(path, "poses file")
    try:
        return pd.read_csv(
            io.StringIO(text),
            header=None,
            dtype=str,
            na_filter=False,
            skip_blank_lines=False,
            skipinitialspace=True,
        )
    except pd.errors.EmptyDataError as error:
        raise InputDataError(
            f"poses file {path}, line 1: the line is blank; put the header {','.join(COLUMNS)} there"
        ) from error
    except pd.errors.ParserError as error:
        ragged = _RAGGED.search(str(error))
        if ragged is None:
            raise InputDataError(
                f"poses file {path}: not a CSV table ({reason(error)}); close the quotes"
            ) from error
        raise InputDataError(
            f"poses file {path}, line {ragged[2]}: found {ragged[3]} fields, but the header has"
            f" {ragged[1]}; remove the surplus, or quote a name that contains a comma"
        ) from error


def _header(path: Path, frame: pd.DataFrame) -> tuple[str, ...]:
    """The column names."""
    header = tuple(str(cell).strip() for cell in frame.iloc[0])
    for column in COLUMNS:
        if header.count(column) != 1:
            problem = "is missing" if column not in header else "occurs more than once"
            raise InputDataError(
                f"poses file {path}, line 1: column {column} {problem}; found"
                f" {shown(','.join(header))}, but wanted {','.join(COLUMNS)}, separated by commas"
            )
    return header


def _rows(frame: pd.DataFrame) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Number of the first line and cells of each row after the header that is not blank."""
    line = 1
    for i, cells in enumerate(frame.itertuples(index=False, name=None)):
        if i > 0 and any(cell.strip() for cell in cells):
            yield line, cells
        line += 1 + sum(cell.count("\n") for cell in cells)


def _number(cell: str, where: str, column: str) -> float:
    """The finite number in a cell."""
    text = cell.strip()
    number = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not math.isfinite(number):
        raise InputDataError(
            f"{where}, column {column}: {shown(cell)} is not a finite number; correct the value or"
            " remove the row"
        )
    return number


def _check_name(name: object, where: str) -> None:
    """Refuse what is no name of a file in the image folder."""
    if not isinstance(name, str) or not name.strip():
        raise InputDataError(f"{where}: {shown(name)} is no image name; name the image's file")
    for kind in (PurePosixPath, PureWindowsPath):
        if kind(name).anchor or ".." in kind(name).parts:
            raise InputDataError(
                f"{where}: {shown(name)} leads out of the image folder; give the name of a file in"
                " the folder"
            )


def _checked_pose(matrix: object, where: str) -> Array:
    """A rigid transform (4, 4) with its rotation made orthonormal to rounding."""
    try:
        array = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputDataError(
            f"{where}: not an array of numbers ({reason(error)}); give a 4x4 matrix"
        ) from error
    if array.shape != (4, 4):
        raise InputDataError(f"{where}: {array.shape=}, but must be (4, 4); give base_T_gripper")
    if not np.isfinite(array).all():
        i, j = np.argwhere(~np.isfinite(array))[0]
        raise InputDataError(
            f"{where}: the value in row {i}, column {j} is {array[i, j]}, but must be finite;"
            " correct it or leave the pose out"
        )
    if not np.array_equal(array[3], (0.0, 0.0, 0.0, 1.0)):
        raise InputDataError(
            f"{where}: the last row is {array[3].tolist()}, but must be [0, 0, 0, 1]; transpose the"
            " matrix if its translation is there"
        )
    rotation = array[:3, :3]
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
    return pose(orthonormalised(rotation), array[:3, 3])
