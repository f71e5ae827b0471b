"""Absolute poses to motion pairs, and what rotation axes the motions span.

Solvers take ``PosePairs`` (absolute poses of robot and camera at the same instants: A X = Z B) or
``MotionPairs`` (motions between such instants: A X = X B), and turn one into the other with
``as_motions`` and ``as_poses``. X = gripper_T_camera. Nothing is solved here.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse
from handeye_fg.types import Indices

# Two motions are the least that determine X; they need three poses.
MIN_POSES = 3
# 63 images give 1953 pairs: up to there every pair is used, beyond it more pairs of the same
# images add time but hardly information.
MAX_PAIRS = 2000
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
        _checked_length(self.base_T_gripper, self.world_T_camera)
        object.__setattr__(self, "weights", _weights(self.weights, len(self.base_T_gripper)))

    def __len__(self) -> int:
        return len(self.base_T_gripper)


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


def motion_pairs(
    base_T_gripper: Array,
    world_T_camera: Array,
    *,
    min_rotation: float = 0.0,
    max_pairs: int = MAX_PAIRS,
) -> MotionPairs:
    """Motions between poses that are far apart in rotation and in camera position.

    All pairs i < j if they are no more than ``max_pairs``. Else each pose gets the same number of
    partners: from the half of the later poses that lie farthest from it (wide baselines keep the
    noise of the camera's translations from biasing the scale low), evenly spread over that half so
    that no direction of motion is lost. Memory grows with the number of pairs and of poses, not
    with the square of the poses.

    Args:
        base_T_gripper: robot poses (n, 4, 4), metres.
        world_T_camera: camera poses (n, 4, 4) of the same instants, world units.
        min_rotation: pairs that turn the gripper less than this (radians) are left out.
        max_pairs: most pairs returned.

    Raises:
        InputDataError: fewer than three poses, lists of different length, matrices that are not
            poses, or no pair turns by ``min_rotation``.
        ValueError: ``max_pairs`` is not positive.
    """
    n = _checked_length(base_T_gripper, world_T_camera)
    if max_pairs < 1:
        raise ValueError(f"{max_pairs=} but expected at least 1")
    if n * (n - 1) // 2 <= max_pairs:
        i, j = np.triu_indices(n, k=1)
    else:
        i, j = _distant_pairs(base_T_gripper, world_T_camera, max_pairs)
    gi_T_gj = inverse(base_T_gripper[i]) @ base_T_gripper[j]
    if min_rotation > 0.0:
        keep = Rotation.from_matrix(gi_T_gj[:, :3, :3]).magnitude() >= min_rotation
        i, j, gi_T_gj = i[keep], j[keep], gi_T_gj[keep]
        if len(i) == 0:
            raise InputDataError(
                f"no two of the {n} robot poses differ by {np.degrees(min_rotation):.1f} degrees "
                "or more in orientation: add poses that turn the gripper"
            )
    ci_T_cj = inverse(world_T_camera[i]) @ world_T_camera[j]
    return MotionPairs(i=i, j=j, gi_T_gj=gi_T_gj, ci_T_cj=ci_T_cj)


def as_motions(data: PosePairs | MotionPairs) -> MotionPairs:
    """The same data as motions: of poses the wide-baseline pairs, weights multiplied."""
    if isinstance(data, MotionPairs):
        return data
    pairs = motion_pairs(data.base_T_gripper, data.world_T_camera)
    weights = np.asarray(data.weights)
    return replace(pairs, weights=weights[pairs.i] * weights[pairs.j])


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
    vectors = Rotation.from_matrix(pairs.gi_T_gj[:, :3, :3]).as_rotvec()
    _, singular, axes = np.linalg.svd(vectors, full_matrices=len(vectors) < 3)
    rms = np.zeros(3)
    rms[: len(singular)] = singular / np.sqrt(len(vectors))
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


def _checked_length(base_T_gripper: Array, world_T_camera: Array) -> int:
    """The number of poses in both lists."""
    for name, poses in (("robot", base_T_gripper), ("camera", world_T_camera)):
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise InputDataError(
                f"the {name} poses have the shape {poses.shape}: expected (n, 4, 4) matrices"
            )
        if not np.all(np.isfinite(poses)):
            bad = int(np.argmax(~np.isfinite(poses).all(axis=(1, 2))))
            raise InputDataError(f"{name} pose {bad} holds a value that is not a finite number")
        rotation = poses[:, :3, :3]
        defect = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2))
        defect[np.linalg.det(rotation) < 0.0] = np.inf
        if np.any(defect > ROTATION_TOLERANCE):
            bad = int(np.argmax(defect))
            raise InputDataError(
                f"{name} pose {bad} does not hold a rotation: its columns must be orthogonal unit "
                "vectors of a right-handed frame; check the layout of the matrices"
            )
    n = len(base_T_gripper)
    if len(world_T_camera) != n:
        raise InputDataError(
            f"there are {n} robot poses but {len(world_T_camera)} camera poses: "
            "give one camera pose for each robot pose, in the same order"
        )
    if n < MIN_POSES:
        raise InputDataError(
            f"{n} pose(s) cannot determine the camera on the gripper: at least {MIN_POSES} with two "
            "different rotation axes are needed, ten or more are advised"
        )
    return n


def _distant_pairs(
    base_T_gripper: Array, world_T_camera: Array, max_pairs: int
) -> tuple[Indices, Indices]:
    """At most ``max_pairs`` pairs i < j, evenly over i, among the distant half of the partners."""
    n = len(base_T_gripper)
    rotation = base_T_gripper[:, :3, :3].reshape(n, 9)
    position = world_T_camera[:, :3, 3]
    # Both distances as fractions of their typical size. |R_i - R_j|_F = 2 sqrt(2) sin(angle / 2).
    features = np.hstack([rotation / _spread(rotation), position / _spread(position)])
    first = np.arange(n - 1)
    # Pairs (i, j) with i < j: earlier poses have more partners. Each gets its share.
    share = max_pairs * 2.0 * (n - 1 - first) / (n * (n - 1))
    counts = np.diff(np.floor(np.concatenate([[0.0], np.cumsum(share)]) + 0.5).astype(np.int64))
    i_parts, j_parts = [], []
    for i, count in zip(first, counts, strict=True):
        distance = np.sum((features[i + 1 :] - features[i]) ** 2, axis=1)
        nearer = min(len(distance) // 2, len(distance) - int(count))
        distant = np.argsort(distance)[nearer:]
        chosen = distant[np.linspace(0, len(distant) - 1, int(count)).astype(np.int64)]
        i_parts.append(np.full(int(count), i, dtype=np.int64))
        j_parts.append(i + 1 + np.sort(chosen))
    return np.concatenate(i_parts), np.concatenate(j_parts)


def _spread(values: Array) -> float:
    """Root mean square distance of rows (n, d) from their mean; 1 if they are all the same."""
    spread = float(np.sqrt(np.mean(np.sum((values - values.mean(axis=0)) ** 2, axis=1))))
    return spread if spread > 0.0 else 1.0
