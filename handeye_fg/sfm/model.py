"""The seam between COLMAP's reconstruction and ours; entry point ``read_model``.

COLMAP stores camera_T_world and puts the first pixel's centre at (0.5, 0.5), as we do inside: poses
are inverted here, pixels and intrinsics pass unchanged.
"""

import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap

from handeye_fg import frames
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.sfm.model_files import check_model_files, model_folder
from handeye_fg.types import CameraModel, Fragment, SfmModel, Tracks, folder_of, folders_of

ModelSource = pycolmap.Reconstruction | str | os.PathLike[str]
"""A reconstruction, or the folder of a COLMAP model in binary or text form."""

# Three cameras are the least from which robot motions determine X.
FEWEST_IMAGES = 3
# No observation is off by as much (pixels), and no camera lies as far away (world units), unless the model is
# damaged.
_LARGEST = 1e9


def read_model(source: ModelSource) -> SfmModel:
    """Convert a COLMAP model.

    Args:
        source: a reconstruction, or a folder with cameras, images and points3D (.bin or .txt), of COLMAP 3 or 4, or
            one that has it in sparse/0.

    Returns:
        The registered images in the order of their names; points in world units.

    Raises:
        InputDataError: the folder holds no readable model, or images in one folder have several
            cameras.
        ReconstructionError: fewer than 3 images are registered, or there are no points.
    """
    with _readable(source):
        model = to_sfm_model(opened(source))
    numbers = (model.world_T_camera, model.tracks.points_world, model.tracks.pixels)
    if not all(np.isfinite(array).all() for array in numbers):
        raise InputDataError(
            f"{_named(source)}: has poses, points or pixels that are no finite numbers; export the model again"
        )
    return model


def read_model_poses(source: ModelSource) -> dict[str, Array]:
    """The poses world_T_camera (4, 4) of the registered images of a COLMAP model by name, without its points.

    Raises:
        InputDataError: the folder holds no readable model.
    """
    with _readable(source):
        images = _registered(opened(source))
        return {image.name: world_T_camera(image) for image in images}


def opened(source: ModelSource) -> pycolmap.Reconstruction:
    """The reconstruction, read where it is given as a folder.

    Raises:
        InputDataError: the folder holds no readable model.
    """
    if isinstance(source, pycolmap.Reconstruction):
        return source
    if not Path(source).is_dir():
        raise InputDataError(
            f"{_named(source)}: no such folder; give the folder that holds cameras.bin, "
            "images.bin and points3D.bin (or .txt)"
        )
    folder = model_folder(Path(source)) or Path(source)
    check_model_files(folder)
    with _readable(source):
        return pycolmap.Reconstruction(folder)


@contextmanager
def _readable(source: ModelSource) -> Iterator[None]:
    """What COLMAP says of a damaged model as an error for users."""
    try:
        yield
    except (RuntimeError, ValueError, LookupError, OSError) as error:
        raise InputDataError(
            f"{_named(source)}: cannot be read ({' '.join(str(error).split())[:300]}); give the folder that holds "
            "cameras.bin, images.bin and points3D.bin (or .txt), often sparse/0"
        ) from error


def _named(source: ModelSource) -> str:
    return "COLMAP model" + ("" if isinstance(source, pycolmap.Reconstruction) else f" {source}")


def to_camera_model(camera: pycolmap.Camera) -> CameraModel:
    """COLMAP's camera as ours."""
    return CameraModel(
        model=camera.model.name,
        width=camera.width,
        height=camera.height,
        params=np.asarray(camera.params, dtype=np.float64),
    )


def to_sfm_model(
    reconstruction: pycolmap.Reconstruction, unregistered: tuple[tuple[str, str], ...] | None = None
) -> SfmModel:
    """Convert a reconstruction; ``unregistered``: None takes the images without pose from it."""
    images = _registered(reconstruction)
    if unregistered is None:
        unregistered = tuple(
            (image.name, "not registered in the model")
            for image in sorted(reconstruction.images.values(), key=lambda image: image.name)
            if not image.has_pose
        )
    if len(images) < FEWEST_IMAGES:
        raise ReconstructionError(too_few(len(images), len(images) + len(unregistered)))
    camera_ids = _cameras(images)
    tracks, mean_reprojection_px = _tracks(reconstruction, images)
    return SfmModel(
        names=tuple(image.name for image in images),
        world_T_camera=np.stack([world_T_camera(image) for image in images]),
        cameras=tuple(to_camera_model(reconstruction.cameras[i]) for i in camera_ids),
        image_camera=np.array([camera_ids.index(image.camera_id) for image in images]),
        tracks=tracks,
        mean_reprojection_px=mean_reprojection_px,
        unregistered=unregistered,
    )


def to_fragment(reconstruction: pycolmap.Reconstruction) -> Fragment:
    """The poses of a reconstruction that others stand beside."""
    images = _registered(reconstruction)
    return Fragment(
        names=tuple(image.name for image in images),
        world_T_camera=np.array([world_T_camera(image) for image in images]).reshape(-1, 4, 4),
        cameras={
            folder_of(image.name): to_camera_model(reconstruction.cameras[image.camera_id])
            for image in images
        },
    )


def _registered(reconstruction: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    """The images that have a pose, in the order of their names."""
    images = (reconstruction.images[i] for i in reconstruction.reg_image_ids())
    return sorted(images, key=lambda image: image.name)


def _cameras(images: list[pycolmap.Image]) -> list[int]:
    """The cameras' numbers in the order of their images' folders.

    Raises:
        InputDataError: images in one folder have several cameras.
    """
    ids = list(dict.fromkeys(image.camera_id for image in images))
    folders = {(folder_of(image.name), image.camera_id) for image in images}
    if len(ids) > 1 and len(folders) > len(folders_of([image.name for image in images])):
        raise InputDataError(
            f"the COLMAP model has {len(ids)} cameras, but all images in a folder must share one; "
            "reconstruct with a single camera (--ImageReader.single_camera 1), or with one for each "
            "folder (--ImageReader.single_camera_per_folder 1)"
        )
    return ids


def too_few(registered: int, total: int) -> str:
    """The sentence for a reconstruction that is too small to calibrate with."""
    return (
        f"structure from motion placed {registered} of {total} images, but at least {FEWEST_IMAGES} "
        "are needed; take sharper, more textured, more overlapping images, and mask what moves with "
        "the camera"
    )


def world_T_camera(image: pycolmap.Image) -> Array:
    """The pose (4, 4) of a registered image.

    Raises:
        InputDataError: it is none: the model is damaged.
    """
    camera_T_world = np.eye(4)
    camera_T_world[:3] = image.cam_from_world().matrix()
    rotation = camera_T_world[:3, :3]
    # Its square and its inverse may overflow where it is none.
    bounded = np.abs(rotation).max() < 2.0 and np.abs(camera_T_world).max() < _LARGEST
    if not (bounded and np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-6)):
        raise InputDataError(
            f"the pose of image {image.name} in the COLMAP model is no rotation and position; export the model again"
        )
    return frames.inverse(camera_T_world)


def _tracks(
    reconstruction: pycolmap.Reconstruction, images: list[pycolmap.Image]
) -> tuple[Tracks, float]:
    """Points and observations of the images, and the mean length of the reprojection errors."""
    point_ids = sorted(reconstruction.point3D_ids())
    position = {point_id: i for i, point_id in enumerate(point_ids)}
    image_index: list[int] = []
    point_index: list[int] = []
    pixels: list[Array] = []
    for i, image in enumerate(images):
        for point2D in image.get_observation_points2D():
            image_index.append(i)
            if point2D.point3D_id not in position:
                raise InputDataError(
                    f"the COLMAP model lacks point {point2D.point3D_id}, which image {image.name} observes; export "
                    "the model again, with all its files"
                )
            point_index.append(position[point2D.point3D_id])
            pixels.append(point2D.xy)
    if not pixels:
        raise ReconstructionError(
            "the reconstruction has no points that the images observe; give a model with its points "
            "(points3D and the observations in images), or the images themselves"
        )
    points = reconstruction.points3D
    tracks = Tracks(
        points_world=np.array([points[point_id].xyz for point_id in point_ids]),
        image_index=np.array(image_index),
        point_index=np.array(point_index),
        pixels=np.array(pixels),
    )
    tracks = _distinct(tracks)
    return tracks, _mean_reprojection(tracks, images)


def _distinct(tracks: Tracks) -> Tracks:
    """One observation for each place in an image, that of the longest track.

    SIFT gives a keypoint with two orientations twice. Both are one measurement: counted twice they
    would make the result look surer than it is, and a mismatch weigh double.
    """
    length = np.bincount(tracks.point_index, minlength=len(tracks.points_world))
    order = np.argsort(-length[tracks.point_index], kind="stable")
    places = np.column_stack([tracks.image_index, tracks.pixels])[order]
    _, first = np.unique(places, axis=0, return_index=True)
    kept = np.sort(order[first])
    return replace(
        tracks,
        image_index=tracks.image_index[kept],
        point_index=tracks.point_index[kept],
        pixels=tracks.pixels[kept],
    )


def _mean_reprojection(tracks: Tracks, images: list[pycolmap.Image]) -> float:
    """Mean length in pixels, by COLMAP's own projection; behind a camera counts as not a number."""
    lengths = []
    for i, image in enumerate(images):
        seen = tracks.image_index == i
        camera_T_world = image.cam_from_world().matrix()
        points = tracks.points_world[tracks.point_index[seen]]
        camera = image.camera
        if camera is None or not len(points):
            continue
        with np.errstate(over="ignore", invalid="ignore"):  # of damaged numbers
            local = points @ camera_T_world[:, :3].T + camera_T_world[:, 3]
            error = camera.img_from_cam(local) - tracks.pixels[seen]
            lengths.append(np.hypot(error[:, 0], error[:, 1]))
    every = np.concatenate(lengths)
    every = every[~np.isnan(every)]
    mean = float(every.mean()) if len(every) and every.max() < _LARGEST else math.nan
    if not math.isfinite(mean):
        raise InputDataError(
            "the points of the COLMAP model do not project into its images: its poses, points or cameras are "
            "damaged; export the model again"
        )
    return mean
