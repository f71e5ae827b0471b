"""Images that share no points with the others: only the robot joins them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.simulate import simulate_scene

N_IMAGES, N_APART = 12, 3


def scene_in_parts(seed):
    """The last images see points of their own."""
    scene = simulate_scene(
        np.random.default_rng(seed), n_images=N_IMAGES, n_points=80, start_sigma=1e-4
    )
    tracks, n = scene.model.tracks, len(scene.model.tracks.points_world)
    apart = tracks.image_index >= N_IMAGES - N_APART
    point_index = tracks.point_index + n * apart
    # A point that is seen once is none.
    seen = np.bincount(point_index, minlength=2 * n)
    kept = seen[point_index] >= 2
    used, point_index = np.unique(point_index[kept], return_inverse=True)
    parts = replace(
        tracks,
        points_world=np.concatenate([tracks.points_world] * 2)[used],
        image_index=tracks.image_index[kept],
        point_index=point_index,
        pixels=tracks.pixels[kept],
    )
    return scene, replace(scene.model, tracks=parts)


@pytest.mark.simulation
def test_the_covariance_is_that_of_the_errors(refined):
    nees = []
    for seed in range(20):
        scene, model = scene_in_parts(seed)
        result = refined(scene, model=model)
        error = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
        nees.append(error @ np.linalg.solve(result.observability.covariance, error))
    # The estimated sigmas spread the sum a little more than chi-square.
    assert stats.chi2.ppf(0.0005, 120) / 1.1 < np.sum(nees) < 1.1 * stats.chi2.ppf(0.9995, 120)


def test_a_wrong_pose_among_them_does_not_break_the_others(refined):
    """Without its robot pose, the scale of what such an image sees is not determined."""
    scene, model = scene_in_parts(1)
    reported = scene.robot_poses.base_T_gripper.copy()
    reported[-1] = reported[-1] @ frames.exp(np.array([0.5, -0.4, 0.3, 0.1, 0.1, -0.1]))
    result = refined(scene, model=model, reported=reported)
    assert result.outliers[-N_APART:].any()
    assert not result.outliers[: N_IMAGES - N_APART].any()
    error = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    assert error @ np.linalg.solve(result.observability.covariance, error) < 22.5
