"""From a refinement to the scene that pictures are made of; entry point ``refined_scene``."""

import warnings
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from handeye_fg.frames import Array
from handeye_fg.graph import Refinement, reprojection_errors
from handeye_fg.io.scene_file import MOST_OBSERVATIONS, MOST_POINTS, RefinedScene
from handeye_fg.types import Indices

_MOST_THUMBNAILS = 60
_THUMBNAIL = (128, 128)  # pixels
_QUALITY = 50
_SEED = 0


def refined_scene(
    final: Refinement, names: Sequence[str], start: Array, n_known: int, images: Path | None
) -> RefinedScene:
    """The scene of a refinement, thinned where it is large.

    Args:
        final: the refinement.
        names: of its images.
        start: X (4, 4) of the linear start.
        n_known: the first so many points are corners of a target.
        images: folder of the images, for their thumbnails; None: there are none.
    """
    rng, tracks, state = np.random.default_rng(_SEED), final.tracks, final.state
    points = _some(len(state.points_world), MOST_POINTS, rng)
    seen = _some(len(tracks.pixels), MOST_OBSERVATIONS, rng)
    errors = reprojection_errors(state, tracks)[seen]
    kept = np.isfinite(errors).all(axis=1)
    metric = float(np.exp(state.log_scale)) * state.points_world[points]
    corner = tracks.point_index[seen] < n_known
    levels = np.where(corner, final.noise.corner or 1.0, final.noise.pixel)
    return RefinedScene(
        points=metric @ state.base_T_world[:3, :3].T + state.base_T_world[:3, 3],
        n_points=len(state.points_world),
        image=tracks.image_index[seen][kept],
        pixels=tracks.pixels[seen][kept],
        errors=errors[kept],
        sigmas=(final.sigma_scale[seen] * levels)[kept],
        n_observations=len(tracks.pixels),
        names=tuple(names),
        thumbnails={} if images is None else _thumbnails(images, names),
        path=np.concatenate([start[None], final.path]),
    )


def _some(count: int, most: int, rng: np.random.Generator) -> Indices:
    """Numbers below ``count``, as many as may be, in order."""
    if count <= most:
        return np.arange(count)
    return np.sort(rng.choice(count, most, replace=False))


def _thumbnails(images: Path, names: Sequence[str]) -> dict[str, bytes]:
    """Small pictures of images spread over the set; one that cannot be read any more has none."""
    chosen = np.unique(
        np.linspace(0, len(names) - 1, min(len(names), _MOST_THUMBNAILS)).astype(int)
    )
    found = {}
    for name in (names[i] for i in chosen):
        try:
            found[name] = _thumbnail(images / name)
        except (OSError, ValueError, Image.DecompressionBombError):
            continue
    return found


def _thumbnail(path: Path) -> bytes:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # remarks on metadata
        with Image.open(path) as image:
            image.draft(
                "RGB", (2 * _THUMBNAIL[0], 2 * _THUMBNAIL[1])
            )  # JPEG: decoded small at once
            deep = image.mode.startswith("I;16")
            eight = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)) if deep else image
            small = eight.convert("RGB")
    small.thumbnail(_THUMBNAIL)
    # Not with Pillow, whose writers are not safe where COLMAP's library was loaded before it.
    done, data = cv2.imencode(
        ".jpg", np.asarray(small)[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
    )
    if not done:
        raise ValueError(f"{path} cannot be encoded")
    return data.tobytes()
