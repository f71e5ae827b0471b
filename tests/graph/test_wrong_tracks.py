"""Observations that are not of their point, one by one or by half of a track: X and the levels bear them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.simulate import simulate_scene
from handeye_fg.simulate.wrong_tracks import astray, scattered

RUNS = 15
ROTATION, TRANSLATION = np.deg2rad(0.02), 1e-4


def anywhere(scene, rng):
    """A fifth of the observations anywhere in their image."""
    return scattered(scene, rng, 0.2)


def misled(scene, rng):
    """A fifth of the tracks see another point, 10 to 50 mm away, in half of their images."""
    return astray(scene, rng, 0.1, (0.01, 0.05))


def draw(refined, spoilt, seed):
    rng = np.random.default_rng(seed)
    scene = simulate_scene(
        rng,
        n_images=12,
        n_points=80,
        robot_rotation_sigma=ROTATION,
        robot_translation_sigma=TRANSLATION,
        start_sigma=1e-4,
    )
    model = replace(scene.model, tracks=spoilt(scene, rng))
    result = refined(scene, model=model, believed=True)
    error = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    nees = error @ np.linalg.solve(result.observability.covariance, error)
    noise = result.noise
    ratios = [
        noise.pixel / scene.noise.pixel,
        noise.robot_rotation / ROTATION,
        noise.robot_translation / TRANSLATION,
    ]
    return nees, ratios, result.outliers.sum()


@pytest.mark.simulation
@pytest.mark.parametrize("spoilt", [anywhere, misled])
def test_wrong_observations_neither_bias_x_nor_the_noise_levels(refined, spoilt):
    nees, ratios, outliers = zip(
        *(draw(refined, spoilt, seed) for seed in range(RUNS)), strict=True
    )
    assert stats.chi2.ppf(0.0005, 6 * RUNS) < np.sum(nees) < 1.1 * stats.chi2.ppf(0.9995, 6 * RUNS)
    # Each robot level has about 30 degrees of freedom, that of the pixels a thousand.
    assert np.abs(np.mean(ratios, axis=0) - 1.0) == pytest.approx(0.0, abs=0.12)
    assert np.mean(ratios, axis=0)[0] == pytest.approx(1.0, abs=0.02)
    assert sum(outliers) <= 1
