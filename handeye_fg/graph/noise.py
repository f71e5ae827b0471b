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
from handeye_fg.graph.reduced import Layout, Quadratic, Rows, predicted_covariance, scatter
from handeye_fg.options import NoiseOptions
from handeye_fg.types import NoiseLevels

# One pseudo-observation of each robot sigma keeps it away from zero when there are few images or
# the poses are exact: 0.02 degrees and 0.1 mm are usual for industrial arms.
_PRIOR_WEIGHT = 1.0
_PRIOR_ROTATION = np.deg2rad(0.02)
_PRIOR_TRANSLATION = 1e-4
_MAX_ITERATIONS = 200
_CONVERGED = 1e-4  # relative change of a sigma; its own uncertainty is above 1e-2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseEstimate:
    """Noise levels, and the linearised problem solved with them.

    Attributes:
        noise: the levels.
        pixel_unit: factor from the sigmas given to the observations to the estimated ones.
        redundancy: degrees of freedom of the pixel, robot rotation and robot translation sigmas.
        covariance: of the shared unknowns (d, d).
        rows_covariance: covariance (n, 6, 6) of the robot residuals after the fit.
    """

    noise: NoiseLevels
    pixel_unit: float
    redundancy: tuple[float, float, float]
    covariance: Array
    rows_covariance: Array


def known_levels(options: NoiseOptions) -> tuple[float | None, float | None, float | None]:
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


def estimate_noise(
    reprojections: Quadratic,
    n_pixel_rows: int,
    n_point_unknowns: int,
    robot: Rows,
    prior: Quadratic,
    gauge_dim: int,
    start: NoiseLevels,
    pixel_unit_px: float,
    known: tuple[float | None, float | None, float | None],
    layout: Layout,
) -> NoiseEstimate:
    """Find the noise levels that agree with the residuals of the linearised problem.

    Args:
        reprojections: image observations, weighted with sigmas whose unit is ``pixel_unit_px``.
        n_pixel_rows: number of pixel coordinates observed.
        n_point_unknowns: number of eliminated point coordinates.
        robot: robot pose residuals in radians and metres.
        prior: gauge and other priors.
        gauge_dim: how many of the priors' rows only fix the gauge.
        start: first levels.
        pixel_unit_px: the sigma (pixels) of an undistorted-view-free observation in
            ``reprojections``.
        known: the user's levels; None where they are estimated.
        layout: of the shared unknowns.

    Raises:
        ConvergenceError: the information matrix is not positive definite.
    """
    levels = np.array([start.pixel, start.robot_rotation, start.robot_translation])
    estimated = np.array([level is None for level in known])
    levels = np.where(estimated, levels, [level or 0.0 for level in known])
    floor = np.array([0.0, _PRIOR_ROTATION, _PRIOR_TRANSLATION])
    for _ in range(_MAX_ITERATIONS):
        unit = levels[0] / pixel_unit_px
        weights = np.repeat(levels[1:] ** -2.0, 3)
        robot_hessian, robot_gradient = scatter(robot, weights, layout.dim)
        hessian = reprojections.hessian / unit**2 + robot_hessian + prior.hessian
        gradient = reprojections.gradient / unit**2 + robot_gradient + prior.gradient
        covariance = _inverse(hessian)
        step = covariance @ gradient
        predicted = predicted_covariance(robot, covariance)
        moved = robot.residual + np.einsum("nij,nj->ni", robot.jacobian, step[robot.columns])
        leverage = np.diagonal(predicted, axis1=1, axis2=2) * weights
        used = leverage.sum(axis=0).reshape(2, 3).sum(axis=1)
        prior_leverage = float(np.sum(prior.hessian * covariance)) - gauge_dim
        pixel_redundancy = (
            n_pixel_rows
            - n_point_unknowns
            - (layout.dim - gauge_dim - used.sum() - prior_leverage)
        )
        squares = np.array(
            [
                (
                    reprojections.constant
                    - 2 * reprojections.gradient @ step
                    + step @ reprojections.hessian @ step
                )
                * pixel_unit_px**2,
                *np.sum(moved**2, axis=0).reshape(2, 3).sum(axis=1),
            ]
        )
        redundancy = np.array([pixel_redundancy, *(3 * len(robot.residual) - used)])
        weight = np.array([0.0, _PRIOR_WEIGHT, _PRIOR_WEIGHT])
        new = np.sqrt((squares + weight * floor**2) / np.maximum(redundancy + weight, 1e-3))
        new = np.where(estimated, new, levels)
        change = np.abs(np.log(new / levels)).max()
        levels = new
        if change < _CONVERGED:
            break
    return NoiseEstimate(
        noise=NoiseLevels(
            pixel=float(levels[0]),
            robot_rotation=float(levels[1]),
            robot_translation=float(levels[2]),
            estimated=bool(estimated.any()),
        ),
        pixel_unit=float(levels[0] / pixel_unit_px),
        redundancy=(float(redundancy[0]), float(redundancy[1]), float(redundancy[2])),
        covariance=covariance,
        rows_covariance=np.diag(1.0 / weights) - predicted,
    )
