"""A robot pose as a noisy measurement of a camera pose in a world of unknown scale."""

from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors._adapter import checked_factor, pose_key, scalar_key

Array = NDArray[np.float64]


def _slot(columns: int = 6) -> Array:
    """An output argument for one of GTSAM's own derivatives."""
    return np.zeros((6, columns), order="F")


def robot_pose_residual(
    world_T_camera: gtsam.Pose3,
    gripper_T_camera: gtsam.Pose3,
    base_T_world: gtsam.Pose3,
    log_metres_per_world_unit: float,
    *,
    base_T_gripper: gtsam.Pose3,
    jacobian: bool = False,
) -> tuple[Array, tuple[Array, ...]]:
    """Deviation of the predicted gripper pose from the reported one, in the gripper frame.

    In vector terms: predicted minus reported. In Lie group terms, with s = exp(log scale) and
    S = (R_c, s t_c) the camera pose in metres::

        r = Log( base_T_gripper^-1  base_T_world  S  gripper_T_camera^-1 )

    The scale stands on the camera's side of a metric residual; regressing noisy camera translations
    on robot ones would bias it low. No built-in factor has a scale between two frames.

    Args:
        world_T_camera: unknown camera pose, translation in world units.
        gripper_T_camera: unknown X, metres.
        base_T_world: unknown Z, metres.
        log_metres_per_world_unit: unknown logarithm of the scale.
        base_T_gripper: reported robot pose, metres.
        jacobian: whether to return the Jacobian blocks.

    Returns:
        The residual (6,), order (rotation, translation), radians and metres, and the blocks
        (6, 6), (6, 6), (6, 6), (6, 1) in the order of the unknowns (empty without ``jacobian``).
    """
    scale = float(np.exp(log_metres_per_world_unit))
    rotation = world_T_camera.rotation()
    metric = gtsam.Pose3(rotation, scale * world_T_camera.translation())
    if not jacobian:
        camera = base_T_world.compose(metric)
        gripper = camera.compose(gripper_T_camera.inverse())
        return gtsam.Pose3.Logmap(base_T_gripper.between(gripper)), ()
    d_inverse, by_z, by_metric, by_camera, by_inverse = (_slot() for _ in range(5))
    d_measured, d_between, d_log = (_slot() for _ in range(3))
    camera = base_T_world.compose(metric, by_z, by_metric)
    gripper = camera.compose(gripper_T_camera.inverse(d_inverse), by_camera, by_inverse)
    difference = base_T_gripper.between(gripper, d_measured, d_between)
    residual = gtsam.Pose3.Logmap(difference, d_log)
    by_gripper = d_log @ d_between
    d_metric = by_gripper @ by_camera @ by_metric
    metric_by_scale = np.concatenate(
        [np.zeros(3), rotation.unrotate(metric.translation())]
    )  # d(s t)/d ln s = s t, seen from the camera
    return residual, (
        d_metric * np.array([1.0, 1.0, 1.0, scale, scale, scale]),
        by_gripper @ by_inverse @ d_inverse,
        by_gripper @ by_camera @ by_z,
        (d_metric @ metric_by_scale)[:, None],
    )


def robot_pose_factor(
    world_T_camera: int,
    gripper_T_camera: int,
    base_T_world: int,
    log_metres_per_world_unit: int,
    base_T_gripper: gtsam.Pose3,
    noise: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """``robot_pose_residual`` bound to its four keys; ``noise`` is the robot's, 6-dimensional."""

    def residual(*unknowns: Any, jacobian: bool) -> tuple[Array, tuple[Array, ...]]:
        return robot_pose_residual(*unknowns, base_T_gripper=base_T_gripper, jacobian=jacobian)

    keys = (pose_key(world_T_camera), pose_key(gripper_T_camera), pose_key(base_T_world))
    return checked_factor((*keys, scalar_key(log_metres_per_world_unit)), noise, residual)
