"""Reprojection errors of many observations at once, with analytic derivatives.

For the point p seen from the camera with rotation R and position t in the world::

    q = R' (p - t),   (x, y) = (q_1, q_2) / q_3,   error = lens(x, y) - observed

with any lens of ``handeye_fg.lens``. In Lie group terms the error is
``project(world_T_camera^-1 p) - observed``, and the pose is perturbed on the right, rotation first:
``q`` moves by ``q x w - v``. Where GTSAM has the camera model, these are the errors and the derivatives
of its ``GenericProjectionFactor`` and ``GeneralSFMFactor2``; GTSAM makes and evaluates such factors one
by one, which takes most of the time of a refinement.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.graph.rig import image_poses
from handeye_fg.graph.variables import State
from handeye_fg.lens import embedding, lens_of
from handeye_fg.types import Tracks

Index = NDArray[np.integer]

# A point behind its camera has no image. Like GTSAM's factor, it counts as off by twice the focal
# length in each coordinate, whatever the unknowns, so that a step that sends it there is refused.
_BEHIND = 2.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Derivatives:
    """Errors of m observations and how they change.

    Attributes:
        errors: predicted minus observed (m, 2), pixels.
        by_pose: by the tangent of world_T_camera (m, 2, 6).
        by_point: by the point (m, 2, 3).
        by_intrinsics: by those parameters of the cameras that were asked for (m, 2, k).
    """

    errors: Array
    by_pose: Array
    by_point: Array
    by_intrinsics: Array


def reprojection_errors(state: State, tracks: Tracks) -> Array:
    """Predicted minus observed pixels (m, 2); NaN for a point behind its camera."""
    rays = _rays(state, tracks.image_index, tracks.point_index)
    found = _errors(state, tracks.image_index, rays, tracks.pixels)
    found[rays.behind] = np.nan
    return found


def errors(state: State, image: Index, point: Index, pixels: Array) -> Array:
    """Errors (m, 2) as they count; the arguments are those of ``derivatives``."""
    return _errors(state, image, _rays(state, image, point), pixels)


def derivatives(
    state: State,
    image: Index,
    point: Index,
    pixels: Array,
    intrinsics: Sequence[Sequence[int]] = (),
) -> Derivatives:
    """Errors and their derivatives.

    Args:
        state: poses, points and intrinsics.
        image: which pose (m,) belongs to an observation.
        point: which point (m,) does.
        pixels: observed (m, 2).
        intrinsics: by which parameters of each camera derivatives are wanted; empty: by none.
    """
    rays = _rays(state, image, point)
    x, y, depth = rays.x, rays.y, rays.depth
    m, xy = len(x), x * y
    by_ray = np.empty((m, 2, 2))
    by_intrinsics = np.zeros((m, 2, sum(map(len, intrinsics))))
    column = 0
    for k, rows in _by_camera(state, image):
        lens = lens_of(state.cameras[k])
        by_ray[rows] = lens.by_ray(x[rows], y[rows]) * lens.focal[:, None]
        if intrinsics and len(intrinsics[k]):
            into = embedding(state.cameras[k].model)[:, list(intrinsics[k])]
            block = by_intrinsics[:, :, column : column + len(intrinsics[k])]
            by_params = lens.by_params(x[rows], y[rows])
            # One product, not one for each observation.
            product = by_params.reshape(-1, len(into)) @ into
            block[rows] = product.reshape(*by_params.shape[:2], into.shape[1])
            column += len(intrinsics[k])
    by_ray[rays.behind] = 0.0
    by_intrinsics[rays.behind] = 0.0
    ray_by_pose = np.zeros((m, 2, 6))
    ray_by_pose[:, 0, :3] = np.stack([xy, -1.0 - x * x, y], axis=1)
    ray_by_pose[:, 1, :3] = np.stack([1.0 + y * y, -xy, -x], axis=1)
    ray_by_pose[:, 0, 3] = ray_by_pose[:, 1, 4] = -1.0 / depth
    ray_by_pose[:, 0, 5], ray_by_pose[:, 1, 5] = x / depth, y / depth
    by_pose = by_ray @ ray_by_pose
    # A point that moves is a camera that moves the other way.
    camera_R_world = np.ascontiguousarray(np.swapaxes(rays.rotations, 1, 2))  # products are faster
    by_point = -by_pose[:, :, 3:] @ camera_R_world[image]
    return Derivatives(
        errors=_errors(state, image, rays, pixels),
        by_pose=by_pose,
        by_point=by_point,
        by_intrinsics=by_intrinsics,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rays:
    """Where the camera sees the points (m,): x, y, depth, and whether behind it; then depth is 1.

    ``rotations`` are those of the images, world_T_camera (n, 3, 3).
    """

    x: Array
    y: Array
    depth: Array
    behind: NDArray[np.bool_]
    rotations: Array


def _by_camera(state: State, image: Index) -> Iterator[tuple[int, slice | Index]]:
    """Each camera, and the observations in its images (m,)."""
    if len(state.cameras) == 1:
        yield 0, slice(None)
        return
    camera = state.rig.camera[image]
    for k in range(len(state.cameras)):
        yield k, np.flatnonzero(camera == k)


def _rays(state: State, image: Index, point: Index) -> _Rays:
    poses = image_poses(state)
    offset = state.points_world[point] - poses[image, :3, 3]
    q = np.einsum("mi,mij->mj", offset, poses[:, :3, :3][image])
    behind = ~(q[:, 2] > 0.0)
    depth = np.where(behind, 1.0, q[:, 2])
    return _Rays(
        x=q[:, 0] / depth,
        y=q[:, 1] / depth,
        depth=depth,
        behind=behind,
        rotations=poses[:, :3, :3],
    )


def _errors(state: State, image: Index, rays: _Rays, pixels: Array) -> Array:
    """Errors (m, 2)."""
    found = np.empty((len(pixels), 2))
    for k, rows in _by_camera(state, image):
        lens = lens_of(state.cameras[k])
        predicted = lens.pixels(rays.x[rows], rays.y[rows]) - pixels[rows]
        predicted[rays.behind[rows]] = _BEHIND * lens.focal[0]
        found[rows] = predicted
    return found
