"""Exports of where each image was taken: nerfstudio's transforms.json and a trajectory of TUM."""

import json
from collections.abc import Mapping
from pathlib import PurePosixPath

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.export_options import ExportOptions
from handeye_fg.frames import Array
from handeye_fg.io.direction import direction
from handeye_fg.io.exports.placed import chosen_cameras
from handeye_fg.io.fields import shown
from handeye_fg.io.poses.writer import tum_text
from handeye_fg.io.results import Result
from handeye_fg.lens import lens_of
from handeye_fg.types import CameraModel, RobotPoses, folder_of

# OpenGL's camera looks along -z with y up, that of OpenCV along z with y down.
_OPENCV_T_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def scene_poses(result: Result, camera: str = "") -> dict[str, Array]:
    """Refined poses (4, 4) of the camera by image name, metres: in the base, for eye-to-hand in the gripper.

    That is the frame in which what the images show stands still.

    Args:
        result: the result.
        camera: of several cameras only this one; "": all.

    Raises:
        InputDataError: no image has a pose, or no camera has the name.
    """
    chosen_cameras(result, camera)
    in_hand = result.setup == "eye-in-hand"
    poses = {
        image.name: image.base_T_camera if in_hand else image.gripper_T_camera
        for image in result.images
        if not camera or folder_of(image.name) == camera
    }
    known = {name: matrix for name, matrix in poses.items() if matrix is not None}
    if not known:
        raise InputDataError(
            "the result has no camera poses, as it is of motions or of an earlier version; calibrate from "
            "images or poses, with this version"
        )
    return known


def scene_cameras(result: Result) -> dict[str, CameraModel]:
    """Final intrinsics by the folder of the images they are of.

    Raises:
        InputDataError: the result has none.
    """
    if result.cameras:
        return {report.name: report.camera for report in result.cameras}
    if result.camera is None:
        raise InputDataError(
            "the result has no intrinsics, as it is of poses without images; use the format tum, or calibrate "
            "from images"
        )
    folders = {folder_of(image.name) for image in result.images}
    return dict.fromkeys(folders, result.camera)


def nerfstudio(result: Result, options: ExportOptions) -> str:
    """transforms.json: metres, in the base (eye-to-hand: the gripper), OpenGL's camera axes.

    Its pixels are COLMAP's: the centre of the first is at (0.5, 0.5).
    """
    cameras = {folder: _intrinsics(camera) for folder, camera in scene_cameras(result).items()}
    poses = scene_poses(result, options.camera)
    shared = cameras[folder_of(next(iter(poses)))]
    several = any(cameras[folder_of(name)] != shared for name in poses)
    frames = [
        {
            "file_path": str(PurePosixPath(options.images) / name),
            **(cameras[folder_of(name)] if several else {}),
            "transform_matrix": (matrix @ _OPENCV_T_OPENGL).tolist(),
        }
        for name, matrix in poses.items()
    ]
    frame = "base" if result.setup == "eye-in-hand" else "gripper"
    first, pose = next((name, matrix @ _OPENCV_T_OPENGL) for name, matrix in poses.items())
    comment = (
        f"transform_matrix is {frame}_T_camera in metres, camera axes of OpenGL (x right, y up, z backward): "
        f"p_{frame} = transform_matrix p_camera. Of {first}: {direction(pose, frame, ahead=-1.0)}"
    )
    content = {"comment": comment, **({} if several else shared), "frames": frames}
    return json.dumps(content, indent=2, allow_nan=False) + "\n"


def tum(result: Result, options: ExportOptions) -> str:
    """The camera's trajectory in the base: a line an image, with its own time stamp or a number.

    Raises:
        InputDataError: the camera stands still, or there are several.
    """
    if result.setup == "eye-to-hand":
        raise InputDataError(
            "the camera stands still in the base (eye-to-hand), so that it has no trajectory; its pose is X: "
            "use json, ros2 or another format"
        )
    if len(chosen_cameras(result, options.camera)) > 1:
        names = ", ".join(camera.name for camera in result.cameras)
        raise InputDataError(
            f"a trajectory is of one camera, but there are several; choose one with the option camera ({names})"
        )
    poses = scene_poses(result, options.camera)
    rows = RobotPoses(names=tuple(poses), base_T_gripper=np.array(list(poses.values())))
    text, stamps = tum_text(rows)
    first, pose = next(iter(poses.items()))
    lines = [
        "# Camera (z forward, x right, y down) in the base, metres: p_base = base_T_camera p_camera",
        f"# Of {shown(first)}: {direction(pose, 'base')}",
    ]
    lines += [f"# {stamp} {shown(name)}" for stamp, name in zip(stamps, poses, strict=True)]
    return "\n".join([*lines, text])


def _intrinsics(camera: CameraModel) -> Mapping[str, object]:
    """The intrinsics under nerfstudio's names.

    Raises:
        InputDataError: its models have no such distortion.
    """
    lens = lens_of(camera)
    k1, k2, p1, p2, k3, *denominator = (float(value) for value in lens.coefficients)
    if lens.fisheye:
        terms = dict(zip(("k1", "k2", "k3", "k4"), (k1, k2, p1, p2), strict=True))
    elif any(denominator):
        raise InputDataError(
            f"nerfstudio has no camera model with the terms k4, k5 and k6 of {camera.model}; use the format "
            "colmap, or undistort the images"
        )
    else:
        terms = {"k1": k1, "k2": k2, "k3": k3, "k4": 0.0, "p1": p1, "p2": p2}
    return {
        "camera_model": "OPENCV_FISHEYE" if lens.fisheye else "OPENCV",
        "w": int(camera.width),
        "h": int(camera.height),
        "fl_x": float(lens.focal[0]),
        "fl_y": float(lens.focal[1]),
        "cx": float(lens.centre[0]),
        "cy": float(lens.centre[1]),
        **terms,
    }
