"""M5 without noise: exact, and the same in other frames and units."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from exact_poses import (
    ROTATION_BOUND,
    X_RANDOM,
    Case,
    assert_exact,
    case,
    motions_between,
    pose_lists,
    random_poses,
    rotation_error,
    twists,
)
from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.motions import MotionPairs, axis_spread
from handeye_fg.simulate import disturbed, simulate_poses
from handeye_fg.solvers import andreff_scale, linear_start

scales = st.floats(-4.0, 4.0).map(math.exp)


@pytest.mark.parametrize("angle_deg", [10.0, 90.0, 179.9])
@pytest.mark.parametrize("length", [1e-3, 0.1, 1.0, 100.0])
def test_exact_without_noise(angle_deg: float, length: float) -> None:
    rng = np.random.default_rng(int(angle_deg * 10 + 1000 * length))
    for _ in range(30):
        X = exp(rng.uniform(-1.0, 1.0, 6) * [1.8, 1.8, 1.8, 0.1, 0.1, 0.1])
        robot = random_poses(rng, int(rng.integers(4, 12)), math.radians(angle_deg), length)
        wanted = case(robot, X, float(np.exp(rng.uniform(-3.0, 3.0))))
        start = linear_start(wanted.base_T_gripper, wanted.world_T_camera)
        assert_exact(start, wanted)
        assert start.residual_rotation < 1e-7
        # Rounding of positions: 1e-16 relative, and some hundred operations.
        assert start.residual_translation < 1e-12 * max(1.0, length)


def test_three_general_poses_are_enough() -> None:
    for seed in range(30):
        robot = random_poses(np.random.default_rng(seed), 3, 2.0, 0.3)
        wanted = case(robot, X_RANDOM, 0.7)
        # Two motions may be badly conditioned by chance.
        assert_exact(linear_start(wanted.base_T_gripper, wanted.world_T_camera), wanted, 1e-8)


# Sets of orientations whose rotations alone leave two or four solutions for R_X, which only the
# translations can tell apart.
ABOUT_X = np.diag([1.0, -1.0, -1.0])
ABOUT_Y = np.diag([-1.0, 1.0, -1.0])
TILTS = exp(np.outer([0.0, 0.3, -0.4, 0.6], [0.0, 0.6, 0.8, 0.0, 0.0, 0.0]))[:, :3, :3]
AMBIGUOUS = {
    "perpendicular half turns": np.stack([np.eye(3), ABOUT_X, ABOUT_Y]),
    "perpendicular half turns, repeated": np.stack([np.eye(3), ABOUT_X, ABOUT_Y] * 3),
    "tilts and half turns across them": np.concatenate([TILTS, TILTS @ ABOUT_X]),
}


@pytest.mark.parametrize("orientations", AMBIGUOUS.values(), ids=AMBIGUOUS.keys())
@pytest.mark.parametrize("noise", [0.0, 1e-5, 1e-3])
def test_half_turns(orientations: Array, noise: float) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        robot = pose(orientations, rng.uniform(-0.5, 0.5, (len(orientations), 3)))
        X = exp(rng.uniform(-1.7, 1.7, 6) * [1.0, 1.0, 1.0, 0.1, 0.1, 0.1])
        wanted = case(robot, X, 2.0)
        start = linear_start(disturbed(rng, robot, noise, 0.1 * noise), wanted.world_T_camera)
        # Few poses, and one draw in some hundred lies beyond four sigma.
        bound = ROTATION_BOUND + 6.0 * noise
        assert rotation_error(start.gripper_T_camera, X) < bound


def test_half_turns_among_others() -> None:
    robot = random_poses(np.random.default_rng(13), 4, 1.0, 0.3)
    robot = np.concatenate([robot, robot @ pose(ABOUT_X, np.array([0.1, 0.0, 0.2]))])
    wanted = case(robot, X_RANDOM, 2.0)
    assert_exact(linear_start(wanted.base_T_gripper, wanted.world_T_camera), wanted)


def test_z_closes_the_chain() -> None:
    robot, camera, truth = simulate_poses(np.random.default_rng(1))
    start = linear_start(robot, camera)
    np.testing.assert_allclose(start.base_T_world, truth.base_T_world, atol=1e-9)


def solvable(wanted: Case) -> MotionPairs:
    """The pairs of a case with two clear axes and a clear scale, which Hypothesis may not draw."""
    pairs = motions_between(wanted.base_T_gripper, wanted.world_T_camera)
    spread = axis_spread(pairs)
    assume(spread.rms_rotation[1] > 0.1)
    R_A, v = pairs.gi_T_gj[:, :3, :3], pairs.ci_T_cj[:, :3, 3] @ wanted.gripper_T_camera[:3, :3].T
    columns = np.concatenate([R_A - np.eye(3), -v[:, :, None]], axis=2).reshape(-1, 4)
    norms = np.linalg.norm(columns, axis=0)
    assume(norms.min() > 1e-3)
    assume(np.linalg.svd(columns / norms, compute_uv=False)[-1] > 1e-2)
    total = np.einsum("kij,kab->iajb", R_A, pairs.ci_T_cj[:, :3, :3]).reshape(9, 9)
    values = np.linalg.eigvalsh(total + total.T)
    assume(values[-1] - values[-2] > 1e-2)
    return pairs


@given(pose_lists, twists, scales)
def test_recovers_any_x_and_scale(robot: Array, xi: Array, scale: float) -> None:
    wanted = case(robot, exp(xi), scale)
    solvable(wanted)
    assert_exact(linear_start(wanted.base_T_gripper, wanted.world_T_camera), wanted)


@given(pose_lists, twists, twists, twists)
def test_other_base_and_world_frames_leave_x(
    robot: Array, xi: Array, base_change: Array, world_change: Array
) -> None:
    wanted = case(robot, exp(xi), 0.8)
    solvable(wanted)
    other_T_base, other_T_world = exp(base_change), exp(world_change)
    start = linear_start(
        other_T_base @ wanted.base_T_gripper, other_T_world @ wanted.world_T_camera
    )
    assert_exact(start, wanted)
    plain = linear_start(wanted.base_T_gripper, wanted.world_T_camera)
    expected = other_T_base @ plain.base_T_world @ scaled(inverse(other_T_world), 0.8)
    np.testing.assert_allclose(start.base_T_world, expected, atol=1e-7)


@given(st.integers(0, 2**32 - 1), twists, twists, scales)
def test_frames_and_unit_do_not_matter_with_noise_either(
    seed: int, base_change: Array, world_change: Array, unit: float
) -> None:
    robot, camera, _ = simulate_poses(
        np.random.default_rng(seed), robot_rotation_sigma=0.002, camera_translation_sigma=0.001
    )
    plain = linear_start(robot, camera)
    moved = linear_start(exp(base_change) @ robot, scaled(exp(world_change) @ camera, unit))
    np.testing.assert_allclose(moved.gripper_T_camera, plain.gripper_T_camera, atol=1e-8)
    assert moved.metres_per_world_unit * unit == pytest.approx(
        plain.metres_per_world_unit, rel=1e-8
    )
    assert moved.residual_translation == pytest.approx(plain.residual_translation, rel=1e-6)


@given(pose_lists, twists)
def test_exchanging_robot_and_camera_inverts_x(robot: Array, xi: Array) -> None:
    wanted = case(robot, exp(xi), 1.0)
    pairs = solvable(wanted)
    solvable(Case(wanted.world_T_camera, wanted.base_T_gripper, inverse(exp(xi)), 1.0))
    exchanged = MotionPairs(i=pairs.i, j=pairs.j, gi_T_gj=pairs.ci_T_cj, ci_T_cj=pairs.gi_T_gj)
    found = andreff_scale(exchanged)
    np.testing.assert_allclose(inverse(found.gripper_T_camera), exp(xi), atol=1e-8)


@given(st.integers(0, 2**32 - 1))
def test_order_of_the_poses_does_not_matter_for_the_rotation(seed: int) -> None:
    """A motion and its inverse weigh the same in step 1; step 2 sees the noise from one end."""
    rng = np.random.default_rng(seed)
    robot, camera, _ = simulate_poses(rng, robot_rotation_sigma=0.002)
    order = rng.permutation(len(robot))
    plain, shuffled = linear_start(robot, camera), linear_start(robot[order], camera[order])
    np.testing.assert_allclose(
        shuffled.gripper_T_camera[:3, :3], plain.gripper_T_camera[:3, :3], atol=1e-9
    )
