"""Reusable GTSAM factors for hand-eye calibration; needs gtsam and numpy only.

For each factor there are two functions: ``x_residual`` (pure mathematics, with analytic Jacobians on
request) and ``x_factor`` (the residual bound to keys and to the caller's noise model). Poses are
``gtsam.Pose3``; tangents are ordered (rotation, translation) and act on the right, as in GTSAM; units
are metres and radians.
"""

from factors._adapter import Key, pose_key, scalar_key
from factors.camera_distance import (
    camera_distance_factor,
    camera_distance_residual,
    camera_spread_factor,
    camera_spread_residual,
)
from factors.robot_pose import robot_pose_factor, robot_pose_residual

__all__ = [
    "Key",
    "camera_distance_factor",
    "camera_distance_residual",
    "camera_spread_factor",
    "camera_spread_residual",
    "pose_key",
    "robot_pose_factor",
    "robot_pose_residual",
    "scalar_key",
]
