"""What an export says: frame names from options, and the transforms between them; entry point ``placed``."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.errors import InputDataError
from handeye_fg.export_options import ExportOptions
from handeye_fg.frames import Array, inverse, pose
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.io.direction import direction
from handeye_fg.io.fields import shown
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.types import CameraModel, Setup

# What ROS, URDF, a shell and XML all take as one word.
_NAME = re.compile(r"[A-Za-z0-9_/.:-]+")
# Axes of a camera's optical frame (z forward, x right, y down) in its body (x forward, y left, z up).
_OPTICAL_XYZW = (-0.5, 0.5, -0.5, 0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """One camera under the names of an export.

    Attributes:
        name: the camera's own name, "camera" where there is only one.
        setup: whether it is on the gripper.
        base, gripper: names of the robot's frames.
        parent, child: names of the frames of the transform; the parent is one of the robot's.
        parent_T_child: (4, 4), metres: X, or the pose of the camera's body.
        X: the pose of the optical frame in the parent (4, 4), metres.
        covariance: of X (6, 6), or None.
        camera: intrinsics, or None.
        comments: what the transform is, in sentences.
    """

    name: str
    setup: Setup
    base: str
    gripper: str
    parent: str
    child: str
    parent_T_child: Array
    X: Array
    covariance: Array | None
    camera: CameraModel | None
    comments: tuple[str, ...]

    @property
    def position(self) -> list[float]:
        """Of the child in the parent, x y z, metres."""
        return [float(value) for value in self.parent_T_child[:3, 3]]

    @property
    def quaternion_xyzw(self) -> list[float]:
        """Of the child in the parent, Hamilton, w not negative."""
        rotation = Rotation.from_matrix(self.parent_T_child[:3, :3])
        return [float(value) for value in rotation.as_quat(canonical=True)]


def placed(result: Result, options: ExportOptions) -> tuple[Placed, ...]:
    """The cameras that are to be exported.

    Raises:
        InputDataError: a frame's name has characters that some format does not take, the offset of the body is
            no pose, or no camera has the name.
    """
    chosen = chosen_cameras(result, options.camera)
    if len(chosen) > 1 and (options.camera_frame or options.camera_link):
        raise InputDataError(
            f"there are {len(chosen)} cameras, but one frame name is given for them; choose one with "
            f"the option camera ({_names(result.cameras)})"
        )
    cameras = tuple(_placed(report, result.setup, options) for report in chosen)
    if len({camera.child for camera in cameras}) < len(cameras):
        raise InputDataError(
            f"two of the cameras {_names(result.cameras)} would have one frame name; choose one with the option "
            "camera, and name its frame"
        )
    return cameras


def chosen_cameras(result: Result, name: str) -> tuple[Result | CameraReport, ...]:
    """The reports of the cameras; that of the name where one is given.

    Raises:
        InputDataError: no camera has the name.
    """
    if not result.cameras:
        if name:
            raise InputDataError(
                f"there is one camera, without a name, but {shown(name)} is asked for; leave the option "
                "camera out"
            )
        return (result,)
    chosen = tuple(camera for camera in result.cameras if name in {"", camera.name})
    if not chosen:
        raise InputDataError(
            f"no camera has the name {shown(name)}; choose one of {_names(result.cameras)}"
        )
    return chosen


def one(cameras: Sequence[Placed], what: str) -> Placed:
    """The only camera.

    Raises:
        InputDataError: there are several.
    """
    if len(cameras) != 1:
        raise InputDataError(
            f"{what} holds one camera, but the result has {len(cameras)}; choose one with the option camera "
            f"({', '.join(camera.name for camera in cameras)})"
        )
    return cameras[0]


def rpy(rotation: Array) -> list[float]:
    """Roll, pitch and yaw of a rotation (3, 3) as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll), radians.

    Roll is found after the yaw is taken off, so that their sum is right to rounding where the pitch is 90 degrees
    and neither is determined by itself.
    """
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-rotation[2, 0], c * rotation[0, 0] + s * rotation[1, 0])
    across = -s * rotation[0] + c * rotation[1]
    roll = np.arctan2(-across[2], across[1])
    return [float(roll), float(pitch), float(yaw)]


def _placed(report: Result | CameraReport, setup: Setup, options: ExportOptions) -> Placed:
    base, gripper = _checked(options.base_frame), _checked(options.gripper_frame)
    parent = gripper if setup == "eye-in-hand" else base
    name = report.name if isinstance(report, CameraReport) else "camera"
    optical = _checked(options.camera_frame or f"{_as_word(name)}_optical_frame")
    frame = parent_frame(setup)
    comments = [
        direction(report.matrix, frame),
        f"{frame} is the frame {parent}, camera the frame {optical} (optical: z forward, x right, y down).",
    ]
    child, matrix = optical, report.matrix
    if options.camera_link:
        child = _checked(options.camera_link)
        link_T_optical = _offset(options.link_to_optical)
        matrix = report.matrix @ inverse(link_T_optical)
        comments.append(
            f"What stands here is the pose of {child} in {parent}: {frame}_T_camera times the inverse of the "
            f"pose of {optical} in {child}."
        )
    elif options.link_to_optical:
        raise InputDataError(
            "the pose of the optical frame in the camera's body is given, but no name of the body; give it "
            "with the option camera_link"
        )
    if report.free_directions:
        free = " ".join(item.description for item in report.free_directions)
        comments.append(f"PARTIAL: a part of this transform was chosen, not measured. {free}")
    return Placed(
        name=name,
        setup=setup,
        base=base,
        gripper=gripper,
        parent=parent,
        child=child,
        parent_T_child=matrix,
        X=report.matrix,
        covariance=report.covariance,
        camera=report.camera,
        # On one line each: what follows a line end would not be a comment.
        comments=tuple(" ".join(comment.split()) for comment in comments),
    )


def _offset(numbers: Sequence[float]) -> Array:
    """The pose (4, 4) of the optical frame in the body."""
    values = np.array(numbers or (0.0, 0.0, 0.0), dtype=np.float64)
    if len(values) == 3:
        values = np.append(values, _OPTICAL_XYZW)
    norm = float(np.linalg.norm(values[3:]))
    if len(values) != 7 or not np.isfinite(values).all() or abs(norm - 1.0) > 1e-3:
        raise InputDataError(
            f"the pose of the optical frame in the camera's body is {' '.join(map(str, numbers))}, but must be "
            "X Y Z, or X Y Z QX QY QZ QW with a unit quaternion"
        )
    return pose(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def _checked(name: str) -> str:
    if not _NAME.fullmatch(name):
        raise InputDataError(
            f"{shown(name)} is no name of a frame: use letters, digits and _ / . : -, without spaces"
        )
    return name


def _as_word(name: str) -> str:
    """A camera's name, which is that of a folder, in the characters of a frame's name."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def _names(cameras: Sequence[CameraReport]) -> str:
    return ", ".join(camera.name for camera in cameras)
