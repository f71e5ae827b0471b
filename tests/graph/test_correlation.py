"""Errors of features that are alike in a neighbourhood: found, and counted in the covariance."""

from dataclasses import replace

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.findings import LinearStart
from handeye_fg.graph import start_state
from handeye_fg.graph.correlation import inflation
from handeye_fg.graph.elimination import batches, by_regions, eliminate
from handeye_fg.graph.noise import solve
from handeye_fg.graph.reduced import Layout
from handeye_fg.graph.variables import LOG_SCALE
from handeye_fg.options import NoiseOptions
from handeye_fg.simulate import simulate_scene
from refinements import problem_of, refined_from

# Robot poses that are exact, for all that matters: X is as certain as the images are.
EXACT = NoiseOptions(robot_rotation_deg=1e-3, robot_translation_mm=1e-3)
RUNS = 25


def scene_at_truth(seed, n_points=400):
    return simulate_scene(
        np.random.default_rng(seed),
        n_images=8,
        n_points=n_points,
        robot_rotation_sigma=np.deg2rad(1e-3),
        robot_translation_sigma=1e-6,
        start_sigma=0.0,
    )


def with_alike_errors(scene, seed, size=0.5, reach=0.2):
    """Observations with errors that are, in each image, a smooth function of the place in the scene."""
    rng, tracks = np.random.default_rng(seed), scene.model.tracks
    spread = scene.points_world.std(axis=0).max()
    waves = rng.standard_normal((30, 3)) / (reach * spread)
    phases = scene.points_world @ waves.T + rng.uniform(0, 2 * np.pi, 30)
    amplitudes = rng.standard_normal((len(scene.model.names), 2, 30)) * size * np.sqrt(2 / 30)
    fields = np.einsum("nak,pk->npa", amplitudes, np.cos(phases))
    errors = fields[tracks.image_index, tracks.point_index]
    return replace(
        scene, model=replace(scene.model, tracks=replace(tracks, pixels=tracks.pixels + errors))
    )


def start_of(scene):
    return start_state(
        scene.model,
        [scene.camera],
        LinearStart(
            method="truth",
            gripper_T_camera=scene.gripper_T_camera,
            base_T_world=scene.base_T_world,
            metres_per_world_unit=scene.metres_per_world_unit,
            residual_rotation=0.0,
            residual_translation=0.0,
        ),
    )


def refined(scene):
    reported = scene.robot_poses.base_T_gripper
    return refined_from(start_of(scene), scene.model, reported, noise=EXACT)


def factor(scene):
    """The factor of X and the scale, with the true noise levels."""
    state = start_of(scene)
    problem = problem_of(scene, state)
    solution = solve(problem.linearised(state), scene.noise)
    layout = problem.layout
    columns = np.append(layout.x_columns(), layout.columns(LOG_SCALE))
    return inflation(problem, state, solution, columns)


def nees(scene, result):
    error = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    return error @ np.linalg.solve(result.observability.covariance, error)


def test_information_along_directions_is_that_of_the_elimination():
    scene, rng = scene_at_truth(1, n_points=50), np.random.default_rng(2)
    tracks, n_images = scene.model.tracks, len(scene.model.names)
    layout = Layout(n_poses=n_images, intrinsics=((0, 1, 4),))
    parts = batches(tracks, np.full(len(tracks.pixels), 0.3), n_images, 0)
    directions = rng.standard_normal((layout.dim, 4))
    region = rng.integers(0, 3, len(tracks.points_world))
    products, gradients = by_regions(parts, start_of(scene), layout, directions, region)
    wanted = eliminate(parts, start_of(scene), layout).quadratic
    scale = np.abs(wanted.hessian @ directions).max()
    np.testing.assert_allclose(products.sum(axis=0), wanted.hessian @ directions, atol=1e-9 * scale)
    np.testing.assert_allclose(
        gradients.sum(axis=0), wanted.gradient, atol=1e-9 * np.abs(wanted.gradient).max()
    )
    # One region alone is what its own points say.
    alone = np.flatnonzero(region[tracks.point_index] == 1)
    points, index = np.unique(tracks.point_index[alone], return_inverse=True)
    own = replace(
        tracks,
        points_world=tracks.points_world[points],
        image_index=tracks.image_index[alone],
        point_index=index,
        pixels=tracks.pixels[alone],
    )
    state = replace(start_of(scene), points_world=start_of(scene).points_world[points])
    theirs = eliminate(batches(own, np.full(len(alone), 0.3), n_images, 0), state, layout).quadratic
    np.testing.assert_allclose(products[1], theirs.hessian @ directions, atol=1e-9 * scale)


@pytest.mark.simulation
def test_independent_errors_keep_their_covariance():
    factors = np.array([factor(scene_at_truth(seed)) for seed in range(12)])
    # The factor is 1 on average before it is cut off there, with a deviation of about 0.2.
    assert factors.mean() < 1.15
    assert 3 <= np.sum(factors == 1.0) <= 11


def test_a_scene_of_few_points_says_nothing():
    assert factor(with_alike_errors(scene_at_truth(3, n_points=100), 3)) == 1.0


@pytest.mark.slow
@pytest.mark.simulation
def test_alike_errors_are_found_and_counted():
    draws = []
    for seed in range(RUNS):
        scene = with_alike_errors(scene_at_truth(seed), seed + 1000)
        result = refined(scene)
        draws.append((nees(scene, result), result.noise.image_inflation))
    honest, factors = np.array(draws).T
    assert np.median(factors) > 1.7
    # Taken as independent, the errors are several times larger than their covariance; most of it, though
    # not all, is seen: the camera poses take up what is smooth over the whole image.
    as_independent = np.mean(honest * factors)
    assert as_independent > 2.0 * 6.0
    assert np.mean(honest) < 0.6 * as_independent
    assert np.mean(honest) < 2.0 * 6.0
