"""The model in metres: written, and read back by COLMAP and by the calibration itself."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

import handeye_fg as hf
from colmap_models import synthetic
from example_results import make_result
from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result
from handeye_fg.sfm import read_model, write_metric
from handeye_fg.types import CameraModel

Z = frames.exp(np.array([0.4, -0.3, 2.0, 0.5, -0.2, 0.1]))
SCALE = 0.073


def placed(model: pycolmap.Reconstruction) -> dict[str, Array]:
    """Where the base has the cameras of a model."""
    read = read_model(model)
    poses = Z @ frames.scaled(read.world_T_camera, SCALE)
    return dict(zip(read.names, poses, strict=True))


def result_of(model: pycolmap.Reconstruction, setup: str = "eye-in-hand") -> Result:
    key = "base_T_camera" if setup == "eye-in-hand" else "gripper_T_camera"
    images = [
        ImageReport(name=name, registered=True, **{key: matrix})
        for name, matrix in placed(model).items()
    ]
    return make_result(setup=setup, images=tuple(images), camera=read_model(model).camera)


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_a_model_in_metres_in_the_frame_of_the_robot(tmp_path: Path, setup: str) -> None:
    source = synthetic()
    (tmp_path / "sfm").mkdir()
    source.write(tmp_path / "sfm")
    said = hf.export(
        result_of(source, setup), "colmap", tmp_path / "colmap", model=tmp_path / "sfm"
    )
    frame = "base" if setup == "eye-in-hand" else "gripper"
    assert f"p_{frame} = inverse(cam_from_world) p_camera" in said
    assert (tmp_path / "colmap" / "README.txt").read_text().strip() == said
    written = pycolmap.Reconstruction(tmp_path / "colmap")
    assert written.is_valid()
    poses = placed(source)
    assert {image.name for image in written.images.values()} == set(poses)
    for image in written.images.values():
        camera_T_a = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        np.testing.assert_allclose(camera_T_a @ poses[image.name], np.eye(4), atol=1e-9)
        assert image.camera.params.tolist() == read_model(source).camera.params.tolist()
    assert written.num_points3D() == source.num_points3D()
    assert written.compute_num_observations() == source.compute_num_observations()
    assert written.compute_mean_reprojection_error() < 1e-5
    # The points as well are those of the world, carried over.
    expected = np.array([p.xyz for p in source.points3D.values()]) * SCALE @ Z[:3, :3].T + Z[:3, 3]
    found = np.array([p.xyz for p in written.points3D.values()])
    np.testing.assert_allclose(
        found[np.lexsort(found.T)], expected[np.lexsort(expected.T)], atol=1e-6
    )


def test_points_follow_the_cameras(tmp_path: Path) -> None:
    """The cameras stay, and points that do not fit them move to where they see them."""
    source = synthetic()
    poses, camera = placed(source), read_model(source).camera
    rng = np.random.default_rng(3)
    for point in source.points3D.values():
        point.xyz = point.xyz + rng.normal(0.0, 0.02, 3)
    assert read_model(source).mean_reprojection_px > 1.0
    assert write_metric(source, poses, {".": camera}, tmp_path / "colmap", "note") == ()
    written = read_model(tmp_path / "colmap")
    assert written.mean_reprojection_px < 1e-4
    np.testing.assert_allclose(
        written.world_T_camera, [poses[name] for name in written.names], atol=1e-9
    )


def test_images_that_one_side_lacks_are_left_out(tmp_path: Path) -> None:
    source = synthetic()
    poses = placed(source)
    first, *rest = sorted(poses)
    poses["board_only.jpg"] = np.eye(4)
    del poses[first]
    missing = write_metric(
        source, poses, {".": read_model(source).camera}, tmp_path / "colmap", "note"
    )
    assert missing == ("board_only.jpg",)
    written = pycolmap.Reconstruction(tmp_path / "colmap")
    assert sorted(image.name for image in written.images.values()) == rest
    with pytest.raises(
        hf.InputDataError, match="has 2 of the 2 images of the result, but at least"
    ):
        write_metric(source, dict(list(poses.items())[:2]), {}, tmp_path / "x", "")
    here = dict.fromkeys(rest, np.eye(4))
    with pytest.raises(hf.InputDataError, match="lie otherwise"):
        write_metric(source, here, {}, tmp_path / "x", "")
    assert not (tmp_path / "x").exists()


def test_only_its_own_folder_is_replaced(tmp_path: Path) -> None:
    source = synthetic()
    cameras: dict[str, CameraModel] = {".": read_model(source).camera}
    for _ in range(2):
        write_metric(source, placed(source), cameras, tmp_path / "colmap", "note")
    assert [p.name for p in tmp_path.iterdir()] == ["colmap"]
    (tmp_path / "colmap" / "thesis.tex").touch()
    with pytest.raises(
        hf.InputDataError, match="holds something else than a model of this program"
    ):
        write_metric(source, placed(source), cameras, tmp_path / "colmap", "note")
    assert (tmp_path / "colmap" / "thesis.tex").exists()
    (tmp_path / "file").touch()
    with pytest.raises(hf.InputDataError, match="something else"):
        write_metric(source, placed(source), cameras, tmp_path / "file", "note")
