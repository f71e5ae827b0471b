"""M3: non-linear least squares in rotation and translation together.

R. Horaud, F. Dornaika, "Hand-eye calibration", International Journal of Robotics Research 14(3),
1995, its simultaneous solution, started from its closed form. A = gi_T_gj is the robot's motion,
B = ci_T_cj the camera's, X = gripper_T_camera (the paper exchanges robot and camera).
"""

import numpy as np

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array, orthonormalised, rotation_matrix
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.metric import (
    in_lengths,
    metres_per_radian,
    metric_motions,
    solution,
    translation,
)
from handeye_fg.solvers.solution import Solution

# A step (radians, and lengths in the common unit) that changes nothing any more.
CONVERGED = 1e-11
# Each step leaves a part of the error that is as small as the noise: a handful is enough.
MAX_STEPS = 50


def horaud_dornaika(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B by minimising rotation and translation errors at once (method M3).

    The sum over the motions, with v = sin(angle / 2) axis and lengths in a unit in which both errors
    are alike (``metres_per_radian``), is

        |v_A - R_X v_B|^2 + |R_X t_B - (R_A - I) t_X - t_A|^2.

    The paper takes unit axes and the data's unit of length, and adds a penalty that keeps the
    quaternion near unit length. Here axes weigh by sin(angle / 2), since the axis of a small
    rotation is mostly noise; the result does not depend on the unit; and the steps are taken on the
    rotation group itself.

    Args:
        data: robot motions A and camera motions B, both in metres, or poses that they are made of.

    Returns:
        X = gripper_T_camera.

    Raises:
        UnobservableError: fewer than two motions, no rotation, or all rotations about one axis.
        InputDataError: the rotations of robot and camera do not correspond.
        ConvergenceError: the minimisation did not settle.
    """
    motions = metric_motions(data)
    # sin(angle / 2) is half the angle where it is an error.
    length = 2.0 * metres_per_radian(motions)
    v_A, v_B = motions.q_A[:, 1:], motions.q_B[:, 1:]
    # The closed form: the quaternion of the largest eigenvalue of sum Q(v_A)^T W(v_B) is that of
    # the rotation nearest to sum v_A v_B^T.
    correlation = (v_A.T * motions.weights) @ v_B
    R = orthonormalised(correlation)
    t = translation(motions.moments, R) / length
    # Both errors are linear in the rows r of R and in t: the sum over the motions is condensed into
    # z^T G z with z = (r, -t, -1). The first error adds what v_B and v_A say of r.
    moments = in_lengths(motions.moments, length)
    moments[:, :3, :3] += (v_B.T * motions.weights) @ v_B
    moments[:, :3, 6] += correlation
    moments[:, 6, :3] += correlation
    for _ in range(MAX_STEPS):
        step = _gauss_newton_step(moments, R, t)
        R, t = R @ rotation_matrix(np.array([2.0, *step[:3]])), t + step[3:]
        if np.linalg.norm(step) < CONVERGED:
            return solution(motions, R, length * t)
    raise ConvergenceError(
        f"horaud_dornaika did not settle within {MAX_STEPS} steps: robot and camera poses "
        "contradict each other; check the pose format and the unit of the camera's translations"
    )


def _gauss_newton_step(moments: Array, R: Array, t: Array) -> Array:
    """The step (6,) of (rotation vector on the right of R, t) towards the minimum."""
    hessian, gradient = np.zeros((6, 6)), np.zeros(6)
    for r, G in zip(R, moments, strict=True):
        z = np.concatenate([r, -t, [-1.0]])
        # R Exp(omega) changes the row r by r x omega.
        J = np.zeros((7, 6))
        J[:3, :3] = [[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]]
        J[3:6, 3:] = -np.eye(3)
        hessian += J.T @ G @ J
        gradient += J.T @ (G @ z)
    return np.asarray(-np.linalg.solve(hessian, gradient))
