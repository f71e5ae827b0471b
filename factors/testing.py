"""Checks of a factor's derivatives, for whoever writes one (public, like ``numpy.testing``)."""

from collections.abc import Sequence

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _moved(
    values: gtsam.Values, keys: Sequence[int], dims: Sequence[int], step: Array
) -> gtsam.Values:
    """The values after a step in the joint tangent space of ``keys``."""
    delta = gtsam.VectorValues()
    start = 0
    for key, dim in zip(keys, dims, strict=True):
        delta.insert(key, step[start : start + dim])
        start += dim
    return values.retract(delta)


def _whitened_error(factor: gtsam.NoiseModelFactor, values: gtsam.Values) -> Array:
    return np.asarray(factor.whitenedError(values))


def assert_jacobians_match(
    factor: gtsam.NoiseModelFactor,
    values: gtsam.Values,
    dims: Sequence[int],
    *,
    step: float = 1e-6,
    relative_tolerance: float = 1e-5,
) -> None:
    """Assert that the factor's whitened Jacobian equals central differences.

    Args:
        factor: the factor.
        values: where to test it.
        dims: tangent size of each of the factor's keys.
        step: step of the central differences in every tangent direction.
        relative_tolerance: largest allowed difference of a column, relative to the largest column.

    Raises:
        AssertionError: naming the column that differs.
    """
    analytic = np.asarray(factor.linearize(values).jacobian()[0])
    total = sum(dims)
    if analytic.shape[1] != total:
        raise AssertionError(f"Jacobian has {analytic.shape[1]} columns but expected {total}")
    scale = max(1e-12, float(np.abs(analytic).max()))
    for column, direction in enumerate(np.eye(total)):
        ahead = _whitened_error(factor, _moved(values, factor.keys(), dims, step * direction))
        behind = _whitened_error(factor, _moved(values, factor.keys(), dims, -step * direction))
        numeric = (ahead - behind) / (2 * step)
        worst = float(np.abs(numeric - analytic[:, column]).max()) / scale
        if not worst <= relative_tolerance:
            raise AssertionError(f"Jacobian column {column} differs by {worst:.2e} of the largest")


def taylor_slope(
    factor: gtsam.NoiseModelFactor, values: gtsam.Values, dims: Sequence[int], direction: Array
) -> float:
    """Order with which the linearisation error vanishes: 2 for a right Jacobian, 1 for a wrong one.

    Args:
        factor: the factor.
        values: where to test it.
        dims: tangent size of each of the factor's keys.
        direction: step direction (sum of dims,).
    """
    jacobian = np.asarray(factor.linearize(values).jacobian()[0])
    origin = _whitened_error(factor, values)
    steps = np.logspace(-2.5, -1.0, 7)
    errors = [
        np.linalg.norm(
            _whitened_error(factor, _moved(values, factor.keys(), dims, step * direction))
            - origin
            - jacobian @ (step * direction)
        )
        for step in steps
    ]
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])
