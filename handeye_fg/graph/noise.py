"""Noise levels from the data: variance components with redundancy numbers.

A residual is smaller than the noise that caused it, since the unknowns adapt to the noise. For each
group of measurements the variance is therefore the sum of squared residuals divided by the group's
redundancy, ``sum(1 - leverage)``, not by its count (Foerstner's form of Helmert's estimator). It is
iterated with the solution of the linearised problem, which costs no new elimination.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array
from handeye_fg.graph.reduced import Linearised, Quadratic, predicted_covariance, scatter
from handeye_fg.options import NoiseOptions
from handeye_fg.types import NoiseLevels

# A tenth of an observation of each robot sigma keeps it away from zero when there are few images or
# the poses are exact: 0.02 degrees and 0.1 mm are usual for industrial arms.
_PRIOR_WEIGHT = 0.1
_PRIOR_ROTATION = np.deg2rad(0.02)
_PRIOR_TRANSLATION = 1e-4
# No feature is located better than this (pixels); exact observations keep a finite weight.
_FINEST_PIXEL = 0.01
_MAX_ITERATIONS = 200
_CONVERGED = 1e-4  # relative change of a sigma; its own uncertainty is above 1e-2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A linearised problem solved with certain noise levels.

    Attributes:
        noise: the levels.
        redundancy: degrees of freedom of the pixel, robot rotation, robot translation and corner sigmas.
        squares: weightless sums of squared residuals of the same four groups after the step.
        step: of the shared unknowns (d,), towards the minimum.
        covariance: of the shared unknowns (d, d).
        robot_covariance: covariance (n, 6, 6) of the robot residuals after the fit.
    """

    noise: NoiseLevels
    redundancy: tuple[float, float, float, float]
    squares: tuple[float, float, float, float]
    step: Array
    covariance: Array
    robot_covariance: Array


def _known(options: NoiseOptions) -> tuple[float | None, float | None, float | None]:
    """The user's sigmas in pixels, radians and metres; None where they are to be estimated."""
    rotation = options.robot_rotation_deg
    translation = options.robot_translation_mm
    return (
        options.pixel_px,
        None if rotation is None else float(np.deg2rad(rotation)),
        None if translation is None else 1e-3 * translation,
    )


def _inverse(hessian: Array) -> Array:
    """Inverse of an information matrix whose unknowns have very different units.

    Raises:
        ConvergenceError: it is not positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(hessian))
    try:
        factor = linalg.cho_factor(hessian * np.outer(scale, scale))
    except linalg.LinAlgError as error:
        raise ConvergenceError(
            "the information matrix of the refinement is not positive definite: the images do not "
            "hold together; check that they overlap and that the poses belong to them"
        ) from error
    inverse = linalg.cho_solve(factor, np.eye(len(hessian)))
    return np.asarray(0.5 * (inverse + inverse.T) * np.outer(scale, scale))


def solve(problem: Linearised, noise: NoiseLevels) -> Solution:
    """Solve the linearised problem with the given levels.

    Raises:
        ConvergenceError: the information matrix is not positive definite.
    """
    images, corners = problem.reprojections, problem.corners
    robot, prior = problem.robot, problem.prior
    unit, corner = noise.pixel / problem.pixel_unit_px, _corner(noise)
    weights = np.repeat([noise.robot_rotation, noise.robot_translation], 3) ** -2.0
    robot_hessian, robot_gradient = scatter(robot, weights, problem.layout.dim)
    seen = images.hessian / unit**2 + corners.hessian / corner**2
    seen_gradient = images.gradient / unit**2 + corners.gradient / corner**2
    others, others_gradient = prior.hessian, prior.gradient
    if problem.held is not None:
        others = others + problem.held.hessian
        others_gradient = others_gradient + problem.held.gradient
    covariance = _inverse(seen + robot_hessian + others)
    step = covariance @ (seen_gradient + robot_gradient + others_gradient)

    predicted = predicted_covariance(robot, covariance)
    leverage = np.diagonal(predicted, axis1=1, axis2=2) * weights
    rotation_used, translation_used = leverage.sum(axis=0).reshape(2, 3).sum(axis=1)
    pixel_used = np.sum(images.hessian * covariance) / unit**2
    corner_used = np.sum(corners.hessian * covariance) / corner**2
    rows = 3 * len(robot.residual)

    moved = robot.residual + np.einsum("nij,nj->ni", robot.jacobian, step[robot.columns])
    rotation_squares, translation_squares = np.sum(moved**2, axis=0).reshape(2, 3).sum(axis=1)
    return Solution(
        noise=noise,
        redundancy=(
            float(problem.pixel_redundancy - pixel_used),
            float(rows - rotation_used),
            float(rows - translation_used),
            float(problem.corner_rows - corner_used),
        ),
        squares=(
            problem.pixel_unit_px**2 * _squares(images, step),
            float(rotation_squares),
            float(translation_squares),
            _squares(corners, step),
        ),
        step=step,
        covariance=covariance,
        robot_covariance=np.diag(1.0 / weights) - predicted,
    )


def _corner(noise: NoiseLevels) -> float:
    """The sigma of corners; any where there are none."""
    return 1.0 if noise.corner is None else noise.corner


def _squares(measurements: Quadratic, step: Array) -> float:
    """Sum of squares after a step; not below zero by rounding."""
    moved = step @ measurements.hessian @ step - 2 * measurements.gradient @ step
    return max(float(measurements.constant + moved), 0.0)


def _updated(solution: Solution, options: NoiseOptions) -> NoiseLevels:
    """Levels that agree with the residuals; the user's where the user gave them."""
    pixel, rotation, translation, corner = (
        float(np.sqrt((squares + weight * prior**2) / max(redundancy + weight, 1e-3)))
        for squares, redundancy, weight, prior in zip(
            solution.squares,
            solution.redundancy,
            (0.0, _PRIOR_WEIGHT, _PRIOR_WEIGHT, 0.0),
            (0.0, _PRIOR_ROTATION, _PRIOR_TRANSLATION, 0.0),
            strict=True,
        )
    )
    known = _known(options)
    corner = max(corner, _FINEST_PIXEL) if known[0] is None else known[0]
    if solution.redundancy[0] == 0.0:  # nothing but corners was observed
        pixel = corner
    return NoiseLevels(
        pixel=max(pixel, _FINEST_PIXEL) if known[0] is None else known[0],
        robot_rotation=rotation if known[1] is None else known[1],
        robot_translation=translation if known[2] is None else known[2],
        estimated=None in known,
        corner=None if solution.noise.corner is None else corner,
    )


def relative_change(before: NoiseLevels, after: NoiseLevels) -> float:
    """Largest relative change of a level."""
    pairs = (
        (before.pixel, after.pixel),
        (before.robot_rotation, after.robot_rotation),
        (before.robot_translation, after.robot_translation),
        (_corner(before), _corner(after)),
    )
    return max(abs(float(np.log(a / b))) for a, b in pairs)


def estimate_noise(problem: Linearised, start: NoiseLevels, options: NoiseOptions) -> Solution:
    """Find the noise levels that agree with the residuals of the linearised problem.

    Args:
        problem: the linearised problem.
        start: first levels.
        options: the levels that the user knows.

    Returns:
        The problem solved with the levels found.

    Raises:
        ConvergenceError: the information matrix is not positive definite.
    """
    solution = solve(problem, start)
    for _ in range(_MAX_ITERATIONS):
        levels = _updated(solution, options)
        change = relative_change(solution.noise, levels)
        solution = solve(problem, levels)
        if change < _CONVERGED:
            break
    return solution


def degrees_of_freedom(problem: Linearised, solution: Solution) -> float:
    """Effective degrees of freedom of X's covariance (Welch-Satterthwaite); infinite if known.

    X's covariance is the sum of what each noise level contributes, ``Sigma H_g Sigma``. The less
    data a level was found from, the less certain is its share.
    """
    if not solution.noise.estimated:
        return float("inf")
    noise, columns = solution.noise, problem.layout.x_columns
    to_x = solution.covariance[columns]
    sigmas = (noise.robot_rotation, noise.robot_translation)
    contributions = [problem.reprojections.hessian / (noise.pixel / problem.pixel_unit_px) ** 2]
    for part, sigma in enumerate(sigmas):
        weights = np.zeros(6)
        weights[3 * part : 3 * part + 3] = sigma**-2.0
        contributions.append(scatter(problem.robot, weights, problem.layout.dim)[0])
    contributions.append(problem.corners.hessian / _corner(noise) ** 2)
    x_information = _inverse(solution.covariance[np.ix_(columns, columns)])
    shares = [float(np.sum(x_information * (to_x @ part @ to_x.T))) / 6 for part in contributions]
    uncertainty = sum(
        share**2 / max(redundancy, 1.0)
        for share, redundancy in zip(shares, solution.redundancy, strict=True)
    )
    return 1.0 / uncertainty
