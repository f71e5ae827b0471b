"""Camera models against GTSAM's and COLMAP's own code, which are two."""

import gtsam
import numpy as np
import pycolmap
import pytest

from example_cameras import PARAMS, PINHOLE, camera_of
from handeye_fg.errors import InputDataError
from handeye_fg.lens import MODELS, embedding, lens_of, refinable


def rays():
    """Rays (m, 2) up to 45 degrees off the axis, on it, and next to it."""
    rng = np.random.default_rng(0)
    spread = rng.uniform(-0.7, 0.7, (200, 2))
    radii = np.array([1e-12, 1e-9, 1e-7, 9e-7, 1e-6, 2e-6, 1e-5, 1e-3, 0.03])
    return np.vstack([[[0.0, 0.0]], spread, np.outer(radii, [0.6, -0.8])])


def gtsam_cameras():
    """GTSAM's camera for each model that it has, and the columns of its Jacobian by ours."""
    f, cx, cy, k1, k2 = PARAMS["RADIAL"]
    fx, fy, ux, uy, *distortion = PARAMS["OPENCV"]
    fisheye = gtsam.Cal3Fisheye(*PINHOLE[:2], 0.0, *PINHOLE[2:], *PARAMS["OPENCV_FISHEYE"][4:])
    here, without_skew = gtsam.Pose3(), [0, 1, 3, 4, 5, 6, 7, 8]
    return {
        "PINHOLE": (
            gtsam.PinholeCameraCal3_S2(here, gtsam.Cal3_S2(*PINHOLE[:2], 0.0, *PINHOLE[2:])),
            [0, 1, 3, 4],
        ),
        "RADIAL": (
            gtsam.PinholeCameraCal3Bundler(here, gtsam.Cal3Bundler(f, k1, k2, cx, cy)),
            [0, None, None, 1, 2],
        ),
        "OPENCV": (
            gtsam.PinholeCameraCal3DS2(here, gtsam.Cal3DS2(fx, fy, 0.0, ux, uy, *distortion)),
            without_skew,
        ),
        "OPENCV_FISHEYE": (gtsam.PinholeCameraCal3Fisheye(here, fisheye), without_skew),
    }


@pytest.mark.parametrize("model", MODELS)
def test_projections_are_colmaps(model):
    native = pycolmap.Camera(model=model, width=960, height=720, params=PARAMS[model])
    expected = native.img_from_cam(np.column_stack([rays(), np.ones(len(rays()))]))
    found = lens_of(camera_of(model)).pixels(*rays().T)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("model", gtsam_cameras())
def test_projections_and_derivatives_are_gtsams(model):
    native, columns = gtsam_cameras()[model]
    lens = lens_of(camera_of(model))
    by_ray = lens.by_ray(*rays().T) * lens.focal[:, None]
    by_params = lens.by_params(*rays().T) @ embedding(model)
    ours = [i for i, column in enumerate(columns) if column is not None]
    theirs = [column for column in columns if column is not None]
    for k, ray in enumerate(rays()):
        by_pose, by_point = np.zeros((2, 6), order="F"), np.zeros((2, 3), order="F")
        by_cal = np.zeros((2, native.calibration().dim()), order="F")
        expected = native.project(np.append(ray, 1.0), by_pose, by_point, by_cal)
        found = lens.pixels(*rays()[k : k + 1].T)[0]
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9)
        # On the axis GTSAM's fisheye leaves its derivative by the point at zero.
        if np.linalg.norm(ray) > 1e-9:
            np.testing.assert_allclose(by_ray[k], by_point[:, :2], rtol=1e-8, atol=1e-6)
        np.testing.assert_allclose(by_params[k][:, ours], by_cal[:, theirs], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("model", MODELS)
def test_derivatives_are_those_of_the_projection(model):
    at, params = camera_of(model), np.array(PARAMS[model])
    lens, into = lens_of(at), embedding(model)
    x, y = rays().T
    h = 1e-6
    ahead, behind = lens.pixels(x + h, y), lens.pixels(x - h, y)
    by_ray = lens.by_ray(x, y) * lens.focal[:, None]
    np.testing.assert_allclose(by_ray[:, :, 0], (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-5)
    ahead, behind = lens.pixels(x, y + h), lens.pixels(x, y - h)
    np.testing.assert_allclose(by_ray[:, :, 1], (ahead - behind) / (2 * h), rtol=1e-6, atol=1e-5)
    found = lens.by_params(x, y) @ into
    for k in range(len(params)):
        step = np.zeros(len(params))
        step[k] = 1e-6 * max(1.0, abs(params[k]))
        ahead = lens_of(camera_of(model, params + step)).pixels(x, y)
        behind = lens_of(camera_of(model, params - step)).pixels(x, y)
        expected = (ahead - behind) / (2 * step[k])
        np.testing.assert_allclose(found[:, :, k], expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_a_ray_keeps_its_radius_but_for_the_tangential_part(model):
    lens = lens_of(camera_of(model))
    radius = np.linspace(0.0, 0.6, 7)
    expected = np.hypot(*lens.distorted(0.6 * radius, 0.8 * radius))
    tangential = 0.01 if model in ("OPENCV", "FULL_OPENCV") else 1e-15
    np.testing.assert_allclose(lens.radial(radius), expected, rtol=0.0, atol=tangential)


def test_only_the_denominator_of_the_rational_model_is_never_refined():
    for model in MODELS:
        kept = np.setdiff1d(np.arange(len(PARAMS[model])), refinable(model))
        assert kept.tolist() == ([9, 10, 11] if model == "FULL_OPENCV" else [])


def test_what_is_not_understood_is_refused():
    with pytest.raises(InputDataError, match="THIN_PRISM_FISHEYE is not one"):
        lens_of(camera_of("THIN_PRISM_FISHEYE", (1.0,) * 12))
    with pytest.raises(InputDataError, match="8 parameters, but 4"):
        lens_of(camera_of("OPENCV", PINHOLE))
