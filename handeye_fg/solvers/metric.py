"""What the solvers share that take the camera's translations in metres.

``metric_motions`` and ``metric_poses`` check that the data determine X and prepare them;
``translation`` is the second step of every method that finds the rotation first; ``solution``
checks what was found. The equations are those of each paper, in its own module.
"""

import math
from dataclasses import dataclass

import numpy as np

from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, pose, quaternions, rotation_vectors
from handeye_fg.motions import MotionPairs, PosePairs, as_motions, as_poses, between, with_weight
from handeye_fg.solvers.andreff_scale import (
    NO_FIT,
    NO_ROTATION,
    NORMAL_MEDIAN,
    ONE_AXIS,
    SIGNIFICANT,
    rotations_from_kronecker,
)
from handeye_fg.solvers.solution import Solution


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MetricMotions:
    """Motions A X = X B that determine X, all of weight above zero.

    Attributes:
        R_A: rotations (k, 3, 3) of the robot's motions A = gi_T_gj.
        t_A: translations (k, 3) of A, metres.
        t_B: translations (k, 3) of the camera's motions B = ci_T_cj, metres.
        q_A: unit quaternions (k, 4) of A, scalar first and not negative.
        q_B: unit quaternions (k, 4) of B, of that sign which turns them into q_A by X: at half
            turns, where either sign of the axis is right, they still belong together.
        weights: weights (k,) of the squared residuals, of mean one.
        R_start: a first R_X (3, 3), by the linear equations of Andreff, Horaud and Espiau.
    """

    R_A: Array
    t_A: Array
    t_B: Array
    q_A: Array
    q_B: Array
    weights: Array
    R_start: Array


def metric_motions(data: PosePairs | MotionPairs) -> MetricMotions:
    """The data as motions, checked.

    Raises:
        UnobservableError: fewer than two motions, or their rotations vanish or share one axis.
        InputDataError: the rotations of robot and camera are not those of one rigid body.
    """
    return _determining(with_weight(as_motions(data)))


def metric_poses(data: PosePairs | MotionPairs) -> tuple[PosePairs, MetricMotions]:
    """The data as poses of weight above zero, and their motions from one of them, checked.

    Raises:
        UnobservableError: as ``metric_motions``.
        InputDataError: as ``metric_motions``, or fewer than three poses.
    """
    if isinstance(data, MotionPairs):
        data = with_weight(data)
        _require_two(len(data))
    poses = with_weight(as_poses(data))
    weights = np.asarray(poses.weights)
    # The motions from one pose to the others span all axes that the motions between them span.
    first = int(np.argmax(weights))
    j = np.delete(np.arange(len(poses)), first)
    i = np.full(len(j), first)
    star = MotionPairs(
        i=i,
        j=j,
        gi_T_gj=between(poses.base_T_gripper, i, j),
        ci_T_cj=between(poses.world_T_camera, i, j),
        weights=weights[j],
    )
    return poses, _determining(star)


def translation(motions: MetricMotions, R_X: Array) -> Array:
    """t_X (3,), metres: least squares of ``(R_A - I) t_X = R_X t_B - t_A`` over the motions."""
    return linear_translation(
        motions.R_A - np.eye(3), motions.t_B @ R_X.T - motions.t_A, motions.weights
    )


def linear_translation(matrices: Array, right: Array, weights: Array) -> Array:
    """Vector t (3,) that minimises the weighted squares of M_k t - r_k; M (k, 3, 3), r (k, 3)."""
    rows = matrices.reshape(-1, 3)
    weighted = rows * np.repeat(weights, 3)[:, None]
    return np.asarray(np.linalg.solve(weighted.T @ rows, weighted.T @ right.ravel()))


def centred_translations(poses: PosePairs, R_Z: Array) -> tuple[Array, Array]:
    """t_X and t_Z (3,), metres: least squares of ``R_A t_X - t_Z = R_Z t_B - t_A`` over the poses.

    t_Z takes out the weighted means, and far origins with them.
    """
    weights = np.asarray(poses.weights) / np.sum(np.asarray(poses.weights))
    R_A, t_A = poses.base_T_gripper[:, :3, :3], poses.base_T_gripper[:, :3, 3]
    t_B = poses.world_T_camera[:, :3, 3]
    mean_R_A, mean_A, mean_B = np.tensordot(weights, R_A, axes=1), weights @ t_A, weights @ t_B
    right = (t_B - mean_B) @ R_Z.T - (t_A - mean_A)
    t_X = linear_translation(R_A - mean_R_A, right, weights)
    return t_X, mean_R_A @ t_X + mean_A - R_Z @ mean_B


def kronecker_sum(R_A: Array, R_B: Array, weights: Array) -> Array:
    """Sum (9, 9) of w R_A kron R_B over rotations (k, 3, 3).

    Entry (3 i + a, 3 j + b) is the sum of w R_A[i, j] R_B[a, b].
    """
    k = len(weights)
    products = (R_A.reshape(k, 9) * weights[:, None]).T @ R_B.reshape(k, 9)
    return np.asarray(products.reshape(3, 3, 3, 3).transpose(0, 2, 1, 3).reshape(9, 9))


def typical_length(motions: MetricMotions) -> float:
    """Root mean square translation, metres; 1 if there is none.

    Methods that mix rotation and translation in one sum take lengths in this unit, so that the
    result does not depend on the user's.
    """
    squares = np.sum(motions.t_A**2, axis=1) + np.sum(motions.t_B**2, axis=1)
    length = math.sqrt(0.5 * float(np.average(squares, weights=motions.weights)))
    return length if length > 0.0 else 1.0


def translation_moments(t_B: Array, M: Array, t_A: Array, weights: Array) -> Array:
    """Normal matrices (3, 7, 7) of ``R t_B - M t - t_A`` for each row c of R.

    Component c of the residual is ``d . z`` with the data d = (t_B, M[c], t_A[c]) and the unknowns
    z = (R[c], -t, -1), and its weighted sum of squares z^T G[c] z.
    """
    k = len(t_A)
    shared = np.broadcast_to(t_B, (3, k, 3))
    data = np.concatenate([shared, M.transpose(1, 0, 2), t_A.T[:, :, None]], axis=2)
    return np.asarray(np.swapaxes(data * weights[:, None], 1, 2) @ data)


def solution(
    motions: MetricMotions, R_X: Array, t_X: Array, base_T_world: Array | None = None
) -> Solution:
    """X of its parts, if its rotation fits the motions.

    Raises:
        InputDataError: robot and camera do not belong together.
    """
    _require_correspondence(_agreement(motions.q_A, motions.q_B, R_X))
    return Solution(gripper_T_camera=pose(R_X, t_X), base_T_world=base_T_world)


def _determining(pairs: MotionPairs) -> MetricMotions:
    """The motions with their quaternions and a first rotation, if they determine X."""
    _require_two(len(pairs))
    R_A, R_B = pairs.gi_T_gj[:, :3, :3], pairs.ci_T_cj[:, :3, :3]
    q_A, q_B = quaternions(R_A), quaternions(R_B)
    weights = np.asarray(pairs.weights)
    weights = weights / weights.mean()
    noise = _require_two_axes(q_A, q_B, weights)
    candidates = rotations_from_kronecker(pairs, max(NO_ROTATION, noise))

    def prepared(R: Array) -> MetricMotions:
        agreement = _agreement(q_A, q_B, R)
        return MetricMotions(
            R_A=R_A,
            t_A=pairs.gi_T_gj[:, :3, 3],
            t_B=pairs.ci_T_cj[:, :3, 3],
            q_A=q_A,
            q_B=np.copysign(1.0, agreement)[:, None] * q_B,
            weights=weights,
            R_start=R,
        )

    # Half turns may leave several rotations, among which the translations choose.
    motions = min(map(prepared, candidates), key=_translation_misfit)
    _require_correspondence(_agreement(motions.q_A, motions.q_B, motions.R_start))
    return motions


def _translation_misfit(motions: MetricMotions) -> float:
    R = motions.R_start
    residuals = (
        (motions.R_A - np.eye(3)) @ translation(motions, R) + motions.t_A - motions.t_B @ R.T
    )
    return float(motions.weights @ np.sum(residuals**2, axis=1))


def _agreement(q_A: Array, q_B: Array, R_X: Array) -> Array:
    """cos(half the angle) (k,) between R_A R_X and R_X R_B; the sign is that of the quaternions."""
    return np.asarray(q_A[:, 0] * q_B[:, 0] + np.sum(q_A[:, 1:] * (q_B[:, 1:] @ R_X.T), axis=1))


def _require_two(n_motions: int) -> None:
    if n_motions < 2:
        raise UnobservableError(
            f"{n_motions} motion(s) cannot determine the camera on the gripper: "
            "two with different rotation axes are needed, ten or more poses are advised"
        )


def _require_two_axes(q_A: Array, q_B: Array, weights: Array) -> float:
    """What rotations could be by noise (radians), if they are larger and about two axes."""
    vectors = rotation_vectors(q_A)
    angles_A = np.linalg.norm(vectors, axis=1)
    angles_B = 2.0 * np.arccos(np.minimum(q_B[:, 0], 1.0))
    # A and B turn by the same angle whatever X is; the median bears a few wrong poses.
    difference = float(np.median(np.abs(angles_A - angles_B)))
    if difference > NO_FIT:
        raise InputDataError(_no_correspondence(difference))
    noise = SIGNIFICANT * difference / NORMAL_MEDIAN
    moment = (vectors.T * weights) @ vectors / weights.sum()
    weakest_to_strongest = np.sqrt(np.maximum(np.linalg.eigvalsh(moment), 0.0))
    second, first = weakest_to_strongest[1:]
    if first < max(NO_ROTATION, noise):
        raise UnobservableError(
            f"the gripper turned by {math.degrees(first):.2f} degrees only (rms), which does not "
            "determine the camera's position on it: add poses that turn it by 20 degrees or more "
            "about two different axes"
        )
    if second < max(ONE_AXIS * first, noise):
        raise UnobservableError(
            "all rotations share one axis, along which the camera's position on the gripper is "
            "not determined: add two poses tilted by 20 degrees or more about another axis"
        )
    return noise


def _require_correspondence(agreement: Array) -> None:
    misfit = 2.0 * math.acos(min(1.0, max(-1.0, float(np.median(agreement)))))
    if misfit > NO_FIT:
        raise InputDataError(_no_correspondence(misfit))


def _no_correspondence(misfit: float) -> str:
    return (
        f"the robot's rotations are not those of the camera, whatever its mounting (they differ by "
        f"{math.degrees(misfit):.0f} degrees): the robot poses follow another convention (inverted, "
        "transposed, other quaternion or Euler order) or their rows are shifted against the "
        "images; check the pose format"
    )
