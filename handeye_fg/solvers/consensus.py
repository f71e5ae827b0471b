"""Rows that agree with each other: samples of them, fits to these, and the fits grown.

X is found from many small samples of rows (three poses, or two motions); the samples on which half of
the rows agree best are grown to all rows that agree.

Nothing here has a threshold in metres or world units. What agrees is told by the median of the
residuals, rotation and translation each in its own unit, so an arm of 0.05 mm and one of 5 mm are
judged alike. Limits are wide: they are to find rows that are wrong, not rows that are inaccurate.
"""

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import stdtrit

from handeye_fg.frames import Array, inverse, scaled
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.solvers.andreff_scale import NORMAL_MEDIAN
from handeye_fg.solvers.batched import Turning, solved, turning_of
from handeye_fg.solvers.residuals import average_base_T_world, differences
from handeye_fg.types import Indices

Rows = NDArray[np.bool_]
# With half of the rows wrong one sample of three poses in eight is good: 300 samples miss all good
# ones with probability 1e-17, and have dozens with well spread axes.
_SAMPLES = 300
# Candidates that are grown; the good samples are the best by far, these differ in their noise.
_GROWN = 5
_ROUNDS = 10
# Residuals of so many rows at once: memory does not grow with the rows.
_BLOCK = 2**14
# Probability that a good row of a good set is taken for wrong, if residuals were normal along one
# axis; those along three axes, as here, are rarer.
_FALSE_ALARM = 1e-3
# Residuals below this part of the largest coordinate are rounding.
_ROUNDING = 1e-9
# So many rows beyond those that determine X must agree: with fewer, and hundreds of samples, poses
# of another convention (inverted, transposed) agree by chance.
_REDUNDANT = 3
# Rows nearer to each other than this part of the spread of all are repetitions.
_SAME = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """Rows, and what does not change while they are sorted.

    Attributes:
        data: the rows (n,), none a repetition of another.
        turning: how many axes they turn about.
        scale_known: whether the camera's translations are in metres.
        majority: so many rows at least agree, if any answer is to be right.
        floor: angle and distance (2,) that are rounding.
    """

    data: PosePairs | MotionPairs
    turning: Turning
    scale_known: bool
    majority: int
    floor: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """X and scale of some rows, and what all rows leave: angles and distances (n, 2)."""

    gripper_T_camera: Array
    metres_per_world_unit: float
    residuals: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """Rows (n,) that agree, the fit to them, and the limits (2,) of agreement."""

    rows: Rows
    fit: Fit
    limit: Array


def only(data: PosePairs | MotionPairs, rows: Rows | Indices) -> PosePairs | MotionPairs:
    """Some of the rows."""
    weights = np.asarray(data.weights)[rows]
    if isinstance(data, PosePairs):
        return PosePairs(
            base_T_gripper=data.base_T_gripper[rows],
            world_T_camera=data.world_T_camera[rows],
            weights=weights,
        )
    return MotionPairs(
        i=data.i[rows],
        j=data.j[rows],
        gi_T_gj=data.gi_T_gj[rows],
        ci_T_cj=data.ci_T_cj[rows],
        weights=weights,
    )


def sample_size(data: PosePairs | MotionPairs) -> int:
    """The rows that determine X."""
    return 3 if isinstance(data, PosePairs) else 2


def fewest(data: PosePairs | MotionPairs) -> int:
    """So many rows at least agree, if their agreement is to say anything."""
    return sample_size(data) + _REDUNDANT


def problem_of(rows: PosePairs | MotionPairs, *, scale_known: bool) -> Problem:
    """The rows, none a repetition of another, with what does not change while they are sorted."""
    return Problem(
        data=rows,
        turning=turning_of(as_motions(rows)),
        scale_known=scale_known,
        majority=min(len(rows), max(len(rows) // 2, fewest(rows))),
        floor=_rounding(rows),
    )


def best_candidate(problem: Problem, seed: int) -> Candidate | None:
    """The best candidate from samples."""
    size = sample_size(problem.data)
    samples = _samples(len(problem.data), size, np.random.default_rng(seed))
    return _best(problem, _sample_fits(problem, samples))


def distinct_rows(data: PosePairs | MotionPairs) -> Indices:
    """The first of the rows that have about the same pose of the robot and of the camera."""
    features = []
    for matrices in both(data):
        for part in (matrices[:, :3, :3].reshape(-1, 9), matrices[:, :3, 3]):
            spread = float(np.sqrt(np.sum(np.var(part, axis=0))))
            features.append(part / (spread if spread > 0.0 else 1.0))
    points = np.hstack(features)
    covered = np.zeros(len(points), dtype=bool)
    chosen = []
    for row, near in enumerate(KDTree(points).query_ball_point(points, _SAME)):
        if not covered[row]:
            chosen.append(row)
            covered[near] = True
    return np.array(chosen)


def _samples(n: int, size: int, rng: np.random.Generator) -> Indices:
    """Different rows (s, size): all choices, or as many as are enough."""
    if math.comb(n, size) <= _SAMPLES:
        return np.array(list(combinations(range(n), size)))
    return np.asarray(np.argpartition(rng.random((_SAMPLES, n)), size, axis=1)[:, :size])


def _sample_fits(problem: Problem, samples: Indices) -> list[Fit]:
    """Fits of samples (s, size) of the rows, less those with a negative scale."""
    data = problem.data
    if isinstance(data, PosePairs):
        first, second = samples[:, [0, 0, 1]], samples[:, [1, 2, 2]]
        A = inverse(data.base_T_gripper[first]) @ data.base_T_gripper[second]
        B = inverse(data.world_T_camera[first]) @ data.world_T_camera[second]
    else:
        A, B = data.gi_T_gj[samples], data.ci_T_cj[samples]
    X, scales = solved(A, B, problem.turning, scale_known=problem.scale_known)
    possible = np.flatnonzero(scales > 0.0)
    block = max(1, _BLOCK // len(data))
    fits: list[Fit] = []
    for start in range(0, len(possible), block):
        chosen = possible[start : start + block]
        fits += fits_of(data, samples[chosen], X[chosen], scales[chosen])
    return fits


def fits_of(data: PosePairs | MotionPairs, rows: Indices, X: Array, scales: Array) -> list[Fit]:
    """X (s, 4, 4) and scales (s,) with the residuals of all rows; rows (s, m) place the world."""
    A, B = both(data)
    B = scaled(np.broadcast_to(B, (len(X), *B.shape)), scales[:, None, None])
    left = A @ X[:, None]
    if isinstance(data, PosePairs):
        each = np.arange(len(X))[:, None]
        right = average_base_T_world(left[each, rows], B[each, rows])[:, None] @ B
    else:
        right = X[:, None] @ B
    residuals = np.stack(differences(left, right), axis=-1)
    return [
        Fit(gripper_T_camera=X[k], metres_per_world_unit=float(scales[k]), residuals=residuals[k])
        for k in range(len(X))
    ]


def _best(problem: Problem, fits: list[Fit]) -> Candidate | None:
    """The most promising fits, grown; of those the one that most rows agree with."""
    if not fits:
        return None

    def score(fit: Fit) -> float:
        return float(np.log(_typical(problem, fit)).sum())

    candidates = [_grown(problem, fit) for fit in sorted(fits, key=score)[:_GROWN]]
    # All are judged by the tightest limits: a wrong X has wide ones, and all rows agree with it. An
    # X that fits half of the rows may yet be wrong, where those turn about one axis.
    limit = min((candidate.limit for candidate in candidates), key=lambda each: float(each.prod()))

    def cost(candidate: Candidate) -> float:
        return float(relative_to(candidate.fit.residuals, limit).clip(0.0, 1.0).sum())

    return min(candidates, key=cost)


def _grown(problem: Problem, fit: Fit) -> Candidate:
    """All rows that agree with the fit to themselves, from the majority that fits best."""
    data, n = problem.data, len(problem.data)
    rows = _majority(problem, fit)
    rounds = _ROUNDS
    while True:
        pairs = as_motions(only(data, rows))
        X, scales = solved(
            pairs.gi_T_gj[None],
            pairs.ci_T_cj[None],
            problem.turning,
            scale_known=problem.scale_known,
        )
        [fit] = fits_of(data, np.flatnonzero(rows)[None], X, scales)
        limit = limits_of(fit.residuals[rows], n, problem.floor)
        agree = (relative_to(fit.residuals, limit) <= 1.0) | _majority(problem, fit)
        rounds -= 1
        if rounds == 0 or np.array_equal(agree, rows):
            return Candidate(rows=rows, fit=fit, limit=limit)
        rows = agree


def _majority(problem: Problem, fit: Fit) -> Rows:
    """The rows that fit best, as many as make a majority."""
    order = np.argsort(relative_to(fit.residuals, _typical(problem, fit)), kind="stable")
    rows = np.zeros(len(order), dtype=bool)
    rows[order[: problem.majority]] = True
    return rows


def _typical(problem: Problem, fit: Fit) -> Array:
    """Angle and distance (2,) that the majority does not exceed."""
    last = problem.majority - 1
    typical: Array = np.partition(fit.residuals, last, axis=0)[last]
    return np.maximum(typical, problem.floor)


def limits_of(residuals: Array, n: int, floor: Array) -> Array:
    """Largest angle and distance (2,) of n good rows, from residuals (m, 2) of good ones.

    The median is taken as that of absolute values along one axis, and the tail from Student's
    distribution: both err on the side of rows that are inaccurate.
    """
    equations = 3 * len(residuals)
    freedom = max(equations - 7, 1)
    spread = np.median(residuals, axis=0) / NORMAL_MEDIAN * math.sqrt(equations / freedom)
    tail = -float(stdtrit(freedom, 0.5 * _FALSE_ALARM / n))
    return np.maximum(tail * spread, floor)


def relative_to(residuals: Array, limit: Array) -> Array:
    """The larger of angle and distance (n,) in units of their limits."""
    return np.asarray(np.max(residuals / limit, axis=1))


def both(data: PosePairs | MotionPairs) -> tuple[Array, Array]:
    """What the rows hold of the robot and of the camera, (n, 4, 4) each."""
    if isinstance(data, PosePairs):
        return data.base_T_gripper, data.world_T_camera
    return data.gi_T_gj, data.ci_T_cj


def _rounding(data: PosePairs | MotionPairs) -> Array:
    """Angle and distance (2,) that are rounding of the numbers."""
    robot, _ = both(data)
    largest = float(np.abs(robot[:, :3, 3]).max())
    return _ROUNDING * np.array([1.0, max(largest, _ROUNDING)])
