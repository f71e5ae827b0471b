"""Right poses are right, wrong ones are found out with the right diagnosis, and none passes for right."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handeye_fg import frames
from handeye_fg.conventions import judge, sentence, table
from handeye_fg.simulate import simulate_poses
from handeye_fg.simulate.careless import WAYS
from handeye_fg.types import RobotPoses

SETUPS = ("eye-in-hand", "eye-to-hand")


def simulated(seed, n, *, motion="general", setup="eye-in-hand", noise=1.0):
    """Reported poses, camera poses and the depth of the scene in world units."""
    robot, camera, truth = simulate_poses(
        np.random.default_rng(seed),
        n_poses=n,
        motion=motion,
        robot_rotation_sigma=noise * np.deg2rad(0.03),
        robot_translation_sigma=noise * 2e-4,
        camera_rotation_sigma=noise * np.deg2rad(0.05),
        camera_translation_sigma=noise * 4e-4,
    )
    robot = robot if setup == "eye-in-hand" else frames.inverse(robot)
    return robot, camera, 0.45 / truth.metres_per_world_unit


def found(verdict):
    """A verdict in a word, to compare with that of a way."""
    if verdict.parts is not None:
        return "parts"
    return verdict.kind if verdict.kind == "contradiction" else verdict.convention


def judged(poses, camera, depth, setup="eye-in-hand", **options):
    names = tuple(f"image_{i:03d}.jpg" for i in range(len(poses)))
    reported = RobotPoses(names=names, base_T_gripper=poses)
    return judge(reported, np.arange(len(poses)), camera, setup=setup, depth=depth, **options)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(("seed", "n", "setup"), [(1, 18, SETUPS[0]), (2, 13, SETUPS[1])])
def test_every_wrong_way_is_named(way, seed, n, setup):
    convert, expected = WAYS[way]
    poses, camera, depth = simulated(seed, n, setup=setup)
    verdict = judged(convert(poses), camera, depth, setup)
    assert verdict.kind == "wrong"
    got = found(verdict)
    assert got.startswith(expected) if expected.endswith("-") else got == expected
    assert sentence(verdict, [f"image_{i:03d}.jpg" for i in range(n)]).startswith("your poses look")


@pytest.mark.parametrize("n", [6, 8, 40])
@pytest.mark.parametrize("seed", range(3))
def test_right_poses_are_right(n, seed):
    setup = SETUPS[seed % 2]
    poses, camera, depth = simulated(100 + seed, n, setup=setup)
    assert judged(poses, camera, depth, setup).kind == "right"


@pytest.mark.parametrize("way", ["w first", "inverse", "mirrored y", "y negated", "reversed"])
def test_of_six_images_wrong_ways_are_named_as_well(way):
    convert, expected = WAYS[way]
    poses, camera, depth = simulated(5, 6)
    assert found(judged(convert(poses), camera, depth)) == expected


@pytest.mark.parametrize("seed", range(2))
def test_a_fifth_of_wrong_rows_and_a_bad_arm_raise_no_alarm(seed):
    poses, camera, depth = simulated(200 + seed, 20, noise=15.0)
    wrong = np.random.default_rng(seed).choice(20, 4, replace=False)
    poses[wrong] = poses[np.roll(wrong, 1)]
    assert judged(poses, camera, depth).kind == "right"


@pytest.mark.parametrize("motion", ["one_axis", "pure_translation", "pure_rotation"])
def test_poor_motions_raise_no_alarm(motion):
    poses, camera, depth = simulated(300, 9, motion=motion)
    verdict = judged(poses, camera, depth)
    assert verdict.kind in ("right", "undecided")
    assert verdict.best is verdict.given
    assert not verdict.doubtful


def test_motions_that_cannot_tell_are_said_to():
    """Turns about the vertical alone: the base may be turned by half a turn about it."""
    poses, camera, depth = simulated(300, 9, motion="one_axis")
    verdict = judged(poses, camera, depth)
    assert verdict.kind == "undecided"
    assert "turned-z" in [one.reading.name for one in verdict.alike]
    assert "the motions cannot tell" in sentence(verdict, [])


def test_no_motion_accuses_nobody():
    poses, camera, depth = simulated(0, 8)
    still = np.broadcast_to(poses[0], poses.shape)
    assert judged(still, camera, depth).kind == "undecided"


def test_what_has_nothing_in_common_is_a_contradiction():
    poses, camera, depth = simulated(7, 12)
    turned = Rotation.random(12, random_state=3).as_matrix()
    verdict = judged(frames.pose(turned, poses[:, :3, 3]), camera, depth)
    assert verdict.kind == "contradiction"
    assert not verdict.fixable
    assert "robot and camera move differently" in sentence(verdict, [])


def test_one_of_two_explanations_is_named_first_by_the_length_of_x():
    """An inverse and the other setup are the same to every equation."""
    poses, camera, depth = simulated(8, 12)
    words = sentence(judged(frames.inverse(poses), camera, depth), [])
    assert words.startswith("your poses look inverted (gripper_T_base), or like those of setup eye")
    words = sentence(judged(poses, camera, depth, "eye-to-hand"), [])
    assert words.startswith("your poses look like those of setup eye-in-hand, or inverted")
    assert "--setup eye-in-hand if the camera moves, or" in words


def test_of_a_known_world_the_unit_is_certain():
    """Metres from a target of known size: no guess by usual sizes."""
    robot, camera, truth = simulate_poses(np.random.default_rng(9), n_poses=10)
    metric = frames.scaled(camera, truth.metres_per_world_unit)
    assert judged(robot, metric, None, scale_known=True).kind == "right"
    verdict = judged(frames.scaled(robot, 1e3), metric, None, scale_known=True)
    assert (verdict.kind, verdict.convention) == ("wrong", "mm")
    # Far from usual, and right.
    large = frames.scaled(robot, 20.0)
    assert judged(large, frames.scaled(metric, 20.0), None, scale_known=True).kind == "right"


def test_every_reading_that_was_tried_is_in_the_table():
    poses, camera, depth = simulated(10, 10)
    verdict = judged(frames.inverse(poses), camera, depth)
    lines = table(verdict).splitlines()
    assert lines[1].startswith("inverted ")
    assert any(line.startswith("as-given ") for line in lines)
