"""Synthetic data close exactly without noise and have the noise that they state."""

import cv2
import numpy as np
import pycolmap
import pytest
from scipy.stats import chi2

from handeye_fg.errors import InputDataError
from handeye_fg.frames import inverse, log, scaled
from handeye_fg.simulate import (
    Motion,
    Scene,
    default_camera,
    disturbed,
    project,
    simulate_poses,
    simulate_scene,
)
from handeye_fg.types import CameraModel

MOTIONS: tuple[Motion, ...] = ("general", "one_axis", "pure_translation", "pure_rotation")


def noise_free(seed: int, motion: Motion = "general") -> Scene:
    return simulate_scene(
        np.random.default_rng(seed),
        motion=motion,
        pixel_sigma=0.0,
        robot_rotation_sigma=0.0,
        robot_translation_sigma=0.0,
        start_sigma=0.0,
    )


def assert_spread(deviations: np.ndarray, sigma: float) -> None:
    """The sum of squares lies within the two-sided 99.9 % chi-square bounds."""
    squares = float(np.sum((deviations / sigma) ** 2))
    assert chi2.ppf(0.0005, deviations.size) < squares < chi2.ppf(0.9995, deviations.size)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("seed", range(3))
def test_truth_closes_exactly(motion: Motion, seed: int) -> None:
    scene = noise_free(seed, motion)
    left = scene.base_T_gripper @ scene.gripper_T_camera
    right = scene.base_T_world @ scaled(scene.world_T_camera, scene.metres_per_world_unit)
    # Some products of numbers of order one: a few times 1e-16.
    np.testing.assert_allclose(left, right, atol=1e-14)
    np.testing.assert_allclose(scene.robot_poses.base_T_gripper, scene.base_T_gripper, atol=1e-15)
    np.testing.assert_allclose(scene.model.world_T_camera, scene.world_T_camera, atol=1e-15)
    assert scene.model.mean_reprojection_px == pytest.approx(0.0, abs=1e-9)


def test_projections_at_the_truth_agree_with_opencv_and_colmap() -> None:
    scene = noise_free(4)
    tracks = scene.model.tracks
    fx, fy, cx, cy, *distortion = scene.camera.params
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    colmap_camera = pycolmap.Camera(
        model=scene.camera.model,
        width=scene.camera.width,
        height=scene.camera.height,
        params=scene.camera.params,
    )
    for i, world_T_camera in enumerate(scene.world_T_camera):
        camera_T_world = inverse(world_T_camera)
        rows = tracks.image_index == i
        points_world = scene.points_world[tracks.point_index[rows]]
        points_camera = points_world @ camera_T_world[:3, :3].T + camera_T_world[:3, 3]
        opencv, _ = cv2.projectPoints(
            points_camera, np.zeros(3), np.zeros(3), K, np.array(distortion)
        )
        np.testing.assert_allclose(tracks.pixels[rows], opencv[:, 0], atol=1e-9)
        colmap = np.array([colmap_camera.img_from_cam(point) for point in points_camera])
        np.testing.assert_allclose(tracks.pixels[rows], colmap, atol=1e-9)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_PINHOLE", [800.0, 320.5, 240.5]),
        ("PINHOLE", [800.0, 810.0, 320.5, 240.5]),
        ("SIMPLE_RADIAL", [800.0, 320.5, 240.5, -0.1]),
        ("RADIAL", [800.0, 320.5, 240.5, -0.1, 0.05]),
        ("OPENCV", [800.0, 810.0, 320.5, 240.5, -0.1, 0.05, 1e-3, -2e-3]),
    ],
)
def test_camera_models_agree_with_colmap(model: str, params: list[float]) -> None:
    camera = CameraModel(model=model, width=640, height=480, params=np.array(params))
    colmap_camera = pycolmap.Camera(model=model, width=640, height=480, params=params)
    points = np.random.default_rng(0).uniform([-0.4, -0.3, 0.9], [0.4, 0.3, 2.0], (50, 3))
    expected = np.array([colmap_camera.img_from_cam(point) for point in points])
    np.testing.assert_allclose(project(camera, points), expected, atol=1e-9)


def test_a_camera_that_cannot_be_simulated_is_named() -> None:
    camera = CameraModel(
        model="FOV",
        width=640,
        height=480,
        params=np.array([300.0, 300.0, 320.0, 240.0, 0.0, 0.0, 0.0, 0.0]),
    )
    with pytest.raises(InputDataError, match="FOV"):
        simulate_scene(np.random.default_rng(0), camera=camera)


def test_every_point_is_seen_by_two_images_and_inside_them() -> None:
    scene = simulate_scene(np.random.default_rng(5), pixel_sigma=0.0, visibility=0.2)
    tracks = scene.model.tracks
    assert np.bincount(tracks.point_index, minlength=len(scene.points_world)).min() >= 2
    assert tracks.pixels.min() >= 0.0
    assert np.all(tracks.pixels <= [scene.camera.width, scene.camera.height])


def test_pixel_noise_has_its_sigma() -> None:
    seed = 6
    exact = simulate_scene(np.random.default_rng(seed), pixel_sigma=0.0)
    noisy = simulate_scene(np.random.default_rng(seed), pixel_sigma=0.7)
    assert_spread(noisy.model.tracks.pixels - exact.model.tracks.pixels, 0.7)


def test_robot_noise_has_its_sigmas() -> None:
    scene = simulate_scene(
        np.random.default_rng(7),
        n_images=400,
        n_points=10,
        robot_rotation_sigma=0.002,
        robot_translation_sigma=0.0005,
    )
    reported = scene.robot_poses.base_T_gripper
    twists = log(inverse(scene.base_T_gripper) @ reported)
    assert_spread(twists[:, :3], 0.002)
    # The right perturbation's translation: rotated axes, same distribution.
    assert_spread(twists[:, 3:], 0.0005)
    assert_spread(reported[:, :3, 3] - scene.base_T_gripper[:, :3, 3], 0.0005)


def test_pose_noise_has_its_sigmas_in_metres() -> None:
    robot, camera, truth = simulate_poses(
        np.random.default_rng(8),
        n_poses=300,
        robot_rotation_sigma=0.001,
        robot_translation_sigma=0.002,
        camera_rotation_sigma=0.003,
        camera_translation_sigma=0.004,
    )
    robot_twists = log(inverse(truth.base_T_gripper) @ robot)
    assert_spread(robot_twists[:, :3], 0.001)
    assert_spread(robot_twists[:, 3:], 0.002)
    camera_twists = log(inverse(truth.world_T_camera) @ camera)
    assert_spread(camera_twists[:, :3], 0.003)
    assert_spread(camera_twists[:, 3:] * truth.metres_per_world_unit, 0.004)


def test_large_rotation_noise_stays_a_rotation() -> None:
    poses = disturbed(np.random.default_rng(9), np.stack([np.eye(4)] * 20), 1.0, 1.0)
    product = poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), (20, 3, 3)), atol=1e-14)


def test_same_seed_same_scene() -> None:
    first, again, other = (simulate_scene(np.random.default_rng(seed)) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.gripper_T_camera, again.gripper_T_camera)
    np.testing.assert_array_equal(first.model.tracks.pixels, again.model.tracks.pixels)
    np.testing.assert_array_equal(
        first.robot_poses.base_T_gripper, again.robot_poses.base_T_gripper
    )
    assert not np.array_equal(first.gripper_T_camera, other.gripper_T_camera)


def test_truth_is_read_only() -> None:
    scene = noise_free(0)
    with pytest.raises(ValueError, match="read-only"):
        scene.gripper_T_camera[0, 0] = 2.0


def test_motions_are_what_they_are_called() -> None:
    one_axis = noise_free(1, "one_axis").base_T_gripper
    first = one_axis[0, :3, :3]
    turns = one_axis[:, :3, :3] @ first.T
    np.testing.assert_allclose(turns[:, 2, 2], 1.0, atol=1e-12)
    shifts = noise_free(1, "pure_translation").base_T_gripper
    np.testing.assert_allclose(shifts[:, :3, :3], np.broadcast_to(shifts[0, :3, :3], (15, 3, 3)))
    rests = noise_free(1, "pure_rotation").base_T_gripper[:, :3, 3]
    np.testing.assert_allclose(rests, np.broadcast_to(rests[0], (15, 3)), atol=1e-14)


def test_a_scene_out_of_sight_is_refused() -> None:
    with pytest.raises(ValueError, match="no point is seen"):
        simulate_scene(np.random.default_rng(0), camera=default_camera(), visibility=0.0)
