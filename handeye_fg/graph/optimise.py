"""Levenberg-Marquardt on a factor graph, step by step, with the failures that GTSAM keeps silent."""

from dataclasses import dataclass

import gtsam
import numpy as np

from handeye_fg.errors import ConvergenceError

# A step that lowers the cost by less than this part of it moves X by a small fraction of its
# standard deviation: near the optimum the cost is quadratic, and with the cost near half the number
# of observations N, a drop of 1e-8 N corresponds to sqrt(2e-8 N) sigma in all directions together.
_RELATIVE_TOLERANCE = 1e-8
_FIRST_DAMPING = 1e-6  # the start is already an optimum of the images alone


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Optimum:
    """Where an optimisation ended."""

    values: gtsam.Values
    converged: bool


def optimise(
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    ordering: gtsam.Ordering,
    *,
    max_iterations: int,
) -> Optimum:
    """Minimise the graph's cost from ``start``.

    Args:
        graph: the measurements.
        start: first values of all unknowns.
        ordering: elimination ordering of all keys.
        max_iterations: stop after as many steps.

    Raises:
        ConvergenceError: the cost is not finite after a step.
    """
    params = gtsam.LevenbergMarquardtParams()
    params.setOrdering(ordering)
    params.setlambdaInitial(_FIRST_DAMPING)
    # The unknowns have very different units: radians, metres, pixels. Damping in proportion to each
    # one's own curvature lets weak ones (intrinsics, a free height) settle in ten steps, not hundreds.
    params.setDiagonalDamping(True)
    optimiser = gtsam.LevenbergMarquardtOptimizer(graph, start, params)
    cost, iterations, converged = float(graph.error(start)), 0, False
    while iterations < max_iterations and not converged:
        optimiser.iterate()
        iterations += 1
        new_cost = float(optimiser.error())
        if not np.isfinite(new_cost):
            raise ConvergenceError(
                f"the joint refinement diverged in iteration {iterations}: its cost is not finite; "
                "check the robot poses and the reconstruction"
            )
        converged = cost - new_cost <= _RELATIVE_TOLERANCE * max(cost, 1e-12)
        cost = new_cost
    return Optimum(values=optimiser.values(), converged=converged)
