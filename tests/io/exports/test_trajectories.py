"""Exports of the camera's poses at the images."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

import handeye_fg as hf
from example_results import make_result
from export_readers import EXACT
from handeye_fg.io.exports import export_text


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
