"""M5: exact without noise, equivariant, honest about degenerate motions, accurate with noise."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, exp, inverse, pose, rotation_angle, scaled
from handeye_fg.motions import MotionPairs, PosePairs, axis_spread, motion_pairs
from handeye_fg.simulate import Motion, disturbed, simulate_poses
from handeye_fg.solvers import Solution, andreff_scale, linear_start

# A busy machine is no failure.
UNHURRIED = settings(deadline=None)

ROTATION_BOUND = math.radians(1e-6)
TRANSLATION_BOUND = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    base_T_gripper: Array
    world_T_camera: Array
    gripper_T_camera: Array
    metres_per_world_unit: float


def case(base_T_gripper: Array, X: Array, scale: float, Z: Array | None = None) -> Case:
    """Exact camera poses of given robot poses."""
    Z = exp(np.array([0.4, -1.1, 0.7, 0.3, 0.2, -0.5])) if Z is None else Z
    world_T_camera = inverse(Z) @ base_T_gripper @ X
    return Case(base_T_gripper, scaled(world_T_camera, 1.0 / scale), X, scale)


def rotation_error(found: Array, wanted: Array) -> float:
    # The chord, not the angle by arccos: exact near zero.
    return float(np.linalg.norm(found[:3, :3] - wanted[:3, :3]) / math.sqrt(2.0))


def translation_error(found: Array, wanted: Array) -> float:
    return float(np.linalg.norm(found[:3, 3] - wanted[:3, 3]))


def assert_exact(start, wanted: Case, bound: float = TRANSLATION_BOUND) -> None:
    assert rotation_error(start.gripper_T_camera, wanted.gripper_T_camera) < ROTATION_BOUND
    assert translation_error(start.gripper_T_camera, wanted.gripper_T_camera) < bound
    assert start.metres_per_world_unit == pytest.approx(wanted.metres_per_world_unit, rel=1e-8)


def random_poses(rng: np.random.Generator, n: int, angle: float, length: float) -> Array:
    """Poses with rotations up to an angle about any axis and positions up to a length."""
    axes = rng.standard_normal((n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotation = exp(np.hstack([axes * rng.uniform(0.1 * angle, angle, (n, 1)), np.zeros((n, 3))]))
    return pose(rotation[:, :3, :3], rng.uniform(-length, length, (n, 3)))


X_RANDOM = exp(np.array([0.9, -0.3, 1.4, 0.05, -0.02, 0.11]))


def solved(robot: Array, camera: Array) -> Solution:
    """The solver alone: ``linear_start`` completes what it refuses."""
    return andreff_scale(PosePairs(base_T_gripper=robot, world_T_camera=camera))


# --- exactness ------------------------------------------------------------------------------------


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


# --- properties -----------------------------------------------------------------------------------

# Rotation vectors below 3 radians, translations below a metre.
twists = arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)).map(
    lambda xi: xi * [1.7, 1.7, 1.7, 1.0, 1.0, 1.0]
)
pose_lists = arrays(np.float64, (5, 6), elements=st.floats(-1.0, 1.0)).map(
    lambda xi: exp(xi * [1.7, 1.7, 1.7, 1.0, 1.0, 1.0])
)
scales = st.floats(-4.0, 4.0).map(math.exp)


def solvable(wanted: Case) -> MotionPairs:
    """The pairs of a case with two clear axes and a clear scale, which Hypothesis may not draw."""
    pairs = motion_pairs(wanted.base_T_gripper, wanted.world_T_camera)
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


@UNHURRIED
@given(pose_lists, twists, scales)
def test_recovers_any_x_and_scale(robot: Array, xi: Array, scale: float) -> None:
    wanted = case(robot, exp(xi), scale)
    solvable(wanted)
    assert_exact(linear_start(wanted.base_T_gripper, wanted.world_T_camera), wanted)


@UNHURRIED
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


@UNHURRIED
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


@UNHURRIED
@given(pose_lists, twists)
def test_exchanging_robot_and_camera_inverts_x(robot: Array, xi: Array) -> None:
    wanted = case(robot, exp(xi), 1.0)
    pairs = solvable(wanted)
    solvable(Case(wanted.world_T_camera, wanted.base_T_gripper, inverse(exp(xi)), 1.0))
    exchanged = MotionPairs(i=pairs.i, j=pairs.j, gi_T_gj=pairs.ci_T_cj, ci_T_cj=pairs.gi_T_gj)
    found = andreff_scale(exchanged)
    np.testing.assert_allclose(inverse(found.gripper_T_camera), exp(xi), atol=1e-8)


@UNHURRIED
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


# --- degenerate motions ---------------------------------------------------------------------------


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
    axis = axis_spread(motion_pairs(robot, camera)).axes[:, 0]
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
        axis = axis_spread(motion_pairs(reported, wanted.world_T_camera)).axes[:, 0]
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
    pairs = motion_pairs(data.base_T_gripper, data.world_T_camera)
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


# --- wrong conventions ----------------------------------------------------------------------------


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


# --- noise ----------------------------------------------------------------------------------------

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
    everything = andreff_scale(motion_pairs(robot, camera, max_pairs=10_000))
    selected = andreff_scale(motion_pairs(robot, camera))
    assert len(motion_pairs(robot, camera)) == 2000
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
