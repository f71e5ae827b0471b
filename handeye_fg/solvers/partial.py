"""Whatever the motions determine of X and the scale, for motions of every kind; entry ``partial``.

A closed form gives a representative, least squares make it exact in the determined directions. What the
motions leave open is chosen, and stays as it was chosen:

- the camera's position: zero along the axis that all rotations share, or altogether if nothing turns;
- its rotation: the smallest turn that takes the camera's axis (or line of motion) to the gripper's;
- the scale: the one at which the camera travels as far as one at 0.1 m from the gripper's origin would.

Which directions those are says ``observability.analyse`` of ``first_order_covariance``. The closed form
is that of ``andreff_scale`` with its degenerate cases: the paper's theorems 1 and 2 (translations
only) and its section on planar motions.
"""

import math
from collections.abc import Sequence

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, orthonormalised, pose
from handeye_fg.known import OfXAndScale
from handeye_fg.motions import (
    AxisSpread,
    MotionPairs,
    PosePairs,
    as_motions,
    axis_spread,
    with_weight,
)
from handeye_fg.solvers.adjustment import settle
from handeye_fg.solvers.andreff_scale import (
    NEGATIVE_SCALE,
    NO_ROTATION,
    ONE_AXIS,
    SIGNIFICANT,
    least_squares,
    require_motion,
    rotation_noise,
    rotations_from_kronecker,
    translation_equations,
)
from handeye_fg.solvers.groups import grouped
from handeye_fg.solvers.solution import Solution

# Distance (metres) of the camera from the gripper's origin where nothing else gives the scale.
TYPICAL_MOUNT = 0.1
# Least over greatest extent of the translations above which they tell a rotation from a reflection.
SOLID = 0.1
# What a few motions fit by chance is not exact (metres): a shift along the axis of a single motion
# gives the scale where it is three times as large.
TYPICAL_NOISE = 1e-3
# A scale below zero by so many of its standard deviations is no chance; they are uncertain themselves.
DECISIVE = 10.0


def partial(
    data: PosePairs | MotionPairs, *, scale_known: bool, priors: Sequence[OfXAndScale] = ()
) -> Solution:
    """X and the scale, exact in what the motions determine, whatever they are.

    Args:
        data: two poses or one motion at least; camera translations in world units.
        scale_known: whether the world unit is the metre; the scale is then 1.
        priors: what else is known of X and the scale.

    Raises:
        UnobservableError: the robot or the camera did not move.
        InputDataError: the scale came out negative: the poses follow another convention.
    """
    pairs = with_weight(as_motions(data))
    require_motion(pairs)
    R_X, found = _rotation(pairs)
    t_X, scale = _translation_and_scale(pairs, R_X, found, scale_known=scale_known)
    state = settle(
        grouped(data), pose(R_X, t_X), scale, scale_known=scale_known, priors=priors, move=True
    )
    return Solution(
        gripper_T_camera=state.gripper_T_camera,
        metres_per_world_unit=1.0 if scale_known else math.exp(state.log_scale),
    )


def first_order_covariance(
    data: PosePairs | MotionPairs,
    solution: Solution,
    *,
    scale_known: bool,
    priors: Sequence[OfXAndScale] = (),
) -> Array:
    """Covariance (7, 7) of (rotation, translation, ln scale) from the residuals; always finite.

    X's part is that of a right perturbation, radians and metres. Noise is estimated from the residuals
    of absolute poses, so that motions which share poses do not count twice. Free directions have the
    variance of a wide prior; a known scale has none.

    Args:
        data: as for ``partial``.
        solution: where to linearise, an answer of any solver.
        scale_known: whether the scale is a constant.
        priors: what else is known of X and the scale.
    """
    return settle(
        grouped(data),
        np.asarray(solution.gripper_T_camera),
        solution.metres_per_world_unit,
        scale_known=scale_known,
        priors=priors,
        move=False,
    ).covariance


def _rotation(pairs: MotionPairs) -> tuple[Array, Array]:
    """R_X (3, 3): determined by the rotations, completed from the translations, or chosen.

    Also a basis (3, d) of the directions of t_X on which the motions' rotations act.
    """
    spread = axis_spread(pairs)
    noise = SIGNIFICANT * rotation_noise(pairs)
    if spread.rms_rotation[0] < max(NO_ROTATION, noise):
        return _from_translations(pairs), np.zeros((3, 0))
    if spread.rms_rotation[1] < max(ONE_AXIS * spread.rms_rotation[0], noise):
        return _about_one_axis(pairs, spread), spread.axes[:, 1:]
    everything = np.eye(3)
    candidates = rotations_from_kronecker(pairs, max(NO_ROTATION, noise))
    best = min(candidates, key=lambda R: translation_equations(pairs, R, everything)[2])
    return best, everything


def _from_translations(pairs: MotionPairs) -> Array:
    """R_X from translations t_A = lambda R_X u_B alone (theorems 1 and 2): orthogonal Procrustes.

    Raises:
        InputDataError: the translations are mirror images of each other.
    """
    t_A, u_B = pairs.gi_T_gj[:, :3, 3], pairs.ci_T_cj[:, :3, 3]
    correlation = (t_A.T * np.asarray(pairs.weights)) @ u_B
    u, singular, vt = np.linalg.svd(correlation)
    if singular[1] < ONE_AXIS**2 * singular[0]:
        return smallest_turn(vt[0], u[:, 0])
    if np.linalg.det(correlation) < 0.0 and singular[2] > SOLID**2 * singular[0]:
        raise InputDataError(NEGATIVE_SCALE)
    return orthonormalised(correlation)


def _about_one_axis(pairs: MotionPairs, spread: AxisSpread) -> Array:
    """R_X where all rotations share one axis: that axis, and a turn about it from translations.

    With n the axis in the gripper frame, m in the camera frame and R_0 the smallest rotation that
    takes m to n, R_X = Rot(n, phi) R_0. Across the axis the translation equation reads

        (R_A - I) t_X - a v - b (n x v) = -t_A,   v = R_0 u_B,   (a, b) = lambda (cos, sin)(phi)

    which is linear in (t_X, a, b). Where (a, b) cannot be told from zero, phi is zero.
    """
    R_A, t_A = pairs.gi_T_gj[:, :3, :3], pairs.gi_T_gj[:, :3, 3]
    n, plane = spread.axes[:, 0], spread.axes[:, 1:]
    R_0 = smallest_turn(_camera_axis(pairs, n), n)
    v = pairs.ci_T_cj[:, :3, 3] @ R_0.T
    columns = np.concatenate(
        [(R_A - np.eye(3)) @ plane, -v[:, :, None], -np.cross(n, v)[:, :, None]], axis=2
    )
    # The two components across the axis.
    across = np.einsum("xp,kxc->kpc", plane, columns).reshape(-1, 4)
    solution, covariance, _ = least_squares(
        across, -(t_A @ plane).reshape(-1), pairs, TYPICAL_NOISE
    )
    ab = solution[2:]
    if not np.linalg.norm(ab) > SIGNIFICANT * math.sqrt(np.trace(covariance[2:, 2:])):
        return R_0
    c, s = ab / np.linalg.norm(ab)
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    turn = c * np.eye(3) + s * cross + (1.0 - c) * np.outer(n, n)
    return orthonormalised(turn @ R_0)


def _camera_axis(pairs: MotionPairs, n: Array) -> Array:
    """The common axis of the camera's rotations, with the sense of the gripper's axis n.

    sin(angle) axis is the vector of the antisymmetric part; where all angles are 180 degrees it
    vanishes and either sense of the axis fits the rotations.
    """
    R_A, R_B = pairs.gi_T_gj[:, :3, :3], pairs.ci_T_cj[:, :3, :3]
    # R_B + R_B^T = 2 cos I + 2 (1 - cos) m m^T: m is the strongest eigenvector of the sum.
    mean = np.tensordot(np.asarray(pairs.weights), R_B, axes=1)
    _, vectors = np.linalg.eigh(mean + mean.T)
    m = np.asarray(vectors[:, -1])
    agreement = np.sum((_antisymmetric(R_A) @ n) * (_antisymmetric(R_B) @ m) * pairs.weights)
    return m if agreement >= 0.0 else -m


def _antisymmetric(R: Array) -> Array:
    """sin(angle) axis (k, 3) of rotation matrices (k, 3, 3)."""
    return 0.5 * np.stack(
        [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1
    )


def smallest_turn(m: Array, n: Array) -> Array:
    """The rotation matrix of the smallest angle that takes the unit vector m to the unit vector n."""
    half_way = m + n
    if np.linalg.norm(half_way) < 1e-9:  # opposite: any half turn about an axis across them
        half_way = np.cross(m, np.eye(3)[np.abs(m).argmin()])
        half_way /= np.linalg.norm(half_way)
        return orthonormalised(2.0 * np.outer(half_way, half_way) - np.eye(3))
    # A half turn about m maps m to itself, one about the bisector maps it to n.
    bisector = half_way / np.linalg.norm(half_way)
    turn = (2.0 * np.outer(bisector, bisector) - np.eye(3)) @ (2.0 * np.outer(m, m) - np.eye(3))
    return orthonormalised(turn)


def _translation_and_scale(
    pairs: MotionPairs, R_X: Array, found: Array, *, scale_known: bool
) -> tuple[Array, float]:
    """``[R_A - I, -R_X u_B] [t_X; lambda] = -t_A``; what is not determined is chosen.

    Raises:
        InputDataError: the scale is negative.
    """
    solution, covariance, _ = translation_equations(pairs, R_X, found, TYPICAL_NOISE)
    scale, sigma = float(solution[-1]), math.sqrt(covariance[-1, -1])
    if not scale_known and scale < -DECISIVE * sigma:
        raise InputDataError(NEGATIVE_SCALE)
    if not scale_known and scale > SIGNIFICANT * sigma:
        return found @ solution[:-1], scale
    scale = 1.0 if scale_known else _typical_scale(pairs)
    R_A, t_A = pairs.gi_T_gj[:, :3, :3], pairs.gi_T_gj[:, :3, 3]
    if not found.shape[1]:
        return np.zeros(3), scale
    columns = ((R_A - np.eye(3)) @ found).reshape(-1, found.shape[1])
    right = (scale * pairs.ci_T_cj[:, :3, 3] @ R_X.T - t_A).reshape(-1)
    return found @ least_squares(columns, right, pairs)[0], scale


def _typical_scale(pairs: MotionPairs) -> float:
    """The scale at which the camera travels as far as one mounted at a typical distance would.

    The mean square length of (R_A - I) t_X over all directions of t_X is 4/3 (1 - cos) |t_X|^2.
    """
    weights = np.asarray(pairs.weights)
    cosine = 0.5 * (np.trace(pairs.gi_T_gj[:, :3, :3], axis1=1, axis2=2) - 1.0)
    gripper = np.sum(pairs.gi_T_gj[:, :3, 3] ** 2, axis=1)
    camera = weights @ np.sum(pairs.ci_T_cj[:, :3, 3] ** 2, axis=1)
    mount = 4.0 / 3.0 * TYPICAL_MOUNT**2 * (1.0 - cosine)
    return math.sqrt(float(weights @ (gripper + mount) / camera)) if camera > 0.0 else 1.0
