"""Which rows belong together: wrong ones are found before anything is solved; entry ``trusted_rows``.

Swapped rows, failed registrations and poses of another image would break any closed form. The rows that
agree best (``handeye_fg.solvers.consensus``) are believed, the rest is not trusted. Poses are sampled,
not pairs of them: one wrong pose spoils all of its pairs.
"""

import math
from dataclasses import dataclass

import numpy as np

from handeye_fg.frames import Array, inverse
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.solvers.batched import rotation_spread
from handeye_fg.solvers.consensus import (
    Candidate,
    Fit,
    Problem,
    Rows,
    best_candidate,
    both,
    distinct_rows,
    fewest,
    fits_of,
    limits_of,
    only,
    problem_of,
    relative_to,
    sample_size,
)
from handeye_fg.solvers.residuals import motion_residuals
from handeye_fg.types import Indices

# Wrong rows are off by tens of degrees, or by as much as the camera moves. Where rows that agree may
# differ by more than this (radians; part of the camera's extent), either nothing tells wrong rows
# apart or nothing fits. A bad arm of 1 degree and 4 mm has half of it.
_APART_ROTATION = math.radians(20.0)
_APART_TRANSLATION = 0.5
# Rotations about several axes that agree within this (radians) suffice: of a gripper that turns about
# its own origin the translations say nothing.
_ROTATION_ALONE = math.radians(2.0)
# Trusted rows that turn less than this part of all rows about a second axis may fit an X that is
# wrong, and cannot say that the others are.
_RICH = 0.25


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
    distinct = distinct_rows(data)
    if len(distinct) <= fewest(data):
        return everything
    problem = problem_of(only(data, distinct), scale_known=scale_known)
    best = best_candidate(problem, seed)
    if best is None or not _credible(problem, best):
        return everything
    fit = _of_all(data, distinct, best)
    trusted = relative_to(fit.residuals, best.limit) <= 1.0
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
    distinct = distinct_rows(data)
    if len(distinct) < sample_size(data):
        distinct = np.arange(len(data))
    problem = problem_of(only(data, distinct), scale_known=scale_known)
    best = best_candidate(problem, seed)
    if best is None:
        return None
    fit = _of_all(data, distinct, best)
    return Majority(
        gripper_T_camera=fit.gripper_T_camera,
        metres_per_world_unit=fit.metres_per_world_unit,
        residuals=fit.residuals,
        several_axes=problem.turning == "general",
    )


def _of_all(data: PosePairs | MotionPairs, distinct: Indices, best: Candidate) -> Fit:
    """The fit of a candidate among distinct rows, with the residuals of all rows."""
    X, scale = best.fit.gripper_T_camera, best.fit.metres_per_world_unit
    [fit] = fits_of(data, distinct[best.rows][None], X[None], np.array([scale]))
    return fit


def _credible(problem: Problem, best: Candidate) -> bool:
    """Whether the rows that agree can say that the others are wrong.

    Not where nothing fits (another convention), nor where the others have the motions that
    determine X.
    """
    data, limit = problem.data, best.limit
    _, camera = both(data)
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


def _along_sequence(data: PosePairs, fit: Fit, trusted: Rows, floor: Array) -> Rows:
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
                rows[row] = bool(relative_to(step, limit)[0] <= 1.0)
            if rows[row]:
                before = row
    return rows


def _step_limits(data: PosePairs, fit: Fit, trusted: Rows, floor: Array) -> Array:
    """Limits (2,) of the motions between neighbours, from those of trusted rows."""
    known = np.flatnonzero(trusted)
    return limits_of(_steps(data, fit, known[:-1], known[1:]), len(data), floor)


def _steps(data: PosePairs, fit: Fit, i: Indices, j: Indices) -> Array:
    """Residuals (k, 2) of the motions from rows i to rows j."""
    pairs = MotionPairs(
        i=i,
        j=j,
        gi_T_gj=inverse(data.base_T_gripper[i]) @ data.base_T_gripper[j],
        ci_T_cj=inverse(data.world_T_camera[i]) @ data.world_T_camera[j],
    )
    residuals = motion_residuals(pairs, fit.gripper_T_camera, fit.metres_per_world_unit)
    return np.stack(residuals, axis=1)
