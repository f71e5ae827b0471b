"""Absolute poses to motion pairs, and what rotation axes the motions span.

Solvers take ``PosePairs`` (absolute poses of robot and camera at the same instants: A X = Z B) or
``MotionPairs`` (motions between such instants: A X = X B), and turn one into the other with
``as_motions`` and ``as_poses``. X = gripper_T_camera. Nothing is solved here.
"""

from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, quaternions, rotation_vectors
from handeye_fg.types import Indices

# One motion: the least that says anything of X. Two that determine it need three poses.
MIN_POSES = 2
# 63 images give 1953 pairs: up to there every pair is used, beyond it more pairs of the same
# images add time but hardly information.
MAX_PAIRS = 2000
# Distances are ranked in blocks of so many entries: memory does not grow with the square of the
# poses, and blocks stay in the cache (and below the size from which BLAS starts threads).
BLOCK = 2**14
# Largest defect of R^T R: entries rounded to three digits still pass, a scaled or sheared matrix
# does not.
ROTATION_TOLERANCE = 5e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionPairs:
    """Motions of the gripper and of the camera between the same two instants.

    Attributes:
        i: index (k,) of the pose where the motion starts.
        j: index (k,) of the pose where it ends.
        gi_T_gj: robot motions A (k, 4, 4), metres.
        ci_T_cj: camera motions B (k, 4, 4), translations in world units.
        weights: relative weights (k,), not negative, of the squared residuals; None: all one.
    """

    i: Indices
    j: Indices
    gi_T_gj: Array
    ci_T_cj: Array
    weights: Array | None = None

    def __post_init__(self) -> None:
        for name in ("i", "j"):
            index = np.array(getattr(self, name), dtype=np.int64)
            index.setflags(write=False)
            object.__setattr__(self, name, index)
        for name in ("gi_T_gj", "ci_T_cj"):
            motion = np.array(getattr(self, name), dtype=np.float64)
            if motion.shape != (len(self.i), 4, 4):
                raise ValueError(f"{name}: {motion.shape=} but expected ({len(self.i)}, 4, 4)")
            _check_matrices("robot motion" if name == "gi_T_gj" else "camera motion", motion)
            motion.setflags(write=False)
            object.__setattr__(self, name, motion)
        if self.i.shape != self.j.shape:
            raise ValueError(f"{self.i.shape=} but {self.j.shape=}")
        object.__setattr__(self, "weights", _weights(self.weights, len(self.i)))

    def __len__(self) -> int:
        return len(self.i)

    @property
    def n_poses(self) -> int:
        """Number of distinct poses that the pairs connect."""
        return len(np.union1d(self.i, self.j))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosePairs:
    """Poses of the gripper and of the camera at the same instants.

    Attributes:
        base_T_gripper: robot poses (n, 4, 4), metres.
        world_T_camera: camera poses (n, 4, 4), translations in world units.
        weights: relative weights (n,), not negative, of the squared residuals; None: all one.
    """

    base_T_gripper: Array
    world_T_camera: Array
    weights: Array | None = None

    def __post_init__(self) -> None:
        for name in ("base_T_gripper", "world_T_camera"):
            poses = np.array(getattr(self, name), dtype=np.float64)
            poses.setflags(write=False)
            object.__setattr__(self, name, poses)
        _check_lists(self.base_T_gripper, self.world_T_camera)
        object.__setattr__(self, "weights", _weights(self.weights, len(self.base_T_gripper)))

    def __len__(self) -> int:
        return len(self.base_T_gripper)


Data = TypeVar("Data", PosePairs, MotionPairs)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisSpread:
    """The principal axes of the rotation vectors of a set of motions.

    Attributes:
        axes: unit axes in the columns of a matrix (3, 3), gripper frame, strongest first.
        rms_rotation: root mean square (3,) of the rotation vectors along each axis, radians. One
            value above zero: all rotations share one axis. Two are enough to determine X.
    """

    axes: Array
    rms_rotation: Array

    @property
    def relative(self) -> Array:
        """rms_rotation (3,) as fractions of the strongest; zeros if nothing rotates."""
        strongest = self.rms_rotation[0]
        return self.rms_rotation / strongest if strongest > 0.0 else np.zeros(3)


def between(a_T_b: Array, i: Indices, j: Indices) -> Array:
    """bi_T_bj (k, 4, 4) of poses (n, 4, 4).

    The positions are subtracted before they are turned: far from the origin this rounds least.
    """
    bi_R_a = np.swapaxes(a_T_b[i, :3, :3], 1, 2)
    difference = a_T_b[j, :3]
    difference[:, :, 3] -= a_T_b[i, :3, 3]
    motion = np.zeros((len(i), 4, 4))
    np.matmul(bi_R_a, difference, out=motion[:, :3])
    motion[:, 3, 3] = 1.0
    return motion


def as_motions(data: PosePairs | MotionPairs, max_pairs: int = MAX_PAIRS) -> MotionPairs:
    """The same data as motions: of poses those between distant ones, weights multiplied.

    All pairs i < j if they are no more than ``max_pairs``. Else each pose gets the same number of
    partners: from the half of the later poses that lie farthest from it (wide baselines keep the
    noise of the camera's translations from biasing the scale low), evenly spread over that half so
    that no direction of motion is lost. Memory grows with the number of pairs and of poses, not
    with the square of the poses.

    Poses of weight 0 take part in no pair; ``i`` and ``j`` count them nevertheless.

    Args:
        data: poses or motions; motions are returned as they are.
        max_pairs: most pairs of poses.

    Raises:
        InputDataError: fewer than two poses have a weight.
    """
    if isinstance(data, MotionPairs):
        return data
    weights = np.asarray(data.weights)
    used = np.flatnonzero(weights)
    _require_poses(len(used))
    i, j = _chosen_pairs(data.base_T_gripper[used], data.world_T_camera[used], max_pairs)
    i, j = used[i], used[j]
    return MotionPairs(
        i=i,
        j=j,
        gi_T_gj=between(data.base_T_gripper, i, j),
        ci_T_cj=between(data.world_T_camera, i, j),
        weights=weights[i] * weights[j],
    )


def with_weight(data: Data) -> Data:
    """The same data less the rows of weight 0."""
    used = np.flatnonzero(np.asarray(data.weights))
    if len(used) == len(data):
        return data
    return type(data)(**{field.name: getattr(data, field.name)[used] for field in fields(data)})


def as_poses(data: PosePairs | MotionPairs) -> PosePairs:
    """The same data as absolute poses, for solvers of A X = Z B.

    Motions (A, B) of a rigid camera satisfy A X = Z B with Z = X. Beside each motion stands the
    identity on both sides, which says so: I X = Z I.
    """
    if isinstance(data, PosePairs):
        return data
    rest = np.broadcast_to(np.eye(4), (len(data), 4, 4))
    return PosePairs(
        base_T_gripper=np.concatenate([rest, data.gi_T_gj]),
        world_T_camera=np.concatenate([rest, data.ci_T_cj]),
        weights=np.tile(np.asarray(data.weights), 2),
    )


def axis_spread(pairs: MotionPairs) -> AxisSpread:
    """What rotation axes the robot's motions span, from the rotation vectors' second moment.

    A rotation by 180 degrees has two rotation vectors of opposite sign; the moment is the same.
    """
    vectors = rotation_vectors(quaternions(pairs.gi_T_gj[:, :3, :3]))
    weights = np.asarray(pairs.weights)
    # R of the QR factors has the same singular values and axes as the tall matrix.
    triangle = np.linalg.qr(vectors * np.sqrt(weights)[:, None], mode="r")
    _, singular, axes = np.linalg.svd(triangle, full_matrices=True)
    rms = np.zeros(3)
    rms[: len(singular)] = singular / np.sqrt(max(weights.sum(), np.finfo(float).tiny))
    return AxisSpread(axes=np.asarray(axes.T), rms_rotation=rms)


def _weights(weights: Array | None, n: int) -> Array:
    """Read-only weights (n,)."""
    result = np.ones(n) if weights is None else np.array(weights, dtype=np.float64)
    if result.shape != (n,):
        raise InputDataError(f"the weights have the shape {result.shape}: expected ({n},)")
    if not (np.all(np.isfinite(result)) and np.all(result >= 0.0)):
        raise InputDataError("the weights must be finite and not negative")
    result.setflags(write=False)
    return result


def _check_lists(base_T_gripper: Array, world_T_camera: Array) -> None:
    """Refuse lists that are not as many poses each."""
    for name, poses in (("robot", base_T_gripper), ("camera", world_T_camera)):
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise InputDataError(
                f"the {name} poses have the shape {poses.shape}: expected (n, 4, 4) matrices"
            )
        _check_matrices(f"{name} pose", poses)
    n = len(base_T_gripper)
    if len(world_T_camera) != n:
        raise InputDataError(
            f"there are {n} robot poses but {len(world_T_camera)} camera poses: "
            "give one camera pose for each robot pose, in the same order"
        )
    _require_poses(n)


def _require_poses(n: int) -> None:
    if n < MIN_POSES:
        raise InputDataError(
            f"{n} pose(s) say nothing of the camera on the gripper: at least {MIN_POSES} are needed for "
            "a part of it, three with two different rotation axes for all, ten or more are advised"
        )


def _check_matrices(name: str, matrices: Array) -> None:
    """Refuse matrices (n, 4, 4) that are not poses; ``name`` says of what."""
    finite = np.isfinite(matrices)
    if not np.all(finite):
        bad = int(np.argmin(finite.all(axis=(1, 2))))
        raise InputDataError(f"{name} {bad} holds a value that is not a finite number")
    if len(matrices) == 0:
        return
    # Columns as (3, n): the first two are orthogonal unit vectors, the third is their product.
    x, y, z = np.ascontiguousarray(np.moveaxis(matrices[:, :3, :3], (2, 1), (0, 1)))
    product = [
        x[1] * y[2] - x[2] * y[1] - z[0],
        x[2] * y[0] - x[0] * y[2] - z[1],
        x[0] * y[1] - x[1] * y[0] - z[2],
    ]
    dots = [np.sum(x * x, axis=0) - 1.0, np.sum(y * y, axis=0) - 1.0, np.sum(x * y, axis=0)]
    defect = np.abs([*dots, *product]).max(axis=0)
    bad = int(np.argmax(defect))
    if defect[bad] > ROTATION_TOLERANCE:
        raise InputDataError(
            f"{name} {bad} does not hold a rotation: its columns must be orthogonal unit vectors "
            "of a right-handed frame; check the layout of the matrices"
        )


def _chosen_pairs(
    base_T_gripper: Array, world_T_camera: Array, max_pairs: int
) -> tuple[Indices, Indices]:
    """All pairs i < j, or ``max_pairs`` distant ones."""
    n = len(base_T_gripper)
    if n * (n - 1) // 2 <= max_pairs:
        i, j = np.triu_indices(n, k=1)
        return i, j
    return _distant_pairs(base_T_gripper, world_T_camera, max_pairs)


def _distant_pairs(
    base_T_gripper: Array, world_T_camera: Array, max_pairs: int
) -> tuple[Indices, Indices]:
    """At most ``max_pairs`` pairs i < j, evenly over i, among the distant half of the partners."""
    n = len(base_T_gripper)
    rotation = base_T_gripper[:, :3, :3].reshape(n, 9)
    position = world_T_camera[:, :3, 3]
    # Both distances as fractions of their typical size. |R_i - R_j|_F = 2 sqrt(2) sin(angle / 2).
    features = np.hstack([rotation / _spread(rotation), position / _spread(position)])
    square = np.sum(features**2, axis=1)
    first = np.arange(n - 1)
    # Pairs (i, j) with i < j: earlier poses have more partners. Each gets its share.
    share = max_pairs * 2.0 * (n - 1 - first) / (n * (n - 1))
    ends = np.floor(np.concatenate([[0.0], np.cumsum(share)]) + 0.5).astype(np.int64)
    counts = ends[1:] - ends[:-1]
    partners = []
    rows = max(1, BLOCK // n)
    for start in range(0, n - 1, rows):
        i = first[start : start + rows]
        # Squared distance less a constant of the row. Poses up to i itself come first: no partners.
        distance = square - 2.0 * features[i] @ features.T
        distance[np.arange(n) <= i[:, None]] = -np.inf
        # Stable: the default sort is slow where many values are the same.
        order = np.argsort(distance, axis=1, kind="stable")
        # The farther half of the partners, or as many as are wanted, evenly.
        count = counts[i]
        nearest = i + 1 + np.minimum((n - 1 - i) // 2, n - 1 - i - count)
        row = np.repeat(np.arange(len(i)), count)
        step = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        last, intervals = n - 1 - nearest, np.maximum(count - 1, 1)
        partners.append(order[row, nearest[row] + step * last[row] // intervals[row]])
    return np.repeat(first, counts), np.concatenate(partners)


def _spread(values: Array) -> float:
    """Root mean square distance of rows (n, d) from their mean; 1 if they are all the same."""
    spread = float(np.sqrt(np.mean(np.sum((values - values.mean(axis=0)) ** 2, axis=1))))
    return spread if spread > 0.0 else 1.0
