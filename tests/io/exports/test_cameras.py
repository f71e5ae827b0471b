"""Exports that hold intrinsics, or several cameras."""

import json
import shlex
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_parser_py.urdf import URDF

import handeye_fg as hf
from example_results import make_result
from export_readers import EXACT, of_arguments, of_opencv
from handeye_fg.frames import exp
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.io.cameras import read_camera
from handeye_fg.io.exports import export_text
from handeye_fg.io.results import Result
from handeye_fg.types import CameraModel


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
