"""A model of ours as a COLMAP model in files; entry point ``write_model``."""

from pathlib import Path

import numpy as np
import pycolmap

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.sfm.native import native_camera
from handeye_fg.types import SfmModel


def write_model(model: SfmModel, folder: Path) -> None:
    """Write cameras, images and points with their tracks, in COLMAP's binary form.

    Args:
        model: the model; it keeps its world frame and unit.
        folder: where; made if missing.

    Raises:
        InputDataError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        to_reconstruction(model).write(folder)
    except (OSError, RuntimeError, ValueError) as error:
        raise InputDataError(
            f"{folder}: the model cannot be written ({error}); choose another output folder"
        ) from error


def to_reconstruction(model: SfmModel) -> pycolmap.Reconstruction:
    """The model as COLMAP has it."""
    result = pycolmap.Reconstruction()
    for k, camera in enumerate(model.cameras):
        result.add_camera_with_trivial_rig(native_camera(camera, k + 1))
    tracks = model.tracks
    place = np.empty(len(tracks.image_index), dtype=np.int64)
    camera_T_world = frames.inverse(model.world_T_camera)
    for i, name in enumerate(model.names):
        rows = np.flatnonzero(tracks.image_index == i)
        place[rows] = np.arange(len(rows))
        image = pycolmap.Image(
            name=name,
            camera_id=int(model.image_camera[i]) + 1,
            image_id=i + 1,
            keypoints=tracks.pixels[rows],
        )
        result.add_image_with_trivial_frame(image, pycolmap.Rigid3d(camera_T_world[i, :3]))
    order = np.argsort(tracks.point_index, kind="stable")
    ends = np.searchsorted(tracks.point_index[order], np.arange(len(tracks.points_world) + 1))
    for j, point in enumerate(tracks.points_world):
        track = pycolmap.Track()
        for row in order[ends[j] : ends[j + 1]].tolist():
            track.add_element(int(tracks.image_index[row]) + 1, int(place[row]))
        result.add_point3D(point, track)
    return result
