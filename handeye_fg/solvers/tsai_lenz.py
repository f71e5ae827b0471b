"""M1: rotation from Rodrigues vectors, then translation.

R. Y. Tsai, R. K. Lenz, "A new technique for fully autonomous and efficient 3D robotics hand/eye
calibration", IEEE Transactions on Robotics and Automation 5(3), 1989. Its H_gij is the robot's
motion A = gi_T_gj, its H_cij the camera's B = ci_T_cj, its H_cg X = gripper_T_camera.
"""

import numpy as np

from handeye_fg.frames import rotation_matrix
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.metric import metric_motions, solution, translation
from handeye_fg.solvers.solution import Solution


def tsai_lenz(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B (method M1).

    The paper's unknown is tan(angle / 2) axis of R_X, infinite for half turns. Here the problem is
    first turned by a rotation R_0 close to R_X, B -> R_0 B R_0^T, which leaves an unknown close to
    zero; it also gives all motions the weight of their own angle, where the paper's factor
    |P_gij + P_cij| depends on the angle of R_X and vanishes for half turns.

    Args:
        data: robot motions A and camera motions B, both in metres, or poses that they are made of.

    Returns:
        X = gripper_T_camera.

    Raises:
        UnobservableError: fewer than two motions, no rotation, or all rotations about one axis.
        InputDataError: the rotations of robot and camera do not correspond.
    """
    motions = metric_motions(data)
    # (9): P = 2 sin(angle / 2) axis, here without the factor, which all terms share.
    P_gij, P_cij = motions.q_A[:, 1:], motions.q_B[:, 1:] @ motions.R_start.T
    # (12): Skew(P_gij + P_cij) P' = P_cij - P_gij, by its normal equations:
    # Skew(s)^T Skew(s) = |s|^2 I - s s^T and Skew(s)^T d = d x s.
    s, d = P_gij + P_cij, P_cij - P_gij
    weighted = s * motions.weights[:, None]
    normal = np.sum(weighted * s) * np.eye(3) - weighted.T @ s
    P = np.linalg.solve(normal, np.sum(np.cross(d, weighted), axis=0))
    # (14) and (10): P' = tan(angle / 2) axis is the quaternion (1, P') but for its length.
    R_X = rotation_matrix(np.array([1.0, *P])) @ motions.R_start
    # (15): (R_gij - I) T_cg = R_cg T_cij - T_gij.
    return solution(motions, R_X, translation(motions.moments, R_X))
