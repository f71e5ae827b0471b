"""Lens distortion: where it can be inverted, and other forms of the same camera.

Entry points: ``covers_image``, ``nearest``, ``fitted_opencv``, ``pinhole_view``. Normalised
coordinates are those of the plane at depth 1; pixels have the first pixel's centre at (0.5, 0.5).
"""

from dataclasses import replace

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.optimize import least_squares

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.lens import embedding, lens_of, refinable
from handeye_fg.types import CameraModel, Indices

# A root of a polynomial with a smaller imaginary part counts as real (rounding of a double root).
_REAL_ROOT = 1e-9
# Samples of the radial function from which an inversion starts; Newton does the rest.
_RADIAL_SAMPLES = 2048
# A ray that is farther out than this (89.9 degrees) is not in a perspective image.
_FARTHEST_RADIUS = 600.0
_NEWTON_STEPS = 30
# Largest error of an inversion, projected again, in pixels: far below what any observation knows.
_ROUND_TRIP_PX = 1e-9
_NEWTON_DONE_PX = 1e-11  # rounding of a position of some thousand pixels is 1e-12
# Determinants are kept this far from zero, so that a step at a fold stays finite.
_SMALLEST_DETERMINANT = 1e-6
# Near its fold a distortion is a poor description of the lens: the part of the radius that is used
# to fit another; smaller where the fit would fold over as well.
_SAFE_PARTS = (0.9, 0.8, 0.7, 0.6, 0.5)
# Rows and columns of the pixels to which a camera model is fitted, and that stand for the border.
_GRID = (30, 40)
# Rays farther off the axis are not moved into a pinhole view: a pixel's error grows 33-fold there.
_WIDEST_VIEW = np.deg2rad(80.0)


def _smallest_positive_root(*polynomials: Polynomial) -> float:
    """The smallest positive real root of any of the polynomials; infinity if there is none."""
    roots = np.concatenate([polynomial.trim().roots() for polynomial in polynomials])
    real = roots.real[(np.abs(roots.imag) < _REAL_ROOT * (1 + np.abs(roots))) & (roots.real > 0)]
    return float(real.min()) if len(real) else float("inf")


def invertible_radius(camera: CameraModel) -> float:
    """The undistorted radius, in normalised coordinates, up to which the radial distortion rises.

    Beyond it the image is folded over: two rays share a pixel. Infinite if the distortion never folds.

    Raises:
        InputDataError: the model has no counterpart in OpenCV.
    """
    lens = lens_of(camera)
    k1, k2, *_, k4, k5, k6 = lens.coefficients
    s = Polynomial([0.0, 1.0])
    if lens.fisheye:
        series = Polynomial([1.0, *lens.coefficients[:4]])
        theta = np.sqrt(_smallest_positive_root(series + 2 * s * series.deriv()))
        return float(np.tan(theta)) if theta < np.pi / 2 else float("inf")
    numerator = Polynomial([1.0, k1, k2, lens.coefficients[4]])
    denominator = Polynomial([1.0, k4, k5, k6])
    slope = (numerator + 2 * s * numerator.deriv()) * denominator
    slope -= 2 * s * numerator * denominator.deriv()
    return float(np.sqrt(_smallest_positive_root(slope, denominator)))


def _undistorted(
    camera: CameraModel, pixels: Array, *, part: float = 1.0
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Invert the distortion by Newton's method from a table of the radial function.

    Args:
        camera: the camera.
        pixels: observed positions (m, 2).
        part: of the invertible radius; farther rays count as not found.

    Returns:
        Undistorted normalised coordinates (m, 2), whether each was found (m,), and the determinants
        (m,) of the distortion's Jacobian there.
    """
    lens = lens_of(camera)
    target = (np.asarray(pixels, dtype=np.float64) - lens.centre) / lens.focal
    radius = np.linalg.norm(target, axis=1)
    fold = invertible_radius(camera)
    # Angles in equal steps: dense where the images are, and yet as far as the widest ray.
    farthest = np.arctan(min(fold, _FARTHEST_RADIUS))
    table = np.tan(np.linspace(0.0, farthest, _RADIAL_SAMPLES))
    bent = np.maximum.accumulate(lens.radial(table))
    start = np.interp(radius, bent, table)
    xy = target * (start / np.maximum(radius, np.finfo(float).tiny))[:, None]
    limit = float(table[-1])
    for _ in range(_NEWTON_STEPS):
        error = target - np.stack(lens.distorted(*xy.T), axis=1)
        if np.abs(error * lens.focal).max(initial=0.0) < _NEWTON_DONE_PX:
            break
        xy = xy + _solved(lens.by_ray(*xy.T), error)
        length = np.linalg.norm(xy, axis=1)
        xy *= np.where(length > limit, limit / np.maximum(length, limit), 1.0)[:, None]
    miss = np.abs(lens.pixels(*xy.T) - pixels).max(axis=1, initial=0.0)
    determinant = np.linalg.det(lens.by_ray(*xy.T))
    found = (miss < _ROUND_TRIP_PX) & (determinant > 0)
    found &= np.linalg.norm(xy, axis=1) <= part * min(fold, _FARTHEST_RADIUS)
    return xy, found, determinant


def _solved(jacobian: Array, error: Array) -> Array:
    """Newton steps (m, 2) for Jacobians (m, 2, 2) and errors (m, 2)."""
    (a, b), (c, d) = jacobian.transpose(1, 2, 0)
    determinant = a * d - b * c
    small = np.abs(determinant) < _SMALLEST_DETERMINANT
    determinant = np.where(small, _SMALLEST_DETERMINANT, determinant)
    u, v = error.T
    return np.stack([d * u - b * v, a * v - c * u], axis=1) / determinant[:, None]


def _image_grid(camera: CameraModel) -> Array:
    """Pixels (n, 2) on a grid over the whole image, its border included."""
    rows, columns = _GRID
    x, y = np.meshgrid(np.linspace(0, camera.width, columns), np.linspace(0, camera.height, rows))
    return np.stack([x.ravel(), y.ravel()], axis=1)


def covers_image(camera: CameraModel) -> bool:
    """Whether every pixel of the image has a line of sight: the distortion can be inverted there.

    Raises:
        InputDataError: the model has no counterpart in OpenCV.
    """
    _, found, _ = _undistorted(camera, _image_grid(camera))
    return bool(found.all())


def fitted_opencv(camera: CameraModel) -> tuple[CameraModel, float]:
    """The camera of model OPENCV nearest to a perspective camera; see ``nearest``."""
    return nearest(camera, replace(camera, model="OPENCV", params=np.zeros(8)))


def nearest(camera: CameraModel, like: CameraModel) -> tuple[CameraModel, float]:
    """The camera of another one's model that is nearest to a camera.

    Args:
        camera: what is to be described.
        like: gives the model, and the values of those of its parameters that are never refined.

    Returns:
        The camera and its root mean square distance from the given one in pixels, over a grid of the
        image's pixels as far as these lie well within the invertible radius. It is exact, 0.0, where
        the model contains the camera.

    Raises:
        InputDataError: only one of the models is a fisheye, or the camera has no use in its own image.
    """
    into, own = embedding(like.model), embedding(camera.model) @ camera.params
    free = refinable(like.model)
    params = like.params.copy()
    params[free] = (into.T @ own / into.sum(axis=0))[free]
    start = replace(like, params=params)
    if lens_of(start).fisheye != lens_of(camera).fisheye:
        raise InputDataError(
            f"camera model {camera.model} cannot be written as {like.model}: one is for fisheye lenses, "
            "the other is not; give the intrinsics in a model of the other kind"
        )
    if np.array_equal(into @ params, own):
        return start, 0.0
    grid = _image_grid(camera)
    best, rms = start, float("inf")
    for part in _SAFE_PARTS:
        rays, found, _ = _undistorted(camera, grid, part=part)
        if 2 * np.sum(found) < len(free):
            break
        best, rms = _fitted(start, free, rays[found], grid[found])
        if covers_image(best):
            break
    if not np.isfinite(rms):
        raise InputDataError(
            f"the distortion of this {camera.model} camera cannot be inverted in its own image; "
            "calibrate the camera again, or leave the camera file out"
        )
    return best, rms


def _fitted(
    start: CameraModel, free: Indices, rays: Array, pixels: Array
) -> tuple[CameraModel, float]:
    """The camera, only some parameters changed, that best projects rays (n, 2) to pixels (n, 2)."""
    into = embedding(start.model)[:, free]

    def trial(unknowns: Array) -> CameraModel:
        params = start.params.copy()
        params[free] = unknowns
        return replace(start, params=params)

    def misfit(unknowns: Array) -> Array:
        return np.ravel(lens_of(trial(unknowns)).pixels(*rays.T) - pixels)

    def slope(unknowns: Array) -> Array:
        by_params = lens_of(trial(unknowns)).by_params(*rays.T)
        return np.reshape(by_params @ into, (-1, len(free)))

    best = least_squares(
        misfit, start.params[free], slope, method="lm", x_scale="jac", xtol=1e-14, ftol=1e-14
    )
    return trial(best.x), float(np.sqrt(2.0 * best.cost / len(pixels)))


def pinhole_view(camera: CameraModel, pixels: Array) -> tuple[CameraModel, Array, Array]:
    """Move observations into the undistorted view of the same camera matrix.

    Args:
        camera: the camera that observed.
        pixels: observed positions (m, 2).

    Returns:
        The PINHOLE camera, the moved positions (m, 2), and for each the factor (m,) by which an
        isotropic standard deviation in pixels grows (the square root of the area's).

    Raises:
        InputDataError: no such model, or the distortion cannot be inverted at an observation, or its
            ray is too far off the axis for a pinhole view.
    """
    lens = lens_of(camera)
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    xy, found, determinant = _undistorted(camera, pixels)
    if not found.all():
        x, y = pixels[np.argmin(found)]
        raise InputDataError(
            f"the {camera.model} distortion cannot be inverted at {np.sum(~found)} of {len(found)} "
            f"observations, the first at pixel ({x:.0f}, {y:.0f}); calibrate the camera again with "
            "views of the image's corners, or have the intrinsics refined"
        )
    angle = np.arctan(np.linalg.norm(xy, axis=1))
    if (angle > _WIDEST_VIEW).any():
        raise InputDataError(
            f"{np.sum(angle > _WIDEST_VIEW)} of {len(angle)} observations are more than "
            f"{np.rad2deg(_WIDEST_VIEW):.0f} degrees off the optical axis; mask the border of the image"
        )
    view = CameraModel(
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=np.concatenate([lens.focal, lens.centre]),
    )
    return view, xy * lens.focal + lens.centre, determinant**-0.5
