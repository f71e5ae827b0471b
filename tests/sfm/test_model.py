"""The seam: COLMAP's reconstruction against our own chain of transforms."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from colmap_models import PARAMS, synthetic
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.frames import inverse
from handeye_fg.sfm import read_model
from handeye_fg.sfm.ladder import _thin
from handeye_fg.sfm.model import _distinct
from handeye_fg.types import Tracks


def named_by_folder(reconstruction: pycolmap.Reconstruction, n_cameras: int) -> None:
    """Each camera's images in a folder of their own."""
    for image in reconstruction.images.values():
        image.name = f"cam{n_cameras - image.camera_id}/{image.name}"


def test_cameras_are_in_the_order_of_their_folders() -> None:
    reconstruction = synthetic(n_cameras=2)
    reconstruction.cameras[1].params = [1.01 * p for p in PARAMS]
    named_by_folder(reconstruction, 2)
    model = read_model(reconstruction)
    assert model.image_camera.tolist() == [0, 0, 0, 1, 1, 1]
    assert [name[:4] for name in model.names] == ["cam0"] * 3 + ["cam1"] * 3
    np.testing.assert_array_equal(model.cameras[0].params, PARAMS)
    np.testing.assert_allclose(model.cameras[1].params, 1.01 * np.array(PARAMS))


def test_our_chain_projects_to_colmaps_pixels() -> None:
    reconstruction = synthetic()
    model = read_model(reconstruction)
    fx, fy, cx, cy, k1, k2, p1, p2 = model.camera.params
    tracks = model.tracks
    camera_T_world = inverse(model.world_T_camera)[tracks.image_index]
    points = tracks.points_world[tracks.point_index]
    local = (camera_T_world[:, :3, :3] @ points[:, :, None])[:, :, 0] + camera_T_world[:, :3, 3]
    x, y = (local[:, :2] / local[:, 2:]).T
    s = x * x + y * y
    radial = 1 + k1 * s + k2 * s * s
    u = x * radial + 2 * p1 * x * y + p2 * (s + 2 * x * x)
    v = y * radial + p1 * (s + 2 * y * y) + 2 * p2 * x * y
    ours = np.stack([u, v], axis=1) * [fx, fy] + [cx, cy]
    by_name = {image.name: image for image in reconstruction.images.values()}
    for i, name in enumerate(model.names):
        for k in np.flatnonzero(tracks.image_index == i):
            theirs = by_name[name].project_point(tracks.points_world[tracks.point_index[k]])
            assert np.abs(ours[k] - theirs).max() < 1e-9
    # Synthetic observations are exact.
    assert np.abs(ours - tracks.pixels).max() < 1e-6
    assert model.mean_reprojection_px < 1e-6
    assert len(tracks.pixels) == reconstruction.compute_num_observations()
    assert model.unregistered == ()


def test_names_are_in_order_whatever_the_ids_are() -> None:
    model = read_model(synthetic())
    assert list(model.names) == sorted(model.names)
    assert model.world_T_camera.shape == (6, 4, 4)


def test_a_folder_reads_as_the_reconstruction(tmp_path: Path) -> None:
    reconstruction = synthetic()
    reconstruction.write_text(tmp_path)
    from_text, direct = read_model(str(tmp_path)), read_model(reconstruction)
    np.testing.assert_allclose(from_text.world_T_camera, direct.world_T_camera, atol=1e-12)
    np.testing.assert_allclose(from_text.tracks.pixels, direct.tracks.pixels, atol=1e-9)
    assert from_text.names == direct.names


def test_the_mean_error_is_that_of_the_observations() -> None:
    reconstruction = synthetic()
    image = reconstruction.images[min(reconstruction.reg_image_ids())]
    point2D = next(p for p in image.points2D if p.has_point3D())
    point2D.xy = point2D.xy + np.array([3.0, 4.0])
    model = read_model(reconstruction)
    expected = 5.0 / len(model.tracks.pixels)
    assert model.mean_reprojection_px == pytest.approx(expected, rel=1e-3)


def test_models_that_cannot_serve_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="no such folder"):
        read_model(tmp_path / "missing")
    with pytest.raises(InputDataError, match="cannot be read"):
        read_model(tmp_path)
    with pytest.raises(InputDataError, match="has 2 cameras"):
        read_model(synthetic(n_cameras=2))
    with pytest.raises(ReconstructionError, match="placed 2 of 2 images, but at least 3"):
        read_model(synthetic(n_images=2))
    bare = synthetic()
    bare.delete_all_points2D_and_points3D()
    with pytest.raises(ReconstructionError, match="no points"):
        read_model(bare)


def test_a_keypoint_that_is_listed_twice_counts_once():
    """SIFT lists a keypoint of two orientations twice; the longer track keeps it."""
    tracks = Tracks(
        points_world=np.zeros((2, 3)),
        image_index=np.array([0, 0, 1, 1, 2]),
        point_index=np.array([0, 1, 0, 1, 1]),
        pixels=np.array([[5.0, 6.0], [5.0, 6.0], [7.0, 8.0], [7.5, 8.0], [1.0, 2.0]]),
    )
    distinct = _distinct(tracks)
    assert distinct.image_index.tolist() == [0, 1, 1, 2]
    assert distinct.point_index.tolist() == [1, 0, 1, 1]
    assert distinct.pixels[0].tolist() == [5.0, 6.0]


def test_a_model_that_few_points_hold_is_thin():
    assert _thin(None)
    assert _thin(synthetic())  # 60 points
    assert not _thin(synthetic(n_points=400))
