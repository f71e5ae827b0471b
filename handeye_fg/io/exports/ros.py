"""Commands and files of ROS: static transforms, URDF, and those of other calibrations."""

from collections.abc import Callable, Sequence
from xml.sax.saxutils import escape

import yaml

from handeye_fg.io.exports.placed import Placed, one, rpy

_MARKER = "handeye_target"  # these programs want a name for the board that they would have used


def ros2(cameras: Sequence[Placed]) -> str:
    """Commands that publish the transforms, for a shell."""
    return _commented(
        cameras, "#", lambda camera: f"ros2 run tf2_ros static_transform_publisher {_flags(camera)}"
    )


def ros1(cameras: Sequence[Placed]) -> str:
    """The same for ROS 1: position, quaternion, parent, child."""
    return _commented(
        cameras, "#", lambda camera: f"rosrun tf2_ros static_transform_publisher {_words(camera)}"
    )


def ros2_launch(cameras: Sequence[Placed]) -> str:
    """A launch file in XML."""
    return _launch(
        cameras, lambda camera: f'exec="static_transform_publisher" args="{_flags(camera)}"'
    )


def ros1_launch(cameras: Sequence[Placed]) -> str:
    """A launch file of ROS 1, as MoveIt's calibration writes it."""
    return _launch(
        cameras, lambda camera: f'type="static_transform_publisher" args="{_words(camera)}"'
    )


def urdf(cameras: Sequence[Placed]) -> str:
    """A robot of its own: the parent, the cameras and a fixed joint to each."""
    links = f'  <link name="{cameras[0].parent}"/>\n'
    return f'<?xml version="1.0"?>\n<robot name="handeye">\n{links}{_joints(cameras)}</robot>\n'


def xacro(cameras: Sequence[Placed]) -> str:
    """What xacro includes into a robot that has the parent."""
    return (
        '<?xml version="1.0"?>\n<robot xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        f"{_joints(cameras)}</robot>\n"
    )


def easy_handeye(cameras: Sequence[Placed]) -> str:
    """The file of easy_handeye: ~/.ros/easy_handeye/NAME.yaml."""
    camera = one(cameras, "a file of easy_handeye")
    in_hand = camera.setup == "eye-in-hand"
    keys = ("x", "y", "z", "qx", "qy", "qz", "qw")
    content = {
        "parameters": {
            "eye_on_hand": in_hand,
            "freehand_robot_movement": True,
            "move_group": "manipulator",
            "move_group_namespace": "/",
            "namespace": f"/handeye_{'eye_on_hand' if in_hand else 'eye_on_base'}/",
            **_frames(camera),
        },
        "transformation": dict(zip(keys, (*camera.position, *camera.quaternion_xyzw), strict=True)),
    }
    return _yaml(camera, content)


def easy_handeye2(cameras: Sequence[Placed]) -> str:
    """The file of easy_handeye2: ~/.ros2/easy_handeye2/calibrations/NAME.calib."""
    camera = one(cameras, "a file of easy_handeye2")
    content = {
        "parameters": {
            "name": "handeye",
            "calibration_type": "eye_in_hand" if camera.setup == "eye-in-hand" else "eye_on_base",
            **_frames(camera),
            "freehand_robot_movement": True,
            "move_group_namespace": "/",
            "move_group": "manipulator",
        },
        "transform": {
            "translation": dict(zip("xyz", camera.position, strict=True)),
            "rotation": dict(zip("xyzw", camera.quaternion_xyzw, strict=True)),
        },
    }
    return _yaml(camera, content)


def _frames(camera: Placed) -> dict[str, str]:
    return {
        "robot_base_frame": camera.base,
        "robot_effector_frame": camera.gripper,
        "tracking_base_frame": camera.child,
        "tracking_marker_frame": _MARKER,
    }


def _flags(camera: Placed) -> str:
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*camera.position, *camera.quaternion_xyzw)
    numbers = " ".join(f"--{name} {value!r}" for name, value in zip(names, values, strict=True))
    return f"{numbers} --frame-id {camera.parent} --child-frame-id {camera.child}"


def _words(camera: Placed) -> str:
    return f"{_numbers((*camera.position, *camera.quaternion_xyzw))} {camera.parent} {camera.child}"


def _launch(cameras: Sequence[Placed], attributes: Callable[[Placed], str]) -> str:
    nodes = [
        f"{_xml_comments(camera)}  <!-- {_origin(camera)} -->\n"
        f'  <node pkg="tf2_ros" name="{_node(camera)}" {attributes(camera)}/>\n'
        for camera in cameras
    ]
    return f'<?xml version="1.0"?>\n<launch>\n{"".join(nodes)}</launch>\n'


def _node(camera: Placed) -> str:
    """A name for the node that publishes a transform: letters, digits and _ only."""
    word = "".join(char if char.isalnum() else "_" for char in camera.child)
    return f"handeye_{word}_broadcaster"


def _joints(cameras: Sequence[Placed]) -> str:
    return "".join(
        f'{_xml_comments(camera)}  <link name="{camera.child}"/>\n'
        f'  <joint name="{camera.parent}_to_{camera.child}" type="fixed">\n'
        f'    <parent link="{camera.parent}"/>\n    <child link="{camera.child}"/>\n'
        f"    <origin {_origin(camera)}/>\n  </joint>\n"
        for camera in cameras
    )


def _origin(camera: Placed) -> str:
    """The pose as URDF has it: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    angles = rpy(camera.parent_T_child[:3, :3])
    return f'xyz="{_numbers(camera.position)}" rpy="{_numbers(angles)}"'


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(value) for value in values)


def _commented(cameras: Sequence[Placed], mark: str, line: Callable[[Placed], str]) -> str:
    lines = []
    for camera in cameras:
        lines += [f"{mark} {comment}" for comment in camera.comments]
        lines.append(line(camera))
    return "\n".join(lines) + "\n"


def _yaml(camera: Placed, content: object) -> str:
    comments = "".join(f"# {comment}\n" for comment in camera.comments)
    return comments + yaml.safe_dump(content, sort_keys=False)


def _xml_comments(camera: Placed) -> str:
    # Two hyphens end a comment in XML.
    comments = (escape(comment).replace("--", "- -") for comment in camera.comments)
    return "".join(f"  <!-- {comment} -->\n" for comment in comments)
