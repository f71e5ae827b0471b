"""The error that X causes: by simulation, and where the answer is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from handeye_fg import frames
from handeye_fg.point_errors import accuracy

RUNS = 20_000
X = frames.exp(np.array([0.4, -0.3, 1.1, 0.03, -0.05, 0.09]))


def positive(rng, sigmas):
    a = rng.normal(size=(6, 8))
    correlation = a @ a.T
    scale = sigmas / np.sqrt(np.diag(correlation))
    return correlation * np.outer(scale, scale)


@pytest.mark.parametrize("freedom", [np.inf, 5.0, 12.0])
def test_of_simulated_errors_of_x_95_percent_are_within(freedom):
    rng = np.random.default_rng(3)
    covariance = positive(rng, np.array([1e-4, 2e-4, 3e-4, 1e-4, 2e-4, 3e-4]))
    found = accuracy(X, covariance, freedom, 0.4)
    xi = rng.multivariate_normal(np.zeros(6), covariance, RUNS)
    if np.isfinite(freedom):
        xi *= np.sqrt((freedom - 2.0) / rng.chisquare(freedom, RUNS))[:, None]
    true = X @ frames.exp(xi)
    for error in (found.tool, *found.along_axis):
        moved = true[:, :3, :3] @ error.point_camera + true[:, :3, 3]
        off = (moved - (X[:3, :3] @ error.point_camera + X[:3, 3])) @ X[:3, :3]
        inside = np.mean(np.linalg.norm(off, axis=1) <= error.within_95)
        assert inside == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / RUNS) + 2e-3)
        np.testing.assert_allclose(
            off.std(axis=0), np.sqrt(np.diag(error.covariance)), rtol=0.05 if freedom > 10 else 0.15
        )


def test_independent_errors_of_the_position_alone_are_a_chi_distribution():
    covariance = np.diag([0.0, 0.0, 0.0, 1e-8, 1e-8, 1e-8])
    found = accuracy(X, covariance, np.inf, None)
    expected = 1e-4 * stats.chi.ppf(0.95, 3)
    for error in (found.tool, *found.along_axis):
        assert error.within_95 == pytest.approx(expected, rel=0.01)
    assert found.working_distance is None
    assert found.at_work.distance == pytest.approx(0.5)


def test_the_tool_is_the_origin_of_the_gripper():
    found = accuracy(X, np.eye(6), np.inf, 0.4)
    np.testing.assert_allclose(X[:3, :3] @ found.tool.point_camera + X[:3, 3], 0.0, atol=1e-12)
    assert found.at_work.distance == pytest.approx(0.4)


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.floats(3.5, 200.0), st.floats(0.05, 5.0))
def test_a_larger_covariance_makes_larger_errors(seed, freedom, distance):
    rng = np.random.default_rng(seed)
    covariance = positive(rng, np.full(6, 1e-3))
    more = covariance + positive(rng, np.full(6, 3e-4))
    small, large = (accuracy(X, c, freedom, distance) for c in (covariance, more))
    for a, b in zip(small.along_axis, large.along_axis, strict=True):
        assert 0.0 < a.within_95 < b.within_95
