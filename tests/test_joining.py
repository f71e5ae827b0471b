"""Images that hang together in fragments, joined by the robot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from handeye_fg import frames, sfm
from handeye_fg.inputs import Inputs
from handeye_fg.parts import only
from handeye_fg.scene.joining import joined
from handeye_fg.simulate import simulate_scene
from handeye_fg.types import Fragment, RobotPoses

N = 14


@pytest.fixture
def scene():
    return simulate_scene(
        np.random.default_rng(1), n_images=N, n_points=60, pixel_sigma=0.1, start_sigma=1e-4
    )


@pytest.fixture(autouse=True)
def asked(monkeypatch):
    """Where images are asked for; none is placed."""
    poses = {}

    def complete(_folder, model, expected, _cameras):
        poses.update(expected)
        return model

    monkeypatch.setattr(sfm, "complete", complete)
    return poses


def inputs_of(scene, poses=None):
    given = scene.robot_poses.base_T_gripper if poses is None else poses
    names = scene.model.names
    return Inputs(
        images=Path(),
        names=names,
        left_out=(),
        poses=RobotPoses(names=names, base_T_gripper=given),
        cameras=None,
        masks=None,
        digest="",
    )


ELSEWHERE = frames.exp(np.array([0.5, -1.0, 0.3, 4.0, 2.0, -1.0]))


def fragment(model, which, scale=0.3):
    poses = frames.scaled(ELSEWHERE @ model.world_T_camera[which], scale)
    names = tuple(model.names[i] for i in which)
    return Fragment(names=names, world_T_camera=poses, cameras={".": model.camera})


def in_parts(model, *parts):
    """The model of the first part, the others beside it."""
    kept = only(model, [model.names[i] for i in parts[0]])
    missing = [name for name in model.names if name not in kept.names]
    return replace(
        kept,
        unregistered=tuple((name, "why") for name in missing),
        fragments=tuple(fragment(model, part) for part in parts[1:]),
    )


def off_deg_and_relative(scene, asked):
    """How far the images are asked for from where they are: degrees, part of the distance."""
    rows = [scene.model.names.index(name) for name in asked]
    true = scene.world_T_camera[rows]
    error = frames.log(frames.inverse(true) @ np.array(list(asked.values())))
    distance = np.linalg.norm(true[:, :3, 3] - scene.points_world.mean(axis=0), axis=1)
    return (
        np.rad2deg(np.linalg.norm(error[:, :3], axis=1)).max(),
        (np.linalg.norm(error[:, 3:], axis=1) / distance).max(),
    )


@pytest.mark.parametrize(
    "parts",
    [
        [range(8), range(8, 14)],
        [range(8)],
        [range(6), range(6, 10), range(10, 13)],
        # None of them could say where the others are.
        [range(4), range(4, 8), range(8, 11), range(11, 14)],
    ],
    ids=["two", "single images", "three and one image", "small"],
)
def test_fragments_are_asked_for_where_they_belong(scene, asked, parts):
    model = in_parts(scene.model, *map(list, parts))
    joined(model, inputs_of(scene), Path())
    assert list(asked) == [name for name, _ in model.unregistered]
    degrees, relative = off_deg_and_relative(scene, asked)
    assert degrees < 0.3
    assert relative < 0.01


def test_a_fragment_keeps_its_shape(scene, asked):
    model = in_parts(scene.model, list(range(8)), list(range(8, 14)))
    joined(model, inputs_of(scene), Path())
    within = [
        frames.inverse(poses[0]) @ poses
        for poses in (np.array(list(asked.values())), scene.model.world_T_camera[8:])
    ]
    # The robot's noise is 100 times larger.
    np.testing.assert_allclose(within[0][:, :3, :3], within[1][:, :3, :3], atol=1e-9)


def test_a_fragment_that_contradicts_the_robot_is_not_joined(scene, asked):
    model = in_parts(scene.model, list(range(8)), [8, 9, 10, 11], [12, 13])
    wrong = model.fragments[0]
    turned = wrong.world_T_camera @ frames.exp(np.random.default_rng(2).normal(0.0, 0.2, (4, 6)))
    model = replace(model, fragments=(replace(wrong, world_T_camera=turned), *model.fragments[1:]))
    found = joined(model, inputs_of(scene), Path())
    assert dict(found.unregistered)[wrong.names[0]] == (
        "placed with 3 others, apart from the rest, but they do not move as the robot did"
    )
    assert dict(found.unregistered)[scene.model.names[13]] == "why"
    # The robot's word remains.
    degrees, relative = off_deg_and_relative(scene, asked)
    assert degrees < 0.3
    assert relative < 0.01


def test_a_few_false_matches_do_not_link_two_worlds(scene, asked):
    poses = np.array(scene.model.world_T_camera)
    poses[9:] = ELSEWHERE @ poses[9:]
    model = replace(scene.model, world_T_camera=poses)
    found = joined(model, inputs_of(scene), Path())
    assert found.names == scene.model.names[:9]
    assert list(asked) == list(scene.model.names[9:])
    degrees, relative = off_deg_and_relative(scene, asked)
    assert degrees < 0.3
    assert relative < 0.01


def test_wrong_robot_poses_break_no_model(scene, asked):
    poses = np.array(scene.robot_poses.base_T_gripper)
    poses[[2, 7, 11]] = poses[[11, 2, 7]]
    assert joined(scene.model, inputs_of(scene, poses), Path()) is scene.model
    assert asked == {}


def test_what_is_not_sure_is_not_asked_for(scene, asked):
    noise = np.random.default_rng(3).normal(size=(N, 6))
    poses = scene.robot_poses.base_T_gripper @ frames.exp(0.1 * noise)
    model = in_parts(scene.model, list(range(8)), list(range(8, 14)))
    assert joined(model, inputs_of(scene, poses), Path()) is model
    assert asked == {}
