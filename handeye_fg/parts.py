"""Parts of a reconstruction."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handeye_fg.types import CameraModel, Fragment, SfmModel, folder_of


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
