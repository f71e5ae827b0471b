"""Formats of exports, and the names in them: one source for Python and the command line."""

from dataclasses import dataclass
from typing import Literal

TextFormat = Literal[
    "ros2",
    "ros2-launch",
    "ros1",
    "ros1-launch",
    "urdf",
    "xacro",
    "easy-handeye2",
    "easy-handeye",
    "moveit",
    "opencv",
    "nerfstudio",
    "tum",
    "covariance",
    "json",
]
"""Formats that are one text."""

ExportFormat = Literal[TextFormat, "colmap"]
"""All formats."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """Names of frames and files in an export."""

    gripper_frame: str = "gripper"
    """Name of what the robot's poses are the poses of: the flange or the TCP, such as tool0."""
    base_frame: str = "base"
    """Name of what they are poses in, such as base_link."""
    camera_frame: str = ""
    """Name of the camera's optical frame (z forward, x right, y down). Default: camera_optical_frame, of several
    cameras NAME_optical_frame."""
    camera_link: str = ""
    """Give the pose of the camera's body, a frame of this name (such as camera_link), instead of that of its
    optical frame: for drivers that publish the optical frame in the body themselves."""
    link_to_optical: tuple[float, ...] = ()
    """With camera_link: pose of the optical frame in it, X Y Z in metres or X Y Z QX QY QZ QW, as tf2_echo prints
    it. Default: at its origin; without a quaternion the axes are those of ROS (body x forward, z up)."""
    camera: str = ""
    """Of several cameras only this one."""
    images: str = "images"
    """For nerfstudio: folder of the images, as seen from the folder of transforms.json."""
