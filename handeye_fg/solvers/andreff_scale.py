"""M5: hand-eye self-calibration with an unknown scale, linear, in two steps.

N. Andreff, R. Horaud, B. Espiau, "Robot Hand-Eye Calibration using Structure-from-Motion",
IJRR 20(3), 2001, section "Using structure-from-motion". There A is the camera's motion, B the
robot's and X = camera_T_gripper. Here the roles are exchanged: A = gi_T_gj is the robot's motion,
B = ci_T_cj the camera's, and X = gripper_T_camera; A X = X B in both. The camera's translation is
known as u_B up to a factor of the whole sequence, t_B = lambda u_B:

    R_A R_X = R_X R_B                                        (rotation)
    (R_A - I) t_X - lambda R_X u_B = -t_A                    (translation)

Step 1 finds R_X and keeps it orthogonal; step 2 is linear in (t_X, lambda). Where the rotations
share one axis or vanish, the rotation equations leave R_X free about that axis or altogether; R_X
is then completed from the translations (the paper's theorems 1 and 2 and its section on planar
motions), and what t_X lacks is set to zero: the minimum-norm solution.
"""

import math

import numpy as np

from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, orthonormalised, rotation_angle
from handeye_fg.motions import (
    AxisSpread,
    MotionPairs,
    PosePairs,
    as_motions,
    axis_spread,
    with_weight,
)
from handeye_fg.solvers.solution import Solution

# Rotations smaller than this (rms, radians) are taken for noise of a translating robot, however
# well they agree: deliberate rotations have ten degrees or more.
NO_ROTATION = math.radians(0.5)
# Second axis over first axis below which all rotations share one axis: 0.4 degrees of noise on
# rotations of 30 degrees give 0.013.
ONE_AXIS = 0.02
# Columns are scaled to unit norm; a direction weaker than this relative to the strongest is free in
# exact arithmetic (rounding leaves about 1e-15).
RANK_TOLERANCE = 1e-9
# A scale within so many of its standard deviations of zero is not determined; rotations within so
# many standard deviations of their noise are not there.
SIGNIFICANT = 3.0
# Median of the absolute value of a standard normal variable.
NORMAL_MEDIAN = 0.6745
# Rotations of robot and camera that differ by more than this (median, radians) at the best R_X
# are not those of one rigid body. The median: a few exchanged rows are another fault.
NO_FIT = math.radians(10.0)
NEGATIVE_SCALE = (
    "the scale came out negative, which no camera can have: the robot poses follow another "
    "convention (inverted, transposed, wrong units, or rows shifted against the images); "
    "check the pose format and that each image has its own pose"
)
# Least over greatest extent of the translations above which they tell a rotation from a reflection.
SOLID = 0.1


def andreff_scale(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B with an unknown scale of B's translations (method M5).

    Components of t_X that the motions leave free (along the axis that all rotations share; all of
    t_X if nothing rotates) are returned as zero.

    Args:
        data: robot motions A = gi_T_gj in metres, camera motions B = ci_T_cj in world units (prefer
            wide baselines), or the poses that they are made of.

    Returns:
        X = gripper_T_camera and metres_per_world_unit (the paper's lambda).

    Raises:
        InputDataError: the scale came out negative: the poses follow another convention.
        UnobservableError: R_X or the scale cannot be found from these motions: pure rotations,
            one motion, translations along one line, or poses that are all the same.
    """
    pairs = with_weight(as_motions(data))
    if len(pairs) < 2:
        raise UnobservableError(
            f"{len(pairs)} motion(s) cannot determine the camera on the gripper: "
            "two with different rotation axes are needed, ten or more poses are advised"
        )
    require_motion(pairs)
    spread = axis_spread(pairs)
    noise = SIGNIFICANT * rotation_noise(pairs)
    if spread.rms_rotation[0] < max(NO_ROTATION, noise):
        R_X = _rotation_from_translations(pairs)
        found = np.zeros((3, 0))
    elif spread.rms_rotation[1] < max(ONE_AXIS * spread.rms_rotation[0], noise):
        R_X = _rotation_about_one_axis(pairs, spread)
        found = spread.axes[:, 1:]
    else:
        found = np.eye(3)
        R_X = min(
            rotations_from_kronecker(pairs, max(NO_ROTATION, noise)),
            key=lambda R: translation_equations(pairs, R, found)[2],
        )
    t_X, metres_per_world_unit = _translation_and_scale(pairs, R_X, found)
    X = np.eye(4)
    X[:3, :3] = R_X
    X[:3, 3] = t_X
    return Solution(gripper_T_camera=X, metres_per_world_unit=metres_per_world_unit)


def rotations_from_kronecker(pairs: MotionPairs, noise: float) -> list[Array]:
    """R_X (3, 3) from rotations about two axes or more, by the paper's linear formulation.

    The null vector of the stacked ``R_A kron I - I kron R_B^T`` on vec(R_X) by rows. The normal
    matrix of one motion is ``2 I - (R_A kron R_B) - (R_A kron R_B)^T``, so the null vector is the
    strongest eigenvector of the sum of the symmetric parts of ``R_A kron R_B``: memory does not
    grow with the motions, and rotations by 180 degrees are like any other.

    Rotations about one axis together with half turns about perpendicular ones leave two solutions,
    which differ by a half turn; half turns about three perpendicular axes leave four. The null
    space then has as many dimensions less one or none, and only the translations can choose.

    Args:
        pairs: the motions; their translations are not used.
        noise: rotations that differ by less than this (radians) cannot be told apart.

    Returns:
        The rotation, or all rotations that fit equally well.
    """
    k, weights = len(pairs), np.asarray(pairs.weights)
    R_A = pairs.gi_T_gj[:, :3, :3].reshape(k, 9) * weights[:, None]
    R_B = pairs.ci_T_cj[:, :3, :3].reshape(k, 9)
    # Sum of R_A kron R_B: entry (3 i + a, 3 j + b) is the sum of R_A[i, j] R_B[a, b].
    total = (R_A.T @ R_B).reshape(3, 3, 3, 3).transpose(0, 2, 1, 3).reshape(9, 9)
    weight = float(weights.sum())
    values, vectors = np.linalg.eigh(2.0 * weight * np.eye(9) - total - total.T)
    # What a rotation does that is off by `noise`: |R(noise) - I|_F^2 = 2 noise^2 for each motion.
    limit = 2.0 * noise**2 * weight
    null = vectors[:, values <= limit]
    best = _projected(vectors[:, 0])
    if null.shape[1] < 2:
        return [best]
    # Null vectors are D R_X with D symmetric; its eigenvectors are the axes of the half turns. Two
    # unequal mixtures of the basis, since any single vector may be singular.
    unequal = np.arange(1.0, null.shape[1] + 1.0)
    mixed, other = null @ np.sqrt(unequal), (null @ unequal[::-1]).reshape(3, 3)
    candidates = []
    for R in (best, _projected(mixed)):
        D = other @ R.T
        _, axes = np.linalg.eigh(D + D.T)
        half_turns = [2.0 * np.outer(axis, axis) - np.eye(3) for axis in axes.T]
        turned = [R, *(half_turn @ R for half_turn in half_turns)]
        candidates += [_projected(null @ (null.T @ R_turned.reshape(9))) for R_turned in turned]
    misfits = [float(6.0 * weight - 2.0 * R.ravel() @ total @ R.ravel()) for R in candidates]
    best_misfit = min(misfits)
    return [
        R for R, misfit in zip(candidates, misfits, strict=True) if misfit <= best_misfit + limit
    ]


def _projected(vector: Array) -> Array:
    """The rotation nearest to plus or minus a vector (9,) of matrix entries by rows.

    The paper rescales by sign(det V) / |det V|^(1/3); the projection needs only the sign.
    """
    V = vector.reshape(3, 3)
    return orthonormalised(np.copysign(1.0, np.linalg.det(V)) * V)


def require_motion(pairs: MotionPairs) -> None:
    """Refuse robot or camera poses that are all the same."""
    for name, motions in (("robot", pairs.gi_T_gj), ("camera", pairs.ci_T_cj)):
        if np.allclose(motions, np.eye(4), rtol=0.0, atol=1e-12):
            raise UnobservableError(
                f"the {name} did not move: its {pairs.n_poses} poses are all the same; "
                "take the images from different poses"
            )


def rotation_noise(pairs: MotionPairs) -> float:
    """Standard deviation (radians) of the rotations' disagreement along their axes.

    A and B turn by the same angle whatever X is; the median bears a few exchanged rows.
    """
    angles_A = rotation_angle(pairs.gi_T_gj[:, :3, :3])
    angles_B = rotation_angle(pairs.ci_T_cj[:, :3, :3])
    return float(np.median(np.abs(angles_A - angles_B))) / NORMAL_MEDIAN


def _rotation_from_translations(pairs: MotionPairs) -> Array:
    """R_X from translations t_A = lambda R_X u_B alone (theorems 1 and 2): orthogonal Procrustes.

    Raises:
        UnobservableError: all translations lie on one line.
        InputDataError: the translations are mirror images of each other.
    """
    t_A, u_B = pairs.gi_T_gj[:, :3, 3], pairs.ci_T_cj[:, :3, 3]
    correlation = (t_A.T * np.asarray(pairs.weights)) @ u_B
    singular = np.linalg.svd(correlation, compute_uv=False)
    if singular[1] < ONE_AXIS**2 * singular[0] or singular[0] == 0.0:
        raise UnobservableError(
            "the robot never turned and moved along one line only: the camera's orientation about "
            "that line is not determined. Add poses that turn the gripper by 20 degrees or more "
            "about two different axes"
        )
    if np.linalg.det(correlation) < 0.0 and singular[2] > SOLID**2 * singular[0]:
        raise InputDataError(NEGATIVE_SCALE)
    return orthonormalised(correlation)


def _rotation_about_one_axis(pairs: MotionPairs, spread: AxisSpread) -> Array:
    """R_X where all rotations share one axis: that axis, and a turn about it from translations.

    With n the axis in the gripper frame, m in the camera frame and R_0 any rotation that takes m
    to n, R_X = Rot(n, phi) R_0. Across the axis the translation equation reads

        (R_A - I) t_X - a v - b (n x v) = -t_A,   v = R_0 u_B,   (a, b) = lambda (cos, sin)(phi)

    which is linear in (t_X, a, b).

    Raises:
        UnobservableError: a and b cannot be told from zero: the translations do not determine phi.
    """
    R_A, t_A = pairs.gi_T_gj[:, :3, :3], pairs.gi_T_gj[:, :3, 3]
    n, plane = spread.axes[:, 0], spread.axes[:, 1:]
    R_0 = _rotation_taking(_camera_axis(pairs, n), n)
    v = pairs.ci_T_cj[:, :3, 3] @ R_0.T
    columns = np.concatenate(
        [(R_A - np.eye(3)) @ plane, -v[:, :, None], -np.cross(n, v)[:, :, None]], axis=2
    )
    # The two components across the axis.
    across = np.einsum("xp,kxc->kpc", plane, columns).reshape(-1, 4)
    solution, covariance, _ = least_squares(across, -(t_A @ plane).reshape(-1), pairs)
    ab = solution[2:]
    if not np.linalg.norm(ab) > SIGNIFICANT * math.sqrt(np.trace(covariance[2:, 2:])):
        raise UnobservableError(
            "all rotations share one axis and the gripper hardly moves across it: the camera's "
            "orientation about that axis and the scale are not determined. Add poses that turn "
            "the gripper by 20 degrees or more about another axis, and that move it"
        )
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


def _rotation_taking(m: Array, n: Array) -> Array:
    """A rotation matrix that takes the unit vector m to the unit vector n."""

    def with_first_column(vector: Array) -> Array:
        q, _ = np.linalg.qr(np.column_stack([vector, np.eye(3)]))
        q[:, 0] = vector
        q[:, 2] = np.cross(q[:, 0], q[:, 1])
        return q

    return with_first_column(n) @ with_first_column(m).T


def _translation_and_scale(pairs: MotionPairs, R_X: Array, found: Array) -> tuple[Array, float]:
    """Step 2: ``[R_A - I, -R_X u_B] [t_X; lambda] = -t_A`` by linear least squares.

    The residual is in metres, the same for each pair: only the weights of the data count.

    Args:
        pairs: the motions.
        R_X: rotation (3, 3) of X.
        found: basis (3, d) of the directions of t_X that the rotations determine.

    Raises:
        InputDataError: the scale is negative.
        UnobservableError: the scale cannot be told from zero.
    """
    solution, covariance, _ = translation_equations(pairs, R_X, found)
    scale, sigma = float(solution[-1]), math.sqrt(covariance[-1, -1])
    if not abs(scale) > SIGNIFICANT * sigma:
        R_A, R_B = pairs.gi_T_gj[:, :3, :3], pairs.ci_T_cj[:, :3, :3]
        misfit = rotation_angle(np.swapaxes(R_A @ R_X, 1, 2) @ (R_X @ R_B))
        if float(np.median(misfit)) > NO_FIT:
            raise InputDataError(
                "the robot's rotations are not those of the camera, whatever its mounting: the "
                "robot poses follow another convention (inverted, transposed, other quaternion or "
                "Euler order) or their rows are shifted against the images; check the pose format"
            )
        raise UnobservableError(
            "the scale is not determined: the gripper only turned about its own origin, or moved "
            "too little against the noise. Add poses that move it by a tenth of a metre or more"
        )
    if scale < 0.0:
        raise InputDataError(NEGATIVE_SCALE)
    return found @ solution[:-1], scale


def translation_equations(
    pairs: MotionPairs, R_X: Array, found: Array, typical_noise: float = 0.0
) -> tuple[Array, Array, float]:
    """Least squares for (components of t_X along ``found``, lambda): see ``least_squares``."""
    R_A, t_A = pairs.gi_T_gj[:, :3, :3], pairs.gi_T_gj[:, :3, 3]
    v = pairs.ci_T_cj[:, :3, 3] @ R_X.T
    turned = ((R_A - np.eye(3)).reshape(-1, 3) @ found).reshape(len(pairs), 3, -1)
    columns = np.concatenate([turned, -v[:, :, None]], axis=2)
    matrix = columns.reshape(-1, columns.shape[2])
    return least_squares(matrix, -t_A.reshape(-1), pairs, typical_noise)


def least_squares(
    matrix: Array, right: Array, pairs: MotionPairs, typical_noise: float = 0.0
) -> tuple[Array, Array, float]:
    """Minimum-norm solution (d,), covariance (d, d; infinite where free), weighted sum of squares.

    Pairs that share poses repeat the same noise: n poses hold n - 1 independent motions, and the
    covariance is enlarged accordingly. ``typical_noise``, in the unit of ``right``, counts as the
    tenth of an observation: equations as few as the unknowns leave nothing to see the noise by.
    """
    root = np.repeat(np.sqrt(np.asarray(pairs.weights)), len(right) // len(pairs))
    # The triangle of the QR factors stands for the tall system: same solutions, same residuals.
    triangle = np.asarray(np.linalg.qr(np.column_stack([matrix, right]) * root[:, None], mode="r"))
    d = matrix.shape[1]
    n_equations, matrix, right = len(right), triangle[:, :d], triangle[:, d]
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0.0] = 1.0
    u, singular, vt = np.linalg.svd(matrix / norms, full_matrices=False)
    # Rounding of the data is as large as the largest of the entries, whatever the column's norm.
    free = singular <= RANK_TOLERANCE * max(singular[0], 1.0)
    weights = np.where(free, 0.0, 1.0 / np.where(free, 1.0, singular))
    solution = (vt.T * weights) @ (u.T @ right)
    squares = float(np.sum((matrix / norms @ solution - right) ** 2))
    repetition = max(1.0, len(pairs) / (pairs.n_poses - 1))
    redundancy = max(0, n_equations - d)
    variance = repetition * squares / max(1, redundancy)
    variance += 0.1 * typical_noise**2 / (0.1 + redundancy)
    covariance = (vt.T * (variance * weights**2)) @ vt
    touched = np.any(np.abs(vt[free]) > math.sqrt(RANK_TOLERANCE), axis=0)
    covariance[touched, touched] = np.inf
    return solution / norms, covariance / np.outer(norms, norms), squares
