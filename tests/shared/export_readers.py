"""A reader of each export format, independent of its writer: the matrix and the names of its two frames."""

import argparse
import json
import re
import shlex
import subprocess
import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import xacro
import yaml
from scipy.spatial.transform import Rotation
from urdf_parser_py.urdf import URDF

from handeye_fg.frames import Array, pose

EXACT = {"rtol": 0.0, "atol": 1e-9}


def matrix_of(position: Any, quaternion_xyzw: Any) -> Array:
    rotation = Rotation.from_quat(np.array(quaternion_xyzw, dtype=float)).as_matrix()
    return pose(rotation, np.array(position, dtype=float))


def of_arguments(words: list[str]) -> tuple[Array, str, str]:
    """What static_transform_publisher makes of its arguments: ROS 2 by flag, ROS 1 by place."""
    if not words[0].startswith("--"):
        numbers = [float(word) for word in words[:7]]
        parent, child = words[7:]
        return matrix_of(numbers[:3], numbers[3:]), parent, child
    parser = argparse.ArgumentParser()
    for name in ("x", "y", "z", "qx", "qy", "qz", "qw"):
        parser.add_argument(f"--{name}", type=float, required=True)
    parser.add_argument("--frame-id", required=True)
    parser.add_argument("--child-frame-id", required=True)
    found = parser.parse_args(words)
    position, quaternion = (found.x, found.y, found.z), (found.qx, found.qy, found.qz, found.qw)
    return matrix_of(position, quaternion), found.frame_id, found.child_frame_id


def of_urdf(text: str) -> tuple[Array, str, str]:
    robot = URDF.from_xml_string(text.encode())
    (joint,) = robot.joints
    assert joint.type == "fixed"
    assert robot.get_root() == joint.parent
    assert set(robot.link_map) == {joint.parent, joint.child}
    rotation = Rotation.from_euler("xyz", joint.origin.rpy).as_matrix()
    return pose(rotation, np.array(joint.origin.xyz)), joint.parent, joint.child


def of_command(text: str) -> tuple[Array, str, str]:
    # A shell takes the words, so that comments are seen to be comments.
    echoed = text.replace("ros2 run tf2_ros", "echo").replace("rosrun tf2_ros", "echo")
    done = subprocess.run(["sh", "-eu"], input=echoed, capture_output=True, text=True, check=True)
    words = shlex.split(done.stdout)
    assert words[0] == "static_transform_publisher"
    return of_arguments(words[1:])


# What the loaders of ROS know of a node: wiki.ros.org/roslaunch/XML/node, and NodeAction of launch_ros. Both
# substitute what stands in $(...), and refuse a node without what they need, or with what they do not know.
NODE = {
    "pkg",
    "name",
    "args",
    "output",
    "cwd",
    "launch-prefix",
    "respawn",
    "respawn_delay",
    "if",
    "unless",
}
NODE_OF_ROS1 = NODE | {"type", "machine", "required", "ns", "clear_params"}
NODE_OF_ROS2 = NODE | {"exec", "ros_args", "namespace", "exec_name"}


def of_launch(text: str, program: str, needed: set[str], known: set[str]) -> tuple[Array, str, str]:
    launch = ET.fromstring(text)
    assert (launch.tag, launch.attrib) == ("launch", {})
    assert text.startswith('<?xml version="1.0"?>\n<launch>')
    (node,) = launch
    assert node.tag == "node"
    assert not len(node)
    assert needed <= set(node.attrib) <= known
    assert not any("$" in value for value in node.attrib.values())
    # A name in the graph, without a namespace.
    assert re.fullmatch(r"[A-Za-z]\w*", node.attrib["name"], re.ASCII)
    assert (node.get("pkg"), node.get(program)) == ("tf2_ros", "static_transform_publisher")
    # Python's and the shell's splitting of the arguments agree.
    assert shlex.split(node.attrib["args"]) == node.attrib["args"].split()
    return of_arguments(node.attrib["args"].split())


def of_launch1(text: str) -> tuple[Array, str, str]:
    return of_launch(text, "type", {"pkg", "type", "name"}, NODE_OF_ROS1)


def of_launch2(text: str) -> tuple[Array, str, str]:
    return of_launch(text, "exec", {"pkg", "exec"}, NODE_OF_ROS2)


def of_xacro(text: str) -> tuple[Array, str, str]:
    robot = (
        '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro"><link name="{}"/>{}</robot>'
    )
    parent = ET.fromstring(text).find("joint/parent").attrib["link"]  # type: ignore[union-attr]  # there
    inside = text[text.index("<robot") :]
    inside = inside[inside.index(">") + 1 : inside.rindex("</robot>")]
    document = xacro.parse(robot.format(parent, inside))
    xacro.process_doc(document)
    return of_urdf(document.toxml())


def of_easy_handeye(text: str) -> tuple[Array, str, str]:
    content = yaml.safe_load(text)
    parameters, found = content["parameters"], content["transformation"]
    parent = parameters["robot_effector_frame" if parameters["eye_on_hand"] else "robot_base_frame"]
    position, quaternion = [found[k] for k in "xyz"], [found[f"q{k}"] for k in "xyzw"]
    return matrix_of(position, quaternion), parent, parameters["tracking_base_frame"]


def of_easy_handeye2(text: str) -> tuple[Array, str, str]:
    content = yaml.safe_load(text)
    assert set(content) == {"parameters", "transform"}
    parameters, found = content["parameters"], content["transform"]
    assert set(parameters) == {
        *("name", "calibration_type", "robot_base_frame", "robot_effector_frame"),
        *("tracking_base_frame", "tracking_marker_frame", "freehand_robot_movement"),
        *("move_group_namespace", "move_group"),
    }
    in_hand = {"eye_in_hand": True, "eye_on_base": False}[parameters["calibration_type"]]
    parent = parameters["robot_effector_frame" if in_hand else "robot_base_frame"]
    position, quaternion = found["translation"], found["rotation"]
    return (
        matrix_of([position[k] for k in "xyz"], [quaternion[k] for k in "xyzw"]),
        parent,
        parameters["tracking_base_frame"],
    )


def of_opencv(text: str) -> tuple[Array, str, str]:
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    names = [storage.getNode(f"{who}_frame").string() for who in ("parent", "child")]
    return storage.getNode("parent_T_child").mat(), names[0], names[1]


def of_json(text: str) -> tuple[Array, str, str]:
    content = json.loads(text)
    matrix = np.array(content["matrix"])
    np.testing.assert_allclose(
        matrix_of(content["translation_m"], content["quaternion_xyzw"]), matrix, **EXACT
    )
    rotation = Rotation.from_euler("xyz", content["rpy_rad"]).as_matrix()
    np.testing.assert_allclose(rotation, matrix[:3, :3], **EXACT)
    return matrix, content["parent"], content["child"]


READERS: dict[str, Callable[[str], tuple[Array, str, str]]] = {
    "ros2": of_command,
    "ros1": of_command,
    "ros2-launch": of_launch2,
    "ros1-launch": of_launch1,
    "moveit": of_launch1,
    "urdf": of_urdf,
    "xacro": of_xacro,
    "easy-handeye": of_easy_handeye,
    "easy-handeye2": of_easy_handeye2,
    "opencv": of_opencv,
    "json": of_json,
}
