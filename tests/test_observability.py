"""Free and determined directions, in kind, vector, words and covariance."""

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.observability import (
    LIMITS,
    analyse,
    feigned_information,
    free_lean,
    without_feigned,
)

SURE = np.diag([1e-8] * 7)
X = frames.exp(np.array([0.3, -0.2, 0.5, 0.1, 0.2, 0.3]))


def with_free(*directions):
    """A covariance with free directions (7,), in units of the limits."""
    basis = np.linalg.qr(np.array(directions).T)[0] * LIMITS[:, None]
    return SURE + 100.0 * basis @ basis.T


@pytest.mark.parametrize(
    ("kind", "index", "words"),
    [
        ("rotation", 1, "Add poses that turn the gripper by 20 degrees or more about two"),
        ("translation", 4, "all rotations share one axis. Add two poses tilted 20 degrees"),
    ],
)
def test_a_direction_without_information_is_named(kind, index, words):
    found = analyse(with_free(np.eye(7)[index]), X, "gripper")
    (free,) = found.free_directions
    assert free.kind == kind
    assert words in free.description
    axis = X[:3, 1]
    np.testing.assert_allclose(np.abs(free.vector @ axis), 1.0)
    assert "gripper axis (-0.50, 0.84, 0.23)" in free.description
    expected = SURE[:6, :6].copy()
    expected[index, index] = 0.0
    np.testing.assert_allclose(found.covariance, expected, atol=1e-15)
    assert found.weakest_std > 1.0
    assert found.log_scale_std == pytest.approx(1e-4)


def test_a_free_scale_is_named():
    found = analyse(with_free(np.eye(7)[6]), np.eye(4), "gripper")
    (free,) = found.free_directions
    assert free.kind == "scale"
    np.testing.assert_array_equal(free.vector, 0.0)
    assert "100 mm" in free.description
    assert found.log_scale_std == np.inf
    np.testing.assert_allclose(found.covariance, SURE[:6, :6], atol=1e-15)


def test_a_position_that_is_free_altogether_is_told_along_the_axes():
    found = analyse(with_free(*np.eye(7)[3:6]), X, "base")
    np.testing.assert_array_equal([d.vector for d in found.free_directions], np.eye(3))
    for direction in found.free_directions:
        assert direction.kind == "translation"
        assert direction.frame == "base"
        assert "the gripper never turned" in direction.description


def test_scale_and_position_that_are_free_together_are_one_direction():
    coupled = np.array([0, 0, 0, 1.0, 0, 0, 1.0])
    found = analyse(with_free(coupled), X, "gripper")
    (free,) = found.free_directions
    assert free.kind == "scale"
    np.testing.assert_allclose(np.abs(free.vector @ X[:3, 0]), 1.0)
    assert "changes with it" in free.description
    assert found.log_scale_std == np.inf
    # X's share of the direction is not determined either.
    np.testing.assert_allclose(np.diag(found.covariance)[3], 0.0, atol=1e-12)
    np.testing.assert_allclose(free_lean(found.covariance), [0, 0, 0, 1, 0, 0], atol=1e-6)


def test_a_rotation_that_moves_the_position_is_a_rotation():
    coupled = np.array([0, 0, 1.0, 1.0, 0, 0, 0])
    found = analyse(with_free(coupled, np.array([0, 0, 0, 0, 1.0, 0, 0])), X, "gripper")
    assert [direction.kind for direction in found.free_directions] == ["translation", "rotation"]
    np.testing.assert_allclose(np.abs(found.free_directions[1].vector @ X[:3, 2]), 1.0)
    assert "its position along" in found.free_directions[1].description
    lean = free_lean(found.covariance)
    np.testing.assert_allclose(lean, [0, 0, 0.5**0.5, 0.5**0.5, 1, 0], atol=1e-6)


def test_all_determined():
    found = analyse(SURE, np.eye(4), "gripper")
    assert found.free_directions == ()
    np.testing.assert_allclose(found.covariance, SURE[:6, :6])
    np.testing.assert_array_equal(free_lean(found.covariance), 0.0)


def test_an_error_along_a_free_direction_leaves_no_trace():
    """Noise leans free directions: the covariance must not be touched by errors of any size."""
    lean = np.array([0.02, 0, 0, 0, 0, 1.0, 0])
    found = analyse(with_free(lean), X, "gripper")
    error = 50.0 * (LIMITS * lean)[:6]
    kept = np.linalg.eigh(found.covariance)[1][:, 1:]
    np.testing.assert_allclose(kept.T @ error, 0.0, atol=1e-7)  # of 2.5 m


def test_what_noise_feigns_is_the_mean_over_the_noise():
    """Against draws: the quadratic form of the residuals' change by the noise of the poses."""
    rng = np.random.default_rng(0)
    std, sigmas, n = np.array([1e-3, 2e-4]), np.array([2e-3, 5e-4]), 4000
    direction = rng.uniform(-1.0, 1.0, 7)
    a, b = X[:3, :3] @ direction[:3], X[:3, :3] @ direction[3:6]
    t, scale = X[:3, 3], direction[6]
    turns = frames.exp(np.hstack([std[0] * rng.standard_normal((n, 3)), np.zeros((n, 3))]))
    dR = turns[:, :3, :3] - np.eye(3)
    rotation = -dR @ a / sigmas[0]
    moved = dR @ (t * scale - np.cross(t, a) - b) + std[1] * scale * rng.standard_normal((n, 3))
    drawn = np.sum(rotation**2) + np.sum((moved / sigmas[1]) ** 2)
    margin = 1.0 + 3.0 * np.sqrt(2.0 / (3.0 * n))
    expected = direction @ feigned_information(X, n, std, sigmas) @ direction / margin
    assert drawn == pytest.approx(expected, rel=0.05)


def test_feigned_information_is_taken_off_weak_directions_only():
    values = np.array([1e6, 1e6, 1e6, 1e6, 1e6, 40.0, 1e6])
    feigned = np.zeros((7, 7))
    feigned[5, 5] = 50.0 / LIMITS[5] ** 2
    feigned[0, 0] = 50.0 / LIMITS[0] ** 2
    covariance = without_feigned(values, np.eye(7), feigned)
    scaled = np.diag(covariance) / LIMITS**2
    assert scaled[0] == pytest.approx(1e-6, rel=1e-4)
    assert scaled[5] > 100.0
    assert analyse(covariance, X, "gripper").free_directions[0].kind == "translation"


def test_what_noise_feigns_of_a_static_camera():
    """Likewise, with the change of Log(base_T_gripper^-1 X S^-1 Z^-1) by X and the scale."""
    rng = np.random.default_rng(0)
    std, sigmas, n = np.array([1e-3, 2e-4]), np.array([2e-3, 5e-4]), 4000
    direction = rng.uniform(-1.0, 1.0, 7)
    a, b = X[:3, :3] @ direction[:3], X[:3, :3] @ direction[3:6]
    base_T_gripper = frames.exp(rng.normal(size=(n, 6)))
    noise = np.concatenate([std[0] * rng.standard_normal((n, 3)), np.zeros((n, 3))], axis=1)
    noisy = base_T_gripper @ frames.exp(noise)
    noisy[:, :3, 3] += std[1] * rng.standard_normal((n, 3))

    def change(pose):
        lever = X[:3, 3] - pose[:, :3, 3]
        moved = b + np.cross(lever, a) - direction[6] * lever
        turned = np.broadcast_to(a, moved.shape)
        return np.einsum("nji,snj->sni", pose[:, :3, :3], np.stack([turned, moved]))

    difference = change(noisy) - change(base_T_gripper)
    drawn = np.sum((difference / sigmas[:, None, None]) ** 2)
    lever = X[:3, 3] - base_T_gripper[:, :3, 3]
    margin = 1.0 + 3.0 * np.sqrt(2.0 / (3.0 * n))
    expected = direction @ feigned_information(X, n, std, sigmas, lever) @ direction / margin
    assert drawn == pytest.approx(expected, rel=0.05)
