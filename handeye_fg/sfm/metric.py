"""A reconstruction in metres in a frame of the robot, for other programs; entry point ``write_metric``."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse, orthonormalised
from handeye_fg.sfm.adjustment import adjust
from handeye_fg.sfm.cache import staging
from handeye_fg.sfm.model import FEWEST_IMAGES, ModelSource, opened, world_T_camera
from handeye_fg.sfm.native import native_camera
from handeye_fg.types import CameraModel, folder_of

_NOTE = "README.txt"
_FILES = {"cameras.bin", "frames.bin", "images.bin", "points3D.bin", "rigs.bin", _NOTE}


def write_metric(
    source: ModelSource,
    a_T_camera: Mapping[str, Array],
    cameras: Mapping[str, CameraModel],
    folder: Path,
    note: str,
) -> tuple[str, ...]:
    """Write a COLMAP model with the given camera poses and intrinsics, whole or not at all.

    Its points are those of the source, moved by the similarity between the two lists of poses and then adjusted to
    the given cameras, which stay.

    Args:
        source: the reconstruction, or its folder.
        a_T_camera: poses (4, 4) by image name, metres.
        cameras: intrinsics for each folder of images ("." for none).
        folder: where to; a model that this function wrote is replaced.
        note: what the model is, for a text file beside it.

    Returns:
        The images with a pose that the source has not; they are left out.

    Raises:
        InputDataError: the source is no model, has fewer than three of the images, or the folder holds something
            else or cannot be written.
    """
    found = opened(source)
    images = {found.images[i].name: found.images[i] for i in found.reg_image_ids()}
    names = sorted(a_T_camera.keys() & images.keys())
    if len(names) < FEWEST_IMAGES:
        raise InputDataError(
            f"the reconstruction has {len(names)} of the {len(a_T_camera)} images of the result, but at least "
            f"{FEWEST_IMAGES} are needed; give the model that the result was made from"
        )
    similarity = _similarity(
        np.array([world_T_camera(images[name]) for name in names]),
        np.array([a_T_camera[name] for name in names]),
    )
    model = pycolmap.Reconstruction()
    ids = _add_images(model, {name: (images[name], a_T_camera[name]) for name in names}, cameras)
    _add_points(model, found, similarity, ids)
    _adjust_points(model)
    _publish(model, folder, note)
    return tuple(sorted(a_T_camera.keys() - images.keys()))


def _similarity(world_T_camera: Array, a_T_camera: Array) -> pycolmap.Sim3d:
    """The similarity that carries cameras (n, 4, 4) to their given poses best: rotation, scale, translation."""
    rotation = orthonormalised(
        np.einsum("nij,nkj->ik", a_T_camera[:, :3, :3], world_T_camera[:, :3, :3])
    )
    source, target = world_T_camera[:, :3, 3] @ rotation.T, a_T_camera[:, :3, 3]
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    spread = np.sum((source - middle) ** 2)
    scale = float(np.sum((source - middle) * (target - goal)) / spread) if spread > 0.0 else 0.0
    if not scale > 0.0:
        raise InputDataError(
            "the cameras of the reconstruction lie otherwise than those of the result; give the model that the "
            "result was made from"
        )
    return pycolmap.Sim3d(scale, pycolmap.Rotation3d(rotation), goal - scale * middle)


def _add_images(
    model: pycolmap.Reconstruction,
    images: Mapping[str, tuple[pycolmap.Image, Array]],
    cameras: Mapping[str, CameraModel],
) -> dict[int, int]:
    """Add cameras and images; the new number of each image by the old one."""
    number = {folder: k for k, folder in enumerate(sorted(cameras), start=1)}
    for folder, camera in cameras.items():
        model.add_camera_with_trivial_rig(native_camera(camera, number[folder]))
    ids = {}
    for k, (name, (image, a_T_camera)) in enumerate(images.items(), start=1):
        pixels = np.array([point.xy for point in image.points2D]).reshape(-1, 2)
        added = pycolmap.Image(name, pixels, number[folder_of(name)], k)
        model.add_image_with_trivial_frame(added, pycolmap.Rigid3d(inverse(a_T_camera)[:3]))
        ids[image.image_id] = k
    return ids


def _add_points(
    model: pycolmap.Reconstruction,
    found: pycolmap.Reconstruction,
    similarity: pycolmap.Sim3d,
    ids: Mapping[int, int],
) -> None:
    """Add the points that two images or more see."""
    for point_id in sorted(found.point3D_ids()):
        point = found.points3D[point_id]
        track = pycolmap.Track()
        for element in point.track.elements:
            if element.image_id in ids:
                track.add_element(ids[element.image_id], element.point2D_idx)
        if track.length() > 1:
            model.add_point3D(similarity * point.xyz, track, point.color)


def _adjust_points(model: pycolmap.Reconstruction) -> None:
    """Move the points to where the cameras, which stay, see them."""
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = False
    options.refine_rig_from_world = options.refine_sensor_from_rig = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    options.ceres.solver_options.function_tolerance = 1e-6
    adjust(model, options, "the adjustment of the points")


def _publish(model: pycolmap.Reconstruction, folder: Path, note: str) -> None:
    if folder.exists() and not (folder.is_dir() and {p.name for p in folder.iterdir()} <= _FILES):
        raise InputDataError(
            f"{folder} exists and holds something else than a model of this program; choose another folder"
        )
    with staging(folder) as work:
        finished = work / "finished"
        try:
            finished.mkdir()
            model.write(finished)
            (finished / _NOTE).write_text(f"{note}\n", encoding="utf-8")
            if folder.exists():
                folder.replace(work / "replaced")
            finished.replace(folder)
        except (OSError, RuntimeError, ValueError) as error:
            raise InputDataError(
                f"{folder}: the model cannot be written ({error}); choose another folder"
            ) from error
