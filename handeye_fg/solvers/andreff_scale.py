"""M5: hand-eye self-calibration with an unknown scale, linear, in two steps.

N. Andreff, R. Horaud, B. Espiau, "Robot Hand-Eye Calibration using Structure-from-Motion",
IJRR 20(3), 2001, section "Using structure-from-motion". There A is the camera's motion, B the
robot's and X = camera_T_gripper. Here the roles are exchanged: A = gi_T_gj is the robot's motion,
B = ci_T_cj the camera's, and X = gripper_T_camera; A X = X B in both. The camera's translation is
known as u_B up to a factor of the whole sequence, t_B = lambda u_B:

    R_A R_X = R_X R_B                                        (rotation)
    (R_A - I) t_X - lambda R_X u_B = -t_A                    (translation)

Step 1 finds R_X and keeps it orthogonal; step 2 is linear in (t_X, lambda). The rotations must turn
about two axes or more; ``partial`` answers for motions of every other kind.
"""

import math

import numpy as np

from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, orthonormalised, pose, rotation_angle
from handeye_fg.motions import MotionPairs, PosePairs, as_motions, axis_spread, with_weight
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


def andreff_scale(data: PosePairs | MotionPairs) -> Solution:
    """Solve A X = X B with an unknown scale of B's translations (method M5).

    Args:
        data: robot motions A = gi_T_gj in metres, camera motions B = ci_T_cj in world units (prefer
            wide baselines), or the poses that they are made of.

    Returns:
        X = gripper_T_camera and metres_per_world_unit (the paper's lambda).

    Raises:
        InputDataError: the scale came out negative, or the rotations are not those of one rigid
            body: the poses follow another convention.
        UnobservableError: the poses are all the same, the rotations share one axis or vanish, or
            the gripper does not move, so that something of X or the scale is not determined.
    """
    pairs = with_weight(as_motions(data))
    require_motion(pairs)
    noise = max(NO_ROTATION, SIGNIFICANT * rotation_noise(pairs))
    require_two_axes(pairs, noise)
    R_X = min(
        rotations_from_kronecker(pairs, noise),
        key=lambda R: translation_equations(pairs, R, np.eye(3))[2],
    )
    t_X, metres_per_world_unit = _translation_and_scale(pairs, R_X)
    return Solution(gripper_T_camera=pose(R_X, t_X), metres_per_world_unit=metres_per_world_unit)


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
    weights = np.asarray(pairs.weights)
    total = kronecker_sum(pairs.gi_T_gj[:, :3, :3], pairs.ci_T_cj[:, :3, :3], weights)
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


def kronecker_sum(R_A: Array, R_B: Array, weights: Array) -> Array:
    """Sum (9, 9) of w R_A kron R_B over rotations (k, 3, 3).

    Entry (3 i + a, 3 j + b) is the sum of w R_A[i, j] R_B[a, b].
    """
    k = len(weights)
    products = (R_A.reshape(k, 9) * weights[:, None]).T @ R_B.reshape(k, 9)
    return np.asarray(products.reshape(3, 3, 3, 3).transpose(0, 2, 1, 3).reshape(9, 9))


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


def require_two_axes(pairs: MotionPairs, noise: float) -> None:
    """Refuse rotations that vanish or share one axis, within the noise (radians)."""
    rms = axis_spread(pairs).rms_rotation
    remedy = "add poses that turn it by 20 degrees or more about two different axes"
    if rms[0] < noise:
        raise UnobservableError(
            f"the gripper never turned, so the camera's position is not determined: {remedy}"
        )
    if rms[1] < max(ONE_AXIS * rms[0], noise):
        raise UnobservableError(
            "all rotations of the gripper share one axis, so the camera's position along it is not "
            f"determined: {remedy}"
        )


def _translation_and_scale(pairs: MotionPairs, R_X: Array) -> tuple[Array, float]:
    """Step 2: ``[R_A - I, -R_X u_B] [t_X; lambda] = -t_A`` by linear least squares.

    The residual is in metres, the same for each pair: only the weights of the data count.

    Args:
        pairs: the motions.
        R_X: rotation (3, 3) of X.

    Raises:
        InputDataError: the scale is negative.
        UnobservableError: the scale cannot be told from zero.
    """
    solution, covariance, _ = translation_equations(pairs, R_X, np.eye(3))
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
            "the scale is not determined, since the gripper only turned about its own origin or moved "
            "too little against the noise: add poses that move it by a tenth of a metre or more"
        )
    if scale < 0.0:
        raise InputDataError(NEGATIVE_SCALE)
    return solution[:-1], scale


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
