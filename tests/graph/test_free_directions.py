"""Motions that leave something free, and priors, in the joint refinement."""

import gtsam
import numpy as np
import pytest

from factors.testing import assert_jacobians_match, taylor_slope
from handeye_fg import frames
from handeye_fg.graph import measurements as m
from handeye_fg.graph import start_state
from handeye_fg.graph.variables import GRIPPER_T_CAMERA
from handeye_fg.observability import LIMITS
from handeye_fg.priors import Prior
from handeye_fg.simulate import simulate_scene
from handeye_fg.solvers import linear_start
from refinements import refined_from


def scene_of(motion, seed=0):
    return simulate_scene(np.random.default_rng(seed), n_images=10, n_points=80, motion=motion)


def fit(scene, priors=()):
    linear = linear_start(
        scene.robot_poses.base_T_gripper, scene.model.world_T_camera, priors=priors
    )
    start = start_state(scene.model, [scene.camera], linear)
    reported = scene.robot_poses.base_T_gripper
    return linear, refined_from(start, scene.model, reported, priors=priors)


def nees(result, scene):
    error = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    values, vectors = np.linalg.eigh(result.observability.covariance)
    kept = values > 1e-9 * values[-1]
    return float(np.sum((vectors[:, kept].T @ error) ** 2 / values[kept])), int(kept.sum())


@pytest.mark.parametrize(
    ("motion", "kinds", "dims"),
    [
        ("one_axis", ["translation"], 5),
        ("pure_translation", ["translation"] * 3, 3),
        ("pure_rotation", ["scale"], 5),
    ],
)
def test_the_determined_part_is_found_and_the_rest_stays(motion, kinds, dims):
    scene = scene_of(motion)
    linear, result = fit(scene)
    directions = result.observability.free_directions
    assert [direction.kind for direction in directions] == kinds
    square, rank = nees(result, scene)
    assert rank == dims
    assert square < 3.0 * dims  # one draw
    assert np.isfinite(result.metres_per_world_unit_std) == (kinds != ["scale"])
    X, start = result.state.gripper_T_camera, linear.gripper_T_camera
    for direction in directions:
        moved = direction.vector @ (X[:3, 3] - start[:3, 3])
        assert abs(moved) < 1e-3
    if motion == "pure_translation":
        np.testing.assert_allclose(X[:3, 3], 0.0, atol=1e-3)
    if motion == "pure_rotation":
        offset, truth = X[:3, 3], scene.gripper_T_camera[:3, 3]
        cosine = offset @ truth / np.linalg.norm(offset) / np.linalg.norm(truth)
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 1.0


def test_a_prior_completes_a_scara():
    scene = scene_of("one_axis")
    (free,) = fit(scene)[1].observability.free_directions
    value = float(free.vector @ scene.gripper_T_camera[:3, 3])
    prior = Prior("translation-along", tuple(free.vector), value, 0.001)
    _, result = fit(scene, (prior,))
    assert result.observability.free_directions == ()
    square, rank = nees(result, scene)
    assert rank == 6
    assert square < 20.0
    X = result.state.gripper_T_camera
    assert free.vector @ X[:3, 3] == pytest.approx(value, abs=2e-4)
    axis = np.concatenate([np.zeros(3), X[:3, :3].T @ free.vector])
    std = np.sqrt(axis @ result.observability.covariance @ axis)
    assert std == pytest.approx(0.001, rel=0.1)  # and the t distribution's inflation


@pytest.mark.parametrize("which", ["prior", "held"])
def test_derivatives(which):
    X = frames.exp(np.array([0.3, -0.2, 0.5, 0.1, 0.2, 0.3]))
    if which == "prior":
        graph = m.known_graph([Prior("translation-along", (0.0, 0.6, 0.8), 0.08, 0.001)])
    else:
        basis = np.linalg.qr(np.random.default_rng(0).standard_normal((6, 2)))[0]
        graph = m.held_graph(X, basis)
    factor = graph.at(0)
    moved = X @ frames.exp(0.1 * np.array([0.5, -0.4, 0.3, 0.2, 0.6, -0.1]))
    values = gtsam.Values()
    values.insert(GRIPPER_T_CAMERA, gtsam.Pose3(moved))
    assert_jacobians_match(factor, values, [6])
    direction = np.array([0.3, 0.2, 0.1, 0.5, 0.3, 0.2])
    assert taylor_slope(factor, values, [6], direction) == pytest.approx(2.0, abs=0.1)


def test_a_prior_is_the_whitened_difference_along_its_axis():
    prior = Prior("translation-along", (0.0, 3.0, 4.0), 0.08, 0.001)
    values = gtsam.Values()
    values.insert(GRIPPER_T_CAMERA, gtsam.Pose3(gtsam.Rot3(), np.array([0.1, 0.2, 0.3])))
    for unit in (1.0, 2.0):
        error = m.known_graph([prior], unit).at(0).whitenedError(values)
        expected = (0.6 * 0.2 + 0.8 * 0.3 - 0.08) / (unit * 0.001)
        np.testing.assert_allclose(error, [expected, 0.0, 0.0])


def test_only_free_directions_are_held():
    basis = np.eye(6)[:, 5:]
    values = gtsam.Values()
    offset = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.0])
    values.insert(GRIPPER_T_CAMERA, gtsam.Pose3(frames.exp(offset)))
    free = frames.log(frames.exp(offset))[5]
    error = m.held_graph(np.eye(4), basis).at(0).whitenedError(values)
    np.testing.assert_allclose(np.linalg.norm(error), abs(free) / LIMITS[5] / 0.01, atol=1e-9)
