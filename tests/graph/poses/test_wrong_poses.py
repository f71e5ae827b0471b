"""Poses that are wrong, and noise with heavy tails, in the pose graph: named, and without harm."""

import numpy as np
import pytest

from handeye_fg.frames import exp
from handeye_fg.graph.poses import pose_graph
from handeye_fg.solvers import METHODS, only, start_of, trusted_rows
from pose_graphs import assert_same, error, moved_start, solved, stds


def outliers(truth, seed, n_wrong):
    """Robot poses of which some are anywhere, and which."""
    rng = np.random.default_rng(seed)
    n = len(truth.data)
    wrong = rng.permutation(n)[:n_wrong]
    robot = np.array(truth.data.base_T_gripper)
    turn = rng.standard_normal((n_wrong, 3))
    turn *= (rng.uniform(0.0, np.pi, n_wrong) / np.linalg.norm(turn, axis=1))[:, None]
    place = rng.uniform(-0.4, 0.4, (n_wrong, 3))
    robot[wrong] = robot[wrong] @ exp(np.hstack([turn, place]))
    return truth.with_data(base_T_gripper=robot), np.isin(np.arange(n), wrong)


@pytest.mark.simulation
def test_wrong_poses_are_named_and_do_no_harm(simulated):
    runs, named, innocent, with_wrong, without = 15, 0, 0, [], []
    for seed in range(runs):
        clean = simulated(100 + seed, 30)
        truth, wrong = outliers(clean, seed, 6)
        trusted = trusted_rows(truth.data, scale_known=True, seed=0)
        agreeing = only(truth.data, trusted)
        start = start_of(agreeing, METHODS["li"].solve(agreeing), "li")
        found = solved(truth, start, trusted=trusted)
        named += np.count_nonzero(found.outliers & wrong)
        innocent += np.count_nonzero(found.outliers & ~wrong)
        rest = only(clean.data, ~wrong)
        best = pose_graph(rest, clean.start(), scale_known=True, camera_noise="independent")
        with_wrong.append(error(found, truth) / stds(best)[:6])
        without.append(error(best, clean) / stds(best)[:6])
    # A pose anywhere within half a turn and 0.4 m looks like one with noise (0.2 degrees and 1 mm)
    # with probability below 1e-6. Each set has a false alarm with probability 0.01.
    assert named >= 0.95 * 6 * runs
    assert innocent <= 0.02 * 24 * runs
    assert np.sqrt(np.mean(np.square(with_wrong))) < 1.15 * np.sqrt(np.mean(np.square(without)))


def test_rows_that_were_not_trusted_come_back(simulated):
    truth = simulated(11, 15)
    trusted = np.ones(15, dtype=bool)
    trusted[[0, 4, 9]] = False
    found = solved(truth, trusted=trusted, camera_noise="independent")
    assert not found.outliers.any()
    assert_same(found, solved(truth, camera_noise="independent"), tolerance=0.01)


def test_half_of_the_poses_may_be_wrong_and_no_more(simulated):
    truth, wrong = outliers(simulated(12, 20), 3, 14)
    start = moved_start(truth, np.zeros(6))
    found = solved(truth, start, trusted=~wrong, camera_noise="independent")
    assert np.count_nonzero(found.outliers) <= 10


@pytest.mark.simulation
def test_heavy_tails_do_no_harm(simulated):
    # Student's t of 3 degrees of freedom has three times the variance of its scale parameter. A
    # normal noise of that variance, the same number of runs: the ratio of two rms of 25 x 6 numbers
    # has a standard error of 1 / sqrt(150) = 0.08 and more for heavy tails; bound of 1.2.
    runs, tails, normal = 25, [], []
    root = np.sqrt(3.0)
    levels = {
        "robot_rotation": np.deg2rad(0.05),
        "robot_translation": 2.5e-4,
        "camera_rotation": np.deg2rad(0.1),
        "camera_across": 2e-4,
        "camera_along": 6e-4,
    }
    inside = []
    for seed in range(runs):
        heavy = simulated(200 + seed, 20, tails=3.0, **levels)
        light = simulated(200 + seed, 20, **{k: root * v for k, v in levels.items()})
        found = solved(heavy, camera_noise="independent")
        plain = solved(light, camera_noise="independent")
        tails.append(error(found, heavy) / stds(plain)[:6])
        normal.append(error(plain, light) / stds(plain)[:6])
        inside.append(np.abs(error(found, heavy) / stds(found)[:6]) < 2.0)
    assert np.sqrt(np.mean(np.square(tails))) < 1.2 * np.sqrt(np.mean(np.square(normal)))
    # 95 % within two standard deviations, 25 x 6 numbers (worst: 25 independent ones: 4 %, twice).
    assert np.mean(inside) > 0.87
