"""How certain the noise levels are, and X with them; entry points ``level_spread``, ``certainty_of``.

With Sigma the covariance of the shared unknowns, Q_k the information of measurements of kind k (image
points, robot rotations, robot translations, corners of a target) and n_k their number, the restricted
likelihood of the variances has this information in their logarithms::

    1/2 (n_k - 2 tr(Sigma Q_k) + tr(Sigma Q_k Sigma Q_k)),    1/2 tr(Sigma Q_k Sigma Q_l)
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg.findings import LevelCertainty
from handeye_fg.frames import Array
from handeye_fg.graph.certainty import Certainty, certainty, given
from handeye_fg.graph.noise import PRIOR_WEIGHT, Solution, known_levels, prior_decides
from handeye_fg.graph.reduced import Linearised, predicted_together
from handeye_fg.options import NoiseOptions

# Weight of observations that the variances are taken to have beyond what the likelihood says: the
# information is that at the levels found, and the mean of its inverse would be too large.
_MORE_INFORMATION = 1.0
_LEAST_INFORMATION = 0.1
_TINY = 1e-12
_MANY = 1e6  # degrees of freedom of what is as good as known
_OUTSIDE = 0.05  # probability outside of an interval


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LevelSpread:
    """Uncertainty of the noise levels: pixel, robot rotation, robot translation, corner.

    Attributes:
        estimated: which of the four (4,) come from the data.
        information: twice that of the logarithms of those variances (k, k).
    """

    estimated: NDArray[np.bool_]
    information: Array

    @property
    def freedoms(self) -> Array:
        """Effective degrees of freedom of the four (4,); infinite where not estimated."""
        result = np.full(len(self.estimated), np.inf)
        result[self.estimated] = 1.0 / np.diag(_inverse(self.information, _LEAST_INFORMATION))
        return result

    @property
    def covariance(self) -> Array:
        """Of the logarithms of the variances (k, k)."""
        more = _MORE_INFORMATION * np.eye(len(self.information))
        return 2.0 * _inverse(self.information + more, _MORE_INFORMATION)


def level_spread(problem: Linearised, solution: Solution, options: NoiseOptions) -> LevelSpread:
    """Of the levels of a solution.

    All information together is that of Sigma, so that what images and robot share of it follows
    from what the robot has; the priors' part is neglected, and so is what pixels and corners share.

    Args:
        problem: the linearised problem.
        solution: its solution.
        options: the levels that the user knows.
    """
    noise, n = solution.noise, len(problem.robot.residual)
    sigmas = np.tile(np.repeat([noise.robot_rotation, noise.robot_translation], 3), n)
    whitened = predicted_together(problem.robot, solution.covariance) / np.outer(sigmas, sigmas)
    parts = (whitened**2).reshape(n, 2, 3, n, 2, 3).sum(axis=(0, 2, 3, 5))
    used = 3.0 * n - np.array(solution.redundancy[1:3])
    redundancy = np.array(solution.redundancy)
    by_images = np.array([problem.pixel_redundancy, problem.corner_rows]) - redundancy[[0, 3]]
    shared = np.outer(by_images / max(by_images.sum(), _TINY), used - parts.sum(axis=1))
    information = np.diag(redundancy)
    information[1:3, 1:3] += parts - np.diag(used)
    information[[0, 3], 1:3] = shared
    information[1:3, [0, 3]] = shared.T
    information[[0, 3], [0, 3]] -= shared.sum(axis=1)
    estimated = _estimated(problem, options)
    chosen = information[np.ix_(estimated, estimated)]
    chosen = chosen + np.diag(np.array([0.0, PRIOR_WEIGHT, PRIOR_WEIGHT, 0.0])[estimated])
    return LevelSpread(estimated=estimated, information=chosen)


def _inverse(information: Array, least: float) -> Array:
    """Inverse (k, k) of an information with eigenvalues that are no less than ``least``."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors / np.maximum(values, least)) @ vectors.T)


def _estimated(problem: Linearised, options: NoiseOptions) -> NDArray[np.bool_]:
    """Which of the four levels come from the data."""
    pixel, rotation, translation = (level is None for level in known_levels(options))
    return np.array(
        [
            pixel and problem.pixel_redundancy > 0,
            rotation,
            translation,
            pixel and problem.corner_rows > 0,
        ]
    )


def certainty_of(
    problem: Linearised,
    solution: Solution,
    spread: LevelSpread,
    derivative: Array,
    together: int,
) -> Certainty:
    """Of some linear functions of the shared unknowns.

    Args:
        problem: the linearised problem.
        solution: its solution.
        spread: of its levels.
        derivative: of the functions by the shared unknowns (k, d).
        together: how many of them, the first ones, are judged together.
    """
    covariance = solution.covariance @ derivative.T
    if not spread.estimated.any():
        return given(derivative @ covariance, together)
    weighted = _weighted(problem, solution, covariance)[spread.estimated]
    first = covariance.T @ weighted
    inner = np.einsum("ij,ljb->lib", solution.covariance, weighted)
    second = np.einsum("kia,lib->klab", weighted, inner)
    return certainty(derivative @ covariance, first, second, spread.covariance, together)


def _weighted(problem: Linearised, solution: Solution, columns: Array) -> Array:
    """``Q_k`` of the four kinds times some columns (d, c): (4, d, c)."""
    noise, robot = solution.noise, problem.robot
    result = np.zeros((4, *columns.shape))
    result[0] = (
        problem.reprojections.hessian @ columns / (noise.image_sigma / problem.pixel_unit_px) ** 2
    )
    result[3] = problem.corners.hessian @ columns / noise.corner_image_sigma**2
    predicted = robot.jacobian @ columns[robot.columns]
    for k, sigma in ((1, noise.robot_rotation), (2, noise.robot_translation)):
        rows = slice(3 * (k - 1), 3 * k)
        back = np.swapaxes(robot.jacobian[:, rows], 1, 2) @ predicted[:, rows] / sigma**2
        np.add.at(result[k], robot.columns, back)
    return result


def level_certainties(
    problem: Linearised, solution: Solution, spread: LevelSpread
) -> dict[str, LevelCertainty]:
    """How certain each noise level is and what decided it, by its name in ``NoiseLevels``.

    Args:
        problem: the linearised problem.
        solution: its solution.
        spread: of its levels.
    """
    names = ["pixel", "robot_rotation", "robot_translation", "corner"]
    present = [problem.pixel_redundancy > 0, True, True, problem.corner_rows > 0]
    result = {}
    for k in np.flatnonzero(present):
        freedom = float(spread.freedoms[k])
        known = not spread.estimated[k]
        chi_squares = special.chdtri(min(freedom, _MANY), [0.5 * _OUTSIDE, 1.0 - 0.5 * _OUTSIDE])
        low, high = (1.0, 1.0) if known else np.sqrt(min(freedom, _MANY) / chi_squares)
        of_prior = k in (1, 2) and prior_decides(solution, int(k) - 1)
        result[names[k]] = LevelCertainty(
            degrees_of_freedom=freedom,
            low=float(low),
            high=float(high),
            source="user" if known else "prior" if of_prior else "data",
            found=_found(solution, int(k)) if known else None,
        )
    return result


def _found(solution: Solution, group: int) -> tuple[float, float, float] | None:
    """What the residuals say of a given level: a multiple of it with its 95 % interval; None: nothing."""
    noise, freedom = solution.noise, solution.redundancy[group]
    if freedom < 1.0:
        return None
    given = (noise.pixel, noise.robot_rotation, noise.robot_translation, noise.corner or 1.0)[group]
    ratio = float(np.sqrt(solution.squares[group] / freedom)) / given
    ends = np.sqrt(freedom / special.chdtri(freedom, [0.5 * _OUTSIDE, 1.0 - 0.5 * _OUTSIDE]))
    return ratio, ratio * float(ends[0]), ratio * float(ends[1])
