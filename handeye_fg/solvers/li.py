"""A X = Z B by one linear system with Kronecker products.

A. Li, L. Wang, D. Wu, "Simultaneous robot-world and hand-eye calibration using dual-quaternions and
Kronecker product", International Journal of the Physical Sciences 5(10), 2010, its second method.
Here A = base_T_gripper and B = world_T_camera are poses, X = gripper_T_camera, Z = base_T_world.
"""

import numpy as np

from handeye_fg.errors import UnobservableError
from handeye_fg.frames import Array, orthonormalised
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.andreff_scale import kronecker_sum
from handeye_fg.solvers.metric import (
    centred_moments,
    in_lengths,
    mean_base_T_world,
    metres_per_radian,
    metric_poses,
    solution,
    translation,
)
from handeye_fg.solvers.solution import Solution

# The linear R_Z of exact data is a rotation, of norm sqrt(3). The equations of rotation are
# homogeneous: what keeps it from zero are the robot's positions alone.
LEAST_NORM = 0.5
# Least over greatest eigenvalue of the normal equations below which they are singular: rounding
# (1e-16) then leaves a millionth of a degree.
SINGULAR = 1e-8


def li(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = Z B for the entries of both rotations and translations at once.

    Lengths are measured in ``metres_per_radian``, so that the result does not depend on the unit.
    Once the rotations are orthogonal, the translations are found again from them.

    Args:
        data: poses of robot and camera, both in metres; or motions, for which Z is X again.

    Returns:
        X = gripper_T_camera and Z = base_T_world.

    Raises:
        UnobservableError: fewer than two motions, no rotation, all rotations about one axis, or a
            gripper that turns about its own origin only.
        InputDataError: the rotations of robot and camera do not correspond, or there are fewer than
            three poses.
    """
    poses, motions = metric_poses(data)
    moments = centred_moments(poses)
    z, x = _linear_rotations(poses, in_lengths(moments, metres_per_radian(motions)))
    R_X, R_Z = orthonormalised(x), orthonormalised(z)
    t_X = translation(moments, R_Z)
    return solution(motions, R_X, t_X, mean_base_T_world(poses, R_Z, t_X))


def _linear_rotations(poses: PosePairs, moments: Array) -> tuple[Array, Array]:
    """Least squares of the paper's system of 24 unknowns: R_Z, R_X (3, 3) before orthogonalisation.

        [R_A kron I   -I kron R_B^T    0   0]  [vec R_X; vec R_Z; t_X; t_Z] = [0; t_A]
        [0             I kron t_B^T  -R_A  I]

    R_A kron I is orthogonal and t_Z has the coefficient I, so that both are eliminated by hand:
    vec R_X = K^T vec R_Z / n with K = sum R_A kron R_B, and t_Z takes the means out of the rest.
    """
    weights = np.asarray(poses.weights) / np.sum(np.asarray(poses.weights))
    K = kronecker_sum(poses.base_T_gripper[:, :3, :3], poses.world_T_camera[:, :3, :3], weights)
    # Unknowns (vec R_Z, -t_X).
    normal, right = np.zeros((12, 12)), np.zeros(12)
    normal[:9, :9] = np.eye(9) - K @ K.T
    for c, G in enumerate(moments):
        unknowns = [3 * c, 3 * c + 1, 3 * c + 2, 9, 10, 11]
        normal[np.ix_(unknowns, unknowns)] += G[:6, :6]
        right[unknowns] += G[:6, 6]
    values, vectors = np.linalg.eigh(normal)
    z = (vectors / np.maximum(values, SINGULAR * values[-1]) @ (vectors.T @ right))[:9]
    if values[0] < SINGULAR * values[-1] or np.linalg.norm(z) < LEAST_NORM:
        raise UnobservableError(
            "the robot's positions do not tell the size of R_Z, on which li depends: the gripper "
            "hardly moved, or the camera's translations are not in metres; add poses that move it "
            "by a tenth of a metre or more, or use another method"
        )
    return np.asarray(z.reshape(3, 3)), np.asarray((K.T @ z).reshape(3, 3))
