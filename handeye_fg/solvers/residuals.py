"""How well X and the scale fit: base_T_world, and what robot and camera disagree by."""

import numpy as np

from handeye_fg.frames import Array, orthonormalised, pose, rotation_angle, scaled
from handeye_fg.motions import MotionPairs, PosePairs


def average_base_T_world(base_T_camera: Array, world_T_camera: Array) -> Array:
    """Z (..., 4, 4) that best takes camera poses in world to those in base, (..., n, 4, 4) in metres.

    The rotation is the chordal mean; with it the translation matches the centroids, so that the
    result follows any change of the world frame exactly.
    """
    products = base_T_camera[..., :3, :3] @ np.swapaxes(world_T_camera[..., :3, :3], -1, -2)
    rotation = orthonormalised(products.mean(axis=-3))
    centre_base, centre_world = (
        poses[..., :3, 3].mean(axis=-2) for poses in (base_T_camera, world_T_camera)
    )
    return pose(rotation, centre_base - np.einsum("...ij,...j->...i", rotation, centre_world))


def motion_residuals(
    pairs: MotionPairs, gripper_T_camera: Array, metres_per_world_unit: float
) -> tuple[Array, Array]:
    """A X against X B: angles (k,) in radians and lengths (k,) in metres of their difference."""
    return differences(
        pairs.gi_T_gj @ gripper_T_camera,
        gripper_T_camera @ scaled(pairs.ci_T_cj, metres_per_world_unit),
    )


def row_residuals(
    data: PosePairs | MotionPairs,
    gripper_T_camera: Array,
    metres_per_world_unit: float,
    base_T_world: Array | None,
) -> tuple[Array, Array]:
    """What robot and camera disagree by in each row.

    Args:
        data: poses, A X against Z B; or motions, A X against X B.
        gripper_T_camera: X (4, 4), metres.
        metres_per_world_unit: the scale of B.
        base_T_world: Z (4, 4), metres; None for motions.

    Returns:
        Angles (n,) in radians and distances (n,) in metres.

    Raises:
        ValueError: poses without base_T_world.
    """
    if isinstance(data, MotionPairs):
        return motion_residuals(data, gripper_T_camera, metres_per_world_unit)
    if base_T_world is None:
        raise ValueError(f"{base_T_world=} but expected a pose")
    return differences(
        data.base_T_gripper @ gripper_T_camera,
        base_T_world @ scaled(data.world_T_camera, metres_per_world_unit),
    )


def world_of(
    data: PosePairs | MotionPairs, gripper_T_camera: Array, metres_per_world_unit: float
) -> Array | None:
    """Z (4, 4), metres, that fits the rows best; None for motions, which have no world."""
    if isinstance(data, MotionPairs):
        return None
    return average_base_T_world(
        data.base_T_gripper @ gripper_T_camera, scaled(data.world_T_camera, metres_per_world_unit)
    )


def differences(left: Array, right: Array) -> tuple[Array, Array]:
    """Angles (...) and distances (...) between poses (..., 4, 4)."""
    turn = np.swapaxes(left[..., :3, :3], -1, -2) @ right[..., :3, :3]
    shift = right[..., :3, 3] - left[..., :3, 3]
    return rotation_angle(turn), np.asarray(np.linalg.norm(shift, axis=-1))
