"""Cameras in JSON: nerfstudio's transforms.json, and the intrinsics of our own result.json."""

import math

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.io.cameras.matrices import require_positive, size
from handeye_fg.io.fields import Fields
from handeye_fg.lens import MODELS, embedding
from handeye_fg.types import CameraModel

_INTRINSICS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2")
_PERSPECTIVE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_FISHEYE = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


def is_nerfstudio(fields: Fields) -> bool:
    """Whether the document is a transforms.json."""
    return any(key in fields.values for key in ("fl_x", "camera_angle_x", "frames"))


def nerfstudio_camera(fields: Fields) -> CameraModel:
    """The camera of a transforms.json, whose frames must agree where they have intrinsics of their own.

    Raises:
        InputDataError: a number is missing, frames differ, or the model cannot be represented.
    """
    fields = _with_frames(fields)
    name = (
        fields.text("camera_model", (*_PERSPECTIVE, *_FISHEYE))
        if "camera_model" in fields.values
        else "OPENCV"
    )
    fisheye = name in _FISHEYE or fields.values.get("is_fisheye") is True
    width, height = size(fields)
    fx = _focal(fields, "fl_x", "camera_angle_x", width)
    fy = _focal(fields, "fl_y", "camera_angle_y", height) if _has_fy(fields) else fx
    cx = fields.number("cx") if "cx" in fields.values else width / 2.0
    cy = fields.number("cy") if "cy" in fields.values else height / 2.0
    terms = {
        key: fields.number(key) if key in fields.values else 0.0
        for key in ("k1", "k2", "k3", "k4", "p1", "p2")
    }
    k1, k2, k3, k4, p1, p2 = terms.values()
    if fisheye:
        if p1 or p2:
            raise fields.error("p1" if p1 else "p2", "0 for a fisheye, which has no such term here")
        model, coefficients = "OPENCV_FISHEYE", [k1, k2, k3, k4]
    elif k4:
        raise fields.error("k4", "0, as no camera model here has a radial term of the eighth power")
    elif k3:
        model, coefficients = "FULL_OPENCV", [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]
    elif any(terms.values()) or "k1" in fields.values:
        model, coefficients = "OPENCV", [k1, k2, p1, p2]
    else:
        model, coefficients = "PINHOLE", []
    params = np.array([fx, fy, cx, cy, *coefficients])
    return CameraModel(model=model, width=width, height=height, params=params)


def our_camera(fields: Fields) -> CameraModel | None:
    """The intrinsics of a result.json, or of an object with the same keys; None for another document.

    Raises:
        InputDataError: they break their form.
    """
    if "schema_version" in fields.values:
        fields = fields.mapping("intrinsics")
    if not {"model", "params"} <= set(fields.values):
        return None
    model = fields.text("model", MODELS)
    width, height = size(fields)
    params = fields.array("params", (embedding(model).shape[1],))
    if params[0] <= 0.0:
        raise fields.error("params", "numbers in COLMAP's order, the focal length positive")
    centre = fields.number("first_pixel_centre") if "first_pixel_centre" in fields.values else 0.5
    if centre not in {0.0, 0.5}:
        raise fields.error("first_pixel_centre", "0.5 as in COLMAP, or 0 as in OpenCV")
    at = int(np.argmax(embedding(model)[2]))  # where the principal point stands
    shifted = params.copy()
    shifted[at : at + 2] += 0.5 - centre
    return CameraModel(model=model, width=width, height=height, params=shifted)


def _with_frames(fields: Fields) -> Fields:
    """The document with the intrinsics that all its frames have."""
    if "frames" not in fields.values:
        return fields
    frames = fields.mappings("frames")
    own = [{k: f.values[k] for k in _INTRINSICS if k in f.values} for f in frames]
    if any(values != own[0] for values in own):
        i = next(i for i, values in enumerate(own) if values != own[0])
        raise InputDataError(
            f"{fields.where}: frames[{i}] has other intrinsics than frames[0], but one camera was wanted; give "
            "a file of one camera"
        )
    values = {**fields.values, **(own[0] if own else {})}
    return Fields(where=fields.where, remedy=fields.remedy, values=values, path=fields.path)


def _has_fy(fields: Fields) -> bool:
    return any(key in fields.values for key in ("fl_y", "camera_angle_y"))


def _focal(fields: Fields, key: str, angle: str, side: int) -> float:
    """The focal length, or that of a field of view."""
    if key not in fields.values and angle in fields.values:
        view = fields.number(angle)
        if not 0.0 < view < math.pi:
            raise fields.error(angle, "an angle of view between 0 and pi")
        return 0.5 * side / math.tan(0.5 * view)
    require_positive(fields, key)
    return fields.number(key)
