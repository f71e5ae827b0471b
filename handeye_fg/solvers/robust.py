"""Which rows belong together: wrong ones are found before anything is solved; entry ``trusted_rows``.

Swapped rows, failed registrations and poses of another image would break any closed form. X is
found from many small samples of rows (three poses, or two motions), the samples on which half of
the rows agree best are grown to all rows that agree, and the rest is not trusted. Poses are
sampled, not pairs of them: one wrong pose spoils all of its pairs.

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
from handeye_fg.solvers.batched import Turning, rotation_spread, solved, turning_of
from handeye_fg.solvers.residuals import average_base_T_world, differences, motion_residuals
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
# Wrong rows are off by tens of degrees, or by as much as the camera moves. Where rows that agree may
# differ by more than this (radians; part of the camera's extent), either nothing tells wrong rows
# apart or nothing fits. A bad arm of 1 degree and 4 mm has half of it.
_APART_ROTATION = math.radians(20.0)
_APART_TRANSLATION = 0.5
# Rotations about several axes that agree within this (radians) suffice: of a gripper that turns about
# its own origin the translations say nothing.
_ROTATION_ALONE = math.radians(2.0)
# Rows nearer to each other than this part of the spread of all are repetitions.
_SAME = 0.02
# Trusted rows that turn less than this part of all rows about a second axis may fit an X that is
# wrong, and cannot say that the others are.
_RICH = 0.25


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Problem:
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
class _Fit:
    """X and scale of some rows, and what all rows leave: angles and distances (n, 2)."""

    gripper_T_camera: Array
    metres_per_world_unit: float
    residuals: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Candidate:
    """Rows (n,) that agree, the fit to them, and the limits (2,) of agreement."""

    rows: Rows
    fit: _Fit
    limit: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Majority:
    """What the rows say that agree best, half of all at least.

    Attributes:
        gripper_T_camera: X (4, 4), metres.
        metres_per_world_unit: the scale; not positive where nothing fits.
        residuals: angles and distances (n, 2) of all rows.
        several_axes: whether robot and camera turn about two axes or more.
    """

    gripper_T_camera: Array
    metres_per_world_unit: float
    residuals: Array
    several_axes: bool


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


def trusted_rows(data: PosePairs | MotionPairs, *, scale_known: bool, seed: int = 0) -> Rows:
    """The rows (n,) that agree with the majority; all where there is no majority to tell.

    Up to half of the rows may be wrong. Poses whose error grows along the sequence (visual
    odometry) stay trusted while they follow from the row before.

    Args:
        data: poses in the order in which they were taken, or motions.
        scale_known: whether the camera's translations are in metres.
        seed: of the samples.
    """
    everything = np.ones(len(data), dtype=bool)
    # Rows that repeat each other agree whatever X is: one of them speaks for all.
    distinct = _distinct(data)
    if len(distinct) <= _fewest(data):
        return everything
    problem = _problem(only(data, distinct), scale_known=scale_known)
    best = _searched(problem, seed)
    if best is None or not _credible(problem, best):
        return everything
    fit = _of_all(data, distinct, best)
    trusted = _relative(fit.residuals, best.limit) <= 1.0
    if isinstance(data, PosePairs):
        trusted = _along_sequence(data, fit, trusted, problem.floor)
    return trusted


def majority(data: PosePairs | MotionPairs, *, scale_known: bool, seed: int = 0) -> Majority | None:
    """What the rows say that agree best, credible or not; None where every sample has a negative scale.

    Args:
        data: poses, or motions, three or more.
        scale_known: whether the camera's translations are in metres.
        seed: of the samples.
    """
    distinct = _distinct(data)
    if len(distinct) < _sample_size(data):
        distinct = np.arange(len(data))
    problem = _problem(only(data, distinct), scale_known=scale_known)
    best = _searched(problem, seed)
    if best is None:
        return None
    fit = _of_all(data, distinct, best)
    return Majority(
        gripper_T_camera=fit.gripper_T_camera,
        metres_per_world_unit=fit.metres_per_world_unit,
        residuals=fit.residuals,
        several_axes=problem.turning == "general",
    )


def _sample_size(data: PosePairs | MotionPairs) -> int:
    """The rows that determine X."""
    return 3 if isinstance(data, PosePairs) else 2


def _fewest(data: PosePairs | MotionPairs) -> int:
    return _sample_size(data) + _REDUNDANT


def _problem(rows: PosePairs | MotionPairs, *, scale_known: bool) -> _Problem:
    return _Problem(
        data=rows,
        turning=turning_of(as_motions(rows)),
        scale_known=scale_known,
        majority=min(len(rows), max(len(rows) // 2, _fewest(rows))),
        floor=_rounding(rows),
    )


def _searched(problem: _Problem, seed: int) -> _Candidate | None:
    """The best candidate from samples."""
    size = _sample_size(problem.data)
    samples = _samples(len(problem.data), size, np.random.default_rng(seed))
    return _best(problem, _sample_fits(problem, samples))


def _of_all(data: PosePairs | MotionPairs, distinct: Indices, best: _Candidate) -> _Fit:
    """The fit of a candidate among distinct rows, with the residuals of all rows."""
    X, scale = best.fit.gripper_T_camera, best.fit.metres_per_world_unit
    [fit] = _fits(data, distinct[best.rows][None], X[None], np.array([scale]))
    return fit


def _distinct(data: PosePairs | MotionPairs) -> Indices:
    """The first of the rows that have about the same pose of the robot and of the camera."""
    features = []
    for matrices in _both(data):
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


def _sample_fits(problem: _Problem, samples: Indices) -> list[_Fit]:
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
    fits: list[_Fit] = []
    for start in range(0, len(possible), block):
        chosen = possible[start : start + block]
        fits += _fits(data, samples[chosen], X[chosen], scales[chosen])
    return fits


def _fits(data: PosePairs | MotionPairs, rows: Indices, X: Array, scales: Array) -> list[_Fit]:
    """X (s, 4, 4) and scales (s,) with the residuals of all rows; rows (s, m) place the world."""
    A, B = _both(data)
    B = scaled(np.broadcast_to(B, (len(X), *B.shape)), scales[:, None, None])
    left = A @ X[:, None]
    if isinstance(data, PosePairs):
        each = np.arange(len(X))[:, None]
        right = average_base_T_world(left[each, rows], B[each, rows])[:, None] @ B
    else:
        right = X[:, None] @ B
    residuals = np.stack(differences(left, right), axis=-1)
    return [
        _Fit(gripper_T_camera=X[k], metres_per_world_unit=float(scales[k]), residuals=residuals[k])
        for k in range(len(X))
    ]


def _best(problem: _Problem, fits: list[_Fit]) -> _Candidate | None:
    """The most promising fits, grown; of those the one that most rows agree with."""
    if not fits:
        return None

    def score(fit: _Fit) -> float:
        return float(np.log(_typical(problem, fit)).sum())

    candidates = [_grown(problem, fit) for fit in sorted(fits, key=score)[:_GROWN]]
    # All are judged by the tightest limits: a wrong X has wide ones, and all rows agree with it. An
    # X that fits half of the rows may yet be wrong, where those turn about one axis.
    limit = min((candidate.limit for candidate in candidates), key=lambda each: float(each.prod()))

    def cost(candidate: _Candidate) -> float:
        return float(_relative(candidate.fit.residuals, limit).clip(0.0, 1.0).sum())

    return min(candidates, key=cost)


def _grown(problem: _Problem, fit: _Fit) -> _Candidate:
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
        [fit] = _fits(data, np.flatnonzero(rows)[None], X, scales)
        limit = _limits(fit.residuals[rows], n, problem.floor)
        agree = (_relative(fit.residuals, limit) <= 1.0) | _majority(problem, fit)
        rounds -= 1
        if rounds == 0 or np.array_equal(agree, rows):
            return _Candidate(rows=rows, fit=fit, limit=limit)
        rows = agree


def _majority(problem: _Problem, fit: _Fit) -> Rows:
    """The rows that fit best, as many as make a majority."""
    order = np.argsort(_relative(fit.residuals, _typical(problem, fit)), kind="stable")
    rows = np.zeros(len(order), dtype=bool)
    rows[order[: problem.majority]] = True
    return rows


def _typical(problem: _Problem, fit: _Fit) -> Array:
    """Angle and distance (2,) that the majority does not exceed."""
    last = problem.majority - 1
    typical: Array = np.partition(fit.residuals, last, axis=0)[last]
    return np.maximum(typical, problem.floor)


def _limits(residuals: Array, n: int, floor: Array) -> Array:
    """Largest angle and distance (2,) of n good rows, from residuals (m, 2) of good ones.

    The median is taken as that of absolute values along one axis, and the tail from Student's
    distribution: both err on the side of rows that are inaccurate.
    """
    equations = 3 * len(residuals)
    freedom = max(equations - 7, 1)
    spread = np.median(residuals, axis=0) / NORMAL_MEDIAN * math.sqrt(equations / freedom)
    tail = -float(stdtrit(freedom, 0.5 * _FALSE_ALARM / n))
    return np.maximum(tail * spread, floor)


def _relative(residuals: Array, limit: Array) -> Array:
    """The larger of angle and distance (n,) in units of their limits."""
    return np.asarray(np.max(residuals / limit, axis=1))


def _credible(problem: _Problem, best: _Candidate) -> bool:
    """Whether the rows that agree can say that the others are wrong.

    Not where nothing fits (another convention), nor where the others have the motions that
    determine X.
    """
    data, limit = problem.data, best.limit
    _, camera = _both(data)
    places = best.fit.metres_per_world_unit * camera[best.rows, :3, 3]
    if isinstance(data, PosePairs):
        places = places - places.mean(axis=0)
        # Errors that accumulate are small from row to row.
        limit = np.minimum(limit, _step_limits(data, best.fit, best.rows, problem.floor))
    extent = math.sqrt(float(np.mean(np.sum(places**2, axis=1))))
    general = problem.turning == "general"
    if limit[0] > _APART_ROTATION:
        return False
    if limit[1] > _APART_TRANSLATION * extent and not (general and limit[0] < _ROTATION_ALONE):
        return False
    if not general:
        return True
    agreeing = rotation_spread(as_motions(only(data, best.rows)))
    return bool(agreeing[1] >= _RICH * rotation_spread(as_motions(data))[1])


def _along_sequence(data: PosePairs, fit: _Fit, trusted: Rows, floor: Array) -> Rows:
    """The trusted rows and those that follow from them: errors that accumulate make none wrong.

    The motion between two neighbours is judged against that between trusted neighbours.
    """
    limit = _step_limits(data, fit, trusted, floor)
    rows = trusted.copy()
    for order in (range(len(rows)), range(len(rows) - 1, -1, -1)):
        before = -1
        for row in order:
            if not rows[row] and before >= 0:
                step = _steps(data, fit, np.array([before]), np.array([row]))
                rows[row] = bool(_relative(step, limit)[0] <= 1.0)
            if rows[row]:
                before = row
    return rows


def _step_limits(data: PosePairs, fit: _Fit, trusted: Rows, floor: Array) -> Array:
    """Limits (2,) of the motions between neighbours, from those of trusted rows."""
    known = np.flatnonzero(trusted)
    return _limits(_steps(data, fit, known[:-1], known[1:]), len(data), floor)


def _steps(data: PosePairs, fit: _Fit, i: Indices, j: Indices) -> Array:
    """Residuals (k, 2) of the motions from rows i to rows j."""
    pairs = MotionPairs(
        i=i,
        j=j,
        gi_T_gj=inverse(data.base_T_gripper[i]) @ data.base_T_gripper[j],
        ci_T_cj=inverse(data.world_T_camera[i]) @ data.world_T_camera[j],
    )
    residuals = motion_residuals(pairs, fit.gripper_T_camera, fit.metres_per_world_unit)
    return np.stack(residuals, axis=1)


def _both(data: PosePairs | MotionPairs) -> tuple[Array, Array]:
    """What the rows hold of the robot and of the camera, (n, 4, 4) each."""
    if isinstance(data, PosePairs):
        return data.base_T_gripper, data.world_T_camera
    return data.gi_T_gj, data.ci_T_cj


def _rounding(data: PosePairs | MotionPairs) -> Array:
    """Angle and distance (2,) that are rounding of the numbers."""
    robot, _ = _both(data)
    largest = float(np.abs(robot[:, :3, 3]).max())
    return _ROUNDING * np.array([1.0, max(largest, _ROUNDING)])
