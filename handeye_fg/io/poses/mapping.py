"""Robot poses from Python: mappings of image names to matrices."""

from collections.abc import Mapping

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, orthonormalised, pose
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.poses.convention import check_rotation
from handeye_fg.io.poses.names import check_name
from handeye_fg.types import RobotPoses


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
        check_name(name, "poses")
        matrices.append(_checked_pose(matrix, f"pose of image {shown(name)}"))
    return RobotPoses(names=tuple(mapping), base_T_gripper=np.array(matrices))


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
    check_rotation(rotation, where)
    return pose(orthonormalised(rotation), array[:3, 3])
