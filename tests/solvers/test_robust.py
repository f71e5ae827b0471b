"""Rows that do not belong together are found, and nothing else is."""

import math
from typing import Any

import numpy as np
import pytest

from handeye_fg.frames import Array, exp, inverse, rotation_angle, scaled
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.simulate import Motion, Truth, disturbed, simulate_poses
from handeye_fg.solvers import andreff_scale, linear_start, only, trusted_rows
from handeye_fg.solvers.consensus import Rows

# A good arm and good camera poses; a bad arm and bad camera poses. Radians, metres.
GOOD = {"robot_rotation_sigma": 2e-4, "robot_translation_sigma": 5e-5}
BAD = {
    "robot_rotation_sigma": 0.01,
    "robot_translation_sigma": 0.004,
    "camera_rotation_sigma": 0.005,
    "camera_translation_sigma": 0.002,
}


def poses(
    seed: int, n: int, noise: dict[str, float], motion: Motion = "general"
) -> tuple[Array, Array, Truth, np.random.Generator]:
    rng = np.random.default_rng(seed)
    robot, camera, truth = simulate_poses(rng, n_poses=n, motion=motion, **noise)
    return robot.copy(), camera.copy(), truth, rng


def found(robot: Array, camera: Array, **options: Any) -> Rows:
    data = PosePairs(base_T_gripper=robot, world_T_camera=camera)
    return ~trusted_rows(data, **({"scale_known": False} | options))


def rates(wrong: Array, flagged: Array) -> tuple[float, float]:
    """Recall, and false alarms as a part of the good rows, over all draws."""
    return float(np.mean(flagged[wrong])), float(np.mean(flagged[~wrong]))


@pytest.mark.parametrize("noise", [GOOD, BAD], ids=["good arm", "bad arm"])
@pytest.mark.parametrize("motion", ["general", "one_axis", "pure_translation", "pure_rotation"])
def test_swapped_rows_are_found(noise: dict[str, float], motion: Motion) -> None:
    if motion in ("pure_rotation", "pure_translation") and noise is BAD:
        pytest.skip("the camera moves, or turns, by less than this noise")
    wrong, flagged = [], []
    for seed in range(25):
        robot, camera, _, rng = poses(seed, 20, noise, motion)
        rows = rng.choice(20, 4, replace=False)
        robot[rows] = robot[np.roll(rows, 1)]
        wrong.append(np.isin(np.arange(20), rows))
        flagged.append(found(robot, camera))
    recall, false_alarms = rates(np.array(wrong), np.array(flagged))
    assert recall >= 0.95
    assert false_alarms <= 0.02


@pytest.mark.parametrize("scale_known", [False, True])
@pytest.mark.parametrize("who", ["robot", "camera"])
def test_random_poses_are_found(who: str, scale_known: bool) -> None:
    wrong, flagged = [], []
    for seed in range(25):
        robot, camera, truth, rng = poses(seed, 30, GOOD)
        if scale_known:
            camera = scaled(camera, truth.metres_per_world_unit)
        rows = rng.choice(30, 12, replace=False)
        unit = 1.0 if who == "robot" else float(np.abs(camera[:, :3, 3]).max())
        random = exp(rng.uniform(-1.0, 1.0, (12, 6)) * [2.0, 2.0, 2.0, unit, unit, unit])
        (robot if who == "robot" else camera)[rows] = random
        wrong.append(np.isin(np.arange(30), rows))
        flagged.append(found(robot, camera, scale_known=scale_known))
    recall, false_alarms = rates(np.array(wrong), np.array(flagged))
    assert recall >= 0.95
    assert false_alarms <= 0.02


@pytest.mark.parametrize("noise", [GOOD, BAD], ids=["good arm", "bad arm"])
def test_robust_is_as_accurate_as_plain_without_wrong_rows(noise: dict[str, float]) -> None:
    squares = np.zeros((2, 2))
    n_flagged = 0
    for seed in range(200):
        robot, camera, truth, _ = poses(seed, 12, noise)
        data = PosePairs(base_T_gripper=robot, world_T_camera=camera)
        rows = trusted_rows(data, scale_known=False)
        n_flagged += np.count_nonzero(~rows)
        for k, rows_used in enumerate((np.ones(12, dtype=bool), rows)):
            X = np.asarray(andreff_scale(only(data, rows_used)).gripper_T_camera)
            turn = X[:3, :3].T @ truth.gripper_T_camera[:3, :3]
            shift = X[:3, 3] - truth.gripper_T_camera[:3, 3]
            squares[k] += [float(rotation_angle(turn)) ** 2, float(shift @ shift)]
    assert n_flagged <= 0.002 * 200 * 12
    # A row that is left out costs a twelfth of the information of one draw in many.
    np.testing.assert_allclose(squares[1], squares[0], rtol=0.02)


@pytest.mark.parametrize("n_wrong", [0, 10])
def test_drift_makes_no_outliers(n_wrong: int) -> None:
    """Visual odometry: each motion has a small error, the poses accumulate them."""
    flagged, wrong = [], []
    for seed in range(15):
        robot, camera, truth, rng = poses(seed, 60, GOOD)
        motions = inverse(camera[:-1]) @ camera[1:]
        unit = 0.003 / truth.metres_per_world_unit
        motions = motions @ exp(
            rng.standard_normal((59, 6)) * [0.006, 0.006, 0.006, unit, unit, unit]
        )
        drifting = [camera[0]]
        for motion in motions:
            drifting.append(drifting[-1] @ motion)
        rows = rng.choice(60, n_wrong, replace=False)
        robot[rows] = robot[np.roll(rows, 1)]
        wrong.append(np.isin(np.arange(60), rows))
        flagged.append(found(robot, np.array(drifting)))
    assert np.mean(np.array(flagged)[~np.array(wrong)]) <= 0.02
    if n_wrong:
        assert np.mean(np.array(flagged)[np.array(wrong)]) >= 0.9


def test_motions_are_sorted_too() -> None:
    wrong, flagged = [], []
    for seed in range(25):
        robot, camera, _, rng = poses(seed, 40, GOOD)
        pairs = as_motions(PosePairs(base_T_gripper=robot, world_T_camera=camera))
        pairs = only(pairs, rng.choice(len(pairs), 20, replace=False))
        assert isinstance(pairs, MotionPairs)
        ci_T_cj = pairs.ci_T_cj.copy()
        ci_T_cj[:4] = np.roll(ci_T_cj[:4], 1, axis=0)
        mixed = MotionPairs(i=pairs.i, j=pairs.j, gi_T_gj=pairs.gi_T_gj, ci_T_cj=ci_T_cj)
        wrong.append(np.arange(20) < 4)
        flagged.append(~trusted_rows(mixed, scale_known=False))
    recall, false_alarms = rates(np.array(wrong), np.array(flagged))
    assert recall >= 0.95
    assert false_alarms <= 0.02


@pytest.mark.parametrize("unit", [1e-4, 1.0, 1e4])
def test_any_world_unit_and_frame(unit: float) -> None:
    robot, camera, _, _ = poses(3, 20, GOOD)
    robot[[2, 9]] = robot[[9, 2]]
    moved = scaled(exp(np.array([1.0, -2.0, 0.5, 3.0, -4.0, 5.0])) @ camera, unit)
    assert np.flatnonzero(found(robot, moved)).tolist() == [2, 9]


def test_same_seed_same_rows() -> None:
    robot, camera, _, rng = poses(4, 30, BAD)
    robot[:8] = rng.permutation(robot[:8])
    assert np.array_equal(found(robot, camera, seed=7), found(robot, camera, seed=7))


def test_repeated_poses_are_one_vote() -> None:
    """Many images from the same pose agree whatever X is."""
    n_flagged = 0
    for seed in range(10):
        robot, camera, truth, rng = poses(seed, 20, {})
        robot[:11], camera[:11] = robot[0], camera[0]
        robot[11:] = disturbed(rng, robot[11:], 2e-4, 5e-5)
        camera = disturbed(rng, camera, 2e-5, 1e-5 / truth.metres_per_world_unit)
        n_flagged += int(np.count_nonzero(found(robot, camera)))
    assert n_flagged == 0


def test_a_row_alone_with_its_axis_is_not_judged() -> None:
    """Rows about one axis cannot say that the only row about another is wrong."""
    _, _, truth, rng = poses(0, 8, {})
    turns = np.zeros((8, 6))
    turns[:7, 2] = rng.uniform(-2.0, 2.0, 7)
    turns[7, 0] = 0.8
    turns[:, 3:] = rng.uniform(-0.2, 0.2, (8, 3))
    robot = exp(turns)
    camera = inverse(truth.base_T_world) @ robot @ truth.gripper_T_camera
    robot = disturbed(rng, robot, 2e-4, 5e-5)
    robot[7] = robot[7] @ exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.02]))
    assert not found(robot, camera, scale_known=True).any()


@pytest.mark.parametrize("change", [inverse, lambda robot: np.roll(robot, 1, axis=0)])
@pytest.mark.parametrize("n", [8, 20])
def test_no_majority_is_found_where_nothing_fits(n: int, change: Any) -> None:
    """Poses of another convention that agree by chance must not hide that the others do not."""
    flagged = 0
    for seed in range(30):
        robot, camera, _, _ = poses(seed, n, GOOD)
        flagged += bool(found(change(robot), camera).any())
    assert flagged <= 1


def test_few_rows_are_all_trusted() -> None:
    robot, camera, _, _ = poses(0, 6, GOOD)
    robot[[0, 1]] = robot[[1, 0]]
    assert not found(robot, camera).any()


def test_start_of_a_calibration_bears_wrong_rows() -> None:
    robot, camera, truth, _ = poses(5, 20, GOOD)
    robot[[3, 12]] = robot[[12, 3]]
    start = linear_start(robot, camera)
    turn = start.gripper_T_camera[:3, :3].T @ truth.gripper_T_camera[:3, :3]
    # Eighteen poses of 0.011 degrees.
    assert float(rotation_angle(turn)) < math.radians(0.05)
    assert np.linalg.norm((inverse(start.base_T_world) @ truth.base_T_world)[:3, 3]) < 2e-3
