"""Random motions of the paper's simulations: amplitudes, noise, and errors against the truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from handeye_fg.errors import UnobservableError
from handeye_fg.frames import Array, exp, inverse, rotation_angle
from handeye_fg.simulate.series import (
    LARGE,
    SMALL,
    Amplitude,
    Draws,
    errors,
    simulate_draws,
    with_proportional_noise,
)


def draws(seed: int = 0, *, sigma: float = 0.0, amplitude: Amplitude = LARGE) -> Draws:
    rng = np.random.default_rng(seed)
    return simulate_draws(rng, n_draws=2000, n_motions=2, amplitude=amplitude, sigma=sigma)


@pytest.mark.parametrize("amplitude", [LARGE, SMALL])
def test_motions_close_exactly_and_keep_their_amplitude(amplitude: Amplitude) -> None:
    drawn = draws(amplitude=amplitude)
    X = drawn.gripper_T_camera[:, None]
    # Products of four matrices of numbers of order one.
    np.testing.assert_allclose(drawn.gi_T_gj @ X, X @ drawn.ci_T_cj, atol=1e-14)
    angles = rotation_angle(drawn.gi_T_gj[..., :3, :3]).ravel()
    lengths = np.linalg.norm(drawn.gi_T_gj[..., :3, 3], axis=-1).ravel()
    # Seeded: uniform angles, and points uniform in a ball.
    assert kstest(angles / amplitude.rotation, "uniform").pvalue > 1e-3
    assert kstest((lengths / amplitude.translation) ** 3, "uniform").pvalue > 1e-3


def test_noise_is_in_proportion_to_angles_and_lengths() -> None:
    rng, sigma = np.random.default_rng(1), 0.05
    exact = draws(2).ci_T_cj[:, 0]
    noisy = with_proportional_noise(rng, exact, sigma, 2.0 * sigma)
    before, after = (Rotation.from_matrix(T[:, :3, :3]).as_euler("xyz") for T in (exact, noisy))
    # Pitch beyond 90 degrees comes back as other angles: only draws far from that are looked at.
    plain = np.all(np.abs(before) < [2.0, 1.0, 2.0], axis=1)
    r = (after / before - 1.0)[plain].ravel() / sigma
    length = np.linalg.norm(exact[:, :3, 3], axis=1, keepdims=True)
    n = ((noisy - exact)[:, :3, 3] / length).ravel() / (2.0 * sigma)
    for standard_normal in (r, n):
        low, high = chi2.ppf([0.0005, 0.9995], standard_normal.size)
        assert low < np.sum(standard_normal**2) < high


def test_same_seed_same_draws() -> None:
    for name in ("gripper_T_camera", "gi_T_gj", "ci_T_cj", "metres_per_world_unit"):
        np.testing.assert_array_equal(
            getattr(draws(3, sigma=0.1), name), getattr(draws(3, sigma=0.1), name)
        )


def test_errors_of_a_known_deviation() -> None:
    drawn = draws(4)
    answers = iter(drawn.gripper_T_camera @ exp(np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])))

    def solve(gi_T_gj: Array, ci_T_cj: Array) -> Array:
        X = np.array(next(answers))
        X[:3, 3] *= 1.1
        return X

    found = errors(drawn, solve)
    # |R - I|_F = 2 sqrt(2) sin(angle / 2).
    np.testing.assert_allclose(found.rotation, np.sqrt(8.0) * np.sin(0.005), rtol=1e-9)
    np.testing.assert_allclose(found.translation, 0.1, rtol=1e-9)


def test_a_method_without_scale_gets_world_units_and_may_refuse() -> None:
    drawn = draws(5)
    ratios = []

    def solve(gi_T_gj: Array, ci_T_cj: Array) -> Array:
        ratios.append(np.linalg.norm(ci_T_cj[0, :3, 3]))
        if len(ratios) % 2:
            raise UnobservableError("refused")
        return inverse(gi_T_gj[0])

    found = errors(drawn, solve, scale_known=False)
    metres = np.linalg.norm(drawn.ci_T_cj[:, 0, :3, 3], axis=1)
    np.testing.assert_allclose(metres / ratios, drawn.metres_per_world_unit)
    np.testing.assert_array_equal(np.isinf(found.rotation), np.arange(len(drawn)) % 2 == 0)
    np.testing.assert_array_equal(np.isinf(found.translation), np.isinf(found.rotation))
