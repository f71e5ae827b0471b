"""M5 where motions leave something free, or poses are of another convention: honest, not wrong."""

import math

import numpy as np
import pytest

from exact_poses import (
    ROTATION_BOUND,
    X_RANDOM,
    case,
    motions_between,
    rotation_error,
    translation_error,
)
from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.motions import MotionPairs, PosePairs, axis_spread
from handeye_fg.simulate import disturbed, simulate_poses
from handeye_fg.solvers import Solution, andreff_scale, linear_start


def solved(robot: Array, camera: Array) -> Solution:
    """The solver alone: ``linear_start`` completes what it refuses."""
    return andreff_scale(PosePairs(base_T_gripper=robot, world_T_camera=camera))


@pytest.mark.parametrize("noise", [0.0, 1.0, 10.0])
@pytest.mark.parametrize("seed", range(5))
def test_one_axis_gives_all_but_the_height(noise: float, seed: int) -> None:
    robot, camera, truth = simulate_poses(
        np.random.default_rng(seed),
        motion="one_axis",
        robot_rotation_sigma=noise * 1e-4,
        robot_translation_sigma=noise * 5e-5,
    )
    start = linear_start(robot, camera)
    axis = axis_spread(motions_between(robot, camera)).axes[:, 0]
    X = truth.gripper_T_camera
    # Against noise: four times the rms errors of this motion over 100 seeds.
    assert rotation_error(start.gripper_T_camera, X) < 1e-8 + noise * 2e-3
    missing = start.gripper_T_camera[:3, 3] - X[:3, 3]
    across = missing - axis * (axis @ missing)
    assert np.linalg.norm(across) < 1e-9 + noise * 5e-4
    # Noise leans the free direction a little.
    assert start.gripper_T_camera[:3, 3] @ axis == pytest.approx(0.0, abs=1e-9 + noise * 1e-6)
    assert start.metres_per_world_unit == pytest.approx(
        truth.metres_per_world_unit, rel=1e-8 + noise * 1e-3
    )


def test_one_axis_by_half_turns_only() -> None:
    """Angles of 0 and 180 degrees: the sense of the camera's axis is not to be seen."""
    half = np.diag([-1.0, -1.0, 1.0])
    positions = np.random.default_rng(3).uniform(-0.3, 0.3, (6, 3))
    robot = pose(np.stack([np.eye(3), half] * 3), positions)
    wanted = case(robot, X_RANDOM, 0.4)
    start = linear_start(wanted.base_T_gripper, wanted.world_T_camera)
    assert rotation_error(start.gripper_T_camera, X_RANDOM) < ROTATION_BOUND
    assert start.metres_per_world_unit == pytest.approx(0.4)


def test_planar_robot() -> None:
    """Rotation about the vertical and translation across it only: a mobile base, a SCARA arm."""
    rng = np.random.default_rng(4)
    xi = np.zeros((8, 6))
    xi[:, 2] = rng.uniform(-1.0, 1.0, 8)
    robot = exp(xi)
    robot[:, :2, 3] = rng.uniform(-0.3, 0.3, (8, 2))
    wanted = case(robot, X_RANDOM, 0.4)
    start = linear_start(wanted.base_T_gripper, wanted.world_T_camera)
    assert rotation_error(start.gripper_T_camera, X_RANDOM) < ROTATION_BOUND
    np.testing.assert_allclose(start.gripper_T_camera[:2, 3], X_RANDOM[:2, 3], atol=1e-9)
    assert start.gripper_T_camera[2, 3] == pytest.approx(0.0, abs=1e-12)


def test_noise_is_not_taken_for_a_second_axis() -> None:
    """A short sweep about one axis with a coarse arm: 0.4 degrees wobble on ten degrees of turn."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        xi = np.zeros((12, 6))
        xi[:, 2] = rng.uniform(-0.17, 0.17, 12)
        robot = pose(exp(xi)[:, :3, :3], rng.uniform(-0.2, 0.2, (12, 3)))
        wanted = case(robot, X_RANDOM, 0.4)
        reported = disturbed(rng, robot, math.radians(0.4), 1e-4)
        start = linear_start(reported, wanted.world_T_camera)
        axis = axis_spread(motions_between(reported, wanted.world_T_camera)).axes[:, 0]
        assert start.gripper_T_camera[:3, 3] @ axis == pytest.approx(0.0, abs=1e-3)
        # Sideways: the positions' 0.12 m times the wobble, over ten degrees of turn.
        assert translation_error(start.gripper_T_camera, X_RANDOM) < 0.15


@pytest.mark.parametrize("rotation_sigma", [0.0, 1e-4, 5e-3])
def test_pure_translation_gives_rotation_and_scale(rotation_sigma: float) -> None:
    for seed in range(10):
        robot, camera, truth = simulate_poses(
            np.random.default_rng(seed),
            motion="pure_translation",
            robot_rotation_sigma=rotation_sigma,
        )
        start = linear_start(robot, camera)
        error = rotation_error(start.gripper_T_camera, truth.gripper_T_camera)
        assert error < ROTATION_BOUND + 4.0 * rotation_sigma
        np.testing.assert_allclose(start.gripper_T_camera[:3, 3], 0.0, atol=1e-4)
        assert start.metres_per_world_unit == pytest.approx(
            truth.metres_per_world_unit, rel=1e-9 + 4.0 * rotation_sigma
        )


def test_two_translations_are_enough_for_the_rotation() -> None:
    robot = pose(np.stack([np.eye(3)] * 3), np.array([[0.0, 0, 0], [0.2, 0, 0], [0, 0.1, 0]]))
    wanted = case(robot, X_RANDOM, 0.4)
    start = linear_start(wanted.base_T_gripper, wanted.world_T_camera)
    assert rotation_error(start.gripper_T_camera, X_RANDOM) < ROTATION_BOUND
    assert start.metres_per_world_unit == pytest.approx(0.4)


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_pure_rotations_leave_the_scale_free(noise: float) -> None:
    for seed in range(10):
        robot, camera, _ = simulate_poses(
            np.random.default_rng(seed),
            motion="pure_rotation",
            robot_rotation_sigma=noise * 2e-4,
            robot_translation_sigma=noise * 5e-5,
            camera_rotation_sigma=noise * 5e-5,
            camera_translation_sigma=noise * 2e-5,
        )
        with pytest.raises(UnobservableError, match="the scale is not determined"):
            andreff_scale(PosePairs(base_T_gripper=robot, world_T_camera=camera))


ONE_AXIS_MOTIONS = {
    "rotations": np.outer([0.0, 0.3, 0.7, -0.5, 1.2], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
    "screws": np.outer([0.0, 0.3, 0.9, -0.6], [0.0, 0.0, 1.0, 0.0, 0.0, 0.2]),
    "one motion": np.outer([0.0, 0.8], [0.0, 0.0, 1.0, 0.3, 0.1, 0.2]),
}


@pytest.mark.parametrize("motions", ONE_AXIS_MOTIONS)
def test_one_axis_is_refused_with_the_reason(motions: str) -> None:
    wanted = case(exp(ONE_AXIS_MOTIONS[motions]), X_RANDOM, 0.4)
    data = PosePairs(base_T_gripper=wanted.base_T_gripper, world_T_camera=wanted.world_T_camera)
    with pytest.raises(UnobservableError, match="share one axis, so the camera's position along"):
        andreff_scale(data)
    # The same motion again adds nothing.
    pairs = motions_between(data.base_T_gripper, data.world_T_camera)
    repeated = np.zeros(20, dtype=np.int64)
    again = MotionPairs(
        i=pairs.i[repeated],
        j=pairs.j[repeated],
        gi_T_gj=pairs.gi_T_gj[repeated],
        ci_T_cj=pairs.ci_T_cj[repeated],
    )
    with pytest.raises(UnobservableError):
        andreff_scale(again)
    assert linear_start(data.base_T_gripper, data.world_T_camera).method == "partial"


def test_translations_are_refused_with_the_reason() -> None:
    robot = pose(np.stack([np.eye(3)] * 4), np.outer([0.0, 0.1, 0.3, -0.2], [1.0, 2.0, 3.0]))
    wanted = case(robot, X_RANDOM, 0.4)
    data = PosePairs(base_T_gripper=wanted.base_T_gripper, world_T_camera=wanted.world_T_camera)
    with pytest.raises(UnobservableError, match="the gripper never turned"):
        andreff_scale(data)


@pytest.mark.parametrize("who", ["robot", "camera"])
def test_nothing_moves(who: str) -> None:
    robot, camera, _ = simulate_poses(np.random.default_rng(7))
    still = np.stack([robot[3]] * len(robot))
    args = (still, camera) if who == "robot" else (robot, still)
    with pytest.raises(UnobservableError, match=f"the {who} did not move"):
        solved(*args)


def test_negative_scale_is_refused() -> None:
    robot, camera, _ = simulate_poses(np.random.default_rng(8), camera_translation_sigma=1e-4)
    with pytest.raises(InputDataError, match="scale came out negative"):
        linear_start(robot, scaled(camera, -1.0))


def test_mirrored_translations_are_refused() -> None:
    # For three translations a negative scale is a reflection.
    robot, camera, _ = simulate_poses(np.random.default_rng(9), motion="pure_translation")
    with pytest.raises(InputDataError, match="scale came out negative"):
        linear_start(robot, scaled(camera, -1.0))


@pytest.mark.parametrize("wrong", ["inverted", "transposed", "shifted"])
def test_wrong_conventions_are_refused_or_show_in_the_residual(wrong: str) -> None:
    robot, camera, _ = simulate_poses(np.random.default_rng(10), robot_rotation_sigma=1e-4)
    changed = {
        "inverted": inverse(robot),
        "transposed": pose(np.swapaxes(robot[:, :3, :3], 1, 2), robot[:, :3, 3]),
        "shifted": np.roll(robot, 1, axis=0),
    }[wrong]
    message = ""
    try:
        misfit = linear_start(changed, camera).residual_rotation
    except InputDataError as error:
        message, misfit = str(error), math.inf
    assert misfit > math.radians(20.0)
    assert message == "" or "convention" in message
