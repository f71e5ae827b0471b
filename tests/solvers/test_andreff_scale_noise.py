"""M5 with noise: as accurate as the noise allows."""

import math

import numpy as np
import pytest

from exact_poses import motions_between, rotation_error, translation_error
from handeye_fg.frames import Array, inverse, rotation_angle
from handeye_fg.motions import MotionPairs
from handeye_fg.simulate import Motion, simulate_poses
from handeye_fg.solvers import Solution, andreff_scale, linear_start

# An ordinary arm and an ordinary reconstruction, sigma per axis.
NOISE = {
    "robot_rotation_sigma": math.radians(0.01),
    "robot_translation_sigma": 5e-5,
    "camera_rotation_sigma": math.radians(0.003),
    "camera_translation_sigma": 2e-5,
}


def rms_errors(multiple: float, solve, motion: Motion = "general") -> tuple[float, float, float]:
    """Root mean square error in rotation (rad), translation (m), scale (relative) over 60 draws."""
    noise = {name: multiple * sigma for name, sigma in NOISE.items()}
    errors = []
    for seed in range(60):
        robot, camera, truth = simulate_poses(np.random.default_rng(seed), motion=motion, **noise)
        found: Solution = solve(robot, camera)
        errors.append(
            (
                rotation_error(found.gripper_T_camera, truth.gripper_T_camera),
                translation_error(found.gripper_T_camera, truth.gripper_T_camera),
                found.metres_per_world_unit / truth.metres_per_world_unit - 1.0,
            )
        )
    return tuple(np.sqrt(np.mean(np.square(errors), axis=0)).tolist())


def consecutive(robot: Array, camera: Array) -> Solution:
    i = np.arange(len(robot) - 1)
    return andreff_scale(
        MotionPairs(
            i=i,
            j=i + 1,
            gi_T_gj=inverse(robot[:-1]) @ robot[1:],
            ci_T_cj=inverse(camera[:-1]) @ camera[1:],
        )
    )


@pytest.mark.simulation
def test_accuracy_follows_the_noise() -> None:
    rotation, translation, scale = rms_errors(1.0, linear_start)
    # 15 poses: 14 independent rotations of sigma 1.8e-4 (0.01 and 0.003 degrees per axis, times
    # sqrt 2 for the pair) leave 1e-4; one third of a metre away they displace by a tenth of that.
    assert rotation < 1.5e-4
    assert translation < 1.2e-4
    assert scale < 3e-4
    larger = rms_errors(10.0, linear_start)
    np.testing.assert_allclose(larger, np.multiply(10.0, [rotation, translation, scale]), rtol=0.1)


@pytest.mark.simulation
def test_wide_baselines_beat_consecutive_pairs() -> None:
    wide, narrow = rms_errors(5.0, linear_start), rms_errors(5.0, consecutive)
    for wide_error, narrow_error in zip(wide, narrow, strict=True):
        assert wide_error < 0.9 * narrow_error


def test_selected_pairs_are_as_good_as_all() -> None:
    robot, camera, truth = simulate_poses(np.random.default_rng(11), n_poses=120, **NOISE)
    everything = andreff_scale(motions_between(robot, camera, max_pairs=10_000))
    selected = andreff_scale(motions_between(robot, camera))
    assert len(motions_between(robot, camera)) == 2000
    best = translation_error(everything.gripper_T_camera, truth.gripper_T_camera)
    found = translation_error(selected.gripper_T_camera, truth.gripper_T_camera)
    # Both errors are some hundredths of a millimetre.
    assert found < best + 2e-5


def test_two_exchanged_rows_leave_a_usable_start() -> None:
    robot, camera, truth = simulate_poses(np.random.default_rng(12), n_poses=20, **NOISE)
    robot = robot.copy()
    robot[[4, 11]] = robot[[11, 4]]
    start = linear_start(robot, camera)
    assert rotation_angle(
        start.gripper_T_camera[:3, :3].T @ truth.gripper_T_camera[:3, :3]
    ) < math.radians(30.0)
