"""Where all cameras were, from a model of some images and the robot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.inputs import Inputs
from handeye_fg.options import Options
from handeye_fg.parts import only
from handeye_fg.scene.expected import all_cameras
from handeye_fg.simulate import simulate_rig, simulate_scene
from handeye_fg.types import RobotPoses

SOME = 16
ELSEWHERE = frames.exp(np.array([0.5, -1.0, 0.3, 4.0, 2.0, -1.0]))


def inputs_of(names, poses):
    return Inputs(
        images=Path(),
        names=tuple(names),
        left_out=(),
        poses=poses,
        cameras=None,
        masks=None,
        digest="",
    )


@pytest.fixture(scope="module", params=["general", "one_axis"])
def scene(request):
    return simulate_scene(
        np.random.default_rng(2),
        n_images=40,
        n_points=60,
        pixel_sigma=0.1,
        start_sigma=1e-4,
        motion=request.param,
    )


def offsets(placed, true, points):
    """Degrees, and parts of the distance to the scene."""
    off = frames.log(frames.inverse(true) @ placed)
    distance = np.linalg.norm(true[:, :3, 3] - points.mean(axis=0), axis=1)
    turns = np.rad2deg(np.linalg.norm(off[:, :3], axis=1))
    return turns, np.linalg.norm(off[:, 3:], axis=1) / distance


@pytest.mark.parametrize("wrong", [False, True])
def test_all_images_are_placed(scene, wrong) -> None:
    """With wrong rows too: those in the model keep its poses, the others stand where the robot says."""
    names = scene.model.names
    reported = scene.robot_poses.base_T_gripper.copy()
    if wrong:
        reported[[1, 2]] = reported[[2, 1]]
    inputs = inputs_of(names, RobotPoses(names=names, base_T_gripper=reported))
    some = only(scene.model, names[:SOME])
    found = all_cameras([some], inputs, Options())
    assert found is not None
    whole, placed = found
    assert whole is some
    np.testing.assert_array_equal(placed[:SOME], some.world_T_camera)
    turns, ways = offsets(placed, scene.world_T_camera, scene.points_world)
    assert turns.max() < 0.3
    assert ways.max() < 0.01


def test_a_model_that_contradicts_the_robot_places_none(scene) -> None:
    names = scene.model.names
    shuffled = np.random.default_rng(0).permutation(scene.robot_poses.base_T_gripper)
    inputs = inputs_of(names, RobotPoses(names=names, base_T_gripper=shuffled))
    assert all_cameras([only(scene.model, names[:SOME])], inputs, Options()) is None
    assert all_cameras([only(scene.model, names[:4])], inputs, Options()) is None


def in_another_world(model):
    points = 0.3 * model.tracks.points_world @ ELSEWHERE[:3, :3].T + ELSEWHERE[:3, 3]
    poses = ELSEWHERE @ frames.scaled(model.world_T_camera, 0.3)
    tracks = replace(model.tracks, points_world=points)
    return replace(model, world_T_camera=poses, tracks=tracks)


@pytest.mark.parametrize("apart", [False, True])
def test_several_cameras(apart) -> None:
    """In one world, or each in its own."""
    rig = simulate_rig(np.random.default_rng(0), n_poses=20, n_points=120, start_sigma=1e-4)
    model = rig.scene.model
    inputs = inputs_of(model.names, rig.scene.robot_poses)
    some = [name for name in model.names if int(Path(name).stem.split("_")[-1]) < SOME]
    assert SOME < len(some) < len(model.names)
    first, second = (
        only(model, [name for name in some if name.startswith(f"cam{k}/")]) for k in range(2)
    )
    models = [first, in_another_world(second)] if apart else [only(model, some)]
    found = all_cameras(models, inputs, Options())
    assert found is not None
    whole, placed = found
    turns, ways = offsets(placed, rig.scene.world_T_camera, rig.scene.points_world)
    assert turns.max() < 0.3
    assert ways.max() < 0.01
    assert sorted(whole.names) == some
    assert len(whole.cameras) == 2
    rows = [model.names.index(name) for name in whole.names]
    np.testing.assert_array_equal(whole.image_camera, model.image_camera[rows])
    np.testing.assert_array_equal(whole.world_T_camera, placed[rows])
    # The second camera's points are where they were, and seen where they were.
    tracks = whole.tracks
    offset = tracks.points_world[tracks.point_index] - placed[rows][tracks.image_index, :3, 3]
    local = np.einsum("mi,mij->mj", offset, placed[rows][tracks.image_index, :3, :3])
    pixels = local[:, :2] / local[:, 2:] * model.camera.params[:2] + model.camera.params[2:4]
    off = np.linalg.norm(pixels - tracks.pixels, axis=1)
    own = whole.image_camera[tracks.image_index] == 1
    assert np.median(off[own]) < 2.0 * np.median(off[~own])  # a lens without distortion
    # Of a camera that no model has an image of, nothing is known.
    assert all_cameras([first], inputs, Options()) is None
