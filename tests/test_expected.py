"""Where all cameras were, from a model of some images and the robot."""

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
    placed = all_cameras(some, inputs, Options())
    assert placed is not None
    np.testing.assert_array_equal(placed[:SOME], some.world_T_camera)
    turns, ways = offsets(placed, scene.world_T_camera, scene.points_world)
    assert turns.max() < 0.3
    assert ways.max() < 0.01


def test_a_model_that_contradicts_the_robot_places_none(scene) -> None:
    names = scene.model.names
    shuffled = np.random.default_rng(0).permutation(scene.robot_poses.base_T_gripper)
    inputs = inputs_of(names, RobotPoses(names=names, base_T_gripper=shuffled))
    assert all_cameras(only(scene.model, names[:SOME]), inputs, Options()) is None
    assert all_cameras(only(scene.model, names[:4]), inputs, Options()) is None


def test_several_cameras() -> None:
    rig = simulate_rig(np.random.default_rng(0), n_poses=20, n_points=120, start_sigma=1e-4)
    model = rig.scene.model
    inputs = inputs_of(model.names, rig.scene.robot_poses)
    some = [name for name in model.names if int(Path(name).stem.split("_")[-1]) < SOME]
    assert SOME < len(some) < len(model.names)
    placed = all_cameras(only(model, some), inputs, Options())
    assert placed is not None
    turns, ways = offsets(placed, rig.scene.world_T_camera, rig.scene.points_world)
    assert turns.max() < 0.3
    assert ways.max() < 0.01
    # Of a camera that the model has no image of, nothing is known.
    first = [name for name in model.names if name.startswith(model.names[0].split("/")[0])]
    assert all_cameras(only(model, first), inputs, Options()) is None
