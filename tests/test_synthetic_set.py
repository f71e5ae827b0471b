"""A simulated scene as files: what is read back is the scene, and a calibration finds its truth."""

import json
from pathlib import Path

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import cli, frames
from handeye_fg.io.cameras import read_camera
from handeye_fg.simulate import default_camera, simulate_scene


def test_files_hold_the_scene(tmp_path: Path) -> None:
    scene = simulate_scene(np.random.default_rng(2), n_images=5, n_points=40)
    folder = hf.write_scene(scene, tmp_path / "set")
    poses = hf.read_poses(folder / "poses.csv")
    assert poses.names == scene.robot_poses.names
    np.testing.assert_allclose(poses.base_T_gripper, scene.robot_poses.base_T_gripper, atol=1e-12)
    camera = read_camera(folder / "camera.yaml")
    assert (camera.model, camera.width, camera.height) == ("OPENCV", 1280, 960)
    np.testing.assert_array_equal(camera.params, default_camera().params)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    np.testing.assert_array_equal(truth["gripper_T_camera"], scene.gripper_T_camera)
    assert list(truth["base_T_gripper"]) == list(poses.names)
    assert truth["rep_deg"] == pytest.approx(0.01)
    assert truth["rep_mm"] == pytest.approx(0.05)


def test_a_calibration_finds_the_truth(tmp_path: Path) -> None:
    out = tmp_path / "set"
    assert cli.main(["simulate", str(out), "--images", "12", "--seed", "3"]) == 0
    result = hf.refine(out / "model", out / "poses.csv")
    truth = json.loads((out / "truth.json").read_text(encoding="utf-8"))
    error = frames.log(frames.inverse(result.matrix) @ np.array(truth["gripper_T_camera"]))
    assert result.covariance is not None
    assert error @ np.linalg.solve(result.covariance, error) < 22.5  # 99.9 % of chi-square of 6
    assert np.linalg.norm(error[3:]) < 1e-3


def test_the_seed_decides(tmp_path: Path) -> None:
    def poses(name: str, *flags: str) -> bytes:
        flags = ("--images", "4", "--points", "30", *flags)
        assert cli.main(["simulate", str(tmp_path / name), *flags]) == 0
        return (tmp_path / name / "poses.csv").read_bytes()

    assert poses("a") == poses("b")
    assert poses("c", "--seed", "1") != poses("a")


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--images", "2"], "--images is 2, but must be from 3 to 10000"),
        (["--pixel-px", "nan"], "--pixel-px is nan"),
        (["--robot-translation-mm", "-1"], "--robot-translation-mm is -1.0"),
        (["--motion", "none"], "--motion"),
    ],
)
def test_impossible_scenes(
    tmp_path: Path, flags: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["simulate", str(tmp_path / "set"), *flags]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "set").exists()
