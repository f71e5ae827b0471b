"""Cameras of a COLMAP model: cameras.txt and cameras.bin."""

import re
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.files import read_bytes
from handeye_fg.lens import MODELS, embedding
from handeye_fg.types import CameraModel

# COLMAP's numbers of the models that are known here, and the names of some that are not.
_NUMBERS = {
    0: "SIMPLE_PINHOLE",
    1: "PINHOLE",
    2: "SIMPLE_RADIAL",
    3: "RADIAL",
    4: "OPENCV",
    5: "OPENCV_FISHEYE",
    6: "FULL_OPENCV",
    7: "FOV",
    8: "SIMPLE_RADIAL_FISHEYE",
    9: "RADIAL_FISHEYE",
    10: "THIN_PRISM_FISHEYE",
    14: "SIMPLE_FISHEYE",
    15: "FISHEYE",
}
_MOST_CAMERAS = 100_000
_LARGEST_SIDE = 100_000
_CAMERA = re.compile(r"\d+\s+[A-Z][A-Z_]+\s+\d{1,9}\s+\d{1,9}(\s+\S+)+", re.ASCII)


def is_text_of_cameras(text: str) -> bool:
    """Whether the first line that is no comment is a camera of COLMAP's."""
    lines = (line.strip() for line in text.splitlines())
    first = next((line for line in lines if line and not line.startswith("#")), "")
    return _CAMERA.fullmatch(first) is not None


def text_cameras(text: str, where: str) -> Mapping[str, CameraModel]:
    """The cameras of a cameras.txt under their numbers.

    Raises:
        InputDataError: a line is no camera, or its model cannot be represented.
    """
    cameras: dict[str, CameraModel] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        place = f"{where}, line {number}"
        if not _CAMERA.fullmatch(line.strip()):
            raise InputDataError(
                f"{place}: found {shown(line)}, but wanted CAMERA_ID MODEL WIDTH HEIGHT PARAMS...; export the "
                "model again"
            )
        key, model, width, height, *words = line.split()
        try:
            params = [float(word) for word in words]
        except ValueError as error:
            raise InputDataError(f"{place}: {reason(error)}; export the model again") from error
        if key in cameras:
            raise InputDataError(f"{place}: camera {key} is already there; export the model again")
        cameras[key] = _camera(model, int(width), int(height), params, place)
    return cameras


def binary_cameras(path: Path, where: str) -> Mapping[str, CameraModel]:
    """The cameras of a cameras.bin under their numbers.

    Raises:
        InputDataError: the file is missing, cut off, or a model cannot be represented.
    """
    data = read_bytes(path, "camera file")
    cameras: dict[str, CameraModel] = {}
    try:
        (count,) = struct.unpack_from("<Q", data)
        if not 1 <= count <= _MOST_CAMERAS:
            raise InputDataError(
                f"{where}: says that it holds {count} cameras, so it is no cameras.bin of COLMAP; give that file"
            )
        offset = 8
        for _ in range(count):
            key, number, width, height = struct.unpack_from("<IiQQ", data, offset)
            place = f"{where}, camera {key}"
            model = _known(_NUMBERS.get(number, f"number {number}"), place)
            n = embedding(model).shape[1]
            params = struct.unpack_from(f"<{n}d", data, offset + 24)
            cameras[str(key)] = _camera(model, width, height, params, place)
            offset += 24 + 8 * n
    except struct.error as error:
        raise InputDataError(
            f"{where}: ends after {len(data)} bytes, within a camera; copy the file again"
        ) from error
    if offset != len(data):
        raise InputDataError(
            f"{where}: {len(data) - offset} bytes follow the last camera, so it is no cameras.bin of COLMAP; "
            "give that file"
        )
    return cameras


def _known(model: str, where: str) -> str:
    if model not in MODELS:
        raise InputDataError(
            f"{where}: camera model {model} is not one that is understood exactly; undistort the images, or "
            f"calibrate with one of {', '.join(MODELS)}"
        )
    return model


def _camera(
    model: str, width: int, height: int, params: list[float] | tuple[float, ...], where: str
) -> CameraModel:
    n = embedding(_known(model, where)).shape[1]
    if len(params) != n or not np.isfinite(params).all():
        raise InputDataError(
            f"{where}: {model} has {n} finite parameters, but found {shown(list(params))}; correct the camera file"
        )
    if not (1 <= width <= _LARGEST_SIDE and 1 <= height <= _LARGEST_SIDE):
        raise InputDataError(
            f"{where}: the image size is {width} x {height}, but must be 1 to {_LARGEST_SIDE} pixels each way; "
            "correct the camera file"
        )
    if params[0] <= 0.0:
        raise InputDataError(
            f"{where}: the focal length is {params[0]:g}, but must be positive; correct the camera file"
        )
    return CameraModel(model=model, width=width, height=height, params=np.array(params))
