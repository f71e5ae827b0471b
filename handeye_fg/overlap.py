"""Which images see the same things, from where their cameras were; entry point ``expected_matches``.

No image is looked at: the cameras' poses, which the robot gives, and some points of the scene with the
directions from which they were seen tell which pairs of images are worth matching.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import minimum_spanning_tree

from handeye_fg.frames import Array
from handeye_fg.lens import lens_of
from handeye_fg.types import CameraModel, Indices, SfmModel, Tracks

# Points that are asked for; more tell the same.
_MOST_POINTS = 2000
# Between two views of a rendered desk the matches fall to 1/e when the angle between the rays to a point
# grows by this.
_FALL = np.deg2rad(30.0)
# As far as this, in depths of the scene, two images may aim apart and still overlap by half.
_IMAGE = 0.5
# A point that was seen from some direction is seen from others up to this far from it, and hidden by the
# thing that it is on from others.
_SAME_SIDE = np.deg2rad(60.0)
# An image is divided into so many cells along each side: finer than the linear start is right, a cell may be empty
# by chance.
_CELLS = 20
# Directions beyond this multiple of the image's corner are never seen: polynomial distortion folds far
# directions back into the image.
_FOLD_GUARD = 1.5


def expected_matches(
    model: SfmModel,
    world_T_camera: Array,
    cameras: Sequence[CameraModel],
    camera: Indices,
    features: Sequence[Array] | None = None,
) -> Array:
    """How many matches of points to expect of two images, up to a factor.

    Beyond the points, near cameras count a little more than others, so that images that look where no
    points are known yet have partners.

    Args:
        model: of some of the images: points, and cameras that saw them.
        world_T_camera: camera poses (n, 4, 4) of all images, in the model's world.
        cameras: the intrinsics.
        camera: index (n,) of the camera that took an image.
        features: pixels (f, 2) of what was found in each image: it matches nowhere else, be it masked, hidden or
            smooth there. None: anywhere.

    Returns:
        Symmetric (n, n), with zeros on the diagonal.
    """
    tracks = _sample(model.tracks)
    points = tracks.points_world
    rays = points - world_T_camera[:, None, :3, 3]
    depth = np.linalg.norm(rays, axis=2)
    rays /= np.maximum(depth, np.finfo(float).tiny)[..., None]
    inside = np.stack(
        [
            _inside(
                cameras[k],
                rays[i] @ world_T_camera[i, :3, :3],
                None if features is None else features[i],
            )
            for i, k in enumerate(camera.tolist())
        ]
    )
    seen = inside & (_nearest_seen(model, tracks, rays) > np.cos(_SAME_SIDE))
    result = np.zeros((len(rays), len(rays)))
    for i, ray in enumerate(rays):
        both = seen[i] & seen[i:]
        angle = np.arccos(np.clip(np.sum(ray * rays[i:], axis=2), -1.0, 1.0))
        nearer = np.minimum(depth[i], depth[i:]) / np.maximum(depth[i], depth[i:])
        result[i, i:] = np.sum(both * np.exp(-angle / _FALL) * nearer, axis=1)
    result = np.maximum(result, result.T)
    result += _nearness(world_T_camera, float(np.median(depth[seen])) if seen.any() else 1.0)
    np.fill_diagonal(result, 0.0)
    return result


def best_partners(matches: Array, partners: int) -> NDArray[np.bool_]:
    """The pairs of images worth matching.

    Args:
        matches: what to expect of each pair (n, n), symmetric.
        partners: how many others an image is matched with, at least.

    Returns:
        Symmetric (n, n); all images are connected.
    """
    order = np.argsort(-matches, axis=1, kind="stable")[:, :partners]
    chosen = np.zeros(matches.shape, dtype=bool)
    np.put_along_axis(chosen, order, values=True, axis=1)
    # The tree with the most matches joins clusters of images of which each has its partners within.
    cost = 1.0 / (1.0 + matches)
    np.fill_diagonal(cost, 0.0)
    chosen |= minimum_spanning_tree(csr_array(cost)).toarray() > 0.0
    chosen |= chosen.T
    np.fill_diagonal(chosen, val=False)
    return chosen


def _sample(tracks: Tracks) -> Tracks:
    """The points with the longest tracks."""
    length = np.bincount(tracks.point_index, minlength=len(tracks.points_world))
    longest = np.argsort(-length, kind="stable")[:_MOST_POINTS]
    # One that lost its observations was seen from nowhere.
    chosen = np.sort(longest[length[longest] > 0])
    index = np.full(len(length), -1)
    index[chosen] = np.arange(len(chosen))
    kept = index[tracks.point_index] >= 0
    return Tracks(
        points_world=tracks.points_world[chosen],
        image_index=tracks.image_index[kept],
        point_index=index[tracks.point_index[kept]],
        pixels=tracks.pixels[kept],
    )


def _inside(camera: CameraModel, rays: Array, features: Array | None) -> NDArray[np.bool_]:
    """Which rays (p, 3), in the camera's frame, end in its image, near features (f, 2) where these are given."""
    front = rays[:, 2] > 0.0
    x, y = np.where(front, rays[:, :2].T / np.where(front, rays[:, 2], 1.0), 0.0)
    lens = lens_of(camera)
    size = np.array([camera.width, camera.height])
    corner = float(np.hypot(*(size / (2.0 * lens.focal))))
    pixels = lens.pixels(x, y)
    within = np.all((pixels >= 0.0) & (pixels <= size), axis=1)
    within &= front & (np.hypot(x, y) < _FOLD_GUARD * corner)
    if features is not None:
        cells = np.zeros((_CELLS, _CELLS), dtype=bool)
        cells[*_cells(features, size)] = True
        within[within] = cells[*_cells(pixels[within], size)]
    return np.asarray(within)


def _cells(pixels: Array, size: Array) -> tuple[Indices, Indices]:
    """The cell of the image in which pixels (m, 2) lie."""
    cells = np.clip((_CELLS * pixels / size).astype(np.int64), 0, _CELLS - 1)
    return cells[:, 0], cells[:, 1]


def _nearness(world_T_camera: Array, depth: float) -> Array:
    """How near cameras are (n, n), from 0 to 1: by their axes, and by what they aim at at the scene's depth."""
    axes = world_T_camera[:, :3, 2]
    aims = world_T_camera[:, :3, 3] + depth * axes
    angle = np.arccos(np.clip(axes @ axes.T, -1.0, 1.0))
    apart = np.linalg.norm(aims[:, None] - aims, axis=2) / depth
    return np.asarray(np.exp(-angle / _FALL - apart / _IMAGE))


def _nearest_seen(model: SfmModel, tracks: Tracks, rays: Array) -> Array:
    """Cosine (n, p) of the angle from each ray (n, p, 3) to the nearest one that saw its point."""
    order = np.argsort(tracks.point_index, kind="stable")
    point, image = tracks.point_index[order], tracks.image_index[order]
    before = tracks.points_world[point] - model.world_T_camera[image, :3, 3]
    before /= np.linalg.norm(before, axis=1, keepdims=True)
    starts = np.searchsorted(point, np.arange(len(tracks.points_world)))
    return np.stack(
        [np.maximum.reduceat(np.sum(ray[point] * before, axis=1), starts) for ray in rays]
    )
