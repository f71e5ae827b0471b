"""M1 to M5 as their papers state them, to repeat the simulations in which they were compared.

For calibrations use ``handeye_fg.solvers``, which hold the same methods in forms that are independent of
the unit of length, hold at half turns, weigh rotations by what they tell, and refuse data that
do not determine X. With two motions and a fifth of noise they refuse most draws, rightly; these
forms always answer, so that their errors can be compared as in the paper.

Every function takes motions A = gi_T_gj and B = ci_T_cj (k, 4, 4) and returns X = gripper_T_camera
(4, 4), A X = X B; metres, but ``andreff_scale`` takes B's translations in any unit.
"""

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from handeye_fg.frames import Array, orthonormalised, pose, quaternions


def tsai_lenz(gi_T_gj: Array, ci_T_cj: Array) -> Array:
    """M1 (Tsai, Lenz 1989): Skew(P_g + P_c) P' = P_c - P_g with P = 2 sin(angle / 2) axis."""
    P_g, P_c = (2.0 * quaternions(T[:, :3, :3])[:, 1:] for T in (gi_T_gj, ci_T_cj))
    P = _least_squares(_skew(P_g + P_c).reshape(-1, 3), (P_c - P_g).ravel())
    # P' = tan(angle / 2) axis.
    skew = _skew(P)
    R_X = np.eye(3) + 2.0 / (1.0 + P @ P) * (skew + skew @ skew)
    return _with_translation(gi_T_gj, ci_T_cj, R_X)


def daniilidis(gi_T_gj: Array, ci_T_cj: Array, *, unit: float = 1.0) -> Array:
    """M2 (Daniilidis 1999): dual quaternions a q = q b, by singular vectors.

    Args:
        gi_T_gj: motions A.
        ci_T_cj: motions B.
        unit: the unit of length (metres) in which the equations are written.
    """
    a, a_dual = _dual_quaternions(gi_T_gj, unit)
    b, b_dual = _dual_quaternions(ci_T_cj, unit)
    real, dual = _product_rows(a, b), _product_rows(a_dual, b_dual)
    # (31), (32): the last two right singular vectors (u, v) span the solutions (q, q').
    T = np.block([[real, np.zeros_like(real)], [dual, real]]).reshape(-1, 8)
    u, v = np.linalg.svd(T)[2][6:].reshape(2, 2, 4).swapaxes(0, 1)
    # (35): s^2 u_1 v_1 + s (u_1 v_2 + u_2 v_1) + u_2 v_2 = 0, in whose complex roots the noise shows.
    s = np.roots([u[0] @ v[0], u[0] @ v[1] + u[1] @ v[0], u[1] @ v[1]]).real
    q = np.outer(s, u[0]) + u[1]
    norms = np.linalg.norm(q, axis=1)
    best = int(np.argmax(norms))
    q, q_dual = q[best] / norms[best], (s[best] * v[0] + v[1]) / norms[best]
    # t = 2 q' conj(q).
    t_X = 2.0 * (q[0] * q_dual[1:] - q_dual[0] * q[1:] - np.cross(q_dual[1:], q[1:]))
    return pose(Rotation.from_quat(q, scalar_first=True).as_matrix(), unit * t_X)


def horaud_dornaika(gi_T_gj: Array, ci_T_cj: Array, *, unit: float = 1.0) -> Array:
    """M3 (Horaud, Dornaika 1995): |n_A - R_X n_B|^2 + |R_X t_B - (R_A - I) t_X - t_A|^2, minimal.

    The n are unit axes. The paper keeps its quaternion at unit length by a penalty; here the steps
    are rotation vectors. The start is the paper's closed form.

    Args:
        gi_T_gj: motions A.
        ci_T_cj: motions B.
        unit: the unit of length (metres) in which the sum is written.
    """
    n_A, n_B = (_unit(quaternions(T[:, :3, :3])[:, 1:]) for T in (gi_T_gj, ci_T_cj))
    start = _with_translation(gi_T_gj, ci_T_cj, orthonormalised(n_A.T @ n_B))
    t_A, t_B, M = gi_T_gj[:, :3, 3], ci_T_cj[:, :3, 3], gi_T_gj[:, :3, :3] - np.eye(3)

    def at(step: Array) -> tuple[Array, Array]:
        R_step = Rotation.from_rotvec(step[:3]).as_matrix()
        return start[:3, :3] @ R_step, start[:3, 3] + unit * step[3:]

    def residuals(step: Array) -> Array:
        R_X, t_X = at(step)
        of_axes, of_translations = n_B @ R_X.T - n_A, t_B @ R_X.T - M @ t_X - t_A
        return np.concatenate([of_axes.ravel(), of_translations.ravel() / unit])

    return pose(*at(least_squares(residuals, np.zeros(6), method="lm").x))


def andreff(gi_T_gj: Array, ci_T_cj: Array) -> Array:
    """M4 (Andreff, Horaud, Espiau 2001), in two steps; the translations in metres."""
    return _with_translation(gi_T_gj, ci_T_cj, _kronecker_rotation(gi_T_gj, ci_T_cj))


def andreff_scale(gi_T_gj: Array, ci_T_cj: Array) -> Array:
    """M5, the same with an unknown scale: [R_A - I, -R_X u_B] (t_X, lambda) = -t_A."""
    R_X = _kronecker_rotation(gi_T_gj, ci_T_cj)
    M = (gi_T_gj[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    matrix = np.column_stack([M, -(ci_T_cj[:, :3, 3] @ R_X.T).ravel()])
    return pose(R_X, _least_squares(matrix, -gi_T_gj[:, :3, 3].ravel())[:3])


def _kronecker_rotation(gi_T_gj: Array, ci_T_cj: Array) -> Array:
    """R_X (3, 3) from the null vector of the stacked R_A kron I - I kron R_B^T."""
    one = np.eye(3)
    rows = [
        np.kron(A, one) - np.kron(one, B.T)
        for A, B in zip(gi_T_gj[:, :3, :3], ci_T_cj[:, :3, :3], strict=True)
    ]
    V = np.linalg.svd(np.concatenate(rows))[2][-1].reshape(3, 3)
    return orthonormalised(np.copysign(1.0, np.linalg.det(V)) * V)


def _with_translation(gi_T_gj: Array, ci_T_cj: Array, R_X: Array) -> Array:
    """X with the t_X that solves (R_A - I) t_X = R_X t_B - t_A."""
    M = (gi_T_gj[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = ci_T_cj[:, :3, 3] @ R_X.T - gi_T_gj[:, :3, 3]
    return pose(R_X, _least_squares(M, right.ravel()))


def _dual_quaternions(motion: Array, unit: float) -> tuple[Array, Array]:
    """Vector parts (k, 3) of the real and the dual part of motions (k, 4, 4)."""
    q, t = quaternions(motion[:, :3, :3]), motion[:, :3, 3] / unit
    return q[:, 1:], 0.5 * (q[:, :1] * t + np.cross(t, q[:, 1:]))


def _product_rows(a: Array, b: Array) -> Array:
    """[a - b, [a + b]_x] (k, 3, 4) of vectors (k, 3)."""
    return np.concatenate([(a - b)[:, :, None], _skew(a + b)], axis=2)


def _least_squares(matrix: Array, right: Array) -> Array:
    return np.asarray(np.linalg.lstsq(matrix, right)[0])


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _skew(v: Array) -> Array:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(*v.shape[:-1], 3, 3)
