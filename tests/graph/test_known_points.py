"""Known points in the graph: corners of a target, alone and beside a scene, against simulated truth."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.graph import corner_fit, refine_views, start_state
from handeye_fg.options import Options
from handeye_fg.progress import silent
from handeye_fg.simulate import project, simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import KnownPoints, Tracks
from refinements import refined_from

N_KNOWN = 20
SIGMA, LOG_SCALE_SIGMA = 2e-4, 1e-3
CORNER_PX, PIXEL_PX = 0.06, 0.3
ROTATION, TRANSLATION = np.deg2rad(0.1), 1e-3


def draw(seed, *, alone=False, robot_scale=1.0, noise=1.0):
    """A scene in a target's metres, its first points known with errors; the robot measures differently.

    Returns:
        Model, known points, the reported robot poses, and the true X.
    """
    rng = np.random.default_rng(seed)
    scene = simulate_scene(
        rng,
        n_points=70,
        pixel_sigma=noise * PIXEL_PX,
        robot_rotation_sigma=noise * ROTATION,
        robot_translation_sigma=noise * TRANSLATION,
        start_sigma=1e-4,
    )
    # One world unit is a metre of the target: the robot's metre but for the error of its size.
    unit = scene.metres_per_world_unit / np.exp(noise * LOG_SCALE_SIGMA * rng.standard_normal())
    unit /= robot_scale
    tracks = scene.model.tracks
    corner = tracks.point_index < N_KNOWN
    truth = frames.inverse(scene.world_T_camera)[tracks.image_index]
    points = scene.points_world[tracks.point_index]
    exact = project(
        scene.camera, np.einsum("nij,nj->ni", truth[:, :3, :3], points) + truth[:, :3, 3]
    )
    pixels = np.where(
        corner[:, None],
        exact + noise * CORNER_PX * rng.standard_normal(exact.shape),
        tracks.pixels,
    )
    known = unit * scene.points_world[:N_KNOWN] + noise * SIGMA * rng.standard_normal((N_KNOWN, 3))
    used = corner if alone else np.ones_like(corner)
    start = np.concatenate([known, unit * tracks.points_world[N_KNOWN:]])
    model = replace(
        scene.model,
        world_T_camera=frames.scaled(scene.model.world_T_camera, unit),
        tracks=Tracks(
            points_world=known if alone else start,
            image_index=tracks.image_index[used],
            point_index=tracks.point_index[used],
            pixels=pixels[used],
        ),
    )
    points = KnownPoints(points_world=known, sigma=SIGMA, log_scale_sigma=LOG_SCALE_SIGMA)
    return model, points, scene.robot_poses.base_T_gripper, scene.gripper_T_camera


def fit(model, known, reported):
    linear = linear_start(reported, model.world_T_camera)
    return refined_from(start_state(model, [model.camera], linear), model, reported, known=known)


def nees(result, truth):
    error = frames.log(frames.inverse(result.state.gripper_T_camera) @ truth)
    return float(error @ np.linalg.solve(result.observability.covariance, error))


@pytest.mark.parametrize("alone", [True, False])
def test_without_noise_the_truth_is_found(alone):
    model, known, reported, truth = draw(1, alone=alone, noise=0.0)
    result = fit(model, known, reported)
    error = frames.log(frames.inverse(result.state.gripper_T_camera) @ truth)
    assert np.abs(error).max() < 1e-6
    assert result.metres_per_world_unit == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(result.state.points_world[:N_KNOWN], known.points_world, atol=1e-6)


def test_corners_have_a_noise_level_of_their_own():
    model, known, reported, _ = draw(2)
    result = fit(model, known, reported)
    assert result.noise.corner == pytest.approx(CORNER_PX, rel=0.15)
    assert result.noise.pixel == pytest.approx(PIXEL_PX, rel=0.1)
    count, rms_px = corner_fit(result, N_KNOWN)
    assert count > 0.95 * np.sum(model.tracks.point_index < N_KNOWN)
    assert rms_px == pytest.approx(np.sqrt(2) * CORNER_PX, rel=0.2)


def test_known_points_need_neither_parallax_nor_observations():
    model, known, reported, _ = draw(3)
    tracks = model.tracks
    # Point 0 is seen by no image, point 1 by one.
    kept = (tracks.point_index != 0) & ((tracks.point_index != 1) | (tracks.image_index == 0))
    model = replace(
        model,
        tracks=Tracks(
            points_world=tracks.points_world,
            image_index=tracks.image_index[kept],
            point_index=tracks.point_index[kept],
            pixels=tracks.pixels[kept],
        ),
    )
    result = fit(model, known, reported)
    assert (result.tracks.point_index == 1).sum() == 1
    np.testing.assert_allclose(result.state.points_world[0], known.points_world[0], atol=1e-9)


def test_the_targets_size_counts_where_the_robot_agrees():
    model, known, reported, truth = draw(4)
    linear = linear_start(reported, model.world_T_camera)
    view = refine_views(model, reported, model.cameras, linear, Options(), "gripper", silent, known)
    assert view.scale_note == ""
    assert view.refinement.log_scale_std < 1.1 * LOG_SCALE_SIGMA
    assert nees(view.refinement, truth) < stats.chi2.isf(1e-3, 6)


def test_the_robots_measure_counts_where_it_contradicts_the_target():
    model, known, reported, truth = draw(5, robot_scale=0.96)
    linear = linear_start(reported, model.world_T_camera)
    view = refine_views(model, reported, model.cameras, linear, Options(), "gripper", silent, known)
    assert "times as large as its file says" in view.scale_note
    assert "check the lengths in the target file" in view.scale_note
    assert np.exp(view.refinement.state.log_scale) == pytest.approx(0.96, abs=0.01)
    assert nees(view.refinement, truth) < stats.chi2.isf(1e-3, 6)


def test_a_known_size_makes_the_position_surer():
    model, known, reported, _ = draw(6)
    with_target, without = fit(model, known, reported), fit(model, None, reported)
    assert without.noise.corner is None
    # The view along the optical axis takes its length from the scale.
    variance = with_target.observability.covariance[5, 5]
    assert variance < 0.5 * without.observability.covariance[5, 5]


@pytest.mark.slow
@pytest.mark.simulation
@pytest.mark.parametrize("alone", [True, False])
def test_covariance_is_that_of_the_errors(alone):
    runs = 30
    values, sigmas = [], []
    for seed in range(runs):
        model, known, reported, truth = draw(100 + seed, alone=alone)
        result = fit(model, known, reported)
        values.append(nees(result, truth))
        sigmas.append(
            [
                (result.noise.corner or 0.0) / CORNER_PX,
                result.noise.robot_rotation / ROTATION,
                result.noise.robot_translation / TRANSLATION,
            ]
        )
    dof = 6 * runs
    assert stats.chi2.ppf(0.0005, dof) < np.sum(values) < 1.05 * stats.chi2.ppf(0.9995, dof)
    # Within 3 standard errors of the mean for 40 degrees of freedom: 3 / sqrt(2 * 40 * 30) = 0.061.
    assert np.abs(np.mean(sigmas, axis=0) - 1.0).max() < 0.065
