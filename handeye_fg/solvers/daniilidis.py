"""M2: rotation and translation at once, with dual quaternions.

K. Daniilidis, "Hand-eye calibration using dual quaternions", International Journal of Robotics
Research 18(3), 1999. Its a is the robot's motion A = gi_T_gj, its b the camera's B = ci_T_cj, and
(q, q') is X = gripper_T_camera: a q = q b in dual quaternions.
"""

import numpy as np

from handeye_fg.frames import Array, rotation_matrix
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.metric import MetricMotions, metres_per_radian, metric_motions, solution
from handeye_fg.solvers.solution import Solution


def daniilidis(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B by the singular vectors of one linear system (method M2).

    Lengths are measured in ``metres_per_radian``, so that the result does not depend on the unit and
    the noise of the translations hardly spoils the rotation.

    Args:
        data: robot motions A and camera motions B, both in metres, or poses that they are made of.

    Returns:
        X = gripper_T_camera.

    Raises:
        UnobservableError: fewer than two motions, no rotation, or all rotations about one axis.
        InputDataError: the rotations of robot and camera do not correspond.
    """
    motions = metric_motions(data)
    length = metres_per_radian(motions)
    null = _null_space(motions, length)
    u, v = null[:4], null[4:]
    # (q, q') = lambda_1 (u_1, v_1) + lambda_2 (u_2, v_2) with q . q' = 0: the quadratic form C
    # vanishes at (lambda_1, lambda_2). Of its two zeros one is (0, q), whose real part vanishes.
    C = 0.5 * (u.T @ v + v.T @ u)
    (low, high), axes = np.linalg.eigh(C)
    weights = np.sqrt(np.maximum([high, -low], 0.0))
    zeros = axes @ np.array([[weights[0], weights[0]], [weights[1], -weights[1]]])
    zeros /= np.linalg.norm(zeros, axis=0)
    best = zeros[:, np.argmax(np.linalg.norm(u @ zeros, axis=0))]
    q, q_dual = u @ best, v @ best
    # |q| = 1, and t_X = 2 q' conj(q).
    scale = float(np.linalg.norm(q))
    q, q_dual = q / scale, q_dual / scale
    w, x = q[0], q[1:]
    t_X = 2.0 * length * (w * q_dual[1:] - q_dual[0] * x - np.cross(q_dual[1:], x))
    return solution(motions, rotation_matrix(q), t_X)


def _null_space(motions: MetricMotions, length: float) -> Array:
    """The two vectors (8, 2) nearest to the null space of the stacked equations."""
    a, b = motions.q_A[:, 1:], motions.q_B[:, 1:]
    a_dual = _dual_vectors(motions.q_A, motions.t_A / length)
    b_dual = _dual_vectors(motions.q_B, motions.t_B / length)
    # (31): [a - b, [a + b]_x, 0, 0; a' - b', [a' + b']_x, a - b, [a + b]_x] (q, q') = 0. With the
    # blocks P = [a - b, [a + b]_x] and P' alike, T^T T of the stacked system (32) is
    # [P^T P + P'^T P', P'^T P; P^T P', P^T P].
    parts = np.concatenate([a - b, a + b, a_dual - b_dual, a_dual + b_dual], axis=1)
    moments = (parts.T * motions.weights) @ parts
    real, mixed, dual = (
        _products(moments[i : i + 6, j : j + 6]) for i, j in ((0, 0), (0, 6), (6, 6))
    )
    _, vectors = np.linalg.eigh(np.block([[real + dual, mixed.T], [mixed, real]]))
    return np.asarray(vectors[:, :2])


def _products(moments: Array) -> Array:
    """Sum of P^T P' (4, 4) from the sum of (d, s) (d', s')^T (6, 6), where P = [d, [s]_x].

    [s]_x^T d' = d' x s, d^T [s']_x = (d x s')^T and [s]_x^T [s']_x = (s . s') I - s' s^T.
    """
    dd, ds, sd, ss = moments[:3, :3], moments[:3, 3:], moments[3:, :3], moments[3:, 3:]
    result = np.empty((4, 4))
    result[0, 0] = np.trace(dd)
    result[0, 1:] = _crossed(ds)
    result[1:, 0] = _crossed(sd.T)
    result[1:, 1:] = np.trace(ss) * np.eye(3) - ss.T
    return result


def _crossed(moment: Array) -> Array:
    """Sum of x x y (3,) from the sum of x y^T (3, 3)."""
    return np.array(
        [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]
    )


def _dual_vectors(q: Array, t: Array) -> Array:
    """Vector parts (k, 3) of the dual parts t q / 2 of motions with unit quaternions q (k, 4)."""
    return 0.5 * (q[:, :1] * t + np.cross(t, q[:, 1:]))
