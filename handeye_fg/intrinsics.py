"""Lens distortion: where it can be inverted, and other forms of the same camera.

Entry points: ``opencv_distortion``, ``covers_image``, ``fitted_opencv``, ``pinhole_view``. Normalised
coordinates are those of the plane at depth 1; pixels have the first pixel's centre at (0.5, 0.5).
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.optimize import least_squares

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.types import CameraModel

# Number of parameters, by model; the order is COLMAP's.
_N_PARAMS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "FULL_OPENCV": 12,
    "OPENCV_FISHEYE": 8,
}
_ONE_FOCAL_LENGTH = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_CONTAINED_IN_OPENCV = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Lens:
    """Focal lengths (2,), centre (2,) and distortion coefficients under OpenCV's names."""

    focal: Array
    centre: Array
    fisheye: bool
    k: Array  # (6,): numerator k1 k2 k3, denominator k4 k5 k6; fisheye: k1 k2 k3 k4 0 0
    p: Array  # (2,)

    def normalised(self, pixels: Array) -> Array:
        """Distorted normalised coordinates (n, 2) of pixels (n, 2)."""
        return (np.asarray(pixels, dtype=np.float64) - self.centre) / self.focal

    def radial(self, radius: Array) -> Array:
        """Distorted radius for undistorted radii (n,), without tangential distortion."""
        if self.fisheye:
            theta = np.arctan(radius)
            return np.asarray(theta * _fisheye_series(self.k)(theta**2))
        numerator, denominator = _radial_series(self.k)
        s = np.asarray(radius) ** 2
        return np.asarray(radius * numerator(s) / denominator(s))

    def distorted(self, xy: Array) -> tuple[Array, Array]:
        """Distorted normalised coordinates (n, 2) of undistorted ones, and Jacobians (n, 2, 2)."""
        x, y = xy[:, 0], xy[:, 1]
        s = x * x + y * y
        if self.fisheye:
            factor, slope = _fisheye_factor(self.k, s)
        else:
            numerator, denominator = _radial_series(self.k)
            n, d = numerator(s), denominator(s)
            factor = n / d
            slope = (numerator.deriv()(s) - factor * denominator.deriv()(s)) / d
        p1, p2 = self.p
        u = x * factor + 2 * p1 * x * y + p2 * (s + 2 * x * x)
        v = y * factor + p1 * (s + 2 * y * y) + 2 * p2 * x * y
        cross = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        jacobian = np.empty((len(xy), 2, 2))
        jacobian[:, 0, 0] = factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        jacobian[:, 0, 1] = jacobian[:, 1, 0] = cross
        jacobian[:, 1, 1] = factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        return np.stack([u, v], axis=1), jacobian


def _radial_series(k: Array) -> tuple[Polynomial, Polynomial]:
    """Numerator and denominator of the radial factor as polynomials of the squared radius."""
    return Polynomial([1.0, *k[:3]]), Polynomial([1.0, *k[3:]])


def _fisheye_series(k: Array) -> Polynomial:
    """Distorted angle / angle as a polynomial of the squared angle."""
    return Polynomial([1.0, *k[:4]])


def _fisheye_factor(k: Array, s: Array) -> tuple[Array, Array]:
    """Distorted / undistorted radius, and its derivative with respect to the squared radius s."""
    r = np.sqrt(np.maximum(s, 1e-12))  # the derivative's limit at the axis, to 1e-12
    theta = np.arctan(r)
    series = _fisheye_series(k)
    bent = theta * series(theta**2)
    bent_slope = series(theta**2) + 2 * theta**2 * series.deriv()(theta**2)
    slope = (bent_slope / (1 + r * r) * r - bent) / (2 * r**3)
    return bent / r, slope


def _lens(camera: CameraModel) -> _Lens:
    """The camera's parameters under OpenCV's names."""
    if camera.model not in _N_PARAMS:
        raise InputDataError(
            f"camera model {camera.model} has no counterpart in OpenCV; convert the camera to one of "
            f"{', '.join(_N_PARAMS)}"
        )
    wanted = _N_PARAMS[camera.model]
    if len(camera.params) != wanted:
        raise InputDataError(
            f"camera model {camera.model} has {wanted} parameters, but {len(camera.params)} are given"
        )
    params = camera.params
    if camera.model in _ONE_FOCAL_LENGTH:
        focal, centre, rest = np.array([params[0], params[0]]), params[1:3], params[3:]
    else:
        focal, centre, rest = params[:2], params[2:4], params[4:]
    fisheye = camera.model == "OPENCV_FISHEYE"
    k, p = np.zeros(6), np.zeros(2)
    if fisheye:
        k[:4] = rest
    else:
        k[: min(2, len(rest))] = rest[:2]
        if len(rest) >= 4:
            p[:] = rest[2:4]
        k[2 : 2 + len(rest[4:])] = rest[4:]
    return _Lens(focal=focal, centre=centre, fisheye=fisheye, k=k, p=p)


def opencv_distortion(camera: CameraModel) -> tuple[Array, Array]:
    """The camera as OpenCV wants it.

    Args:
        camera: a model that OpenCV has.

    Returns:
        The camera matrix (3, 3), first pixel's centre at (0.5, 0.5), to be used with such pixels, and
        the distortion coefficients: k1 k2 p1 p2 (4,), with FULL_OPENCV k1 k2 p1 p2 k3 k4 k5 k6 (8,),
        with OPENCV_FISHEYE those of ``cv2.fisheye``, k1 k2 k3 k4 (4,).

    Raises:
        InputDataError: OpenCV has no such model.
    """
    lens = _lens(camera)
    K = np.diag([*lens.focal, 1.0])
    K[:2, 2] = lens.centre
    if lens.fisheye:
        return K, lens.k[:4].copy()
    dist = np.concatenate([lens.k[:2], lens.p, lens.k[2:]])
    return K, dist if camera.model == "FULL_OPENCV" else dist[:4]


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
    lens = _lens(camera)
    s = Polynomial([0.0, 1.0])
    if lens.fisheye:
        series = _fisheye_series(lens.k)
        theta = np.sqrt(_smallest_positive_root(series + 2 * s * series.deriv()))
        return float(np.tan(theta)) if theta < np.pi / 2 else float("inf")
    numerator, denominator = _radial_series(lens.k)
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
    lens = _lens(camera)
    target = lens.normalised(pixels)
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
        value, jacobian = lens.distorted(xy)
        error = target - value
        if np.abs(error * lens.focal).max(initial=0.0) < _NEWTON_DONE_PX:
            break
        xy = xy + _solved(jacobian, error)
        length = np.linalg.norm(xy, axis=1)
        xy *= np.where(length > limit, limit / np.maximum(length, limit), 1.0)[:, None]
    value, jacobian = lens.distorted(xy)
    miss = np.abs((value - target) * lens.focal).max(axis=1, initial=0.0)
    determinant = np.linalg.det(jacobian)
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
    """The camera of model OPENCV nearest to a perspective camera.

    Args:
        camera: of any perspective model.

    Returns:
        The OPENCV camera and its root mean square distance from the given one in pixels, over a grid
        of the image's pixels as far as these lie well within the invertible radius. It is exact, 0.0,
        for the models that OPENCV contains.

    Raises:
        InputDataError: no such model, or one that is not perspective.
    """
    lens = _lens(camera)
    exact = np.concatenate([lens.focal, lens.centre, lens.k[:2], lens.p])
    if camera.model in _CONTAINED_IN_OPENCV:
        return _opencv(camera, exact), 0.0
    if lens.fisheye:
        raise InputDataError(
            "camera model OPENCV_FISHEYE cannot be written as OPENCV, whose polynomial holds for "
            "narrower lenses; keep the intrinsics fixed"
        )
    grid = _image_grid(camera)
    best, rms = camera, float("inf")
    for part in _SAFE_PARTS:
        rays, found, _ = _undistorted(camera, grid, part=part)
        if np.sum(found) < len(exact):
            break
        best, rms = _fitted(camera, exact, rays[found], grid[found])
        if covers_image(best):
            break
    if not np.isfinite(rms):
        raise InputDataError(
            f"the distortion of this {camera.model} camera cannot be inverted in its own image; "
            "calibrate the camera again, or leave the camera file out"
        )
    return best, rms


def _fitted(
    camera: CameraModel, start: Array, rays: Array, pixels: Array
) -> tuple[CameraModel, float]:
    """The OPENCV camera that best projects rays (n, 2) to pixels (n, 2), and its rms in pixels."""
    scale = np.concatenate([np.repeat(start[:2], 2), np.ones(4)])

    def misfit(unknowns: Array) -> Array:
        trial = _lens(_opencv(camera, unknowns * scale))
        return ((trial.distorted(rays)[0] * trial.focal + trial.centre) - pixels).ravel()

    best = least_squares(misfit, start / scale, method="lm", xtol=1e-14, ftol=1e-14)
    return _opencv(camera, best.x * scale), float(np.sqrt(2.0 * best.cost / len(pixels)))


def _opencv(camera: CameraModel, params: Array) -> CameraModel:
    return CameraModel(model="OPENCV", width=camera.width, height=camera.height, params=params)


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
    lens = _lens(camera)
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
