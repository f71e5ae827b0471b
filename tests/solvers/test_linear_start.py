"""The entry point of the closed forms, and the parts it is made of."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from exact_poses import motions_between
from handeye_fg.errors import InputDataError
from handeye_fg.frames import exp, inverse, pose, rotation_angle, scaled
from handeye_fg.simulate import disturbed, simulate_poses
from handeye_fg.solvers import (
    Solution,
    average_base_T_world,
    linear_start,
    motion_residuals,
)
from tabletop import TABLETOP, TRUTH


def test_poses_of_wrong_shape_are_refused() -> None:
    with pytest.raises(InputDataError, match="robot poses have the shape"):
        linear_start(np.zeros((5, 3, 4)), np.zeros((5, 4, 4)))


def test_residuals_are_the_known_misfit() -> None:
    robot, camera, truth = simulate_poses(np.random.default_rng(1))
    pairs = motions_between(robot, camera)
    scale = truth.metres_per_world_unit
    angles, lengths = motion_residuals(pairs, truth.gripper_T_camera, scale)
    np.testing.assert_allclose(angles, 0.0, atol=1e-7)
    np.testing.assert_allclose(lengths, 0.0, atol=1e-13)
    _, lengths = motion_residuals(pairs, truth.gripper_T_camera, 1.1 * scale)
    expected = 0.1 * scale * np.linalg.norm(pairs.ci_T_cj[:, :3, 3], axis=1)
    np.testing.assert_allclose(lengths, expected, atol=1e-12)


def test_rms_residuals_are_those_of_the_noise() -> None:
    rotation_sigma, translation_sigma = 0.002, 0.001
    values = []
    for seed in range(40):
        robot, camera, _ = simulate_poses(
            np.random.default_rng(seed),
            robot_rotation_sigma=rotation_sigma,
            camera_translation_sigma=translation_sigma,
        )
        values.append(linear_start(robot, camera).residual_rotation)
    # Two noisy poses a pair, three axes; X absorbs 3 of 3 * 14 degrees of freedom.
    expected = rotation_sigma * np.sqrt(2.0 * 3.0 * (1.0 - 3.0 / 42.0))
    assert np.sqrt(np.mean(np.square(values))) == pytest.approx(expected, rel=0.05)


def test_average_follows_a_change_of_the_world_frame() -> None:
    rng = np.random.default_rng(2)
    base_T_camera = exp(rng.uniform(-1.0, 1.0, (6, 6)))
    Z = exp(rng.uniform(-1.0, 1.0, 6))
    world_T_camera = disturbed(rng, inverse(Z) @ base_T_camera, 0.05, 0.05)
    other_T_world = exp(np.array([1.0, -2.0, 0.5, 30.0, -40.0, 50.0]))
    plain = average_base_T_world(base_T_camera, world_T_camera)
    moved = average_base_T_world(base_T_camera, other_T_world @ world_T_camera)
    np.testing.assert_allclose(moved @ other_T_world, plain, atol=1e-12)


def test_average_is_exact_without_noise() -> None:
    rng = np.random.default_rng(3)
    base_T_camera = exp(rng.uniform(-1.0, 1.0, (6, 6)))
    Z = exp(rng.uniform(-1.0, 1.0, 6))
    found = average_base_T_world(base_T_camera, inverse(Z) @ base_T_camera)
    np.testing.assert_allclose(found, Z, atol=1e-14)


def test_solution_checks_its_shape() -> None:
    with pytest.raises(ValueError, match="gripper_T_camera"):
        Solution(gripper_T_camera=np.eye(3), metres_per_world_unit=1.0)


def test_reported_poses_of_a_rendered_set() -> None:
    """The noise of the robot alone: camera poses from the set's truth, in another unit."""
    X = TRUTH["gripper_T_camera"]
    world_T_camera = scaled(TRUTH["base_T_gripper"] @ X, 1.0 / 0.06)
    rows = np.loadtxt(TABLETOP / "poses.csv", delimiter=",", skiprows=1, usecols=range(1, 8))
    reported = pose(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])
    start = linear_start(reported, world_T_camera)
    # The set's noise is 0.05 mm and 0.01 degrees per axis; 18 poses average it.
    assert np.degrees(rotation_angle(X[:3, :3].T @ start.gripper_T_camera[:3, :3])) < 0.03
    assert np.linalg.norm(start.gripper_T_camera[:3, 3] - X[:3, 3]) < 0.5e-3
    assert start.metres_per_world_unit == pytest.approx(0.06, rel=1e-3)
    assert np.degrees(start.residual_rotation) < 0.05
