"""Known lengths in a world of unknown scale: the distance of two cameras, the extent of many."""

from collections.abc import Sequence
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors._adapter import checked_factor, pose_key, scalar_key

Array = NDArray[np.float64]


def camera_distance_residual(
    world_T_one: gtsam.Pose3,
    world_T_other: gtsam.Pose3,
    log_metres_per_world_unit: float,
    *,
    metres: float,
    jacobian: bool = False,
) -> tuple[Array, tuple[Array, ...]]:
    """Distance between two camera centres less the measured one.

    With s = exp(log scale)::

        r = s |t_one - t_other| - metres

    No built-in factor has a scale between poses and a range.

    Args:
        world_T_one: unknown camera pose, translation in world units.
        world_T_other: likewise, of the other camera.
        log_metres_per_world_unit: unknown logarithm of the scale.
        metres: measured distance.
        jacobian: whether to return the Jacobian blocks.

    Returns:
        The residual (1,), metres, and the blocks (1, 6), (1, 6), (1, 1) in the order of the unknowns
        (empty without ``jacobian``). Where the centres coincide the blocks of the poses are zero.
    """
    scale = float(np.exp(log_metres_per_world_unit))
    offset = world_T_one.translation() - world_T_other.translation()
    length = float(np.linalg.norm(offset))
    residual = np.array([scale * length - metres])
    if not jacobian:
        return residual, ()
    direction = scale * offset / max(length, np.finfo(float).tiny)
    blocks = [
        np.concatenate([np.zeros(3), sign * pose.rotation().unrotate(direction)])[None]
        for sign, pose in ((1.0, world_T_one), (-1.0, world_T_other))
    ]
    return residual, (*blocks, np.array([[scale * length]]))


def camera_distance_factor(
    world_T_one: int,
    world_T_other: int,
    log_metres_per_world_unit: int,
    metres: float,
    noise: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """``camera_distance_residual`` bound to its three keys; ``noise`` is 1-dimensional, metres."""

    def residual(*unknowns: Any, jacobian: bool) -> tuple[Array, tuple[Array, ...]]:
        return camera_distance_residual(*unknowns, metres=metres, jacobian=jacobian)

    keys = (pose_key(world_T_one), pose_key(world_T_other), scalar_key(log_metres_per_world_unit))
    return checked_factor(keys, noise, residual)


def camera_spread_residual(
    world_T_camera: Sequence[gtsam.Pose3],
    log_metres_per_world_unit: float,
    *,
    metres: float,
    jacobian: bool = False,
) -> tuple[Array, tuple[Array, ...]]:
    """Logarithm of the extent of many cameras less that of the measured one.

    With l = log scale::

        r = l + ln sqrt(mean |t_i - mean t|^2) - ln metres

    Args:
        world_T_camera: unknown camera poses, translations in world units; not all at one place.
        log_metres_per_world_unit: unknown logarithm of the scale.
        metres: measured root mean square distance of the centres from their mean.
        jacobian: whether to return the Jacobian blocks.

    Returns:
        The residual (1,), without unit, and a block (1, 6) for each pose and (1, 1) for the scale
        (empty without ``jacobian``).
    """
    centres = np.array([pose.translation() for pose in world_T_camera])
    centred = centres - centres.mean(axis=0)
    total = float(np.sum(centred**2))
    spread = np.sqrt(total / len(centres))
    residual = np.array([log_metres_per_world_unit + np.log(spread) - np.log(metres)])
    if not jacobian:
        return residual, ()
    blocks = [
        np.concatenate([np.zeros(3), pose.rotation().unrotate(offset / total)])[None]
        for pose, offset in zip(world_T_camera, centred, strict=True)
    ]
    return residual, (*blocks, np.ones((1, 1)))


def camera_spread_factor(
    world_T_camera: Sequence[int],
    log_metres_per_world_unit: int,
    metres: float,
    noise: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """``camera_spread_residual`` bound to its keys; ``noise`` is 1-dimensional, without unit."""

    def residual(*unknowns: Any, jacobian: bool) -> tuple[Array, tuple[Array, ...]]:
        *poses, scale = unknowns
        return camera_spread_residual(poses, scale, metres=metres, jacobian=jacobian)

    keys = (*map(pose_key, world_T_camera), scalar_key(log_metres_per_world_unit))
    return checked_factor(keys, noise, residual)
