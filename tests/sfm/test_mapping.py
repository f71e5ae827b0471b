"""Mapping from a synthetic database: no image is opened."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest

from handeye_fg.progress import silent
from handeye_fg.sfm.mapping import Rung, largest, map_images, n_registered
from handeye_fg.sfm.matching import matching_summary
from handeye_fg.sfm.model import to_sfm_model
from handeye_fg.sfm.self_calibration import with_centre
from handeye_fg.types import CameraModel

PARAMS = [800.0, 800.0, 512.0, 384.0, -0.06, 0.03, 0.0, 0.0]
STRICT = Rung(relaxed=False, refine=False)


def camera(focal: float = 800.0) -> CameraModel:
    params = np.array([focal, focal, *PARAMS[2:]])
    return CameraModel(model="OPENCV", width=1024, height=768, params=params)


@pytest.fixture
def database(tmp_path: Path) -> Path:
    return synthetic(tmp_path, "OPENCV", PARAMS)


def synthetic(folder: Path, model: str, params: list[float]) -> Path:
    pycolmap.set_random_seed(1)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = 6, 300
    options.camera_model_id = pycolmap.CameraModelId.__members__[model]
    options.camera_width, options.camera_height = 1024, 768
    options.camera_params = params
    options.camera_has_prior_focal_length = True
    path = folder / "database.db"
    with pycolmap.Database.open(path) as db:
        pycolmap.synthesize_dataset(options, db)
    return path


def place(
    database: Path, rung: Rung, file_camera: CameraModel | None = None, progress=silent, **options
) -> pycolmap.Reconstruction | None:
    models = map_images(
        database,
        database.parent,
        rung,
        n_images=6,
        file_cameras=None if file_camera is None else {".": file_camera},
        seed=0,
        progress=progress,
        **options,
    )
    return next(iter(models), None)


@pytest.mark.parametrize("relaxed", [False, True])
def test_fixed_intrinsics_stay_as_they_are(database: Path, relaxed: bool) -> None:
    told: list[tuple[str, int, int | None]] = []
    rung = Rung(relaxed=relaxed, refine=False)
    found = place(database, rung, camera(), lambda *report: told.append(report))
    assert found is not None
    model = to_sfm_model(found)
    assert len(model.names) == 6
    np.testing.assert_array_equal(model.camera.params, PARAMS)
    assert model.mean_reprojection_px < 1e-3
    assert {stage for stage, _, _ in told} == {"registered"}
    assert told[-1] == ("registered", 6, 6)
    assert [path.name for path in database.parent.iterdir()] == ["database.db"]


def test_a_model_of_some_images_is_continued(
    database: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pycolmap.Database.open(database) as db:
        names = [image.name for image in db.read_all_images()][:3]
    some = place(database, STRICT, camera(), names=names)
    assert n_registered(some) == 3
    real, continued = pycolmap.incremental_mapping, []

    def spied(*arguments, input_path, **others) -> dict[int, pycolmap.Reconstruction]:
        continued.extend(to_sfm_model(pycolmap.Reconstruction(input_path)).names)
        return dict(real(*arguments, input_path=input_path, **others))

    monkeypatch.setattr(pycolmap, "incremental_mapping", spied)
    counted: list[int] = []
    found = place(database, STRICT, camera(), lambda _, done, __: counted.append(done), begun=some)
    assert continued == sorted(names)
    assert n_registered(found) == 6
    assert min(counted) >= 3


def test_a_focal_length_far_from_the_files_is_refused(database: Path) -> None:
    refine = Rung(relaxed=False, refine=True)
    assert n_registered(place(database, refine, camera(800.0))) == 6
    assert place(database, refine, camera(500.0)) is None


def test_the_principal_point_is_found_where_the_mapper_kept_a_wrong_one(database: Path) -> None:
    with pycolmap.Database.open(database) as db:
        (native,) = db.read_all_cameras()
        native.params = [800.0, 800.0, 520.0, 380.0, 0.0, 0.0, 0.0, 0.0]
        db.update_camera(native)
    kept = place(database, Rung(relaxed=False, refine=True))
    assert kept is not None
    before = kept.cameras[1].params
    np.testing.assert_array_equal(before[2:4], [520.0, 380.0])
    # Observations without noise: what remains is where the adjustment stopped.
    np.testing.assert_allclose(with_centre(kept).cameras[1].params, PARAMS, atol=0.05)
    np.testing.assert_array_equal(kept.cameras[1].params, before)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("PINHOLE", [800.0, 805.0, 515.0, 380.0]),
        ("SIMPLE_RADIAL", [800.0, 515.0, 380.0, -0.06]),
        ("RADIAL", [800.0, 515.0, 380.0, -0.06, 0.03]),
        ("OPENCV_FISHEYE", [600.0, 605.0, 515.0, 380.0, 0.02, -0.01, 0.004, 0.0]),
    ],
)
def test_a_camera_is_refined_in_its_own_model(
    tmp_path: Path, model: str, params: list[float]
) -> None:
    found, truth = place(synthetic(tmp_path, model, params), STRICT), np.array(params)
    assert found is not None
    found.cameras[1].params = np.where(truth > 1.0, 1.01 * truth, 0.0)
    found.update_point_3d_errors()
    before, after = to_sfm_model(found), to_sfm_model(with_centre(found))
    assert after.camera.model == model
    # Observations without noise: what remains is where the adjustment stopped.
    assert after.mean_reprojection_px < 0.05
    assert before.mean_reprojection_px > 1.0


def test_the_larger_model_is_kept(database: Path) -> None:
    found = place(database, STRICT)
    assert largest(None, found) is found
    assert largest(found, None) is found
    assert n_registered(None) == 0


def test_the_summary_counts_features_and_inliers(database: Path) -> None:
    summary = matching_summary(database)
    assert len(summary) == 6
    assert all(features >= inliers > 15 for features, inliers in summary.values())
