"""Each format is read back by the reader of that format, and has the same numbers."""

import argparse
import io
import json
import re
import runpy
import shlex
import subprocess
import sys
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
import xacro
import yaml
from evo.tools import file_interface
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from urdf_parser_py.urdf import URDF

import handeye_fg as hf
from handeye_fg.cli import main
from handeye_fg.findings import FreeDirection
from handeye_fg.frames import Array, exp, inverse, pose
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.io.cameras import read_camera
from handeye_fg.io.exports import export_text
from handeye_fg.io.exports.placed import rpy
from handeye_fg.io.results import Result
from handeye_fg.types import CameraModel

make_result: Callable[..., Result] = runpy.run_path(
    str(Path(__file__).parents[2] / "report" / "conftest.py")
)["make_result"]
NAMES = hf.ExportOptions(
    gripper_frame="tool0", base_frame="base_link", camera_frame="camera_color_optical_frame"
)
LINK = replace(NAMES, camera_link="camera_link", link_to_optical=(0.001, 0.015, -0.002))
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
# substitute what stands in $(...), and refuse a node without the first of these, or with others.
NODE_OF_ROS1 = (
    "pkg",
    "type",
    "name",
    "args",
    "machine",
    "respawn",
    "respawn_delay",
    "required",
    "ns",
)
NODE_OF_ROS1 += ("clear_params", "output", "cwd", "launch-prefix", "if", "unless")
NODE_OF_ROS2 = (
    "pkg",
    "exec",
    "name",
    "args",
    "ros_args",
    "namespace",
    "exec_name",
    "output",
    "cwd",
)
NODE_OF_ROS2 += ("launch-prefix", "respawn", "respawn_delay", "if", "unless")


def of_launch(text: str, known: tuple[str, ...], n_needed: int) -> tuple[Array, str, str]:
    launch = ET.fromstring(text)
    assert (launch.tag, launch.attrib) == ("launch", {})
    assert text.startswith('<?xml version="1.0"?>\n<launch>')
    (node,) = launch
    assert node.tag == "node"
    assert not len(node)
    assert set(known[:n_needed]) <= set(node.attrib) <= set(known)
    assert not any("$" in value for value in node.attrib.values())
    assert re.fullmatch(
        r"[A-Za-z]\w*", node.attrib["name"], re.ASCII
    )  # of a graph resource, no namespace
    assert (node.get("pkg"), node.get(known[1])) == ("tf2_ros", "static_transform_publisher")
    # Python's and the shell's splitting of the arguments agree.
    assert shlex.split(node.attrib["args"]) == node.attrib["args"].split()
    return of_arguments(node.attrib["args"].split())


def of_launch1(text: str) -> tuple[Array, str, str]:
    return of_launch(text, NODE_OF_ROS1, 3)


def of_launch2(text: str) -> tuple[Array, str, str]:
    return of_launch(text, NODE_OF_ROS2, 2)


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
# Near a pitch of 90 degrees roll and yaw run together.
TURNS = (
    [0.3, -0.2, 1.4],
    [np.pi, 0.0, 0.0],
    [0.0, np.pi / 2, 0.0],
    [0.0, -np.pi / 2 + 1e-9, 0.0],
)


@pytest.mark.parametrize("form", READERS)
@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_the_numbers_and_frames_read_back(form: str, setup: Any) -> None:
    parent = "tool0" if setup == "eye-in-hand" else "base_link"
    for turn in TURNS:
        X = exp(np.array([*turn, 0.03, -0.05, 1 / 3]))
        result = make_result(matrix=X, setup=setup)
        matrix, *names = READERS[form](hf.export(result, form, options=NAMES))
        np.testing.assert_allclose(matrix, X, **EXACT)
        assert names == [parent, "camera_color_optical_frame"]


@pytest.mark.parametrize("form", READERS)
def test_the_body_of_the_camera(form: str) -> None:
    """With the driver's own transform from the body to the optical frame, X comes out."""
    result = make_result()
    matrix, *names = READERS[form](result.export(form, LINK))
    link_T_optical = matrix_of((0.001, 0.015, -0.002), (-0.5, 0.5, -0.5, 0.5))
    # Of ROS: the optical z is the body's x, the optical x its -y.
    np.testing.assert_allclose(link_T_optical[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(link_T_optical[:3, :3] @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(matrix @ link_T_optical, result.matrix, **EXACT)
    assert names == ["tool0", "camera_link"]
    given = replace(LINK, link_to_optical=(0.001, 0.015, -0.002, -0.5, 0.5, -0.5, 0.5))
    assert result.export(form, given) == result.export(form, LINK)


def plain(text: str) -> str:
    """A file's comments on one line, as people read them."""
    return " ".join(text.replace("#", " ").split())


@pytest.mark.parametrize("form", [*READERS, "covariance"])
def test_each_says_what_the_transform_is(form: str) -> None:
    result = make_result()
    text = plain(export_text(result, form, NAMES))
    point = result.matrix[:3, 3] + 0.5 * result.matrix[:3, 2]
    numbers = ", ".join(f"{value:.6f}" for value in point)
    assert "Put a point given in camera coordinates into gripper coordinates" in text
    assert f"p_gripper = gripper_T_camera p_camera; the point 0.5 m in front of the camera, (0, 0, 0.5), is at ({numbers}) m" in text  # fmt: skip
    assert "gripper is the frame tool0, camera the frame camera_color_optical_frame" in text


@pytest.mark.parametrize("form", [*READERS, "covariance"])
def test_a_partial_result_says_so_and_stays_readable(form: str) -> None:
    """Even where the description holds what would end a comment of the format."""
    free = FreeDirection(
        kind="translation",
        vector=np.array([0.0, 0.0, 1.0]),
        frame="gripper",
        description="Height is free; --prior helps -->\n<evil/>\r\necho evil\u2028echo evil",
    )
    result = make_result(status="partial", free_directions=(free,))
    text = export_text(result, form, NAMES)
    assert "PARTIAL: a part of this transform was chosen, not measured." in plain(text)
    if form in READERS:
        np.testing.assert_allclose(READERS[form](text)[0], result.matrix, **EXACT)


def test_intrinsics_of_opencv_are_those_that_camera_files_give(tmp_path: Path) -> None:
    cameras = [
        CameraModel(model="PINHOLE", width=64, height=48, params=np.array([50.1, 51, 32.5, 24])),
        CameraModel(
            model="OPENCV", width=64, height=48, params=np.array([50, 51, 32, 24, 0.1, 0.2, 0.3, 1])
        ),
        CameraModel(
            model="FULL_OPENCV",
            width=64,
            height=48,
            params=np.arange(50.0, 62.0) / [1, 1, *[9] * 10],
        ),
        CameraModel(
            model="OPENCV_FISHEYE",
            width=64,
            height=48,
            params=np.array([50, 51, 32, 24, 0.1, 0.2, 0.3, 0.4]),
        ),
    ]
    for camera in cameras:
        text = export_text(
            make_result(
                camera=camera,
                intrinsics_std=np.zeros(len(camera.params)),
                intrinsics_correlation=None,
            ),
            "opencv",
        )
        path = tmp_path / "camera.yaml"
        path.write_text(text)
        again = read_camera(path)
        n = len(camera.params)
        np.testing.assert_allclose(again.params[:n], camera.params, rtol=0.0, atol=1e-12)
        assert not again.params[n:].any()
        assert (again.width, again.height) == (64, 48)


def test_the_table_of_the_covariance() -> None:
    result = make_result()
    table = pd.read_csv(io.StringIO(export_text(result, "covariance")), comment="#")
    assert list(table.columns) == ["rx", "ry", "rz", "tx", "ty", "tz"]
    assert np.array_equal(table.to_numpy(), result.covariance)
    assert json.loads(export_text(result, "json"))["optical_covariance"] == table.values.tolist()
    with pytest.raises(hf.InputDataError, match="gives no covariance"):
        export_text(make_result(covariance=None, certainty=None), "covariance")


def test_a_trajectory_for_evo(tmp_path: Path) -> None:
    result = make_result()
    path = tmp_path / "trajectory.txt"
    hf.export(result, "tum", path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        trajectory = file_interface.read_tum_trajectory_file(path)
    wanted = {image.name: image.base_T_camera for image in result.images if image.registered}
    np.testing.assert_allclose(
        np.array(trajectory.poses_se3), np.array(list(wanted.values())), **EXACT
    )
    assert trajectory.timestamps.tolist() == list(range(len(wanted)))
    lines = path.read_text().splitlines()
    assert "# 3.000000000 'frame_0003.jpg'" in lines
    assert "p_base = base_T_camera p_camera" in lines[0]
    point = wanted["frame_0000.jpg"] @ [0.0, 0.0, 0.5, 1.0]  # type: ignore[operator]  # placed
    numbers = ", ".join(f"{value:.6f}" for value in point[:3])
    assert lines[1].startswith(
        "# Of 'frame_0000.jpg': Put a point given in camera coordinates into"
    )
    assert lines[1].endswith(f"(0, 0, 0.5), is at ({numbers}) m in the base frame.")


def test_time_stamps_in_names_are_kept(tmp_path: Path) -> None:
    images = [
        replace(image, name=f"14036{i}.25.png") for i, image in enumerate(make_result().images)
    ]
    text = export_text(make_result(images=tuple(images)), "tum")
    path = tmp_path / "trajectory.txt"
    path.write_text(text)
    stamps = file_interface.read_tum_trajectory_file(path).timestamps
    assert stamps[:3].tolist() == [140360.25, 140361.25, 140362.25]


def test_nerfstudio() -> None:
    result = make_result()
    content = json.loads(export_text(result, "nerfstudio", hf.ExportOptions(images="../rgb")))
    assert content["camera_model"] == "OPENCV"
    assert [content[k] for k in ("fl_x", "fl_y", "cx", "cy", "k1", "k2", "p1", "p2")] == (
        result.camera.params.tolist()  # type: ignore[union-attr]  # it has one
    )
    assert (content["w"], content["h"]) == (1280, 960)
    placed = {image.name: image.base_T_camera for image in result.images if image.registered}
    assert [frame["file_path"] for frame in content["frames"]] == [f"../rgb/{n}" for n in placed]
    for frame, base_T_camera in zip(content["frames"], placed.values(), strict=True):
        base_T_opengl = np.array(frame["transform_matrix"])
        assert base_T_camera is not None
        # OpenGL looks along its -z with y up: the same ray, written in its axes.
        for x, y, z in ((0.1, 0.2, 1.0), (0.0, 0.0, 2.0)):
            np.testing.assert_allclose(
                base_T_opengl @ [x, -y, -z, 1.0], base_T_camera @ [x, y, z, 1.0], **EXACT
            )
    assert "p_base = transform_matrix p_camera" in content["comment"]
    point = np.array(content["frames"][0]["transform_matrix"]) @ [0.0, 0.0, -0.5, 1.0]
    numbers = ", ".join(f"{value:.6f}" for value in point[:3])
    assert f"(0, 0, -0.5), is at ({numbers}) m in the base frame" in content["comment"]


def test_eye_to_hand_has_its_scene_in_the_gripper() -> None:
    images = make_result().images
    moving = tuple(
        replace(image, gripper_T_camera=image.base_T_camera, base_T_camera=np.eye(4))
        if image.registered
        else image
        for image in images
    )
    result = make_result(setup="eye-to-hand", images=moving)
    content = json.loads(export_text(result, "nerfstudio"))
    assert "p_gripper = transform_matrix p_camera" in content["comment"]
    np.testing.assert_allclose(
        np.array(content["frames"][0]["transform_matrix"])[:, 3],
        images[0].base_T_camera[:, 3],  # type: ignore[index]  # placed
    )
    with pytest.raises(hf.InputDataError, match="the camera stands still in the base"):
        export_text(result, "tum")


def several() -> Result:
    """Two cameras, the second of which is another."""
    result = make_result()
    images = tuple(
        replace(image, name=f"cam{i % 2}/{image.name}") for i, image in enumerate(result.images)
    )
    first_T_second = exp(np.array([0.1, 0.2, 0.3, 0.1, 0.0, 0.0]))
    assert result.camera is not None
    reports = [
        CameraReport(
            name=f"cam{k}",
            matrix=result.matrix @ offset,
            covariance=result.covariance,
            free_directions=(),
            camera=replace(result.camera, params=result.camera.params * (1.0 + k)),
            intrinsics_refined=False,
            intrinsics_std=np.zeros(8),
            intrinsics_note="",
            pixel=0.5,
            other_intrinsics=None,
            focal_offset=None,
            first_T_camera=offset,
            first_T_camera_covariance=np.zeros((6, 6)),
        )
        for k, offset in enumerate((np.eye(4), first_T_second))
    ]
    return replace(result, images=images, cameras=tuple(reports))


def test_several_cameras() -> None:
    result = several()
    names = [f"cam{k}_optical_frame" for k in (0, 1)]
    robot = URDF.from_xml_string(export_text(result, "urdf").encode())
    assert [joint.child for joint in robot.joints] == names
    lines = [line for line in export_text(result, "ros2").splitlines() if line[0] != "#"]
    for line, report in zip(lines, result.cameras, strict=True):
        np.testing.assert_allclose(of_arguments(shlex.split(line)[4:])[0], report.matrix, **EXACT)
    nodes = ET.fromstring(export_text(result, "ros1-launch")).findall("node")
    assert len({node.get("name") for node in nodes}) == 2
    assert [each["child"] for each in json.loads(export_text(result, "json"))] == names
    for form in ("easy-handeye", "easy-handeye2", "opencv", "covariance", "tum"):
        with pytest.raises(
            hf.InputDataError, match=r"choose one with the option camera \(cam0, cam1"
        ):
            export_text(result, form)
    chosen = hf.ExportOptions(camera="cam1", camera_frame="eye")
    matrix, _, child = of_opencv(export_text(result, "opencv", chosen))
    np.testing.assert_allclose(matrix, result.cameras[1].matrix, **EXACT)
    assert child == "eye"
    frames = json.loads(export_text(result, "nerfstudio"))["frames"]
    assert {(frame["file_path"][7:11], frame["fl_x"]) for frame in frames} == {
        ("cam0", result.cameras[0].camera.params[0]),
        ("cam1", result.cameras[1].camera.params[0]),
    }
    assert len(json.loads(export_text(result, "nerfstudio", chosen))["frames"]) == 8
    alike = [
        replace(report, name=f"a{mark}b") for report, mark in zip(result.cameras, " _", strict=True)
    ]
    with pytest.raises(hf.InputDataError, match="would have one frame name"):
        export_text(replace(result, cameras=tuple(alike)), "urdf")
    with pytest.raises(hf.InputDataError, match="one frame name is given for them"):
        export_text(result, "urdf", hf.ExportOptions(camera_frame="eye"))
    with pytest.raises(
        hf.InputDataError, match="no camera has the name 'x'; choose one of cam0, cam1"
    ):
        export_text(result, "urdf", hf.ExportOptions(camera="x"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gripper_frame": ""}, "'' is no name of a frame"),
        ({"camera_frame": "a b"}, "'a b' is no name of a frame"),
        ({"base_frame": "$(rm -rf /)"}, "is no name of a frame"),
        ({"camera_frame": 'x"/><evil'}, "is no name of a frame"),
        ({"camera_link": "a\nb"}, "is no name of a frame"),
        ({"link_to_optical": (0.0, 0.0, 0.0)}, "no name of the body"),
        ({"camera_link": "c", "link_to_optical": (0.0, 1.0)}, "is 0.0 1.0, but must be X Y Z"),
        ({"camera_link": "c", "link_to_optical": (0.0,) * 7}, "with a unit quaternion"),
        ({"camera_link": "c", "link_to_optical": (np.nan,) * 3}, "is nan nan nan, but must"),
        ({"camera": "cam0"}, "there is one camera, without a name, but 'cam0' is asked for"),
    ],
)
def test_options_that_cannot_be(options: dict[str, Any], message: str) -> None:
    with pytest.raises(hf.InputDataError, match=message.replace("(", r"\(").replace("$", r"\$")):
        export_text(make_result(), "ros2", hf.ExportOptions(**options))


def test_what_a_format_cannot_hold_is_refused() -> None:
    bare = make_result(camera=None, intrinsics_std=None, sfm=None)
    with pytest.raises(hf.InputDataError, match="no intrinsics"):
        export_text(bare, "nerfstudio")
    assert "camera_matrix" not in export_text(bare, "opencv")
    with pytest.raises(hf.InputDataError, match="no camera poses"):
        export_text(make_result(images=()), "tum")
    rational = CameraModel(model="FULL_OPENCV", width=9, height=9, params=np.ones(12))
    with pytest.raises(hf.InputDataError, match="terms k4, k5 and k6 of FULL_OPENCV"):
        export_text(
            make_result(camera=rational, intrinsics_std=np.ones(12), intrinsics_correlation=None),
            "nerfstudio",
        )
    for export in (hf.export, export_text):
        with pytest.raises(hf.InputDataError, match="there is no format 'cad'"):
            export(make_result(), "cad")
    with pytest.raises(hf.InputDataError, match="colmap is a folder"):
        hf.export(make_result(), "colmap")


@settings(max_examples=200, deadline=None)
@given(
    st.tuples(*[st.floats(-np.pi, np.pi)] * 3),
    st.sampled_from([0.0, 1e-12, 1e-9, 1e-7, 1e-4]),
)
def test_angles_are_exact_at_every_rotation(
    angles: tuple[float, float, float], near: float
) -> None:
    for roll, pitch, yaw in (angles, (angles[0], np.pi / 2 - near, angles[2])):
        R = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
        again = Rotation.from_euler("xyz", rpy(R)).as_matrix()
        np.testing.assert_allclose(again, R, rtol=0.0, atol=1e-14)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = make_result()
    result.save(tmp_path)
    flags = ["export", str(tmp_path), "--format", "urdf", "--gripper-frame", "tool0"]
    assert (
        main([*flags, "--camera-link", "camera_link", "--link-to-optical", "0", "-0.1", "0"]) == 0
    )
    printed = capsys.readouterr()
    assert printed.err == ""
    offset = matrix_of((0.0, -0.1, 0.0), (-0.5, 0.5, -0.5, 0.5))
    np.testing.assert_allclose(of_urdf(printed.out)[0], result.matrix @ inverse(offset), **EXACT)
    assert main([*flags, "--output", str(tmp_path / "deep" / "arm.urdf")]) == 0
    assert of_urdf((tmp_path / "deep" / "arm.urdf").read_text())[1] == "tool0"
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "arm.urdf" in printed.err
    assert main(["export", str(tmp_path / "nowhere"), "--format", "ros2"]) == 2
    assert main(["export", str(tmp_path), "--format", "cad"]) == 2
    assert main(["export", str(tmp_path), "--format", "colmap"]) == 2
    capsys.readouterr()
    free = FreeDirection(
        kind="rotation", vector=np.array([0.0, 0.0, 1.0]), frame="gripper", description="Turn it."
    )
    replace(result, status="partial", free_directions=(free,)).save(tmp_path)
    assert main(["export", str(tmp_path), "--format", "ros2"]) == 3
    assert "PARTIAL" in capsys.readouterr().err


def test_the_command_needs_no_gtsam(tmp_path: Path) -> None:
    make_result().save(tmp_path)
    code = (
        "import sys; sys.modules['gtsam'] = sys.modules['pycolmap'] = None\n"
        f"from handeye_fg.cli import main; sys.exit(main(['export', {str(tmp_path)!r}, '--format', 'ros1']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert of_command(done.stdout)[1] == "gripper"
