"""Variance components of a linear model with a chain of unknowns, by restricted likelihood.

The unknowns are a long chain in which a measurement touches neighbours only (true poses of a
sequence), and a few shared ones (X, Z, scale). All unknowns are integrated out, so that the sigmas
found are not too small for the unknowns that adapt to the noise; where the likelihood is stationary
each variance is its sum of squared residuals over its redundancy (H. D. Patterson, R. Thompson,
"Recovery of inter-block information when block sizes are unequal", Biometrika 58, 1971). Time and
memory grow linearly with the chain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, optimize, sparse

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array

# Weight of the first guess of each variance, in observations: it keeps a component that the data
# cannot tell from the others, or that is absent, away from zero and infinity.
_PRIOR_WEIGHT = 0.2
_STEP = 0.05  # of differences in the logarithm of a variance
# Slope of the deviance in the logarithm of a variance at which the search ends: the deviance curves
# by half the redundancy, so that a variance is right to a hundredth of its standard deviation.
_FLAT = 0.01
_MAX_STEPS = 100
_HUGE = 1e12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainRows:
    """Measurements ``residual + jacobian d`` in rows of independent noise.

    Attributes:
        jacobian: sparse (m, n_chain + n_shared).
        residual: (m,), in the unit of the row's component.
        component: index (m,) of the row's variance; -1: its variance is one (priors).
        n_chain: number of chain unknowns, the first columns.
        block: they come in blocks of so many; a row touches one block or two neighbours.
        log_variance: logarithm of the product of what the rows' variances were divided by
            beforehand, to make them those of their components.
    """

    jacobian: sparse.csr_array
    residual: Array
    component: NDArray[np.int64]
    n_chain: int
    block: int
    log_variance: float


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
            options={"gtol": _FLAT, "maxiter": _MAX_STEPS},
        )
        logs = found.x
    factor = likelihood.at(logs)
    return Estimate(
        variances=np.exp(likelihood.all_logs(logs)),
        covariance=factor.covariance(wanted),
        step=factor.step,
        deviance=factor.deviance + rows.log_variance,
    )


def degrees_of_freedom(
    rows: ChainRows, guess: Guess, variances: Array, wanted: Sequence[int]
) -> float:
    """Satterthwaite's: of the chi-square whose relative variance is that of the covariance's size.

    The size is the mean variance of the wanted unknowns relative to the estimate; its variance
    follows from the curvature of the likelihood in the logarithms of the variances. Infinite where
    all variances are given.
    """
    likelihood = _Likelihood(rows, guess)
    logs = np.log(variances[~guess.given])
    if len(logs) == 0:
        return float("inf")
    inverse = np.linalg.pinv(likelihood.at(logs).covariance(wanted), hermitian=True)

    def size_and_slope(at: Array) -> Array:
        size = float(np.sum(inverse * likelihood.at(at).covariance(wanted))) / len(inverse)
        return np.array([size, *likelihood.slope(at)])

    steps = _STEP * np.eye(len(logs))
    differences = np.array([size_and_slope(logs + h) - size_and_slope(logs - h) for h in steps])
    gradient, curvature = np.split(differences / (2.0 * _STEP), [1], axis=1)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    # The deviance is twice a log likelihood. A variance is not less certain than its prior makes it.
    spread = 2.0 / np.maximum(values, _PRIOR_WEIGHT)
    return 2.0 / max(float(np.sum(spread * (vectors.T @ gradient[:, 0]) ** 2)), 1e-12)


class _Likelihood:
    """The restricted likelihood as a function of the logarithms of the variances to be found."""

    def __init__(self, rows: ChainRows, guess: Guess) -> None:
        self._rows = rows
        self._guess = guess
        self._normal = _Normal.of(rows, len(guess.variances))
        self._centre = np.log(guess.variances[~guess.given])
        self._last: tuple[Array, _Factor] | None = None

    def all_logs(self, logs: Array) -> Array:
        """With those of the given variances."""
        everything = np.log(self._guess.variances)
        everything[~self._guess.given] = logs
        return everything

    def at(self, logs: Array) -> "_Factor":
        """The factorised information matrix, and the deviance."""
        if self._last is None or not np.array_equal(self._last[0], logs):
            self._last = (logs.copy(), _factorised(self._normal, self.all_logs(logs)))
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
        inverse, reduced = factor.chain_inverse(self._rows.block), factor.shared_columns
        shared = np.sum(
            (self._rows.jacobian @ reduced @ factor.shared_inverse)
            * (self._rows.jacobian @ reduced),
            axis=1,
        )
        traces = np.tensordot(normal.bands, inverse, 2) + normal.summed(shared)
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
        curvature = np.diag(weights * (residuals**2 @ components)) - gradients.T @ factor.solve(
            gradients
        )
        prior = _PRIOR_WEIGHT * np.exp(self._centre - logs)
        return np.asarray(0.5 * (curvature + curvature.T) + np.diag(prior))

    def _residuals(self, factor: "_Factor") -> Array:
        """At the minimum."""
        return np.asarray(self._rows.residual + self._rows.jacobian @ factor.step)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Normal:
    """Normal equations of each component (first: of the priors) with unit variance."""

    bands: Array
    borders: Array
    corners: Array
    gradients: Array
    squares: Array
    counts: Array
    component: NDArray[np.int64]

    @classmethod
    def of(cls, rows: ChainRows, n_components: int) -> "_Normal":
        n, width = rows.n_chain, 2 * rows.block
        total = rows.jacobian.shape[1]
        bands = np.zeros((n_components + 1, width, n))
        borders = np.zeros((n_components + 1, n, total - n))
        corners = np.zeros((n_components + 1, total - n, total - n))
        gradients = np.zeros((n_components + 1, total))
        for k in range(n_components + 1):
            which = rows.component == k - 1
            jacobian = rows.jacobian[which]
            hessian = sparse.coo_array(jacobian.T @ jacobian)
            row, column, value = *hessian.coords, hessian.data
            lower = (row < n) & (row >= column)
            bands[k, (row - column)[lower], column[lower]] = value[lower]
            border = (row < n) & (column >= n)
            borders[k, row[border], column[border] - n] = value[border]
            corner = (row >= n) & (column >= n)
            corners[k, row[corner] - n, column[corner] - n] = value[corner]
            gradients[k] = jacobian.T @ rows.residual[which]
        component = rows.component + 1
        return cls(
            bands=bands,
            borders=borders,
            corners=corners,
            gradients=gradients,
            squares=np.bincount(component, rows.residual**2, n_components + 1),
            counts=np.bincount(component, minlength=n_components + 1).astype(np.float64),
            component=component,
        )

    def summed(self, values: Array) -> Array:
        """Sums of values (m,) by component."""
        return np.bincount(self.component, values, len(self.counts))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Factor:
    """A factorised information matrix: its chain part, and what is left for the shared part.

    Attributes:
        chain: Cholesky factor of the chain part, banded.
        border: block between chain and shared unknowns.
        chain_inverse_border: the chain part's inverse times ``border``.
        shared_inverse: covariance of the shared unknowns.
        weights: by which each component (first: the priors) is multiplied.
        step: towards the minimum.
        deviance: minus twice the restricted log likelihood.
    """

    chain: Array
    border: Array
    chain_inverse_border: Array
    shared_inverse: Array
    weights: Array
    step: Array
    deviance: float

    @property
    def shared_columns(self) -> Array:
        """How all unknowns move with the shared ones."""
        return np.concatenate([-self.chain_inverse_border, np.eye(len(self.shared_inverse))])

    def solve(self, right: Array) -> Array:
        """The inverse times columns."""
        n = len(self.border)
        shared = self.shared_inverse @ (right[n:] - self.chain_inverse_border.T @ right[:n])
        chain = linalg.cho_solve_banded((self.chain, True), right[:n] - self.border @ shared)
        return np.concatenate([chain, shared])

    def covariance(self, wanted: Sequence[int]) -> Array:
        """Block of the inverse for the wanted columns."""
        unit = np.zeros((len(self.step), len(wanted)))
        unit[list(wanted), range(len(wanted))] = 1.0
        block = self.solve(unit)[list(wanted)]
        return np.asarray(0.5 * (block + block.T))

    def chain_inverse(self, block: int) -> Array:
        """Band of the chain part's inverse, what stands off the diagonal doubled.

        By blocks from the last to the first (K. Takahashi, J. Fagan, M. Chin, "Formation of a
        sparse bus impedance matrix", 1973).
        """
        n = self.chain.shape[1]
        first = block * np.arange(n // block)[:, None, None]
        row, column = np.indices((block, block))
        inverse_root = np.linalg.inv(
            np.where(row >= column, self.chain[np.abs(row - column), first + column], 0.0)
        )
        below = self.chain[block + row - column, first + column] @ inverse_root
        diagonal = np.swapaxes(inverse_root, 1, 2) @ inverse_root
        beside = np.zeros_like(below)
        for i in range(len(diagonal) - 2, -1, -1):
            beside[i] = -diagonal[i + 1] @ below[i]
            diagonal[i] -= below[i].T @ beside[i]
        band = np.zeros_like(self.chain)
        band[block + row - column, first + column] = 2.0 * beside
        lower = row >= column
        band[(row - column)[lower], (first + column)[:, lower]] += (
            np.where(row == column, 1.0, 2.0) * diagonal
        )[:, lower]
        return band


def _factorised(normal: _Normal, logs: Array) -> _Factor:
    """The information matrix at logarithms of the variances."""
    weights = np.concatenate([[1.0], np.exp(-logs)])
    band, border, corner, gradient = (
        np.tensordot(weights, part, 1)
        for part in (normal.bands, normal.borders, normal.corners, normal.gradients)
    )
    n = band.shape[1]
    try:
        chain = linalg.cholesky_banded(band, lower=True)
        solved = linalg.cho_solve_banded((chain, True), np.column_stack([border, gradient[:n]]))
        shared = corner - border.T @ solved[:, :-1]
        scale = 1.0 / np.sqrt(np.diag(shared))
        root = linalg.cholesky(shared * np.outer(scale, scale), lower=True)
    except (linalg.LinAlgError, ValueError) as error:
        raise ConvergenceError(
            "the poses do not determine the unknowns of the pose graph: robot and camera poses "
            "hold too little motion or do not belong together; check them, or add poses"
        ) from error
    shared_inverse = linalg.cho_solve((root, True), np.eye(len(root))) * np.outer(scale, scale)
    shared_step = -shared_inverse @ (gradient[n:] - solved[:, :-1].T @ gradient[:n])
    step = np.concatenate([-solved[:, -1] - solved[:, :-1] @ shared_step, shared_step])
    determinant = 2.0 * float(
        np.log(chain[0]).sum() + np.log(np.diag(root)).sum() - np.log(scale).sum()
    )
    squares = float(weights @ normal.squares + gradient @ step)
    return _Factor(
        chain=chain,
        border=border,
        chain_inverse_border=solved[:, :-1],
        shared_inverse=shared_inverse,
        weights=weights,
        step=step,
        deviance=float(logs @ normal.counts[1:]) + determinant + squares,
    )
