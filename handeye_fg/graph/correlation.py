"""Errors of features that are not independent: how much less the images say; entry ``inflation``.

Neighbouring features err alike: a lens that its model does not describe exactly, edges that look
different from the side, a track that follows the wrong thing for a while. Each region b of the scene
gives a part g_b of the gradient. At the optimum, with the points eliminated, H the information of all
measurements and H_b that of a region, independent errors make::

    cov(g_a, g_b) = delta_ab H_b - H_a H^-1 H_b

What a region moves the unknowns of interest by is u_b = T'g_b, with T their columns of H^-1. The sum of
k_ab u_a u_b' over all pairs of regions, where the weight k_ab falls with their distance, is the meat of a
spatially robust covariance (Conley, J. Econometrics 1999); in units of its expectation under independence
it says how much larger the variance is. Only this factor is taken: the regions are too few for a matrix.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from handeye_fg.frames import Array
from handeye_fg.graph.elimination import by_regions
from handeye_fg.graph.noise import Solution
from handeye_fg.graph.problem import Problem
from handeye_fg.graph.rig import is_plain, to_images
from handeye_fg.graph.variables import State
from handeye_fg.types import Indices

_HALVINGS = 6  # 64 regions
_FEWEST_POINTS = 8  # in a region
_FEWEST_REGIONS = 16  # with fewer the factor would be known to less than a part of 0.3
# Of the weights, in units of the scene's spread: far enough to see the correlation on rendered images and
# photographs (it grows no further), and near enough that the factor is known to a part of 0.2.
_REACH = 0.5
_SMALLEST = 1e-6  # eigenvalue of a matrix of correlations; below it a direction is not determined


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Regions:
    """What the regions (b) say of the unknowns of interest (q), for all shared unknowns (d).

    Attributes:
        weight: of pairs (b, b).
        moved: u (b, q).
        seen: H_b T (b, d, q).
        information: T'H_b T (b, q, q).
    """

    weight: Array
    moved: Array
    seen: Array
    information: Array


def inflation(problem: Problem, state: State, solution: Solution, columns: Indices) -> float:
    """How much larger variances from the images are than those of independent errors, at least 1.

    Args:
        problem: the problem, with its observations.
        state: where it was linearised.
        solution: its solution there.
        columns: of the unknowns of interest.

    Returns:
        The mean factor along these unknowns; 1 where the scene has too few points to say.
    """
    points = state.points_world[problem.layout.n_known :]
    regions = _regions(points)
    if len(regions) < _FEWEST_REGIONS:
        return 1.0
    return _factor(_found(problem, state, solution, regions, columns), solution.covariance)


def _regions(points: Array) -> list[Indices]:
    """Indices of the points of each region: halved again and again along their longest axis."""
    regions = [np.arange(len(points))]
    for _ in range(_HALVINGS):
        if min(map(len, regions)) < 2 * _FEWEST_POINTS:
            break
        regions = [half for region in regions for half in _halves(points, region)]
    return regions


def _halves(points: Array, region: Indices) -> tuple[Indices, Indices]:
    low, high = np.quantile(points[region], [0.1, 0.9], axis=0)
    order = region[np.argsort(points[region, np.argmax(high - low)], kind="stable")]
    return np.sort(order[: len(order) // 2]), np.sort(order[len(order) // 2 :])


def _found(
    problem: Problem, state: State, solution: Solution, regions: Sequence[Indices], columns: Indices
) -> _Regions:
    """What the regions say, with the solution's weights."""
    layout = problem.layout
    region = np.zeros(len(state.points_world), dtype=np.int64)
    for index, points in enumerate(regions):
        region[layout.n_known + points] = index
    to_interest = solution.covariance[:, columns]
    images = replace(layout, n_poses=len(state.rig.pose))
    if is_plain(state.rig):
        seen, gradients = by_regions(problem.scene, state, images, to_interest, region)
    else:
        to = to_images(state, layout)
        seen, gradients = by_regions(problem.scene, state, images, to @ to_interest, region)
        seen, gradients = np.array([to.T @ part for part in seen]), gradients @ to
    unit = solution.noise.image_sigma / problem.pixel_unit_px
    seen, gradients = seen / unit**2, gradients / unit**2
    return _Regions(
        weight=_weights(state.points_world[layout.n_known :], regions),
        # The rest of the gradient after the solution's step.
        moved=gradients @ to_interest - np.swapaxes(seen, 1, 2) @ solution.step,
        seen=seen,
        information=to_interest.T @ seen,
    )


def _weights(points: Array, regions: Sequence[Indices]) -> Array:
    """Weights (b, b) of pairs of regions: one for the same, less for distant ones."""
    centres = np.array([points[region].mean(axis=0) for region in regions])
    low, high = np.quantile(points, special.ndtr([-1.0, 1.0]), axis=0)
    distances = np.linalg.norm(centres[:, None] - centres, axis=2)
    return np.asarray(np.exp(-0.5 * (distances / (_REACH * np.max(high - low) / 2.0)) ** 2))


def _factor(found: _Regions, covariance: Array) -> float:
    """Mean over the determined directions of the variance in units of its expectation, at least 1."""
    expected = np.einsum("bb,bij->ij", found.weight, found.information)
    smooth = np.einsum("ab,bdq->adq", found.weight, found.seen)
    expected = expected - np.einsum("adi,adj->ij", smooth, covariance @ found.seen)
    scale = np.sqrt(np.clip(np.diag(expected), 0.0, None))
    used = scale > 0.0
    if not used.any():
        return 1.0
    expected = expected[np.ix_(used, used)] / np.outer(scale[used], scale[used])
    values, vectors = np.linalg.eigh(expected)
    right = values > _SMALLEST
    along = found.moved[:, used] / scale[used] @ (vectors[:, right] / np.sqrt(values[right]))
    return float(max(np.einsum("ab,aq,bq->", found.weight, along, along) / right.sum(), 1.0))
