"""Observations that are not of their point, one by one or by half of a track: X and the levels bear them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.simulate import project, simulate_scene

RUNS = 15
ROTATION, TRANSLATION = np.deg2rad(0.02), 1e-4


def scattered(scene, rng):
    """A fifth of the observations anywhere in their image."""
    tracks = scene.model.tracks
    pixels = np.array(tracks.pixels)
    bad = rng.choice(len(pixels), len(pixels) // 5, replace=False)
    size = [scene.camera.width, scene.camera.height]
    pixels[bad] = rng.uniform([0.0, 0.0], size, (len(bad), 2))
    return replace(tracks, pixels=pixels)


def misled(scene, rng):
    """A fifth of the tracks see another point, 10 to 50 mm away, in half of their images.

    The model has the point half-way between the two.
    """
    tracks = scene.model.tracks
    pixels, points = np.array(tracks.pixels), np.array(tracks.points_world)
    for j in rng.choice(len(points), len(points) // 5, replace=False):
        seen = np.flatnonzero(tracks.point_index == j)
        bad = rng.choice(seen, len(seen) // 2, replace=False)
        away = rng.standard_normal(3)
        away *= rng.uniform(0.01, 0.05) / np.linalg.norm(away) / scene.metres_per_world_unit
        camera_T_world = frames.inverse(scene.world_T_camera[tracks.image_index[bad]])
        other = camera_T_world @ np.append(scene.points_world[j] + away, 1.0)
        pixels[bad] = project(scene.camera, other[:, :3])
        pixels[bad] += scene.noise.pixel * rng.standard_normal((len(bad), 2))
        points[j] += 0.5 * away
    return replace(tracks, pixels=pixels, points_world=points)


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
@pytest.mark.parametrize("spoilt", [scattered, misled])
def test_wrong_observations_neither_bias_x_nor_the_noise_levels(refined, spoilt):
    nees, ratios, outliers = zip(
        *(draw(refined, spoilt, seed) for seed in range(RUNS)), strict=True
    )
    assert stats.chi2.ppf(0.0005, 6 * RUNS) < np.sum(nees) < 1.1 * stats.chi2.ppf(0.9995, 6 * RUNS)
    # Each robot level has about 30 degrees of freedom, that of the pixels a thousand.
    assert np.abs(np.mean(ratios, axis=0) - 1.0) == pytest.approx(0.0, abs=0.12)
    assert np.mean(ratios, axis=0)[0] == pytest.approx(1.0, abs=0.02)
    assert sum(outliers) <= 1
