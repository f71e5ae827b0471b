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


def scaled(world_T_camera: Array, metres_per_world_unit: float) -> Array:
    """Poses (..., 4, 4) with their translations multiplied by the scale."""
    result = np.array(world_T_camera, dtype=np.float64)
    result[..., :3, 3] *= metres_per_world_unit
    return result


def rotation_angle(rotation: Array) -> Array:
    """Angles in radians of rotation matrices (..., 3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).magnitude())


def orthonormalised(rotation: Array) -> Array:
    """The rotation matrix nearest to a 3x3 matrix in the Frobenius norm."""
    u, _, vt = np.linalg.svd(rotation)
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)


def quaternion_xyzw(rotation: Array) -> Array:
    """Hamilton quaternion (4,), w last and not negative, of a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(rotation).as_quat(canonical=True))
