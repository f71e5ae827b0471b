"""Camera files of ROS (camera_info) and OpenCV (FileStorage), and plain lists of their numbers."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.fields import Fields
from handeye_fg.types import CameraModel

_MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "K", "k")
_DISTORTION_KEYS = ("distortion_coefficients", "distCoeffs", "dist_coeffs", "D", "d", "coeffs")
_WIDTH_KEYS = ("image_width", "width", "imageWidth", "w")
_HEIGHT_KEYS = ("image_height", "height", "imageHeight", "h")

# Coefficients of each distortion model: k1 k2 p1 p2 k3 k4 k5 k6, thin prism (4), tilt (2).
_LENGTHS = {
    "none": (0,),
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    "fisheye": (4,),
    "": (0, 4, 5, 8, 12, 14),
}
_FEWEST = 4  # coefficients of a distortion model that has any
_LARGEST_SIDE = 100_000


def of_matrix(fields: Fields) -> CameraModel:
    """The intrinsics of a ROS camera_info or an OpenCV FileStorage file.

    Distortion is mapped without loss: none to PINHOLE, k1 k2 p1 p2 to OPENCV (zeros as well: they can be
    refined), up to k6 to FULL_OPENCV, equidistant (fisheye) to OPENCV_FISHEYE. A file that names no distortion model has
    OpenCV's standard one.

    Raises:
        InputDataError: image size, camera matrix or distortion are missing or impossible; or the file
            has a skew, thin-prism or tilt terms, binning or a region of interest, which cannot be
            represented.
    """
    width, height = size(fields)
    _check_whole_image(fields, width, height)
    fx, fy, cx, cy = _camera_matrix(fields)
    model, coefficients = _distortion(fields)
    return camera_of(model, width, height, (fx, fy, cx, cy), coefficients)


def of_focal_lengths(fields: Fields) -> CameraModel:
    """The intrinsics where each number has a key: width, height, fx, fy, cx (ppx), cy (ppy), and a list of OpenCV.

    Raises:
        InputDataError: a number is missing or impossible, or the distortion cannot be represented.
    """
    width, height = size(fields)
    centre = [
        fields.number(_key(fields, keys, "the principal point in pixels"))
        for keys in (("cx", "ppx"), ("cy", "ppy"))
    ]
    focal = [fields.number(key) for key in ("fx", "fy")]
    require_positive(fields, "fx", "fy")
    if any(key in fields.values for key in _DISTORTION_KEYS):
        model, coefficients = _distortion(fields)
    else:
        model, coefficients = "PINHOLE", []
    return camera_of(model, width, height, (*focal, *centre), coefficients)


def camera_of(
    model: str,
    width: int,
    height: int,
    pinhole: Sequence[float],
    coefficients: Sequence[float],
) -> CameraModel:
    """A camera from fx fy cx cy with the first pixel's centre at (0, 0), and the coefficients of COLMAP's model."""
    fx, fy, cx, cy = pinhole
    params = np.array([fx, fy, cx + 0.5, cy + 0.5, *coefficients])
    return CameraModel(model=model, width=width, height=height, params=params)


def require_positive(fields: Fields, *keys: str) -> None:
    """Refuse focal lengths that cannot be.

    Raises:
        InputDataError: a number is missing or not positive.
    """
    for key in keys:
        if fields.number(key) <= 0.0:
            raise fields.error(key, "a positive focal length in pixels")


def _key(fields: Fields, keys: Sequence[str], wanted: str) -> str:
    """The one of the synonymous keys that the file has."""
    present = [key for key in keys if key in fields.values]
    if not present:
        raise InputDataError(
            f"{fields.where}: there is no key {keys[0]}, but {wanted} is needed; add the key"
            f" {keys[0]} (also read: {', '.join(keys[1:])})"
        )
    if len(present) > 1:
        raise InputDataError(
            f"{fields.where}: {' and '.join(present)} say the same thing; keep one of them"
        )
    return present[0]


def size(fields: Fields) -> tuple[int, int]:
    """Image width and height.

    Raises:
        InputDataError: one is missing or impossible.
    """
    return (
        fields.integer(
            _key(fields, _WIDTH_KEYS, "the images' width in pixels"), least=1, most=_LARGEST_SIDE
        ),
        fields.integer(
            _key(fields, _HEIGHT_KEYS, "the images' height in pixels"), least=1, most=_LARGEST_SIDE
        ),
    )


def _check_whole_image(fields: Fields, width: int, height: int) -> None:
    """Refuse images that the driver has binned or cropped: the camera matrix is of the full one."""
    for key in ("binning_x", "binning_y"):
        if key in fields.values and fields.integer(key) > 1:
            raise fields.error(key, "0 or 1, as binned images do not have this camera matrix")
    if "roi" in fields.values:
        roi = fields.mapping("roi")
        for key, full in (("x_offset", 0), ("y_offset", 0), ("width", width), ("height", height)):
            if key in roi.values and roi.integer(key) not in (0, full):
                wanted = f"0 or {full}" if full else "0"
                raise roi.error(key, f"{wanted}, as cropped images do not have this camera matrix")


def _numbers(fields: Fields, key: str) -> Array:
    """Numbers of a list, of a list of rows, or of a matrix with ``data``, flattened."""
    value = fields.values[key]
    if isinstance(value, dict):
        matrix = fields.mapping(key)
        numbers = matrix.array("data", (None,))
        if "rows" in matrix.values or "cols" in matrix.values:
            size = matrix.integer("rows"), matrix.integer("cols")
            if size[0] * size[1] != len(numbers):
                raise matrix.error("data", f"{size[0]} x {size[1]} numbers, as rows and cols say")
        return numbers
    if isinstance(value, list) and all(isinstance(row, list) for row in value):
        value = [number for row in value for number in row]
    return replace(fields, values={key: value}).array(key, (None,))


def _camera_matrix(fields: Fields) -> tuple[float, float, float, float]:
    """Focal lengths fx, fy and principal point cx, cy as in the file."""
    key = _key(fields, _MATRIX_KEYS, "the 3x3 matrix of focal lengths and principal point")
    numbers = _numbers(fields, key)
    if len(numbers) != 9:
        raise fields.error(key, f"3 x 3 numbers, not {len(numbers)}")
    fx, skew, cx, zero, fy, cy, *last = numbers.tolist()
    if skew != 0.0:
        raise fields.error(
            key, f"without skew (found {skew:g} in row 1, column 2), as no camera model here has it"
        )
    if zero != 0.0 or last != [0.0, 0.0, 1.0]:
        raise fields.error(key, "fx 0 cx; 0 fy cy; 0 0 1 by rows")
    if min(fx, fy) <= 0.0:
        raise fields.error(key, f"of positive focal lengths, not {fx:g} and {fy:g}")
    return fx, fy, cx, cy


def _distortion(fields: Fields) -> tuple[str, list[float]]:
    """COLMAP's model and its coefficients."""
    name = ""
    if "distortion_model" in fields.values:
        name = fields.text("distortion_model", tuple(_LENGTHS))
    elif "fisheye_model" in fields.values and fields.integer("fisheye_model", most=1):
        name = "fisheye"
    if name == "none" and not any(key in fields.values for key in _DISTORTION_KEYS):
        return "PINHOLE", []
    key = _key(fields, _DISTORTION_KEYS, "the list of coefficients, [] for none,")
    numbers = _numbers(fields, key)
    fisheye = name in ("equidistant", "fisheye")
    if not fisheye and not numbers.any():
        has_terms = name != "none" and len(numbers) >= _FEWEST
        return ("OPENCV", [0.0] * _FEWEST) if has_terms else ("PINHOLE", [])
    if len(numbers) not in _LENGTHS[name]:
        counts = " or ".join(str(n) for n in _LENGTHS[name])
        raise fields.error(
            key,
            f"{counts} coefficients for distortion model {name or 'of OpenCV'!r}, not"
            f" {len(numbers)}",
        )
    if fisheye:
        return "OPENCV_FISHEYE", numbers.tolist()
    if numbers[8:].any():
        raise fields.error(
            key,
            "zero from the ninth coefficient on, as no camera model here has thin-prism or"
            " tilt terms; calibrate with at most 8 coefficients",
        )
    coefficients = np.zeros(8)
    coefficients[: len(numbers[:8])] = numbers[:8]
    if coefficients[4:].any():
        return "FULL_OPENCV", coefficients.tolist()
    return "OPENCV", coefficients[:4].tolist()
