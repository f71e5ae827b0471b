from pathlib import Path

import numpy as np
import pytest

from handeye_fg import InputDataError
from handeye_fg.sfm import read_model, write_model
from handeye_fg.simulate import simulate_rig, simulate_scene
from handeye_fg.types import SfmModel


@pytest.mark.parametrize("n_cameras", [1, 2])
def test_a_model_is_read_as_it_was_written(tmp_path: Path, n_cameras: int) -> None:
    rng = np.random.default_rng(0)
    model = simulate_rig(rng, n_cameras=n_cameras, n_poses=5, n_points=40).scene.model
    write_model(model, tmp_path / "a" / "model")
    read = read_model(tmp_path / "a" / "model")
    assert read.names == tuple(sorted(model.names))
    order = [model.names.index(name) for name in read.names]
    np.testing.assert_allclose(read.world_T_camera, model.world_T_camera[order], atol=1e-12)
    assert len(read.cameras) == n_cameras
    for camera, written in zip(read.cameras, model.cameras, strict=True):
        np.testing.assert_array_equal(camera.params, written.params)
        assert (camera.model, camera.width, camera.height) == (
            written.model,
            written.width,
            written.height,
        )
    np.testing.assert_array_equal(read.tracks.points_world, model.tracks.points_world)
    assert seen(read) == seen(model)
    assert read.mean_reprojection_px == pytest.approx(model.mean_reprojection_px, rel=1e-6)


def seen(model: SfmModel) -> set[tuple[str, int, float, float]]:
    tracks = model.tracks
    names = [model.names[i] for i in tracks.image_index]
    columns = (tracks.point_index.tolist(), *tracks.pixels.T.tolist())
    return set(zip(names, *columns, strict=True))


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    model = simulate_scene(np.random.default_rng(0), n_images=3, n_points=20).model
    with pytest.raises(InputDataError, match="cannot be written"):
        write_model(model, tmp_path / "file")
