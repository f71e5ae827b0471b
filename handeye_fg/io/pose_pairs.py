"""Pose pairs: two lists of poses or motions, paired by name or by order; entry ``read_pairs``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse, orthonormalised, pose
from handeye_fg.io.fields import shown
from handeye_fg.io.poses import PoseFile, open_poses, poses_from_mapping
from handeye_fg.io.read_as import ReadAs
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.options import PoseFileOptions
from handeye_fg.types import RobotPoses, Setup

PoseList = Array | str | Path | Mapping[str, Array]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedPairs:
    """Rows with a pose (or motion) of the robot and one of the camera.

    Attributes:
        names: of the rows (n,).
        data: their poses, those of the robot inverted for eye-to-hand; or their motions.
        left_out: (name, reason) of the rows without partner.
        files: of the "robot" and the "camera"; without those that came otherwise.
    """

    names: tuple[str, ...]
    data: PosePairs | MotionPairs
    left_out: tuple[tuple[str, str], ...]
    files: Mapping[str, PoseFile] = field(default_factory=dict)

    @property
    def read_as(self) -> dict[str, ReadAs]:
        """How the files were read."""
        return {whose: file.read_as for whose, file in self.files.items()}


def read_pairs(
    robot: PoseList,
    camera: PoseList,
    *,
    names: Sequence[str] | None,
    weights: Array | None,
    setup: Setup,
    motions: bool,
    robot_file: PoseFileOptions | None = None,
    camera_file: PoseFileOptions | None = None,
) -> NamedPairs:
    """Both lists, row by row: arrays by order, files and mappings by name, or by time.

    Rotations that are orthogonal within rounding in print are replaced by the nearest rotation.

    Args:
        robot: base_T_gripper, or motions gi_T_gj.
        camera: world_T_camera, or motions ci_T_cj.
        names: of the rows of arrays; None: their numbers.
        weights: (n,), or None.
        setup: for eye-to-hand robot poses are inverted; motions are taken as they are.
        motions: whether the lists are motions.
        robot_file: how a file of the robot's is to be read, and how its rows find those of the camera's,
            which then count as images.
        camera_file: how a file of the camera's is to be read.

    Raises:
        InputDataError: a list breaks its format, or the two do not fit together.
    """
    files: dict[str, PoseFile] = {}
    if isinstance(camera, str | Path):
        files["camera"] = open_poses(camera, camera_file)
    named_camera = _named(camera, files.get("camera"))
    if isinstance(robot, str | Path):
        partners = None if named_camera is None else named_camera.names
        files["robot"] = open_poses(robot, robot_file, partners)
    named = [_named(robot, files.get("robot")), named_camera]
    if named == [None, None]:
        arrays = (_array(robot, "robot"), _array(camera, "camera"))
        rows = tuple(f"row {i}" for i in range(len(arrays[0]))) if names is None else tuple(names)
        if len(rows) != len(arrays[0]):
            raise InputDataError(
                f"there are {len(rows)} names but {len(arrays[0])} rows; give one name for each row"
            )
        left_out: tuple[tuple[str, str], ...] = ()
    elif named[0] is None or named[1] is None:
        raise InputDataError(
            "one list of poses has names and the other is an array; give both as arrays or both "
            "with names"
        )
    elif names is not None:
        raise InputDataError("the poses already have names; give names for arrays only")
    else:
        rows, arrays, left_out = _paired(named[0], named[1])
    return NamedPairs(
        names=rows,
        data=_pairs(*arrays, weights, setup, motions=motions),
        left_out=left_out,
        files=dict(sorted(files.items(), reverse=True)),
    )


def _named(source: PoseList, file: PoseFile | None) -> RobotPoses | None:
    """Poses with names; None for an array."""
    if file is not None:
        return file.poses()
    return poses_from_mapping(source) if isinstance(source, Mapping) else None


def _array(source: object, who: str) -> Array:
    """Matrices (n, 4, 4) of numbers."""
    try:
        array = np.asarray(source, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputDataError(
            f"the {who} poses are no array of numbers: give matrices of shape (n, 4, 4)"
        ) from error
    if array.ndim != 3 or array.shape[1:] != (4, 4):
        raise InputDataError(
            f"the {who} poses have the shape {array.shape}: expected (n, 4, 4) matrices"
        )
    return array


def _paired(
    robot: RobotPoses, camera: RobotPoses
) -> tuple[tuple[str, ...], tuple[Array, Array], tuple[tuple[str, str], ...]]:
    """Names and poses of the rows that are in both lists, and the other rows."""
    index = {name: i for i, name in enumerate(camera.names)}
    kept = [i for i, name in enumerate(robot.names) if name in index]
    names = tuple(robot.names[i] for i in kept)
    if not names:
        raise InputDataError(
            f"no robot pose has the name of a camera pose: the robot's are named like "
            f"{shown(robot.names[0])}, the camera's like {shown(camera.names[0])}; write the same "
            "names into both lists"
        )
    left_out = [(name, "no camera pose has this name") for name in robot.names if name not in index]
    known = set(names)
    left_out += [
        (name, "no robot pose has this name") for name in camera.names if name not in known
    ]
    partners = [index[name] for name in names]
    return names, (robot.base_T_gripper[kept], camera.base_T_gripper[partners]), tuple(left_out)


def _pairs(
    robot: Array, camera: Array, weights: Array | None, setup: Setup, *, motions: bool
) -> PosePairs | MotionPairs:
    """The rows in the form of the equations."""
    if len(robot) != len(camera):
        raise InputDataError(
            f"there are {len(robot)} robot poses but {len(camera)} camera poses: give one camera "
            "pose for each robot pose, in the same order"
        )
    if motions:
        start = 2 * np.arange(len(robot))  # motions share no poses as far as is known
        given = MotionPairs(i=start, j=start + 1, gi_T_gj=robot, ci_T_cj=camera, weights=weights)
        return MotionPairs(
            i=given.i,
            j=given.j,
            gi_T_gj=_rigid(given.gi_T_gj),
            ci_T_cj=_rigid(given.ci_T_cj),
            weights=given.weights,
        )
    checked = PosePairs(base_T_gripper=robot, world_T_camera=camera, weights=weights)
    base_T_gripper = _rigid(checked.base_T_gripper)
    return PosePairs(
        base_T_gripper=base_T_gripper if setup == "eye-in-hand" else inverse(base_T_gripper),
        world_T_camera=_rigid(checked.world_T_camera),
        weights=checked.weights,
    )


def _rigid(matrices: Array) -> Array:
    """The nearest poses (n, 4, 4)."""
    return pose(orthonormalised(matrices[:, :3, :3]), matrices[:, :3, 3])
