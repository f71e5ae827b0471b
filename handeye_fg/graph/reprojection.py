"""Reprojection errors of many observations at once, with analytic derivatives.

The camera is COLMAP's OPENCV model, GTSAM's ``Cal3DS2``. In vector terms, for the point p seen from
the camera with rotation R and position t in the world::

    q = R' (p - t),   (x, y) = (q_1, q_2) / q_3,   r2 = x^2 + y^2,   g = 1 + k1 r2 + k2 r2^2
    u = g x + 2 p1 x y + p2 (r2 + 2 x^2),   v = g y + p1 (r2 + 2 y^2) + 2 p2 x y
    error = (fx u + skew v + cx, fy v + cy) - observed

In Lie group terms the error is ``project(world_T_camera^-1 p) - observed``, and the pose is perturbed
on the right, rotation first: ``q`` moves by ``q x w - v``. These are the errors and the derivatives of
``GenericProjectionFactorCal3DS2`` and ``GeneralSFMFactor2Cal3DS2``; GTSAM makes and evaluates such
factors one by one, which takes most of the time of a refinement.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.graph.rig import image_poses
from handeye_fg.graph.variables import CALIBRATION_DIM, State
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
        by_calibration: by fx, fy, skew, cx, cy, k1, k2, p1, p2 (m, 2, 9); None if not asked for.
    """

    errors: Array
    by_pose: Array
    by_point: Array
    by_calibration: Array | None


def reprojection_errors(state: State, tracks: Tracks) -> Array:
    """Predicted minus observed pixels (m, 2); NaN for a point behind its camera."""
    rays = _rays(state, tracks.image_index, tracks.point_index)
    found = _errors(_params(state, tracks.image_index), rays, tracks.pixels)
    found[rays.behind] = np.nan
    return found


def errors(state: State, image: Index, point: Index, pixels: Array) -> Array:
    """Errors (m, 2) as they count; the arguments are those of ``derivatives``."""
    return _errors(_params(state, image), _rays(state, image, point), pixels)


def derivatives(
    state: State, image: Index, point: Index, pixels: Array, *, with_intrinsics: bool
) -> Derivatives:
    """Errors and their derivatives.

    Args:
        state: poses, points and intrinsics.
        image: which pose (m,) belongs to an observation.
        point: which point (m,) does.
        pixels: observed (m, 2).
        with_intrinsics: whether derivatives by the intrinsics are wanted.
    """
    rays = _rays(state, image, point)
    x, y, depth = rays.x, rays.y, rays.depth
    params = _params(state, image)
    fx, fy, _, _, k1, k2, p1, p2 = params
    m, r2, xy = len(x), x * x + y * y, x * y
    radial, slope = 1.0 + r2 * (k1 + r2 * k2), 2.0 * (k1 + 2.0 * r2 * k2)
    mixed = slope * xy + 2.0 * (p1 * x + p2 * y)
    by_ray = np.empty((m, 2, 2))
    by_ray[:, 0, 0] = fx * (radial + slope * x * x + 2.0 * p1 * y + 6.0 * p2 * x)
    by_ray[:, 0, 1] = fx * mixed
    by_ray[:, 1, 0] = fy * mixed
    by_ray[:, 1, 1] = fy * (radial + slope * y * y + 6.0 * p1 * y + 2.0 * p2 * x)
    by_ray[rays.behind] = 0.0
    ray_by_pose = np.zeros((m, 2, 6))
    ray_by_pose[:, 0, :3] = np.stack([xy, -1.0 - x * x, y], axis=1)
    ray_by_pose[:, 1, :3] = np.stack([1.0 + y * y, -xy, -x], axis=1)
    ray_by_pose[:, 0, 3] = ray_by_pose[:, 1, 4] = -1.0 / depth
    ray_by_pose[:, 0, 5], ray_by_pose[:, 1, 5] = x / depth, y / depth
    by_pose = by_ray @ ray_by_pose
    # A point that moves is a camera that moves the other way.
    by_point = -by_pose[:, :, 3:] @ np.swapaxes(rays.rotations, 1, 2)[image]
    by_calibration = None
    if with_intrinsics:
        u, v = _distorted(x, y, k1, k2, p1, p2)
        by_calibration = np.zeros((m, 2, CALIBRATION_DIM))
        by_calibration[:, 0, 0], by_calibration[:, 1, 1], by_calibration[:, 0, 2] = u, v, v
        by_calibration[:, 0, 3] = by_calibration[:, 1, 4] = 1.0
        by_calibration[:, 0, 5:] = (
            fx * np.stack([x * r2, x * r2 * r2, 2.0 * xy, r2 + 2.0 * x * x])
        ).T
        by_calibration[:, 1, 5:] = (
            fy * np.stack([y * r2, y * r2 * r2, r2 + 2.0 * y * y, 2.0 * xy])
        ).T
        by_calibration[rays.behind] = 0.0
    return Derivatives(
        errors=_errors(params, rays, pixels),
        by_pose=by_pose,
        by_point=by_point,
        by_calibration=by_calibration,
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


def _params(state: State, image: Index) -> Array:
    """Parameters by row (8, m) of the cameras that took images (m,); of one camera (8,)."""
    if len(state.opencv_params) == 1:
        return np.asarray(state.opencv_params[0])
    return np.asarray(state.opencv_params[state.rig.camera[image]].T)


def _rays(state: State, image: Index, point: Index) -> _Rays:
    poses = image_poses(state)
    offset = state.points_world[point] - poses[image, :3, 3]
    q = (offset[:, None, :] @ poses[:, :3, :3][image])[:, 0]
    behind = ~(q[:, 2] > 0.0)
    depth = np.where(behind, 1.0, q[:, 2])
    return _Rays(
        x=q[:, 0] / depth,
        y=q[:, 1] / depth,
        depth=depth,
        behind=behind,
        rotations=poses[:, :3, :3],
    )


def _errors(params: Array, rays: _Rays, pixels: Array) -> Array:
    """Errors (m, 2)."""
    fx, fy, cx, cy, *distortion = params
    u, v = _distorted(rays.x, rays.y, *distortion)
    found = np.stack([fx * u + cx, fy * v + cy], axis=1) - pixels
    return np.where(rays.behind[:, None], np.reshape(_BEHIND * fx, (-1, 1)), found)


def _distorted(
    x: Array, y: Array, k1: Array, k2: Array, p1: Array, p2: Array
) -> tuple[Array, Array]:
    """Distorted image coordinates (m,), before focal length and centre."""
    r2, xy = x * x + y * y, x * y
    radial = 1.0 + r2 * (k1 + r2 * k2)
    u = radial * x + 2.0 * p1 * xy + p2 * (r2 + 2.0 * x * x)
    v = radial * y + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * xy
    return u, v
