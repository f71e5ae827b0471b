"""Estimated noise levels: what is left of the certainty of X, against closed forms and dense algebra."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from handeye_fg.graph import start_state
from handeye_fg.graph.certainty import certainty, enlarged
from handeye_fg.graph.levels import level_spread
from handeye_fg.graph.noise import PRIOR_WEIGHT, solve
from handeye_fg.graph.reduced import scatter
from handeye_fg.options import NoiseOptions
from handeye_fg.simulate import simulate_scene
from handeye_fg.solvers import linear_start
from refinements import problem_of


def positive(seed, n):
    a = np.random.default_rng(seed).normal(size=(n, n + 2))
    return a @ a.T


@given(st.integers(0, 2**31), st.floats(4.0, 500.0))
def test_one_unknown_variance_is_students_t(seed, freedom):
    """With C proportional to one variance the exact answer is known."""
    C = positive(seed, 4)
    found = certainty(C, C[None], C[None, None], np.array([[2.0 / freedom]]), 4)
    assert found.freedom == pytest.approx(freedom)
    np.testing.assert_allclose(found.freedoms, freedom)
    np.testing.assert_allclose(found.expected, C, atol=1e-9 * np.abs(C).max())
    np.testing.assert_allclose(found.covariance, C * freedom / (freedom - 2.0))
    expected = stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(C))
    np.testing.assert_allclose(found.half_widths, expected)


@given(st.integers(0, 2**31))
def test_each_unknown_has_the_freedom_of_its_own_variance(seed):
    """Two unknowns, each with a variance of its own."""
    first = np.array([np.diag([1.0, 0.0]), np.diag([0.0, 4.0])])
    second = np.zeros((2, 2, 2, 2))
    second[0, 0], second[1, 1] = first
    rng = np.random.default_rng(seed)
    freedoms = rng.uniform(4.0, 100.0, 2)
    found = certainty(np.diag([1.0, 4.0]), first, second, np.diag(2.0 / freedoms), 1)
    np.testing.assert_allclose(found.freedoms, freedoms)
    np.testing.assert_allclose(
        np.diag(found.covariance), [1.0, 4.0] * freedoms / (freedoms - 2.0), rtol=1e-9
    )


@given(st.integers(0, 2**31), st.floats(0.0, 10.0))
def test_errors_of_another_source_never_make_x_surer(seed, size):
    C = positive(seed, 4)
    white = certainty(C, C[None], C[None, None], np.array([[0.1]]), 4)
    found = enlarged(white, white.expected, size * positive(seed + 1, 4), 10.0)
    assert np.linalg.eigvalsh(found.covariance - white.covariance)[0] > -1e-9 * np.abs(C).max()
    assert (found.half_widths >= 0.999 * stats.norm.ppf(0.975) * np.sqrt(np.diag(C))).all()


def test_information_on_the_levels_is_that_of_the_dense_model():
    """tr(P V_k P V_l) with all measurements, none eliminated analytically but the points."""
    scene = simulate_scene(np.random.default_rng(0), n_images=6, n_points=40)
    state = start_state(
        scene.model,
        [scene.camera],
        linear_start(scene.robot_poses.base_T_gripper, scene.model.world_T_camera),
    )
    linearised = problem_of(scene, state).linearised(state)
    solution = solve(linearised, scene.noise)
    found = level_spread(linearised, solution, NoiseOptions()).information
    noise, C = scene.noise, solution.covariance
    Q = [linearised.reprojections.hessian * (linearised.pixel_unit_px / noise.pixel) ** 2]
    for k, sigma in enumerate((noise.robot_rotation, noise.robot_translation)):
        weights = np.repeat(np.eye(2)[k], 3) / sigma**2
        Q.append(scatter(linearised.robot, weights, linearised.layout.dim)[0])
    counts = [linearised.pixel_redundancy, 18, 18]
    expected = np.array([[np.trace(C @ a @ C @ b) for a in Q] for b in Q])
    expected += np.diag([n - 2.0 * np.trace(C @ a) for n, a in zip(counts, Q, strict=True)])
    expected += np.diag([0.0, PRIOR_WEIGHT, PRIOR_WEIGHT])
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=2e-3)


def test_the_users_levels_are_certain_and_the_data_decide_the_others(refined):
    scene = simulate_scene(np.random.default_rng(0), n_images=8, n_points=60)
    result = refined(scene, noise=NoiseOptions(robot_rotation_deg=0.01))
    levels = result.level_certainties
    assert levels["robot_rotation"].source == "user"
    assert levels["robot_rotation"].degrees_of_freedom == np.inf
    assert (levels["robot_rotation"].low, levels["robot_rotation"].high) == (1.0, 1.0)
    assert levels["robot_translation"].source == levels["pixel"].source == "data"
    freedom = levels["robot_translation"].degrees_of_freedom
    assert 1.0 < freedom < 3 * 8
    expected = np.sqrt(freedom / stats.chi2.ppf([0.975, 0.025], freedom))
    ends = [levels["robot_translation"].low, levels["robot_translation"].high]
    np.testing.assert_allclose(ends, expected)


def test_the_prior_decides_where_poses_are_exact(refined):
    scene = simulate_scene(
        np.random.default_rng(0),
        n_images=8,
        n_points=60,
        pixel_sigma=1e-4,
        robot_rotation_sigma=0.0,
        robot_translation_sigma=0.0,
    )
    levels = refined(scene).level_certainties
    assert levels["robot_rotation"].source == levels["robot_translation"].source == "prior"


def test_a_given_level_is_held_against_the_residuals(refined):
    """Half of the true level is found to be too small by a factor of two, a right one to be right."""
    scene = simulate_scene(np.random.default_rng(3), n_images=20, n_points=60)
    true_mm = 1e3 * scene.noise.robot_translation
    for given_mm, factor in ((0.5 * true_mm, 2.0), (true_mm, 1.0)):
        levels = refined(scene, noise=NoiseOptions(robot_translation_mm=given_mm)).level_certainties
        value, low, high = levels["robot_translation"].found
        assert low < factor < high
        assert high - low < factor
        assert low < value < high
        assert levels["robot_rotation"].found is None
