"""The rendered set with a board among objects, against its exact truth."""

import json
from pathlib import Path

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.io.cameras import read_camera
from handeye_fg.io.poses import read_poses
from handeye_fg.io.targets import read_target
from handeye_fg.sfm import from_tracks
from handeye_fg.solvers import linear_start
from handeye_fg.targets import board_poses

DATA = Path(__file__).parents[2] / "data" / "board"
TRUTH = json.loads((DATA / "truth.json").read_text(encoding="utf-8"))
X = np.array(TRUTH["gripper_T_camera"])


@pytest.fixture(scope="module")
def board():
    poses = read_poses(DATA / "poses.csv")
    camera, target = read_camera(DATA / "camera.yaml"), read_target(DATA / "board.yaml")
    return poses, camera, board_poses(DATA / "images", poses.names, camera, target)


def test_poses_from_the_board(board):
    """0.04 px over 200 px of board: 0.01 deg and 0.1 mm, and up to four times that where it is seen head-on."""
    _, _, found = board
    assert found.left_out == ()
    assert found.rms_px.max() < 0.06
    base_T_camera = np.array(TRUTH["base_T_gripper"]) @ X
    truth = frames.inverse(np.array(TRUTH["target"]["base_T_board"])) @ base_T_camera
    error = frames.log(frames.inverse(truth) @ found.target_T_camera)
    assert np.rad2deg(np.linalg.norm(error[:, :3], axis=1)).max() < 0.04
    assert np.linalg.norm(error[:, 3:], axis=1).max() < 0.3e-3


def test_the_same_points_without_the_boards_model(board):
    """The corners as anonymous tracks: A X = X B with an unknown scale does as well as with PnP."""
    poses, camera, found = board
    seen = found.detections
    model = from_tracks(seen.names, seen.image_index, seen.corner, seen.pixels, camera)
    assert model.names == poses.names
    start = linear_start(poses.base_T_gripper, model.world_T_camera)
    error = frames.log(frames.inverse(start.gripper_T_camera) @ X)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.02
    assert np.linalg.norm(error[3:]) < 0.4e-3


@pytest.mark.e2e
@pytest.mark.slow
def test_board_and_scene_in_one_graph(tmp_path):
    result = hf.calibrate(
        DATA / "images",
        DATA / "poses.csv",
        camera=DATA / "camera.yaml",
        target=DATA / "board.yaml",
        output=tmp_path,
    )
    assert result.status == "ok"
    error = frames.log(frames.inverse(result.matrix) @ X)
    # No worse than without the board: 0.0091 deg, 0.185 mm.
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.0091
    assert np.linalg.norm(result.matrix[:3, 3] - X[:3, 3]) < 0.185e-3
    assert error @ np.linalg.solve(result.covariance, error) < 16.8
    assert result.metres_per_world_unit == pytest.approx(1.0, abs=1e-3)
    assert result.target is not None
    assert result.target.n_images == 15
    placed = frames.inverse(np.array(TRUTH["target"]["base_T_board"])) @ result.target.base_T_target
    assert np.linalg.norm(placed[:3, 3]) < 1e-3
