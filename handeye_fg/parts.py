"""Parts of a reconstruction."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from handeye_fg.types import Fragment, SfmModel


def only(model: SfmModel, names: Sequence[str]) -> SfmModel:
    """The model without the images that are not named."""
    rows = np.array([model.names.index(name) for name in names])
    new_index = np.full(len(model.names), -1)
    new_index[rows] = np.arange(len(rows))
    tracks = model.tracks
    kept = new_index[tracks.image_index] >= 0
    return replace(
        model,
        names=tuple(names),
        world_T_camera=model.world_T_camera[rows],
        image_camera=model.image_camera[rows],
        tracks=replace(
            tracks,
            image_index=new_index[tracks.image_index[kept]],
            point_index=tracks.point_index[kept],
            pixels=tracks.pixels[kept],
        ),
    )


def as_fragment(model: SfmModel) -> Fragment:
    """The cameras alone."""
    return Fragment(names=model.names, world_T_camera=model.world_T_camera)
