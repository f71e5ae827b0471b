"""Camera poses that exist already: nerfstudio's transforms.json, and trajectories; ``read_camera_poses``."""

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, orthonormalised, pose
from handeye_fg.io.fields import Fields, shown
from handeye_fg.io.json_files import read_json
from handeye_fg.io.poses import read_poses
from handeye_fg.options import PairBy

TRANSFORMS = "transforms.json"

_KIND = "camera poses"
_WANTED = (
    "a transforms.json of nerfstudio, a trajectory (such as TUM), or the folder of a COLMAP model"
)
_REMEDY = "correct the file"
# OpenGL's camera looks along -z with y up, that of OpenCV along z with y down.
_OPENGL_T_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
_TOLERANCE = 1e-4  # entries printed with five decimals put R'R off by less


def read_camera_poses(
    path: Path, names: Sequence[str], pair_by: PairBy = "auto"
) -> dict[str, Array]:
    """Poses world_T_camera (4, 4) of the named images, in the file's unit of length.

    A transforms.json names its images by their files, with or without folder and suffix. The rows of a trajectory
    are found by name or time, as those of a robot's poses are.

    Args:
        path: the file, or the folder of a transforms.json.
        names: of the images, as the robot's poses have them.
        pair_by: how the rows of a trajectory find their images.

    Returns:
        The poses under the given names; those of other images under their own.

    Raises:
        InputDataError: the file is missing, damaged or of another kind, or cannot be paired.
    """
    if path.is_dir():
        path /= TRANSFORMS
    if path.suffix != ".json":
        poses = read_poses(path, images=names, pair_by=pair_by)
        return dict(zip(poses.names, poses.base_T_gripper, strict=True))
    fields = read_json(path, _KIND, _WANTED, _REMEDY)
    return _renamed(_of_transforms(fields), names, fields.where)


def _of_transforms(fields: Fields) -> dict[str, Array]:
    """The poses of a transforms.json under the paths of their images."""
    poses: dict[str, Array] = {}
    for frame in fields.mappings("frames"):
        name = str(PurePosixPath(frame.text("file_path").replace("\\", "/")))
        if name in poses:
            raise frame.error("file_path", "another file in each frame")
        poses[name] = _pose(frame) @ _OPENGL_T_OPENCV
    if not poses:
        raise fields.error("frames", "a list of one frame for each image")
    return poses


def _pose(frame: Fields) -> Array:
    matrix = frame.array("transform_matrix", (4, 4))
    rotation = matrix[:3, :3]
    rigid = (
        np.abs(rotation).max() < 2.0  # else its square may overflow
        and np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=_TOLERANCE)
        and np.linalg.det(rotation) > 0.0
        and np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
    )
    if not rigid:
        raise frame.error(
            "transform_matrix", "a rotation and a position, with 0 0 0 1 in the last row"
        )
    return pose(orthonormalised(rotation), matrix[:3, 3])


def _renamed(poses: Mapping[str, Array], names: Sequence[str], where: str) -> dict[str, Array]:
    """The poses under the given names: of the same file, or else of the same file without suffix."""
    wanted = {PurePosixPath(name).name: name for name in names}
    by_stem = {PurePosixPath(name).stem: name for name in names}
    result: dict[str, Array] = {}
    for path, matrix in poses.items():
        file = PurePosixPath(path)
        name = wanted.get(file.name) or (None if file.suffix else by_stem.get(file.name)) or path
        if name in result:
            raise InputDataError(
                f"{where}: two frames are of images with the name {shown(name)}, so that it cannot be told which "
                "is meant; give the images of one camera different names"
            )
        result[name] = matrix
    return result
