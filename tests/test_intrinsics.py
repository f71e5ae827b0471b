"""The distortion models against pycolmap, which projects with its own code."""

import numpy as np
import pycolmap
import pytest

from example_cameras import PARAMS, PINHOLE, camera_of
from handeye_fg.errors import InputDataError
from handeye_fg.intrinsics import (
    covers_image,
    fitted_opencv,
    invertible_radius,
    pinhole_view,
)
from handeye_fg.types import CameraModel

CONTAINED = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
MODELS = (*CONTAINED, "FULL_OPENCV", "OPENCV_FISHEYE")


def doosan() -> CameraModel:
    """A real file with k3, which folds within the image."""
    params = (898.29, 901.07, 649.87, 363.03, 0.0119, 0.7232, 3.6e-4, -3.8e-4, -2.467, 0, 0, 0)
    return CameraModel(model="FULL_OPENCV", width=1280, height=720, params=np.array(params))


def project(model: CameraModel, rays: np.ndarray) -> np.ndarray:
    native = pycolmap.Camera(
        model=model.model, width=model.width, height=model.height, params=list(model.params)
    )
    return native.img_from_cam(np.column_stack([rays, np.ones(len(rays))]))


def pixels(n: int = 400, margin: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.uniform([-margin, -margin], [960 + margin, 720 + margin], (n, 2))


@pytest.mark.parametrize("model", MODELS)
def test_the_pinhole_view_projects_back_to_the_observations(model: str) -> None:
    observed = pixels()
    view, moved, scale = pinhole_view(camera_of(model), observed)
    rays = (moved - view.params[2:]) / view.params[:2]
    # pycolmap's projection is the independent one; 1e-9 px is the promise.
    assert np.abs(project(camera_of(model), rays) - observed).max() < 2e-9
    assert view.model == "PINHOLE"
    assert scale.shape == (len(observed),)


@pytest.mark.parametrize("model", MODELS)
def test_the_noise_grows_by_the_root_of_the_area(model: str) -> None:
    observed = pixels(50)
    _, _, scale = pinhole_view(camera_of(model), observed)
    h = 1e-4
    columns = []
    for axis in np.eye(2):
        _, ahead, _ = pinhole_view(camera_of(model), observed + h * axis)
        _, behind, _ = pinhole_view(camera_of(model), observed - h * axis)
        columns.append((ahead - behind) / (2 * h))
    area = np.linalg.det(np.stack(columns, axis=2))
    # Central differences with this step: the truncation is far below, rounding 1e-9 / h = 1e-5.
    np.testing.assert_allclose(scale, np.sqrt(np.abs(area)), rtol=1e-4)


@pytest.mark.parametrize("dropped", [8, 9, 10, 11])
def test_every_coefficient_of_the_full_model_counts(dropped: int) -> None:
    observed = pixels()
    params = list(PARAMS["FULL_OPENCV"])
    _, whole, _ = pinhole_view(camera_of("FULL_OPENCV"), observed)
    params[dropped] = 0.0
    _, without, _ = pinhole_view(camera_of("FULL_OPENCV", tuple(params)), observed)
    # k6 is small here; the others move corners by many pixels.
    assert np.abs(whole - without).max() > 1.0


@pytest.mark.parametrize("model", CONTAINED)
def test_models_within_opencv_convert_exactly(model: str) -> None:
    opencv, misfit_px = fitted_opencv(camera_of(model))
    rays = (pixels() - [483, 352]) / 820
    assert misfit_px == 0.0
    np.testing.assert_allclose(project(opencv, rays), project(camera_of(model), rays), atol=1e-9)


def test_a_full_model_is_fitted_where_its_image_is() -> None:
    opencv, misfit_px = fitted_opencv(camera_of("FULL_OPENCV"))
    rays = (pinhole_view(camera_of("FULL_OPENCV"), pixels())[1] - PINHOLE[2:]) / PINHOLE[:2]
    difference = project(opencv, rays) - project(camera_of("FULL_OPENCV"), rays)
    rms = np.sqrt((difference**2).sum(axis=1).mean())
    assert 0 < misfit_px < 2.0
    # The grid has more of its pixels on the border than the uniform sample.
    assert rms == pytest.approx(misfit_px, rel=0.5)
    exact = camera_of("FULL_OPENCV", (*PARAMS["OPENCV"], 0, 0, 0, 0))
    np.testing.assert_allclose(fitted_opencv(exact)[0].params, PARAMS["OPENCV"], atol=1e-6)


def test_a_fold_is_found_where_the_projection_turns_back() -> None:
    fold = invertible_radius(doosan())
    radii = np.linspace(0, 1, 20001)
    k1, k2, k3 = 0.0119, 0.7232, -2.467
    bent = radii * (1 + k1 * radii**2 + k2 * radii**4 + k3 * radii**6)
    assert fold == pytest.approx(radii[np.argmax(bent)], abs=1e-4)
    assert bent.max() == pytest.approx(0.622, abs=2e-3)
    assert not covers_image(doosan())
    for model in MODELS:
        assert covers_image(camera_of(model)), model


def test_the_folded_file_gets_a_usable_opencv_start() -> None:
    opencv, misfit_px = fitted_opencv(doosan())
    assert covers_image(opencv)
    assert misfit_px < 1.0
    assert opencv.params[0] == pytest.approx(898.29, rel=0.02)


def test_a_pole_and_an_unending_rise_are_told_apart() -> None:
    pole = (*PINHOLE, 0, 0, 0, 0, 0, -1.0, 0, 0)
    assert invertible_radius(camera_of("FULL_OPENCV", pole)) == pytest.approx(1.0)
    assert invertible_radius(camera_of("PINHOLE")) == np.inf
    barrel = (*PINHOLE, -1.0, 0.0, 0.0, 0.0)
    assert invertible_radius(camera_of("OPENCV", barrel)) == pytest.approx(np.sqrt(1 / 3))
    fisheye = (*PINHOLE, -0.5, 0, 0, 0)
    assert invertible_radius(camera_of("OPENCV_FISHEYE", fisheye)) == pytest.approx(
        np.tan(np.sqrt(1 / 1.5))
    )


def test_what_cannot_be_done_is_refused() -> None:
    with pytest.raises(InputDataError, match="cannot be inverted at 1 of 2"):
        pinhole_view(doosan(), np.array([[650.0, 360.0], [2.0, 2.0]]))
    with pytest.raises(InputDataError, match="one is for fisheye lenses"):
        fitted_opencv(camera_of("OPENCV_FISHEYE"))
    wide = (300.0, 300.0, 480.0, 360.0, 0.0, 0.0, 0.0, 0.0)
    with pytest.raises(InputDataError, match="80 degrees off"):
        pinhole_view(camera_of("OPENCV_FISHEYE", wide), np.array([[480.0 + 300 * 1.45, 360.0]]))
