"""Pose graphs of simulated poses, and how far they are from the truth and from each other."""

import numpy as np

from handeye_fg.findings import LinearStart
from handeye_fg.frames import exp, inverse, log
from handeye_fg.graph.poses import pose_graph


def solved(truth, start=None, **options):
    """The pose graph of simulated poses, from the closed form unless another start is given."""
    return pose_graph(
        truth.data,
        truth.start() if start is None else start,
        scale_known=truth.scale_known,
        inverted=truth.inverted,
        **options,
    )


def error(found, truth):
    """Twist (6,) from X to the true X."""
    return log(inverse(found.gripper_T_camera) @ truth.gripper_T_camera)


def stds(found):
    return np.sqrt(np.diag(found.covariance))


def assert_same(found, other, tolerance=0.05):
    """X and the scale agree to a part of a standard deviation, covariances to as much."""
    step = log(inverse(found.gripper_T_camera) @ other.gripper_T_camera) / stds(found)[:6]
    assert np.abs(step).max() < tolerance
    np.testing.assert_allclose(stds(found), stds(other), rtol=tolerance)


def moved_start(truth, twist):
    """The true X moved by a twist, with the Z and the scale of the truth."""
    return LinearStart(
        method="test",
        gripper_T_camera=truth.gripper_T_camera @ exp(np.array(twist)),
        base_T_world=truth.base_T_world,
        metres_per_world_unit=truth.unit,
        residual_rotation=0.0,
        residual_translation=0.0,
    )
