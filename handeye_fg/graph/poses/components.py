"""Variance components of a linear model with a chain of unknowns, by restricted likelihood.

The unknowns are a long chain in which a measurement touches neighbours only (true poses of a
sequence), and a few shared ones (X, Z, scale). All unknowns are integrated out, so that the sigmas
found are not too small for the unknowns that adapt to the noise; where the likelihood is stationary
each variance is its sum of squared residuals over its redundancy (H. D. Patterson, R. Thompson,
"Recovery of inter-block information when block sizes are unequal", Biometrika 58, 1971).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array
from handeye_fg.graph.certainty import Certainty, certainty, given
from handeye_fg.graph.poses.chain import ChainRows, Factor, Normal, factorised

# Weight of the first guess of each variance, in observations: it keeps a component that the data
# cannot tell from the others, or that is absent, away from zero and infinity.
_PRIOR_WEIGHT = 0.2
# Slope of the deviance in the logarithm of a variance at which the search ends: the deviance curves
# by half the redundancy, so that a variance is right to a hundredth of its standard deviation.
_FLAT = 0.01
_MAX_STEPS = 100
_LONGEST_STEP = 5.0  # in the logarithms of the variances
_HUGE = 1e12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Estimate:
    """Variances and what follows from them.

    Attributes:
        variances: (k,) by component.
        covariance: of the unknowns asked for.
        step: (n_chain + n_shared,) of all unknowns, towards the minimum.
        deviance: minus twice the restricted log likelihood, up to a constant.
    """

    variances: Array
    covariance: Array
    step: Array
    deviance: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guess:
    """What is known of the variances beforehand.

    Attributes:
        variances: (k,), all positive.
        given: whether each (k,) is the user's and stays as it is.
    """

    variances: Array
    given: NDArray[np.bool_]


def estimate(rows: ChainRows, guess: Guess, start: Array, wanted: Sequence[int]) -> Estimate:
    """Variances of the components, and the covariance of some unknowns under them.

    Args:
        rows: the measurements.
        guess: of the variances.
        start: variances (k,) from which the search starts.
        wanted: columns whose covariance is returned.

    Raises:
        ConvergenceError: the measurements do not determine the unknowns.
    """
    likelihood = _Likelihood(rows, guess)
    logs = np.log(start[~guess.given])
    if len(logs):
        found = optimize.minimize(
            likelihood.penalised,
            logs,
            method="trust-exact",
            jac=likelihood.slope,
            hess=likelihood.average_curvature,
            options={
                "gtol": _FLAT,
                "maxiter": _MAX_STEPS,
                "max_trust_radius": _LONGEST_STEP,
            },
        )
        logs = found.x
    factor = likelihood.at(logs)
    return Estimate(
        variances=np.exp(likelihood.all_logs(logs)),
        covariance=factor.covariance(wanted),
        step=factor.step,
        deviance=factor.deviance + rows.log_variance,
    )


def certainty_of(
    rows: ChainRows, guess: Guess, variances: Array, wanted: Sequence[int]
) -> Certainty:
    """What estimated variances leave of the certainty of some unknowns.

    Args:
        rows: the measurements.
        guess: of the variances.
        variances: (k,) as estimated.
        wanted: columns of the unknowns.
    """
    likelihood = _Likelihood(rows, guess)
    logs = np.log(variances[~guess.given])
    covariance = likelihood.at(logs).covariance(wanted)
    if len(logs) == 0:
        return given(covariance, len(wanted))
    first, second = likelihood.derivatives(logs, wanted)
    spread = np.asarray(2.0 * np.linalg.inv(likelihood.average_curvature(logs)), dtype=np.float64)
    return certainty(covariance, first, second, spread, len(wanted))


class _Likelihood:
    """The restricted likelihood as a function of the logarithms of the variances to be found."""

    def __init__(self, rows: ChainRows, guess: Guess) -> None:
        self._rows = rows
        self._guess = guess
        self._normal = Normal.of(rows, len(guess.variances))
        self._centre = np.log(guess.variances[~guess.given])
        self._last: tuple[Array, Factor] | None = None

    def all_logs(self, logs: Array) -> Array:
        """With those of the given variances."""
        everything = np.log(self._guess.variances)
        everything[~self._guess.given] = logs
        return everything

    def at(self, logs: Array) -> Factor:
        """The factorised information matrix, and the deviance."""
        if self._last is None or not np.array_equal(self._last[0], logs):
            self._last = (logs.copy(), factorised(self._normal, self.all_logs(logs)))
        return self._last[1]

    def penalised(self, logs: Array) -> float:
        """The deviance with the prior of the variances; huge where the matrix is not definite."""
        ratio = logs - self._centre
        prior = _PRIOR_WEIGHT * float(np.sum(ratio + np.exp(-ratio)))
        try:
            return self.at(logs).deviance + prior
        except ConvergenceError:
            return _HUGE

    def slope(self, logs: Array) -> Array:
        """Derivative of ``penalised``: each component's redundancy less its squares, and the prior."""
        factor, normal = self.at(logs), self._normal
        reduced = self._rows.jacobian @ factor.shared_columns
        leverage = np.sum((reduced @ factor.shared_inverse) * reduced, axis=1)
        traces = np.tensordot(normal.bands, factor.chain_inverse(self._rows.block), 2)
        traces += normal.summed(leverage)
        squares = normal.summed(self._residuals(factor) ** 2)
        slope = normal.counts - factor.weights * (traces + squares)
        prior = _PRIOR_WEIGHT * (1.0 - np.exp(self._centre - logs))
        return np.asarray(slope[1:][~self._guess.given] + prior)

    def average_curvature(self, logs: Array) -> Array:
        """Second derivatives of ``penalised``, the mean of the observed and the expected ones.

        A. R. Gilmour, R. Thompson, B. R. Cullis, "Average information REML", Biometrics 51, 1995.
        """
        factor, rows = self.at(logs), self._rows
        residuals = self._residuals(factor)
        components = rows.component[:, None] == np.flatnonzero(~self._guess.given)
        weights = factor.weights[1:][~self._guess.given]
        gradients = rows.jacobian.T @ (components * residuals[:, None]) * weights
        curvature = np.diag(weights * (residuals**2 @ components))
        curvature -= gradients.T @ factor.solve(gradients)
        prior = _PRIOR_WEIGHT * np.exp(self._centre - logs)
        return np.asarray(0.5 * (curvature + curvature.T) + np.diag(prior))

    def derivatives(self, logs: Array, wanted: Sequence[int]) -> tuple[Array, Array]:
        """Of the covariance C of wanted unknowns in logarithms of the variances.

        With Q_k the information of component k: ``C Q_k C`` (k, d, d), and ``C Q_k C Q_l C``
        (k, k, d, d), C on the inside that of all unknowns.
        """
        factor, rows = self.at(logs), self._rows
        unit = np.zeros((len(factor.step), len(wanted)))
        unit[list(wanted), range(len(wanted))] = 1.0
        columns = rows.jacobian @ factor.solve(unit)
        found = np.flatnonzero(~self._guess.given)
        weighted = [
            np.where(rows.component == k, factor.weights[k + 1], 0.0)[:, None] * columns
            for k in found
        ]
        first = np.array([columns.T @ part for part in weighted])
        parts = np.hstack([rows.jacobian.T @ part for part in weighted])
        second = (parts.T @ factor.solve(parts)).reshape(len(found), len(wanted), len(found), -1)
        return first, second.transpose(0, 2, 1, 3)

    def _residuals(self, factor: Factor) -> Array:
        """At the minimum."""
        return np.asarray(self._rows.residual + self._rows.jacobian @ factor.step)
