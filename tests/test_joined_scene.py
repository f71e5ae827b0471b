"""From matches that fall into two parts to one model: mapping, the folder on disk, and the robot."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.inputs import Inputs
from handeye_fg.options import Options
from handeye_fg.progress import silent
from handeye_fg.scene import find_scene
from handeye_fg.simulate import Scene, simulate_scene

N, SECOND = 13, 7  # images, and where the second part starts


@pytest.fixture(scope="module")
def scene() -> Scene:
    return simulate_scene(
        np.random.default_rng(5), n_images=N, n_points=80, pixel_sigma=0.3, start_sigma=0.0
    )


@pytest.fixture
def inputs(scene: Scene, from_matches: Callable[..., Inputs]) -> Inputs:
    tracks = scene.model.tracks
    apart = tracks.image_index >= SECOND
    return from_matches(
        scene.robot_poses,
        scene.model.names,
        tracks.image_index,
        tracks.point_index + apart * len(tracks.points_world),
        tracks.pixels,
        {".": scene.camera},
    )


def test_two_parts_become_one_model(scene: Scene, inputs: Inputs, tmp_path: Path) -> None:
    told: list[tuple[str, int, int | None]] = []

    def find() -> np.ndarray:
        found, _ = find_scene(
            inputs, tmp_path / "out" / "sfm", Options(), lambda *report: told.append(report)
        )
        model = found.model
        assert model.names == scene.model.names
        assert model.unregistered == ()
        assert model.by_robot == N - SECOND
        return model.world_T_camera

    found = find()
    true = frames.inverse(scene.world_T_camera[0]) @ scene.world_T_camera
    ours = frames.inverse(found[0]) @ found
    unit = np.linalg.norm(true[1, :3, 3]) / np.linalg.norm(ours[1, :3, 3])
    error = frames.log(frames.inverse(true) @ frames.scaled(ours, unit))
    distance = np.linalg.norm(scene.world_T_camera[:, :3, 3] - scene.points_world.mean(0), axis=1)
    assert np.rad2deg(np.linalg.norm(error[:, :3], axis=1)).max() < 0.3
    assert (np.linalg.norm(error[:, 3:], axis=1) / distance).max() < 0.01
    # The parts are kept on disk: a second run maps nothing, and joins as the first did.
    told.clear()
    np.testing.assert_array_equal(find(), found)
    assert told == [("registered", SECOND, N)]


def test_a_part_that_contradicts_the_robot_stays_out(
    scene: Scene, inputs: Inputs, tmp_path: Path
) -> None:
    turned = np.array(scene.robot_poses.base_T_gripper)
    noise = np.random.default_rng(0).normal(0.0, 0.3, (N - SECOND, 6))
    turned[SECOND:] = turned[SECOND:] @ frames.exp(noise)
    wrong = replace(inputs, poses=replace(inputs.poses, base_T_gripper=turned))
    found, _ = find_scene(wrong, tmp_path / "out" / "sfm", Options(), silent)
    model = found.model
    assert model.names == scene.model.names[:SECOND]
    assert {why for _, why in model.unregistered} == {
        "placed with 5 others, apart from the rest, but they do not move as the robot did"
    }
