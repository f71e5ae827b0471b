"""Noise levels from the data: variance components with redundancy numbers.

A residual is smaller than the noise that caused it, since the unknowns adapt to the noise. For each
group of measurements the variance is therefore the sum of squared residuals divided by the group's
redundancy, ``sum(1 - leverage)``, not by its count (Foerstner's form of Helmert's estimator). It is
iterated with the solution of the linearised problem, which costs no new elimination.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from handeye_fg.errors import ConvergenceError
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.reduced import Linearised, Quadratic, predicted_covariance, scatter
from handeye_fg.options import NoiseOptions

# A tenth of an observation of each robot sigma keeps it away from zero when there are few images or
# the poses are exact: 0.02 degrees and 0.1 mm are usual for industrial arms.
PRIOR_WEIGHT = 0.1
_PRIOR_ROTATION = np.deg2rad(0.02)
_PRIOR_TRANSLATION = 1e-4
# No feature is located better than this (pixels); exact observations keep a finite weight.
_FINEST_PIXEL = 0.01
_MAX_ITERATIONS = 100
_CONVERGED = 1e-5  # relative change of a sigma; its own uncertainty is above 1e-2
_MEMORY = 4  # solutions from which the levels are extrapolated: one more than there are levels
_FARTHEST = 1.0  # in logarithms


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solution:
    """A linearised problem solved with certain noise levels.

    Attributes:
        noise: the levels.
        redundancy: degrees of freedom of the pixel, robot rotation, robot translation and corner sigmas.
        squares: weightless sums of squared residuals of the same four groups after the step.
        step: of the shared unknowns (d,), towards the minimum.
        decrease: of the cost by this step.
        covariance: of the shared unknowns (d, d).
    """

    noise: NoiseLevels
    redundancy: tuple[float, float, float, float]
    squares: tuple[float, float, float, float]
    step: Array
    decrease: float
    covariance: Array


def known_levels(options: NoiseOptions) -> tuple[float | None, float | None, float | None]:
    """The user's sigmas in pixels, radians and metres; None where they are to be estimated."""
    rotation = options.robot_rotation_deg
    translation = options.robot_translation_mm
    return (
        options.pixel_px,
        None if rotation is None else float(np.deg2rad(rotation)),
        None if translation is None else 1e-3 * translation,
    )


def _solved(hessian: Array, gradient: Array) -> tuple[Array, Array]:
    """Solution (d,) and inverse (d, d) of normal equations whose unknowns have very different units.

    The solution does not come from the inverse: in the directions that are hardly determined, that
    would leave nothing but rounding of the small residuals.

    Raises:
        ConvergenceError: the information matrix is not positive definite.
    """
    scale = 1.0 / np.sqrt(np.diag(hessian))
    # LAPACK works in place on columns; of a symmetric matrix these are the rows.
    scaled = (hessian * scale * scale[:, None]).T
    factor, failed = lapack.dpotrf(scaled, lower=1, overwrite_a=1)
    if failed or not np.isfinite(scale).all():
        raise ConvergenceError(
            "the information matrix of the refinement is not positive definite: the images do not "
            "hold together; check that they overlap and that the poses belong to them"
        )
    solution, _ = lapack.dpotrs(factor, scale * gradient, lower=1)
    lower, _ = lapack.dpotri(factor, lower=1, overwrite_c=1)
    lower *= scale
    lower *= scale[:, None]
    inverse = np.tril(lower)
    inverse += np.tril(lower, -1).T
    return scale * solution, inverse


def _weights(noise: NoiseLevels) -> Array:
    """Weights (6,) of a robot residual."""
    return np.repeat([noise.robot_rotation, noise.robot_translation], 3) ** -2.0


def _normal_equations(problem: Linearised, noise: NoiseLevels) -> tuple[Array, Array]:
    """Information matrix (d, d) and right-hand side (d,) with the given levels."""
    hessian, gradient = scatter(problem.robot, _weights(noise), problem.layout.dim)
    unit = noise.image_sigma / problem.pixel_unit_px
    parts = [(problem.reprojections, unit), (problem.prior, 1.0)]
    parts += [(problem.corners, noise.corner_image_sigma)] if problem.corner_rows else []
    parts += [] if problem.held is None else [(problem.held, 1.0)]
    for part, sigma in parts:
        hessian += part.hessian / sigma**2
        gradient += part.gradient / sigma**2
    return hessian, gradient


def cost(problem: Linearised, noise: NoiseLevels) -> float:
    """Cost of the linearised problem without a step, but with the unknown points at their best."""
    squares = float(np.sum(_weights(noise) * problem.robot.residual**2))
    squares += problem.reprojections.constant * (problem.pixel_unit_px / noise.image_sigma) ** 2
    squares += problem.corners.constant / noise.corner_image_sigma**2 + problem.prior.constant
    return 0.5 * (squares + (0.0 if problem.held is None else problem.held.constant))


def solve(problem: Linearised, noise: NoiseLevels) -> Solution:
    """Solve the linearised problem with the given levels.

    Raises:
        ConvergenceError: the information matrix is not positive definite.
    """
    images, corners, robot = problem.reprojections, problem.corners, problem.robot
    hessian, gradient = _normal_equations(problem, noise)
    step, covariance = _solved(hessian, gradient)

    weights = _weights(noise)
    predicted = predicted_covariance(robot, covariance)
    leverage = np.diagonal(predicted, axis1=1, axis2=2) * weights
    rotation_used, translation_used = leverage.sum(axis=0).reshape(2, 3).sum(axis=1)
    pixel_used = (
        np.sum(images.hessian * covariance) * (problem.pixel_unit_px / noise.image_sigma) ** 2
    )
    corner_used = 0.0
    if problem.corner_rows:
        corner_used = np.sum(corners.hessian * covariance) / noise.corner_image_sigma**2
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
        decrease=0.5 * float(gradient @ step),
        covariance=covariance,
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
            (0.0, PRIOR_WEIGHT, PRIOR_WEIGHT, 0.0),
            (0.0, _PRIOR_ROTATION, _PRIOR_TRANSLATION, 0.0),
            strict=True,
        )
    )
    known = known_levels(options)
    corner = max(corner, _FINEST_PIXEL) if known[0] is None else known[0]
    if solution.redundancy[0] == 0.0:  # nothing but corners was observed
        pixel = corner
    return replace(
        solution.noise,
        pixel=max(pixel, _FINEST_PIXEL) if known[0] is None else known[0],
        robot_rotation=rotation if known[1] is None else known[1],
        robot_translation=translation if known[2] is None else known[2],
        estimated=None in known,
        corner=None if solution.noise.corner is None else corner,
    )


def prior_decides(solution: Solution, part: int) -> bool:
    """Whether the weak prior, and not the data, made the robot's rotation (0) or translation (1) level.

    So it is where the residuals have less than three times its weight, or sum up to less than it adds.
    """
    redundancy, squares = solution.redundancy[1 + part], solution.squares[1 + part]
    prior = (_PRIOR_ROTATION, _PRIOR_TRANSLATION)[part]
    return redundancy < 3.0 * PRIOR_WEIGHT or squares < PRIOR_WEIGHT * prior**2


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

    Each solution gives new levels; their fixed point is sought with Anderson's acceleration, since
    a solution costs the inverse of the information matrix.

    Args:
        problem: the linearised problem.
        start: first levels.
        options: the levels that the user knows.

    Returns:
        The problem solved with the levels found.

    Raises:
        ConvergenceError: the information matrix is not positive definite.
    """
    tried: list[Array] = []
    given: list[Array] = []
    solution = solve(problem, start)
    for _ in range(_MAX_ITERATIONS):
        levels = _updated(solution, options)
        if relative_change(solution.noise, levels) < _CONVERGED:
            break
        tried.append(_logarithms(solution.noise))
        given.append(_logarithms(levels))
        levels = _accelerated(tried[-_MEMORY:], given[-_MEMORY:], levels, options)
        solution = solve(problem, levels)
    return solution


def _logarithms(levels: NoiseLevels) -> Array:
    return np.log([levels.pixel, levels.robot_rotation, levels.robot_translation, _corner(levels)])


def _accelerated(
    tried: Sequence[Array], given: Sequence[Array], updated: NoiseLevels, options: NoiseOptions
) -> NoiseLevels:
    """Levels nearer to the fixed point of ``tried -> given`` than the last ones given, ``updated``.

    The change is extrapolated to zero from the last ones; levels that the user knows stay.
    """
    if len(tried) < 2:
        return updated
    changes = np.subtract(given, tried)
    weights, *_ = np.linalg.lstsq(np.diff(changes, axis=0).T, changes[-1])
    ahead = -weights @ np.diff(given, axis=0)
    pixel, rotation, translation, corner = np.exp(given[-1] + np.clip(ahead, -_FARTHEST, _FARTHEST))
    known = known_levels(options)
    return replace(
        updated,
        pixel=float(pixel) if known[0] is None else updated.pixel,
        robot_rotation=float(rotation) if known[1] is None else updated.robot_rotation,
        robot_translation=float(translation) if known[2] is None else updated.robot_translation,
        corner=updated.corner if updated.corner is None or known[0] else float(corner),
    )
