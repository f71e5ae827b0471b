"""Cameras of Kalibr's camchain, and of the sensor.yaml of EuRoC, which is alike."""

import re
from collections.abc import Mapping

from handeye_fg.errors import InputDataError
from handeye_fg.io.cameras.matrices import camera_of
from handeye_fg.io.fields import Fields
from handeye_fg.types import CameraModel

_NAME = re.compile(r"cam\d+")
# Kalibr's distortion models that COLMAP has, with the number of coefficients.
_DISTORTION = {
    "none": ("PINHOLE", 0),
    "radtan": ("OPENCV", 4),
    "radial-tangential": ("OPENCV", 4),
    "equidistant": ("OPENCV_FISHEYE", 4),
}
_LARGEST_SIDE = 100_000


def is_kalibr(fields: Fields) -> bool:
    """Whether the document has cameras cam0, cam1 ..., or is one."""
    return any(map(_NAME.fullmatch, fields.values)) or {"camera_model", "intrinsics"} <= set(
        fields.values
    )


def kalibr_cameras(fields: Fields) -> Mapping[str, CameraModel]:
    """The cameras under their names; "" for a file that is one camera.

    Raises:
        InputDataError: a camera lacks something, or has a model that cannot be represented.
    """
    names = sorted(filter(_NAME.fullmatch, fields.values), key=lambda name: int(name[3:]))
    if not names:
        return {"": _camera(fields)}
    return {name: _camera(fields.mapping(name)) for name in names}


def _camera(fields: Fields) -> CameraModel:
    if fields.text("camera_model") != "pinhole":
        raise fields.error(
            "camera_model",
            "'pinhole', as no camera model here is a unified or an omnidirectional one",
        )
    if fields.values.get("distortion_model") == "fov":
        raise fields.error(
            "distortion_model",
            "'radtan', 'equidistant' or 'none', as no camera model here has the field-of-view distortion; "
            "calibrate with another model",
        )
    model, n = _DISTORTION[fields.text("distortion_model", tuple(_DISTORTION))]
    width, height = fields.array("resolution", (2,)).tolist()
    if not all(side == int(side) and 1 <= side <= _LARGEST_SIDE for side in (width, height)):
        raise fields.error("resolution", "width and height in whole pixels")
    pinhole = fields.array("intrinsics", (4,)).tolist()
    if min(pinhole[:2]) <= 0.0:
        raise fields.error("intrinsics", "fu, fv, pu, pv with positive focal lengths")
    return camera_of(model, int(width), int(height), pinhole, _coefficients(fields, n))


def _coefficients(fields: Fields, n: int) -> list[float]:
    keys = ("distortion_coeffs", "distortion_coefficients")
    present = [key for key in keys if key in fields.values]
    if not n and not present:
        return []
    if len(present) != 1:
        raise InputDataError(
            f"{fields.where}: {fields.path}{keys[0]} is {'missing' if not present else 'there twice'}, but "
            f"{n} coefficients were wanted; {fields.remedy}"
        )
    coefficients: list[float] = fields.array(present[0], (None,)).tolist()
    if len(coefficients) != n and (n or any(coefficients)):
        raise fields.error(present[0], f"{n} coefficients for this distortion model")
    return coefficients[:n]
