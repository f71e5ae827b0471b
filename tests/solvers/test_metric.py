"""Every solver that takes metres: exact, honest about what it cannot serve, weighted, lean."""

import functools
import importlib
import math
import tracemalloc

import numpy as np
import pytest

from handeye_fg.errors import ConvergenceError, HandEyeError, InputDataError, UnobservableError
from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.simulate import disturbed, simulate_poses
from handeye_fg.solvers import (
    METHODS,
    Solution,
    andreff_scale,
    daniilidis,
    horaud_dornaika,
    li,
    shah,
    tsai_lenz,
)

EVERY = [method.solve for method in METHODS.values()]
METRIC = [method.solve for method in METHODS.values() if method.scale_known]
ROTATION_BOUND = math.radians(1e-6)
TRANSLATION_BOUND = 1e-9


def turns(rng: np.random.Generator, angles: Array) -> Array:
    """Rotations (n, 3, 3) by given angles about random axes."""
    axes = rng.standard_normal((len(angles), 3))
    vectors = axes / np.linalg.norm(axes, axis=1, keepdims=True) * angles[:, None]
    return exp(np.hstack([vectors, np.zeros_like(vectors)]))[:, :3, :3]


@functools.cache
def draw(seed: int) -> tuple[PosePairs, Array, Array]:
    """Poses without noise, X and Z: 4 to 12 poses, 1 mm to 100 m, rotations up to 179.9 degrees."""
    rng = np.random.default_rng(seed)
    length = 10.0 ** rng.uniform(-3.0, 2.0)
    largest = math.radians(rng.choice([20.0, 60.0, 179.9]))
    n = int(rng.integers(4, 13))
    angle_X = math.radians(179.9) * (1.0 if seed % 3 == 0 else rng.uniform())
    X = pose(turns(rng, np.array([angle_X]))[0], rng.uniform(-0.1, 0.1, 3))
    Z = pose(turns(rng, rng.uniform(0.0, math.pi, 1))[0], rng.uniform(-length, length, 3))
    robot = pose(
        turns(rng, rng.uniform(0.1 * largest, largest, n)), rng.uniform(-length, length, (n, 3))
    )
    return PosePairs(base_T_gripper=robot, world_T_camera=inverse(Z) @ robot @ X), X, Z


def simulated(seed: int, n_poses: int = 15, noise: float = 1e-3, motion="general"):
    """Poses in metres, and the truth."""
    robot, camera, truth = simulate_poses(
        np.random.default_rng(seed),
        n_poses=n_poses,
        motion=motion,
        robot_rotation_sigma=noise,
        robot_translation_sigma=noise,
    )
    return robot, scaled(camera, truth.metres_per_world_unit), truth


def posed(robot: Array, camera: Array, weights: Array | None = None) -> PosePairs:
    return PosePairs(base_T_gripper=robot, world_T_camera=camera, weights=weights)


def errors(found: Solution, X: Array) -> tuple[float, float]:
    """Radians (the chord: exact near zero) and metres."""
    difference = found.gripper_T_camera - X
    return (
        float(np.linalg.norm(difference[:3, :3]) / math.sqrt(2.0)),
        float(np.linalg.norm(difference[:3, 3])),
    )


def assert_exact(found: Solution, X: Array) -> None:
    rotation, translation = errors(found, X)
    assert rotation < ROTATION_BOUND
    assert translation < TRANSLATION_BOUND


def assert_same(found: Solution, expected: Solution, tolerance: float = 1e-9) -> None:
    for name in ("gripper_T_camera", "base_T_world"):
        if getattr(expected, name) is not None:
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), atol=tolerance
            )
    assert found.metres_per_world_unit == pytest.approx(expected.metres_per_world_unit, rel=1e-9)


# --- exactness ------------------------------------------------------------------------------------


@pytest.mark.parametrize("solve", EVERY)
def test_exact_without_noise(solve) -> None:
    for seed in range(1000):
        data, X, Z = draw(seed)
        found = solve(data)
        assert_exact(found, X)
        assert found.metres_per_world_unit == pytest.approx(1.0, abs=1e-9)
        if found.base_T_world is not None:
            np.testing.assert_allclose(found.base_T_world, Z, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("solve", EVERY)
def test_motions_are_as_good_as_poses(solve) -> None:
    data, X, _ = draw(7)
    found = solve(as_motions(data))
    assert_exact(found, X)
    if found.base_T_world is not None:
        # Motions A X = Z B of a rigid camera have Z = X.
        np.testing.assert_allclose(found.base_T_world, found.gripper_T_camera, atol=1e-9)


HALF_TURNS = np.stack(
    [np.eye(3), *(2.0 * np.outer(a, a) - np.eye(3) for a in [*np.eye(3), [0.6, 0.8, 0.0]])]
)


@pytest.mark.parametrize("solve", METRIC)
@pytest.mark.parametrize("n", [3, 4, 5])
def test_half_turns_only(solve, n: int) -> None:
    """Three or four of them leave several rotations, which the translations tell apart."""
    for seed in range(50):
        rng = np.random.default_rng(seed)
        robot = pose(HALF_TURNS[:n], rng.uniform(-0.3, 0.3, (n, 3)))
        X = pose(turns(rng, rng.uniform(0.0, math.pi, 1))[0], rng.uniform(-0.1, 0.1, 3))
        assert_exact(solve(posed(robot, robot @ X)), X)


@pytest.mark.parametrize("solve", METRIC)
def test_half_turns_with_noise(solve) -> None:
    """Noise puts robot and camera on either side of 180 degrees; X is a half turn as well."""
    rotation_errors, translation_errors = [], []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        angles = np.where(np.arange(10) % 2 == 0, rng.uniform(0.0, 0.3, 10), math.pi)
        robot = pose(turns(rng, angles), rng.uniform(-0.3, 0.3, (10, 3)))
        X = pose(turns(rng, np.array([math.pi]))[0], rng.uniform(-0.1, 0.1, 3))
        rotation, translation = errors(
            solve(posed(disturbed(rng, robot, 1e-3, 1e-3), robot @ X)), X
        )
        rotation_errors.append(rotation)
        translation_errors.append(translation)
    # 9 independent motions of sigma 1e-3 times sqrt 2 on three axes: 8e-4 (rms); the worst of 100
    # draws is a few times that. A wrong sign would give tens of degrees.
    assert np.median(rotation_errors) < 8e-4
    assert max(rotation_errors) < 4e-3
    assert np.median(translation_errors) < 1e-3
    assert max(translation_errors) < 5e-3


# --- what cannot be served ------------------------------------------------------------------------


def repeated(pairs: MotionPairs, rows: list[int]) -> MotionPairs:
    return MotionPairs(
        i=pairs.i[rows],
        j=pairs.j[rows],
        gi_T_gj=pairs.gi_T_gj[rows],
        ci_T_cj=pairs.ci_T_cj[rows],
        weights=np.asarray(pairs.weights)[rows],
    )


@pytest.mark.parametrize("solve", METRIC)
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_degenerate_motions_are_named(solve, noise: float) -> None:
    general = as_motions(posed(*simulated(0, noise=noise)[:2]))
    with pytest.raises(UnobservableError, match=r"1 motion\(s\) cannot determine"):
        solve(repeated(general, [3]))
    with pytest.raises(UnobservableError, match="all rotations share one axis"):
        solve(repeated(general, [3] * 20))
    for seed in range(5):
        with pytest.raises(UnobservableError, match="the gripper turned by"):
            solve(posed(*simulated(seed, noise=noise, motion="pure_translation")[:2]))
        with pytest.raises(UnobservableError, match="all rotations share one axis"):
            solve(posed(*simulated(seed, noise=noise, motion="one_axis")[:2]))


@pytest.mark.parametrize("solve", METRIC)
def test_two_poses_are_not_enough(solve) -> None:
    robot, camera, _ = simulated(0)
    with pytest.raises(HandEyeError, match=r"1 motion\(s\)|2 pose\(s\)"):
        solve(posed(robot[:2], camera[:2]))
    with pytest.raises(HandEyeError, match=r"[012] (motion|pose)\(s\)"):
        solve(posed(robot, camera, np.zeros(15)))


@pytest.mark.parametrize("solve", METRIC)
@pytest.mark.parametrize("who", ["robot", "camera"])
def test_nothing_moves(solve, who: str) -> None:
    robot, camera, _ = simulated(1)
    still = np.stack([robot[0]] * len(robot))
    data = posed(still, camera) if who == "robot" else posed(robot, still)
    with pytest.raises(HandEyeError, match=r"not those of the camera|the gripper turned by"):
        solve(data)


@pytest.mark.parametrize("solve", METRIC)
@pytest.mark.parametrize("wrong", ["inverted", "transposed", "shifted"])
def test_wrong_conventions_are_refused(solve, wrong: str) -> None:
    for seed in range(10):
        robot, camera, _ = simulated(seed)
        changed = {
            "inverted": inverse(robot),
            "transposed": pose(np.swapaxes(robot[:, :3, :3], 1, 2), robot[:, :3, 3]),
            "shifted": np.roll(robot, 1, axis=0),
        }[wrong]
        with pytest.raises(InputDataError, match="not those of the camera"):
            solve(posed(changed, camera))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_motions_that_are_not_numbers_are_refused(value: float) -> None:
    pairs = as_motions(posed(*simulated(0)[:2]))
    broken = np.array(pairs.ci_T_cj)
    broken[4, 0, 3] = value
    with pytest.raises(InputDataError, match="camera motion 4 holds a value that is not a finite"):
        MotionPairs(i=pairs.i, j=pairs.j, gi_T_gj=pairs.gi_T_gj, ci_T_cj=broken)


def test_li_needs_positions_that_change() -> None:
    """Turns about the gripper's origin give all others everything."""
    robot, camera, truth = simulated(2, noise=0.0, motion="pure_rotation")
    for solve in METRIC:
        if solve is li:
            with pytest.raises(UnobservableError, match="positions do not tell the size of R_Z"):
                solve(posed(robot, camera))
        else:
            assert_exact(solve(posed(robot, camera)), truth.gripper_T_camera)


def test_a_minimisation_that_does_not_settle_is_an_error(monkeypatch) -> None:
    module = importlib.import_module("handeye_fg.solvers.horaud_dornaika")
    monkeypatch.setattr(module, "MAX_STEPS", 1)
    with pytest.raises(ConvergenceError, match="did not settle within 1 steps"):
        horaud_dornaika(posed(*simulated(0)[:2]))


# --- weights --------------------------------------------------------------------------------------


@pytest.mark.parametrize("solve", EVERY)
@pytest.mark.parametrize("n", [12, 70])
def test_weight_zero_leaves_a_pose_out(solve, n: int) -> None:
    robot, camera, _ = simulated(3, n_poses=n)
    wrong = np.array(robot)
    wrong[[0, 4]] = robot[[4, 1]]
    weights = np.random.default_rng(0).uniform(0.5, 2.0, n)
    weights[[0, 4]] = 0.0
    kept = weights > 0.0
    expected = solve(posed(robot[kept], camera[kept], weights[kept]))
    assert_same(solve(posed(wrong, camera, weights)), expected)


@pytest.mark.parametrize("solve", EVERY)
def test_weights_of_motions_count_as_repetitions(solve) -> None:
    pairs = as_motions(posed(*simulated(4, n_poses=8)[:2]))
    rows = np.repeat(np.arange(len(pairs)), np.arange(len(pairs)) % 3)
    weighted = MotionPairs(
        i=pairs.i,
        j=pairs.j,
        gi_T_gj=pairs.gi_T_gj,
        ci_T_cj=pairs.ci_T_cj,
        weights=0.7 * (np.arange(len(pairs)) % 3),
    )
    # The methods that balance rotation and translation by their errors see the same errors.
    assert_same(solve(weighted), solve(repeated(pairs, rows.tolist())))


@pytest.mark.parametrize("solve", EVERY)
def test_weights_favour_the_better_poses(solve) -> None:
    plain, weighted = [], []
    for seed in range(40):
        robot, camera, truth = simulated(seed, n_poses=14, noise=1e-4)
        noisy = np.concatenate(
            [robot[:7], disturbed(np.random.default_rng(seed), robot[7:], 5e-3, 5e-3)]
        )
        weights = np.where(np.arange(14) < 7, 1.0, 4e-4)
        plain.append(errors(solve(posed(noisy, camera)), truth.gripper_T_camera))
        weighted.append(errors(solve(posed(noisy, camera, weights)), truth.gripper_T_camera))
    assert np.all(np.median(weighted, axis=0) < 0.2 * np.median(plain, axis=0))


# --- memory ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("solve", [tsai_lenz, daniilidis, horaud_dornaika, shah, andreff_scale])
def test_memory_is_linear_in_the_motions(solve) -> None:
    rng = np.random.default_rng(5)
    X = exp(rng.uniform(-1.0, 1.0, 6))

    def peak(k: int) -> int:
        B = exp(rng.uniform(-1.0, 1.0, (k, 6)))
        data = MotionPairs(
            i=np.arange(k), j=np.arange(k) + 1, gi_T_gj=X @ B @ inverse(X), ci_T_cj=B
        )
        tracemalloc.start()
        try:
            solve(data)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(100)
    small, large = peak(2000), peak(8000)
    assert large < 4.5 * small
    # Some 30 matrices of 4 x 4 for each motion.
    assert large < 8000 * 4000
