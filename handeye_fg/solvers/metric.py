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

# Errors (radians, or relative to the translations) below this are those of rounding: the sums of
# squares are good to 1e-16.
ROUNDING = 1e-7
# How far noise may move the balance between rotations and translations from their own sizes.
BALANCE = 100.0
# Where (t_B, M[c], t_A[c]) stand among the columns (t_B, M by rows, t_A).
COLUMNS = np.array([[0, 1, 2, 3 * c + 3, 3 * c + 4, 3 * c + 5, c + 12] for c in range(3)])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MetricMotions:
    """Motions A X = X B that determine X, all of weight above zero.

    Attributes:
        t_A: translations (k, 3) of the robot's motions A = gi_T_gj, metres.
        t_B: translations (k, 3) of the camera's motions B = ci_T_cj, metres.
        q_A: unit quaternions (k, 4) of A, scalar first and not negative.
        q_B: unit quaternions (k, 4) of B, of that sign which X turns into q_A: at half turns, where
            either sign of the axis is right, they still belong together.
        weights: weights (k,) of the squared residuals, of mean one.
        moments: all that the translation equations need, (3, 7, 7): see ``translation_moments``.
        R_start: a first R_X (3, 3), by the linear equations of Andreff, Horaud and Espiau.
    """

    t_A: Array
    t_B: Array
    q_A: Array
    q_B: Array
    weights: Array
    moments: Array
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


def translation_moments(t_B: Array, M: Array, t_A: Array, weights: Array) -> Array:
    """Normal matrices (3, 7, 7) of ``R t_B - M t - t_A``, one for each row c of the equation.

    The residual's component c is ``d . z`` with the data d = (t_B, M[c], t_A[c]) and the unknowns
    z = (R[c], -t, -1): its weighted sum of squares is z^T G[c] z, whatever R and t are.
    """
    k = len(weights)
    data = np.concatenate([t_B, M.reshape(k, 9), t_A], axis=1)
    everything = (data.T * weights) @ data
    return np.asarray(everything[COLUMNS[:, :, None], COLUMNS[:, None, :]])


def in_lengths(moments: Array, length: float) -> Array:
    """The moments with t_A, t_B and t measured in a length (metres)."""
    unit = np.array([length, length, length, 1.0, 1.0, 1.0, length])
    return np.asarray(moments / np.outer(unit, unit))


def translation(moments: Array, R: Array) -> Array:
    """The t (3,) that fits a rotation best: least squares of ``M t = R t_B - t_A``."""
    coupling = np.einsum("cij,cj->i", moments[:, 3:6, :3], R) - np.sum(moments[:, 3:6, 6], axis=0)
    return np.asarray(np.linalg.solve(np.sum(moments[:, 3:6, 3:6], axis=0), coupling))


def centred_moments(poses: PosePairs) -> Array:
    """``translation_moments`` (3, 7, 7) of ``R_Z t_B + t_Z = R_A t_X + t_A``, without t_Z.

    t_Z takes out the weighted means, and far origins with them.
    """
    R_A, t_A, t_B, weights = _parts(poses)
    return translation_moments(
        t_B - weights @ t_B, R_A - np.tensordot(weights, R_A, axes=1), t_A - weights @ t_A, weights
    )


def mean_base_T_world(poses: PosePairs, R_Z: Array, t_X: Array) -> Array:
    """Z (4, 4) of its rotation, and the mean of ``t_Z = R_A t_X + t_A - R_Z t_B``."""
    R_A, t_A, t_B, weights = _parts(poses)
    return pose(
        R_Z, np.tensordot(weights, R_A, axes=1) @ t_X + weights @ t_A - R_Z @ (weights @ t_B)
    )


def metres_per_radian(motions: MetricMotions) -> float:
    """The length that errors of translation and rotation have in common.

    Methods that mix both in one sum measure lengths in it: the result depends on no unit, and the
    noisier of the two counts less. It is the ratio of both errors of the first solution, within
    ``BALANCE`` of the typical translation; without noise, the typical translation.
    """
    k, moments = len(motions.weights), motions.moments
    squares = np.trace(moments[0, :3, :3]) + np.sum(moments[:, 6, 6])
    typical = math.sqrt(0.5 * float(squares) / k)
    if typical == 0.0:
        return 1.0
    v_A, v_B = motions.q_A[:, 1:], motions.q_B[:, 1:] @ motions.R_start.T
    # |v_A - v_B| is half the angle between the rotations, where they almost agree.
    radians = 2.0 * math.sqrt(float(motions.weights @ np.sum((v_A - v_B) ** 2, axis=1)) / k)
    metres = math.sqrt(_misfit(moments, motions.R_start) / k)
    if radians < ROUNDING or metres < ROUNDING * typical:
        return typical
    return float(np.clip(metres / radians, typical / BALANCE, typical * BALANCE))


def solution(
    motions: MetricMotions, R_X: Array, t_X: Array, base_T_world: Array | None = None
) -> Solution:
    """X of its parts, if its rotation fits the motions.

    Raises:
        InputDataError: the rotations of robot and camera are not those of one rigid body.
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
    moments = translation_moments(
        pairs.ci_T_cj[:, :3, 3], R_A - np.eye(3), pairs.gi_T_gj[:, :3, 3], weights
    )
    # Half turns may leave several rotations, among which the translations choose.
    R_start = candidates[0]
    if len(candidates) > 1:
        R_start = min(candidates, key=lambda R: _misfit(moments, R))
    agreement = _agreement(q_A, q_B, R_start)
    _require_correspondence(np.abs(agreement))
    return MetricMotions(
        t_A=pairs.gi_T_gj[:, :3, 3],
        t_B=pairs.ci_T_cj[:, :3, 3],
        q_A=q_A,
        q_B=np.copysign(1.0, agreement)[:, None] * q_B,
        weights=weights,
        moments=moments,
        R_start=R_start,
    )


def _misfit(moments: Array, R: Array) -> float:
    """Weighted sum of squares (metres^2) that a rotation and its best translation leave.

    Not less than rounding leaves: 1e-16 of the sum of the squared translations.
    """
    t = translation(moments, R)
    z = np.column_stack([R, np.tile(-t, (3, 1)), -np.ones(3)])
    return max(0.0, float(np.einsum("ci,cij,cj->", z, moments, z)))


def _parts(poses: PosePairs) -> tuple[Array, Array, Array, Array]:
    """R_A (n, 3, 3), t_A (n, 3), t_B (n, 3) and weights (n,) of sum one."""
    weights = np.asarray(poses.weights)
    return (
        poses.base_T_gripper[:, :3, :3],
        poses.base_T_gripper[:, :3, 3],
        poses.world_T_camera[:, :3, 3],
        weights / weights.sum(),
    )


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
    angles_A, angles_B = 2.0 * np.arccos(np.minimum([q_A[:, 0], q_B[:, 0]], 1.0))
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
