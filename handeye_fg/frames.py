"""Conventions, and the few SE(3) operations that they need.

Transforms
    ``a_T_b`` is the pose of frame b in frame a: ``p_a = a_T_b p_b``; adjacent letters cancel:
    ``base_T_camera = base_T_gripper @ gripper_T_camera``. Frames: ``base``, ``gripper``, ``camera``
    (optical: z forward, x right, y down), ``world`` (of the structure from motion: arbitrary pose
    and unit). ``X = gripper_T_camera``, ``Z = base_T_world``; motions ``A = gi_T_gj`` (robot) and
    ``B = ci_T_cj`` (camera) satisfy ``A X = X B``.
Scale
    ``metres_per_world_unit`` (the paper's lambda), positive, estimated as its logarithm.
Units
    Metres, radians, pixels, float64. Any other unit is named in a suffix (``_deg``, ``_mm``, ``_s``)
    and exists only in options, the command line, files and reports.
Covariance
    6x6, order (rotation, translation), of a right perturbation in the child frame:
    ``a_T_b = mean @ Exp(xi)``, ``xi ~ N(0, covariance)``, as in GTSAM.
Pixels
    Inside, the centre of the first pixel is at (0.5, 0.5), as in COLMAP. Files of OpenCV and ROS put
    it at (0, 0); they are converted where they are read and written.
Quaternions
    In files by name (qx, qy, qz, qw); in our JSON ``quaternion_xyzw``.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

Array = NDArray[np.float64]


def _outer_product() -> Array:
    """4 q q^T - I, by rows (16,), is linear in the rotation's entries by rows (9,): its matrix."""
    matrix = np.zeros((3, 3, 4, 4))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        # q_0^2 and q_i^2 grow with the diagonal entry, the others shrink.
        matrix[i, i] = -np.eye(4)
        matrix[i, i, 0, 0] = matrix[i, i, i + 1, i + 1] = 1.0
        # R_kj + R_jk = 4 q_j q_k and R_kj - R_jk = 4 q_0 q_i.
        for row, column, sign in ((k, j, 1.0), (j, k, -1.0)):
            matrix[row, column, j + 1, k + 1] = matrix[row, column, k + 1, j + 1] = 1.0
            matrix[row, column, 0, i + 1] = matrix[row, column, i + 1, 0] = sign
    return matrix.reshape(9, 16)


OUTER_PRODUCT = _outer_product()


def pose(rotation: Array, translation: Array) -> Array:
    """Assemble 4x4 poses from rotations (..., 3, 3) and translations (..., 3)."""
    rotation = np.asarray(rotation, dtype=np.float64)
    matrix = np.zeros((*rotation.shape[:-2], 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1.0
    return matrix


def inverse(a_T_b: Array) -> Array:
    """Return b_T_a for poses (..., 4, 4)."""
    rotation = np.swapaxes(a_T_b[..., :3, :3], -1, -2)
    return pose(rotation, -(rotation @ a_T_b[..., :3, 3:])[..., 0])


def exp(xi: Array) -> Array:
    """Exponential map of twists (..., 6), order (rotation, translation), to poses (..., 4, 4)."""
    return np.asarray(RigidTransform.from_exp_coords(xi).as_matrix())


def log(a_T_b: Array) -> Array:
    """Logarithm of poses (..., 4, 4): twists (..., 6), order (rotation, translation)."""
    return np.asarray(RigidTransform.from_matrix(a_T_b).as_exp_coords())


def adjoint(a_T_b: Array) -> Array:
    """Matrices (..., 6, 6) that take twists in frame b to the same in frame a, for poses (..., 4, 4)."""
    rotation = a_T_b[..., :3, :3]
    result = np.zeros((*a_T_b.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    # The columns of [t]_x R are the cross products of t with those of R.
    columns = np.cross(a_T_b[..., None, :3, 3], np.swapaxes(rotation, -1, -2))
    result[..., 3:, :3] = np.swapaxes(columns, -1, -2)
    return result


def scaled(world_T_camera: Array, metres_per_world_unit: float | Array) -> Array:
    """Poses (..., 4, 4) with their translations multiplied by the scale, or by scales (..., 1)."""
    result = np.array(world_T_camera, dtype=np.float64)
    result[..., :3, 3] *= metres_per_world_unit
    return result


def quaternions(rotation: Array) -> Array:
    """Unit quaternions (..., 4), scalar first and not negative, of rotations (..., 3, 3).

    The row of 4 q q^T with the largest diagonal: exact to rounding at every angle. At 180 degrees
    both signs are right, and rounding chooses.
    """
    outer = (np.reshape(rotation, (-1, 9)) @ OUTER_PRODUCT).reshape(-1, 4, 4) + np.eye(4)
    diagonal = outer[:, range(4), range(4)]
    q = outer[np.arange(len(outer)), np.argmax(diagonal, axis=1)]
    q /= np.copysign(np.sqrt(np.einsum("ki,ki->k", q, q)), q[:, 0])[:, None]
    return np.asarray(q.reshape(*np.shape(rotation)[:-2], 4))


def rotation_matrix(quaternion: Array) -> Array:
    """The rotation matrix (3, 3) of a quaternion (4,) of any length but zero, scalar first."""
    w, x, y, z = quaternion
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + 2.0 / (quaternion @ quaternion) * (w * skew + skew @ skew))


def rotation_vectors(quaternion: Array) -> Array:
    """Rotation vectors (..., 3), radians, of unit quaternions (..., 4), scalar first.

    A negative scalar gives an angle above 180 degrees: neighbouring quaternions give neighbouring
    vectors on both sides of a half turn.
    """
    sine = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, quaternion[..., :1])
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(sine > 0.0, angle / sine, 2.0)
    return np.asarray(factor * quaternion[..., 1:])


def rotation_angle(rotation: Array) -> Array:
    """Angles in radians of rotation matrices (..., 3, 3)."""
    q = quaternions(rotation)
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), q[..., 0]))


def orthonormalised(rotation: Array) -> Array:
    """The rotation matrices nearest to matrices (..., 3, 3) in the Frobenius norm."""
    u, _, vt = np.linalg.svd(rotation)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]
    return np.asarray(u @ vt)


def quaternion_xyzw(rotation: Array) -> Array:
    """Hamilton quaternion (4,), w last and not negative, of a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))
