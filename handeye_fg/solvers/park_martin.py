"""Rotation from the logarithms of the rotations, by least squares on the Lie algebra.

F. C. Park, B. J. Martin, "Robot sensor calibration: solving AX = XB on the Euclidean group", IEEE
Transactions on Robotics and Automation 10(5), 1994. As there, A = gi_T_gj is the robot's motion,
B = ci_T_cj the camera's, X = gripper_T_camera.
"""

from handeye_fg.frames import orthonormalised, rotation_vectors
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.metric import metric_motions, solution, translation
from handeye_fg.solvers.solution import Solution


def park_martin(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B on the Euclidean group.

    The logarithm jumps to its opposite at half turns; where noise puts A and B on either side, the
    angle of one is continued beyond 180 degrees.

    Args:
        data: robot motions A and camera motions B, both in metres, or poses that they are made of.

    Returns:
        X = gripper_T_camera.

    Raises:
        UnobservableError: fewer than two motions, no rotation, or all rotations about one axis.
        InputDataError: the rotations of robot and camera do not correspond.
    """
    motions = metric_motions(data)
    alpha, beta = rotation_vectors(motions.q_A), rotation_vectors(motions.q_B)
    # M = sum beta alpha^T and R_X = (M^T M)^(-1/2) M^T: the orthogonal factor of M^T, which the
    # projection also gives for M of rank two (rotations about two axes).
    R_X = orthonormalised((alpha.T * motions.weights) @ beta)
    # (R_A - I) t_X = R_X t_B - t_A in the least squares sense.
    return solution(motions, R_X, translation(motions.moments, R_X))
