"""M4: the linear formulation with Kronecker products, camera translations in metres.

N. Andreff, R. Horaud, B. Espiau, "Robot Hand-Eye Calibration using Structure-from-Motion",
IJRR 20(3), 2001. The paper exchanges A, B and inverts X against the convention here: A = gi_T_gj
(robot), B = ci_T_cj (camera), X = gripper_T_camera. In two steps:

    (R_A kron I - I kron R_B^T) vec(R_X) = 0
    (R_A - I) t_X = R_X t_B - t_A

The paper's single system of both (12 unknowns) is not used: there the noise of the translations
spoils the rotation, by an amount that depends on the unit of length.
"""

from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.metric import metric_motions, solution, translation
from handeye_fg.solvers.solution import Solution


def andreff(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B (method M4).

    Small rotations weigh less than in methods that use axes, since R_A - I vanishes with the angle.

    Args:
        data: robot motions A and camera motions B, both in metres, or poses that they are made of.

    Returns:
        X = gripper_T_camera.

    Raises:
        UnobservableError: fewer than two motions, no rotation, or all rotations about one axis.
        InputDataError: the rotations of robot and camera do not correspond.
    """
    # The first rotation of all methods is this one.
    motions = metric_motions(data)
    return solution(motions, motions.R_start, translation(motions.moments, motions.R_start))
