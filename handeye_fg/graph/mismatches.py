"""Observations that are no measurements of their point: found by their residuals; ``without_mismatches``."""

from dataclasses import dataclass, replace

import numpy as np

from handeye_fg.errors import ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.graph.reprojection import reprojection_errors
from handeye_fg.graph.rig import image_poses
from handeye_fg.graph.variables import State
from handeye_fg.types import Tracks

# Observations further than this from their prediction are mismatches: of Gaussian ones 0.03 % are.
_REJECTION_SIGMAS = 4.0
_SMALLEST_SIGMA_PX = 1e-6  # of exact observations
# Two lines of sight that meet at 1.2 degrees; a smaller angle leaves the depth to the noise.
_MIN_PARALLAX = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Kept:
    """Values of the unknowns and the observations that are used.

    Attributes:
        state: the values; its points are those of ``tracks``.
        tracks: the observations.
        sigma_scale: their relative standard deviations (m,).
        pixel, corner: robust standard deviations of the observations of unknown points and of known
            ones, pixels; 1 where there are none.
    """

    state: State
    tracks: Tracks
    sigma_scale: Array
    pixel: float
    corner: float


def _parallax(state: State, tracks: Tracks, kept: Array) -> Array:
    """Root mean square angle (p,) of each point's lines of sight to their mean direction, radians.

    Zero for a point that is seen once or never.
    """
    points = tracks.point_index[kept]
    lines = state.points_world[points] - image_poses(state)[tracks.image_index[kept], :3, 3]
    lines /= np.linalg.norm(lines, axis=1, keepdims=True)
    n_points = len(state.points_world)
    total = np.stack([np.bincount(points, axis, n_points) for axis in lines.T], axis=1)
    mean = total / np.maximum(np.bincount(points, minlength=n_points), 1)[:, None]
    cosine_squared = np.sum(mean**2, axis=1)
    return np.where(cosine_squared > 0, np.sqrt(np.clip(1.0 - cosine_squared, 0.0, None)), 0.0)


def _robust_sigma(errors: Array) -> float:
    """Standard deviation of an error's component, by the median; 1 where there are none."""
    sigma = float(1.4826 * np.median(np.abs(errors))) if len(errors) else 1.0
    return max(sigma, _SMALLEST_SIGMA_PX)


def without_mismatches(state: State, tracks: Tracks, sigma_scale: Array, n_known: int = 0) -> Kept:
    """Leave out mismatches, and the points whose depth is then no longer determined.

    The first ``n_known`` points are known: they need neither parallax nor observations. Each of several
    cameras has a standard deviation of its own: a blurred one must not make the others look worse, nor
    the wrong intrinsics of one make all its observations mismatches.

    Raises:
        ReconstructionError: too few are left to determine cameras and points.
    """
    errors = reprojection_errors(state, tracks) / sigma_scale[:, None]
    finite = np.isfinite(errors).all(axis=1)
    length = np.linalg.norm(errors, axis=1)
    corner = tracks.point_index < n_known
    camera = state.rig.camera[tracks.image_index]
    sigmas, relative = [], np.ones(len(errors))
    for group in (~corner & finite, corner & finite):
        sigmas.append(_robust_sigma(errors[group]))
        for k in range(state.rig.n_cameras):
            own = group & (camera == k)
            relative[own] = _robust_sigma(errors[own]) / sigmas[-1]
    limits = _REJECTION_SIGMAS * np.where(corner, sigmas[1], sigmas[0]) * relative
    kept = finite & (length <= limits)
    kept &= corner | (_parallax(state, tracks, kept) >= _MIN_PARALLAX)[tracks.point_index]
    used, point_index = np.unique(
        np.concatenate([np.arange(n_known), tracks.point_index[kept]]), return_inverse=True
    )
    points = state.points_world[used]
    left = Tracks(
        points_world=points,
        image_index=tracks.image_index[kept],
        point_index=point_index[n_known:],
        pixels=tracks.pixels[kept],
    )
    n_images = len(state.rig.pose)
    if 2 * len(left.pixels) < 3 * (len(points) - n_known) + 6 * n_images:
        raise ReconstructionError(
            f"only {len(left.pixels)} observations of {len(points)} points are left in {n_images} "
            "images, too few to refine; take sharper, more textured or more overlapping images"
        )
    return Kept(
        state=replace(state, points_world=points),
        tracks=left,
        sigma_scale=(sigma_scale * relative)[kept],
        pixel=sigmas[0],
        corner=sigmas[1],
    )
