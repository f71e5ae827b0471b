"""Exports for programs that take numbers: OpenCV, tables, JSON."""

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.camera_results import nested
from handeye_fg.io.exports.placed import Placed, one, rpy
from handeye_fg.io.results import parent_frame
from handeye_fg.lens import lens_of
from handeye_fg.types import CameraModel

if TYPE_CHECKING:
    import cv2

_COVARIANCE = (
    "Covariance of the camera's pose: order (rotation, translation), right perturbation in the optical frame, "
    "X = mean Exp(xi), radians and metres."
)
_AXES = ("rx", "ry", "rz", "tx", "ty", "tz")


def opencv(cameras: Sequence[Placed]) -> str:
    """FileStorage in YAML, with the names of calibrateHandEye and of camera files."""
    import cv2  # noqa: PLC0415  # a page of pose pairs does without it

    camera = one(cameras, "a file of OpenCV")
    storage = cv2.FileStorage(
        "export.yaml",
        cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY | cv2.FILE_STORAGE_FORMAT_YAML,
    )
    for comment in camera.comments:
        storage.writeComment(comment)
    storage.write("parent_frame", camera.parent)
    storage.write("child_frame", camera.child)
    storage.write("parent_T_child", camera.parent_T_child)
    parent = parent_frame(camera.setup)
    storage.writeComment("As of cv2.calibrateHandEye, of the optical frame:")
    storage.write(f"R_cam2{parent}", np.ascontiguousarray(camera.X[:3, :3]))
    storage.write(f"t_cam2{parent}", np.ascontiguousarray(camera.X[:3, 3:]))
    if camera.covariance is not None:
        storage.writeComment(_COVARIANCE)
        storage.write("covariance", camera.covariance)
    if camera.camera is not None:
        _write_intrinsics(storage, camera.camera)
    text: str = storage.releaseAndGetString()
    return text


def _write_intrinsics(storage: "cv2.FileStorage", camera: CameraModel) -> None:
    lens = lens_of(camera)
    K = np.eye(3)
    K[[0, 1], [0, 1]] = lens.focal
    K[:2, 2] = lens.centre - 0.5
    storage.writeComment("The centre of the first pixel is at (0, 0).")
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("fisheye_model", int(lens.fisheye))
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", _shortest(lens.coefficients, fisheye=lens.fisheye))


def _shortest(coefficients: Array, *, fisheye: bool) -> Array:
    """OpenCV's list of coefficients (1, n), without zeros that say nothing."""
    n = 4 if fisheye else 8 if coefficients[5:].any() else 5
    return np.ascontiguousarray(coefficients[None, :n])


def covariance(cameras: Sequence[Placed]) -> str:
    """A table of the covariance of X, with a heading.

    Raises:
        InputDataError: there is none.
    """
    camera = one(cameras, "a table of a covariance")
    if camera.covariance is None:
        raise InputDataError(
            "the method of this result gives no covariance; solve with another method, such as pose_graph"
        )
    lines = [f"# {comment}" for comment in camera.comments]
    lines += [f"# {_COVARIANCE}", ",".join(_AXES)]
    lines += [",".join(repr(float(value)) for value in row) for row in camera.covariance]
    return "\n".join(lines) + "\n"


def as_json(cameras: Sequence[Placed]) -> str:
    """One object for one camera, a list for several."""
    documents = [
        {
            "comments": list(camera.comments),
            "camera": camera.name,
            "parent": camera.parent,
            "child": camera.child,
            "matrix": camera.parent_T_child.tolist(),
            "translation_m": camera.position,
            "quaternion_xyzw": camera.quaternion_xyzw,
            "rpy_rad": rpy(camera.parent_T_child[:3, :3]),
            "optical_covariance": nested(camera.covariance),
        }
        for camera in cameras
    ]
    content = documents[0] if len(documents) == 1 else documents
    return json.dumps(content, indent=2, allow_nan=False) + "\n"
