"""The whole program on the images of data/tabletop, against their exact truth."""

import json
import shutil
import subprocess
import sys
import time

import jsonschema
import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.io.results import result_schema
from tabletop import TABLETOP

TRUTH = np.array(json.loads((TABLETOP / "truth.json").read_text())["gripper_T_camera"])


def run(output, *arguments):
    command = [
        *(sys.executable, "-m", "handeye_fg", "calibrate"),
        *(
            str(TABLETOP / "images"),
            str(TABLETOP / "poses.csv"),
            "--output",
            str(output),
            *arguments,
        ),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def errors(matrix):
    error = frames.log(frames.inverse(np.array(matrix)) @ TRUTH)
    return np.rad2deg(np.linalg.norm(error[:3])), 1e3 * np.linalg.norm(error[3:]), error


@pytest.mark.e2e
@pytest.mark.slow
def test_tabletop(tabletop_output):
    output = tabletop_output
    document = json.loads((output / "result.json").read_text())
    jsonschema.validate(document, result_schema())
    assert document["sfm"]["n_registered"] == 18
    degrees, millimetres, error = errors(document["calibration"]["matrix"])
    assert degrees <= 0.012
    assert millimetres <= 0.15
    covariance = np.array(document["calibration"]["covariance"])
    assert error @ np.linalg.solve(covariance, error) <= 16.8
    assert not document["intrinsics"]["refined"]
    start_degrees, start_millimetres, _ = errors(document["initial"]["matrix"])
    assert start_degrees <= 0.03
    assert start_millimetres <= 0.5
    assert "gripper_T_camera" in (output / "report.html").read_text()
    assert (output / "config.toml").exists()


@pytest.mark.e2e
@pytest.mark.slow
def test_a_second_run_uses_the_reconstruction_again(tabletop_output, tmp_path):
    output = shutil.copytree(tabletop_output, tmp_path / "output")
    before = json.loads((output / "result.json").read_text())
    begin = time.perf_counter()
    done = run(output, "--camera", str(TABLETOP / "camera.yaml"), "--json")
    assert time.perf_counter() - begin < 60.0  # seconds, but for what else runs
    after = json.loads(done.stdout)
    assert after["timing_s"]["sfm"] < 5.0
    np.testing.assert_allclose(
        after["calibration"]["matrix"], before["calibration"]["matrix"], atol=1e-9
    )
    assert "reading images: 18 of 18" in done.stderr
    assert "refining" in done.stderr
    assert "p_gripper = gripper_T_camera p_camera" in done.stderr


@pytest.mark.e2e
@pytest.mark.slow
def test_tabletop_without_a_camera_file(tmp_path):
    done = run(tmp_path, "--json", "--quiet")
    assert done.stderr == ""
    document = json.loads(done.stdout)
    degrees, millimetres, _ = errors(document["calibration"]["matrix"])
    assert degrees <= 0.05
    assert millimetres <= 1.5
    assert document["intrinsics"]["refined"]
    assert all(std > 0 for std in document["intrinsics"]["std"])
    assert "No camera file" in document["intrinsics"]["note"]
