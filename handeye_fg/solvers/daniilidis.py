"""M2: rotation and translation at once, with dual quaternions.

K. Daniilidis, "Hand-eye calibration using dual quaternions", International Journal of Robotics
Research 18(3), 1999. Its a is the robot's motion A = gi_T_gj, its b the camera's B = ci_T_cj, and
(q, q') is X = gripper_T_camera: a q = q b in dual quaternions.
"""

import numpy as np

from handeye_fg.frames import Array
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.solvers.metric import MetricMotions, metres_per_radian, metric_motions, solution
from handeye_fg.solvers.solution import Solution


def daniilidis(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B by the singular vectors of one linear system (method M2).

    Lengths are measured by the typical translation, so that the result does not depend on the unit.
    The noise of the translations spoils the rotation a little: the price of a joint solution.

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
    return solution(motions, _matrix(q), t_X)


def _null_space(motions: MetricMotions, length: float) -> Array:
    """The two vectors (8, 2) nearest to the null space of the stacked equations (6 k, 8)."""
    a, b = motions.q_A[:, 1:], motions.q_B[:, 1:]
    a_dual = _dual_vectors(motions.q_A, motions.t_A / length)
    b_dual = _dual_vectors(motions.q_B, motions.t_B / length)
    # (31): [a - b, [a + b]_x, 0, 0; a' - b', [a' + b']_x, a - b, [a + b]_x] (q, q') = 0.
    real, dual = _rows(a, b), _rows(a_dual, b_dual)
    # T^T T, of T = (S_1 ... S_n) in (32), from the products of its blocks.
    blocks = np.concatenate([real, dual], axis=2)
    weighted = blocks * motions.weights[:, None, None]
    products = weighted.reshape(-1, 8).T @ blocks.reshape(-1, 8)
    normal = products[:4, :4] + products[4:, 4:]
    normal = np.block([[normal, products[4:, :4]], [products[:4, 4:], products[:4, :4]]])
    _, vectors = np.linalg.eigh(normal)
    return np.asarray(vectors[:, :2])


def _dual_vectors(q: Array, t: Array) -> Array:
    """Vector parts (k, 3) of the dual parts t q / 2 of motions with unit quaternions q (k, 4)."""
    return 0.5 * (q[:, :1] * t + np.cross(t, q[:, 1:]))


def _rows(a: Array, b: Array) -> Array:
    """[a - b, [a + b]_x] (k, 3, 4) of vectors (k, 3)."""
    s = a + b
    rows = np.zeros((len(a), 3, 4))
    rows[:, :, 0] = a - b
    rows[:, 0, 2], rows[:, 0, 3] = -s[:, 2], s[:, 1]
    rows[:, 1, 1], rows[:, 1, 3] = s[:, 2], -s[:, 0]
    rows[:, 2, 1], rows[:, 2, 2] = -s[:, 1], s[:, 0]
    return rows


def _matrix(q: Array) -> Array:
    """The rotation matrix of a unit quaternion (4,), scalar first."""
    w, (x, y, z) = q[0], q[1:]
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + 2.0 * (w * skew + skew @ skew))
