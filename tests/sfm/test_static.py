"""Features that do not move while the robot turns."""

from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from handeye_fg.sfm.static import drop_static, static_features
from handeye_fg.turns import RobotTurns

N_IMAGES, N_STATIC, N_MOVING = 8, 400, 600


def turns(step_deg: float) -> RobotTurns:
    angles = np.deg2rad(step_deg) * np.arange(N_IMAGES)
    rotations = Rotation.from_rotvec(angles[:, None] * [0.0, 0.6, 0.8]).as_matrix()
    return RobotTurns(rotations=rotations, setup="eye-to-hand")


def descriptors(rng: np.random.Generator, n: int) -> np.ndarray:
    """Of SIFT's length; those of different features are about 500 apart."""
    raw = rng.exponential(size=(n, 128))
    return 512.0 * raw / np.linalg.norm(raw, axis=1, keepdims=True)


def seen_again(rng: np.random.Generator, features: np.ndarray) -> np.ndarray:
    return np.clip(features + rng.normal(size=features.shape, scale=8.0), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def features() -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The static ones first; they are found again to half a pixel, the moving ones anywhere."""
    rng = np.random.default_rng(0)
    size = np.array([960.0, 720.0])
    fixed = rng.uniform(0, 1, (N_STATIC, 2)) * size
    of_static, of_moving = descriptors(rng, N_STATIC), descriptors(rng, N_MOVING)
    places, looks = [], []
    for _ in range(N_IMAGES):
        moving = rng.uniform(0, 1, (N_MOVING, 2)) * size
        places.append(np.vstack([fixed + 0.3 * rng.normal(size=fixed.shape), moving]))
        looks.append(np.vstack([seen_again(rng, of_static), seen_again(rng, of_moving)]))
    return places, looks


def test_static_features_are_found_and_moving_ones_kept(features: tuple) -> None:
    places, looks = features
    found = static_features(places, looks, turns(20.0))
    for which in found:
        assert which[:N_STATIC].mean() > 0.97
        assert which[N_STATIC:].sum() <= 3


def test_while_the_robot_hardly_turns_nothing_is_static(features: tuple) -> None:
    places, looks = features
    found = static_features(places, looks, turns(1.0))
    assert not any(which.any() for which in found)


def test_they_are_taken_out_of_the_database(features: tuple, tmp_path: Path) -> None:
    places, looks = features
    database = tmp_path / "features.db"
    with pycolmap.Database.open(database) as db:
        camera = pycolmap.Camera(
            model="PINHOLE", width=960, height=720, params=[1e3, 1e3, 480, 360]
        )
        camera.camera_id = db.write_camera(camera)
        for k, (place, look) in enumerate(zip(places, looks, strict=True)):
            image = pycolmap.Image(name=f"{k}.jpg", camera_id=camera.camera_id)
            number = db.write_image(image)
            db.write_keypoints(
                number, np.hstack([place, np.ones((len(place), 4))]).astype(np.float32)
            )
            db.write_descriptors(
                number, pycolmap.FeatureDescriptors(pycolmap.FeatureExtractorType.SIFT, look)
            )
    share = drop_static(database, turns(20.0))
    assert share == pytest.approx(N_STATIC / (N_STATIC + N_MOVING), abs=0.01)
    with pycolmap.Database.open(database) as db:
        for number in range(1, N_IMAGES + 1):
            kept, look = db.read_keypoints(number), db.read_descriptors(number)
            assert kept.shape == (len(look.data), 6)
            moving = {tuple(row) for row in places[number - 1][N_STATIC:].astype(np.float32)}
            inside = [tuple(row) in moving for row in kept[:, :2]]
            assert np.mean(inside) > 0.97
    assert drop_static(database, turns(20.0)) < 0.01


def test_a_texture_that_repeats_is_not_static() -> None:
    """A twentieth of the features that lie at one pixel by chance are alike."""
    rng = np.random.default_rng(1)
    of_circle = descriptors(rng, 20)
    places, looks = [], []
    for _ in range(N_IMAGES):
        places.append(rng.uniform(0, 1, (6000, 2)) * [640.0, 480.0])
        looks.append(seen_again(rng, of_circle[rng.integers(0, 20, 6000)]))
    found = static_features(places, looks, turns(20.0))
    assert np.mean(np.concatenate(found)) < 2e-3
