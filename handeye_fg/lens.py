"""Camera models as lenses of two families, with derivatives; entry point ``lens_of``.

Every model that is known here is a linear embedding of its own parameters into the twelve of a family:
focal lengths and centre, then the coefficients of OpenCV's rational distortion (COLMAP's FULL_OPENCV)
or of Kannala and Brandt's fisheye. With s = x^2 + y^2 at depth 1::

    perspective   g = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3)
                  u = g x + 2 p1 x y + p2 (s + 2 x^2),   v = g y + p1 (s + 2 y^2) + 2 p2 x y
    fisheye       (u, v) = (x, y) a / r (1 + k1 a^2 + k2 a^4 + k3 a^6 + k4 a^8),   r^2 = s,  a = atan r
    pixel         (fx u + cx, fy v + cy)

A model therefore has exactly its own parameters when it is refined, and no other model stands in for it.
Pixels have the first pixel's centre at (0.5, 0.5).
"""

from dataclasses import dataclass, replace

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.types import CameraModel, Indices

# For each model, which of its parameters, in COLMAP's order, each parameter of the family is; the
# others are zero.
_PERSPECTIVE = {
    "SIMPLE_PINHOLE": (0, 0, 1, 2),
    "PINHOLE": (0, 1, 2, 3),
    "SIMPLE_RADIAL": (0, 0, 1, 2, 3),
    "RADIAL": (0, 0, 1, 2, 3, 4),
    "OPENCV": tuple(range(8)),
    "FULL_OPENCV": tuple(range(12)),
}
_FISHEYE = {
    "SIMPLE_FISHEYE": (0, 0, 1, 2),
    "FISHEYE": (0, 1, 2, 3),
    "SIMPLE_RADIAL_FISHEYE": (0, 0, 1, 2, 3),
    "RADIAL_FISHEYE": (0, 0, 1, 2, 3, 4),
    "OPENCV_FISHEYE": tuple(range(8)),
}
MODELS = (*_PERSPECTIVE, *_FISHEYE)
_DIM = 12
# The models that hold all others but FULL_OPENCV, perspective and fisheye: with the first parameters.
_GENERAL = ("OPENCV", "OPENCV_FISHEYE")
_GENERAL_PARAMS = 8
# The denominator of the rational model stays as it is given: images do not tell it from the numerator.
_KEPT = {"FULL_OPENCV": (9, 10, 11)}

# Least squared radius for ratios of a fisheye: in derivatives the slope there stands beside a factor of the
# squared radius, so that its rounding vanishes.
_AXIS = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lens:
    """A camera in the terms of its family.

    Attributes:
        fisheye: which family.
        focal: focal lengths (2,), pixels.
        centre: principal point (2,), pixels.
        coefficients: (8,): k1 k2 p1 p2 k3 k4 k5 k6, of a fisheye k1 k2 k3 k4 0 0 0 0.
    """

    fisheye: bool
    focal: Array
    centre: Array
    coefficients: Array

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distorted normalised coordinates of undistorted ones (m,)."""
        s = x * x + y * y
        factor = self._factor(s)
        if self.fisheye:
            return factor * x, factor * y
        p1, p2 = self.coefficients[2:4]
        tangential = 2.0 * (p1 * y + p2 * x)
        return (factor + tangential) * x + p2 * s, (factor + tangential) * y + p1 * s

    def radial(self, radius: Array) -> Array:
        """Distorted radii of undistorted ones (m,), without tangential distortion."""
        return radius * self._factor(radius * radius)

    def pixels(self, x: Array, y: Array) -> Array:
        """Pixels (m, 2) of undistorted normalised coordinates (m,)."""
        return np.stack(self.distorted(x, y), axis=1) * self.focal + self.centre

    def by_ray(self, x: Array, y: Array) -> Array:
        """Derivatives (m, 2, 2) of ``distorted`` by x and y."""
        s = x * x + y * y
        factor, slope = self._factor(s), 2.0 * self._slope(s)
        p1, p2 = (0.0, 0.0) if self.fisheye else self.coefficients[2:4]
        result = np.empty((len(x), 2, 2))
        result[:, 0, 0] = factor + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x
        result[:, 1, 1] = factor + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x
        result[:, 0, 1] = result[:, 1, 0] = slope * x * y + 2.0 * (p1 * x + p2 * y)
        return result

    def by_params(self, x: Array, y: Array) -> Array:
        """Derivatives (m, 2, 12) of ``pixels`` by focal lengths, centre and coefficients."""
        u, v = self.distorted(x, y)
        result = np.zeros((len(x), 2, _DIM))
        result[:, 0, 0], result[:, 1, 1] = u, v
        result[:, 0, 2] = result[:, 1, 3] = 1.0
        s = x * x + y * y
        if self.fisheye:
            ratio, squared = _atan_ratio(s), _squared_angle(s)
            radial = ratio * np.stack([squared, squared**2, squared**3, squared**4])
            which = np.arange(4, 8)
        else:
            numerator, denominator = self._rational(s)
            upper = np.stack([s, s**2, s**3]) / denominator
            radial = np.concatenate([upper, -numerator / denominator * upper])
            which = np.array([4, 5, 8, 9, 10, 11])
            xy = 2.0 * x * y
            result[:, 0, 6], result[:, 0, 7] = xy, s + 2.0 * x * x
            result[:, 1, 6], result[:, 1, 7] = s + 2.0 * y * y, xy
        result[:, 0, which], result[:, 1, which] = (x * radial).T, (y * radial).T
        result[:, :, 4:] *= self.focal[:, None]
        return result

    def _rational(self, s: Array) -> tuple[Array, Array]:
        """Numerator and denominator of the radial factor."""
        k1, k2, _, _, k3, k4, k5, k6 = self.coefficients
        return 1.0 + s * (k1 + s * (k2 + s * k3)), 1.0 + s * (k4 + s * (k5 + s * k6))

    def _factor(self, s: Array) -> Array:
        """The radial factor for squared radii (m,)."""
        if self.fisheye:
            k1, k2, k3, k4 = self.coefficients[:4]
            t = _squared_angle(s)
            bent = _atan_ratio(s) * (1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4))))
            return np.asarray(bent)
        numerator, denominator = self._rational(s)
        return np.asarray(numerator / denominator)

    def _slope(self, s: Array) -> Array:
        """Its derivative by the squared radius."""
        if self.fisheye:
            k1, k2, k3, k4 = self.coefficients[:4]
            ratio, t = _atan_ratio(s), _squared_angle(s)
            series = 1.0 + t * (k1 + t * (k2 + t * (k3 + t * k4)))
            by_t = k1 + t * (2.0 * k2 + t * (3.0 * k3 + t * 4.0 * k4))
            return np.asarray(_atan_ratio_slope(s) * series + ratio**2 / (1.0 + s) * by_t)
        k1, k2, _, _, k3, k4, k5, k6 = self.coefficients
        numerator, denominator = self._rational(s)
        upper = k1 + s * (2.0 * k2 + s * 3.0 * k3)
        lower = k4 + s * (2.0 * k5 + s * 3.0 * k6)
        return np.asarray((upper - numerator / denominator * lower) / denominator)


def _atan_ratio(s: Array) -> Array:
    """atan(r) / r for squared radii."""
    r = np.sqrt(np.maximum(s, _AXIS))
    return np.asarray(np.arctan(r) / r)


def _atan_ratio_slope(s: Array) -> Array:
    """Its derivative by the squared radius."""
    s = np.maximum(s, _AXIS)
    return np.asarray((1.0 / (1.0 + s) - _atan_ratio(s)) / (2.0 * s))


def _squared_angle(s: Array) -> Array:
    return np.arctan(np.sqrt(s)) ** 2


def embedding(model: str) -> Array:
    """The linear map (12, k) from the parameters of a model to those of its family.

    Raises:
        InputDataError: the model belongs to neither family.
    """
    if model not in MODELS:
        raise InputDataError(
            f"camera model {model} is not one that is understood exactly; convert the camera to one of "
            f"{', '.join(MODELS)}"
        )
    order = {**_PERSPECTIVE, **_FISHEYE}[model]
    result = np.zeros((_DIM, max(order) + 1))
    result[np.arange(len(order)), order] = 1.0
    return result


def refinable(model: str) -> Indices:
    """Which parameters of a model are unknowns when it is refined."""
    return np.setdiff1d(np.arange(embedding(model).shape[1]), _KEPT.get(model, ()))


def generalised(camera: CameraModel) -> CameraModel:
    """The same camera in the model with the most parameters that images determine."""
    if camera.model == "FULL_OPENCV":
        return camera
    params = (embedding(camera.model) @ camera.params)[:_GENERAL_PARAMS]
    return replace(camera, model=_GENERAL[camera.model in _FISHEYE], params=params)


def lens_of(camera: CameraModel) -> Lens:
    """The camera in the terms of its family.

    Raises:
        InputDataError: the model belongs to neither family, or has another number of parameters.
    """
    into = embedding(camera.model)
    if len(camera.params) != into.shape[1]:
        raise InputDataError(
            f"camera model {camera.model} has {into.shape[1]} parameters, but {len(camera.params)} "
            "are given"
        )
    params = into @ camera.params
    return Lens(
        fisheye=camera.model in _FISHEYE,
        focal=params[:2],
        centre=params[2:4],
        coefficients=params[4:],
    )
