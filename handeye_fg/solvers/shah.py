"""A X = Z B by the singular vectors of a sum of Kronecker products.

M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product", ASME
Journal of Mechanisms and Robotics 5(3), 2013. Here A = base_T_gripper and B = world_T_camera are
poses, X = gripper_T_camera, and Z = base_T_world is the paper's Y.
"""

import numpy as np

from handeye_fg.frames import orthonormalised
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.andreff_scale import kronecker_sum
from handeye_fg.solvers.metric import (
    centred_moments,
    mean_base_T_world,
    metric_poses,
    solution,
    translation,
)
from handeye_fg.solvers.solution import Solution

# Singular values this close to the largest (relative) are the same: half turns leave several
# solutions.
EQUAL = 1e-9


def shah(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = Z B, rotations first.

    Args:
        data: poses of robot and camera, both in metres; or motions, for which Z is X again.

    Returns:
        X = gripper_T_camera and Z = base_T_world.

    Raises:
        UnobservableError: fewer than two motions, no rotation, or all rotations about one axis.
        InputDataError: the rotations of robot and camera do not correspond, or there are fewer than
            three poses.
    """
    poses, motions = metric_poses(data)
    # K = sum R_A kron R_B, whose largest singular value is n, with vec(R_Z) = K vec(R_X) / n.
    K = kronecker_sum(
        poses.base_T_gripper[:, :3, :3],
        poses.world_T_camera[:, :3, :3],
        np.asarray(poses.weights),
    )
    left, singular, right = np.linalg.svd(K)
    # The sign, and the vector where there are several, agree with a first rotation.
    same = singular > (1.0 - EQUAL) * singular[0]
    parts = right[same] @ motions.R_start.reshape(9)
    R_X = orthonormalised((parts @ right[same]).reshape(3, 3))
    R_Z = orthonormalised((left[:, same] @ parts).reshape(3, 3))
    t_X = translation(centred_moments(poses), R_Z)
    return solution(motions, R_X, t_X, mean_base_T_world(poses, R_Z, t_X))
