"""Monte-Carlo: X of each of two cameras, and the pose of one in the other, are as certain as reported."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.graph import start_state
from handeye_fg.simulate import simulate_rig
from handeye_fg.solvers.rig import rig_start
from handeye_fg.types import Rig
from refinements import refined_from

RUNS = 60
ROTATION, TRANSLATION = np.deg2rad(0.1), 1e-3
# Each camera misses the images of other robot poses.
MISSING = frozenset({(0, 2), (0, 9), (1, 0), (1, 5)})


# The second camera's images are worse: another standard deviation of its observations.
WORSE = 2.5


def with_worse_camera(scene, rng):
    """The second camera's observations with more noise."""
    model = scene.scene.model
    tracks, sigma = model.tracks, scene.scene.noise.pixel
    added = np.where(model.image_camera[tracks.image_index] == 1, np.sqrt(WORSE**2 - 1.0), 0.0)
    noise = sigma * added[:, None] * rng.standard_normal(tracks.pixels.shape)
    tracks = replace(tracks, pixels=tracks.pixels + noise)
    return replace(scene, scene=replace(scene.scene, model=replace(model, tracks=tracks)))


def fit(scene, rig=None, model=None):
    """The refinement with noise levels found from the data; another rig names the cameras otherwise."""
    rig, model = rig or scene.rig, model or scene.scene.model
    reported = scene.robot_poses.base_T_gripper
    linear = rig_start(reported, model.world_T_camera, rig)
    return refined_from(start_state(model, model.cameras, linear, rig), model, reported)


def camera_of(result):
    return result.state.rig.camera[result.tracks.image_index]


def nees(matrix, truth, covariance):
    error = frames.log(frames.inverse(matrix) @ truth)
    return error @ np.linalg.solve(covariance, error)


def draw(seed):
    rng = np.random.default_rng(seed)
    scene = simulate_rig(
        rng,
        n_poses=12,
        n_points=50,
        robot_rotation_sigma=ROTATION,
        robot_translation_sigma=TRANSLATION,
        start_sigma=1e-4,
        missing=MISSING,
    )
    result = fit(with_worse_camera(scene, rng))
    squares = [
        nees(result.state.gripper_T_cameras[k], X, result.observabilities[k].covariance)
        for k, X in enumerate(scene.gripper_T_cameras)
    ]
    relative = nees(
        result.first_T_cameras[1],
        scene.first_T_cameras[1],
        result.first_T_camera_covariances[1],
    )
    pixel = [np.median(result.sigma_scale[camera_of(result) == k]) for k in range(2)]
    sigmas = [
        result.noise.pixel * pixel[0] / scene.scene.noise.pixel,
        result.noise.pixel * pixel[1] / scene.scene.noise.pixel / WORSE,
        result.noise.robot_rotation / ROTATION,
        result.noise.robot_translation / TRANSLATION,
    ]
    return np.array([*squares, relative]), np.array(sigmas)


@pytest.mark.slow
@pytest.mark.simulation
def test_each_x_and_the_relative_pose_are_consistent():
    draws = [draw(seed) for seed in range(RUNS)]
    # Sums of NEES: chi-square of 6 degrees of freedom a run; the robot's estimated sigmas, with 30
    # degrees of freedom each, spread those of X by some percent more.
    sums = np.sum([squares for squares, _ in draws], axis=0)
    low, high = stats.chi2.ppf([0.0005, 0.9995], 6 * RUNS)
    assert (sums > low).all()
    assert (sums < 1.05 * high).all()
    # Estimated sigmas: unbiased within 3.5 standard errors of their mean.
    ratios = np.mean([sigmas for _, sigmas in draws], axis=0)
    assert np.abs(ratios - 1.0).max() < 3.5 / np.sqrt(2 * 30 * RUNS)


def test_the_answer_does_not_depend_on_which_camera_comes_first():
    """Nor on which of them misses images: the pose of a first camera that took none is only a name."""
    scene = simulate_rig(
        np.random.default_rng(3), n_poses=10, n_points=60, start_sigma=1e-4, missing=MISSING
    )
    rig, model = scene.rig, scene.scene.model
    swapped = Rig(n_cameras=2, camera=1 - rig.camera, pose=rig.pose)
    one, other = fit(scene), fit(scene, swapped)
    np.testing.assert_allclose(
        other.state.gripper_T_cameras, one.state.gripper_T_cameras[::-1], atol=1e-7
    )
    for k in range(2):
        np.testing.assert_allclose(
            other.observabilities[k].covariance,
            one.observabilities[1 - k].covariance,
            rtol=1e-3,
            atol=1e-13,
        )
    np.testing.assert_allclose(
        other.first_T_cameras[1], frames.inverse(one.first_T_cameras[1]), atol=1e-7
    )
    # As a left perturbation of its inverse, the relative pose has the same covariance.
    np.testing.assert_allclose(
        np.trace(other.first_T_camera_covariances[1][:3, :3]),
        np.trace(one.first_T_camera_covariances[1][:3, :3]),
        rtol=1e-3,
    )
    np.testing.assert_allclose(other.base_T_camera, one.base_T_camera, atol=1e-7)
    np.testing.assert_allclose(other.residuals, one.residuals, atol=1e-7)
    assert len(model.names) == len(one.base_T_camera)


def test_two_cameras_know_more_than_one():
    scene = simulate_rig(
        np.random.default_rng(4),
        n_poses=10,
        n_points=80,
        robot_rotation_sigma=ROTATION,
        robot_translation_sigma=TRANSLATION,
        start_sigma=1e-4,
    )
    both = fit(scene)
    # The robot's noise limits X; it is common to both cameras, so that they know their own poses
    # relative to each other far better.
    relative = np.sqrt(np.diag(both.first_T_camera_covariances[1]))
    own = np.sqrt(np.diag(both.observabilities[1].covariance))
    assert (relative < 0.5 * own).all()
    assert both.first_T_camera_covariances[0].tolist() == np.zeros((6, 6)).tolist()
    assert len(both.residuals) == 10


@pytest.mark.parametrize("shared", [True, False])
def test_one_axis_leaves_one_direction_free_for_both(shared):
    """Cameras that never took images together are tied by the world that they share."""
    n = 14
    missing = frozenset() if shared else frozenset((i % 2, i) for i in range(n))
    scene = simulate_rig(
        np.random.default_rng(1), n_poses=n, n_points=150, motion="one_axis", missing=missing
    )
    result = fit(scene)
    axes = []
    for k, X in enumerate(scene.gripper_T_cameras):
        (free,) = result.observabilities[k].free_directions
        assert free.kind == "translation"
        axes.append(free.vector)
        found = result.state.gripper_T_cameras[k]
        error = frames.log(frames.inverse(found) @ X)
        covariance = result.observabilities[k].covariance
        determined = error @ np.linalg.pinv(covariance, rcond=1e-9, hermitian=True) @ error
        assert determined < stats.chi2.isf(1e-3, 5)
    assert abs(axes[0] @ axes[1]) > 0.999
    relative = nees(
        result.first_T_cameras[1], scene.first_T_cameras[1], result.first_T_camera_covariances[1]
    )
    assert relative < stats.chi2.isf(1e-3, 6)


def test_a_free_scale_leaves_the_relative_position_free():
    scene = simulate_rig(np.random.default_rng(1), n_poses=14, n_points=150, motion="pure_rotation")
    result = fit(scene)
    covariance = result.first_T_camera_covariances[1]
    values = np.linalg.eigvalsh(covariance)
    assert values[0] < 1e-15 < values[1]  # one direction is not reported
    error = frames.log(frames.inverse(result.first_T_cameras[1]) @ scene.first_T_cameras[1])
    determined = error @ np.linalg.pinv(covariance, rcond=1e-9, hermitian=True) @ error
    assert determined < stats.chi2.isf(1e-3, 5)


def test_a_wrong_robot_pose_is_left_out_for_both_cameras():
    scene = simulate_rig(np.random.default_rng(5), n_poses=14, n_points=80, start_sigma=1e-4)
    reported = np.array(scene.robot_poses.base_T_gripper)
    reported[[3, 8]] = reported[[8, 3]]
    model = scene.scene.model
    linear = rig_start(reported, model.world_T_camera, scene.rig)
    assert linear.trusted is not None
    start = start_state(model, model.cameras, linear, scene.rig)
    result = refined_from(start, model, reported, trusted=linear.trusted)
    np.testing.assert_array_equal(np.flatnonzero(result.outliers), [3, 8])
    for k, X in enumerate(scene.gripper_T_cameras):
        square = nees(result.state.gripper_T_cameras[k], X, result.observabilities[k].covariance)
        assert square < stats.f.isf(1e-3, 6, 30) * 6
