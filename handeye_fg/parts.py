"""Parts of a reconstruction, and one of parts."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.types import CameraModel, Fragment, SfmModel, Tracks, folder_of


def only(model: SfmModel, names: Sequence[str]) -> SfmModel:
    """The model without the images that are not named, and without cameras of which there is none."""
    rows = np.array([model.names.index(name) for name in names])
    new_index = np.full(len(model.names), -1)
    new_index[rows] = np.arange(len(rows))
    cameras, image_camera = np.unique(model.image_camera[rows], return_inverse=True)
    tracks = model.tracks
    kept = new_index[tracks.image_index] >= 0
    return replace(
        model,
        names=tuple(names),
        world_T_camera=model.world_T_camera[rows],
        cameras=tuple(model.cameras[k] for k in cameras.tolist()),
        image_camera=image_camera,
        tracks=replace(
            tracks,
            image_index=new_index[tracks.image_index[kept]],
            point_index=tracks.point_index[kept],
            pixels=tracks.pixels[kept],
        ),
    )


def moved(model: SfmModel, a_T_world: Array, scale: float) -> SfmModel:
    """The model in another frame a, whose unit is smaller than the world's by ``scale``."""
    points = scale * model.tracks.points_world @ a_T_world[:3, :3].T + a_T_world[:3, 3]
    return replace(
        model,
        world_T_camera=a_T_world @ frames.scaled(model.world_T_camera, scale),
        tracks=replace(model.tracks, points_world=points),
    )


def united(one: SfmModel, other: SfmModel) -> SfmModel:
    """Two models of different cameras in one world as one; what is told of other images is the first's."""
    a, b = one.tracks, other.tracks
    return replace(
        one,
        names=one.names + other.names,
        world_T_camera=np.concatenate([one.world_T_camera, other.world_T_camera]),
        cameras=one.cameras + other.cameras,
        image_camera=np.append(one.image_camera, other.image_camera + len(one.cameras)),
        tracks=Tracks(
            points_world=np.concatenate([a.points_world, b.points_world]),
            image_index=np.append(a.image_index, b.image_index + len(one.names)),
            point_index=np.append(a.point_index, b.point_index + len(a.points_world)),
            pixels=np.concatenate([a.pixels, b.pixels]),
        ),
    )


def as_fragment(model: SfmModel) -> Fragment:
    """The cameras alone."""
    return Fragment(
        names=model.names, world_T_camera=model.world_T_camera, cameras=cameras_of(model)
    )


def cameras_of(model: SfmModel) -> dict[str, CameraModel]:
    """The intrinsics for each folder of images."""
    return {
        folder_of(name): model.cameras[k]
        for name, k in zip(model.names, model.image_camera.tolist(), strict=True)
    }
