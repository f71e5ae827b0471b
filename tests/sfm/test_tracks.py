"""Reconstruction from given tracks, of a plane as well."""

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.errors import ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.sfm import from_tracks
from handeye_fg.simulate import default_camera, project, simulate_poses
from handeye_fg.solvers import linear_start


def seen(points: Array, world_T_camera: Array, noise: float) -> Array:
    """Pixels (n, p, 2) of points (p, 3) in all images."""
    camera_T_world = frames.inverse(world_T_camera)
    exact = [
        project(default_camera(), points @ pose[:3, :3].T + pose[:3, 3]) for pose in camera_T_world
    ]
    return np.array(exact) + noise * np.random.default_rng(5).standard_normal(
        (len(exact), *exact[0].shape)
    )


@pytest.mark.parametrize("planar", [True, False])
def test_poses_up_to_a_similarity(planar: bool) -> None:
    """X from the reconstruction is that from the true cameras: A X = X B knows no gauge."""
    _, _, truth = simulate_poses(np.random.default_rng(4), n_poses=10)
    rng = np.random.default_rng(7)
    base_T_camera = truth.base_T_gripper @ truth.gripper_T_camera
    # The point that all cameras look at best is the middle of the target.
    axes = base_T_camera[:, :3, 2]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    middle = np.linalg.solve(
        across.sum(axis=0), np.einsum("nij,nj->i", across, base_T_camera[:, :3, 3])
    )
    points = middle + rng.uniform(-0.1, 0.1, (50, 3)) * [1.0, 1.0, 0.0 if planar else 1.0]
    pixels = seen(points, base_T_camera, 0.05)
    n, p, _ = pixels.shape
    names = tuple(f"{i}.png" for i in range(n))
    model = from_tracks(
        names,
        np.repeat(np.arange(n), p),
        np.tile(np.arange(p), n),
        pixels.reshape(-1, 2),
        default_camera(),
    )
    assert model.names == names
    assert model.unregistered == ()
    assert len(model.tracks.points_world) >= p  # COLMAP may split a track
    start = linear_start(truth.base_T_gripper, model.world_T_camera)
    error = frames.log(frames.inverse(start.gripper_T_camera) @ truth.gripper_T_camera)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.1
    assert np.linalg.norm(error[3:]) < 2e-3


def test_an_image_with_other_points_is_left_out() -> None:
    _, _, truth = simulate_poses(np.random.default_rng(4), n_poses=6)
    base_T_camera = truth.base_T_gripper @ truth.gripper_T_camera
    points = base_T_camera[0, :3, 3] + 0.5 * base_T_camera[0, :3, 2]
    points = points + np.random.default_rng(7).uniform(-0.1, 0.1, (50, 3))
    pixels = seen(points, base_T_camera, 0.05)
    number = np.tile(np.arange(50), 6)
    number[-50:] += 1000
    names = tuple("abcdef")
    index = np.repeat(np.arange(6), 50)
    model = from_tracks(names, index, number, pixels.reshape(-1, 2), default_camera())
    assert model.names == names[:5]
    assert model.unregistered == (("f", "too few of its points could be placed"),)


def test_too_little_is_refused() -> None:
    with pytest.raises(ReconstructionError, match="placed 0 of 3 images"):
        from_tracks(
            tuple("abc"),
            np.repeat(np.arange(3), 4),
            np.tile(np.arange(4), 3),
            np.random.default_rng(1).uniform(0, 900, (12, 2)),
            default_camera(),
        )
