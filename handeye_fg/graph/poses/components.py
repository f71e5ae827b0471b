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
_BOUND = 14.0  # of the logarithm of a variance around its first guess
_STEP = 1e-3  # of first differences in the logarithm of a variance
_WIDE_STEP = 0.05  # of second differences
_TOLERANCE = 1e-9  # relative: with a deviance of thousands 1e-6, a thousandth of what would matter
_HUGE = 1e12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChainRows:
    """Measurements ``residual + jacobian d`` in rows of independent noise.

    Attributes:
        jacobian: sparse (m, n_chain + n_shared).
        residual: (m,), in the unit of the row's component.
        component: index (m,) of the row's variance; -1: its variance is one (priors).
        n_chain: number of chain unknowns, the first columns.
        bandwidth: largest distance of two chain columns in one row.
        log_variance: logarithm of the product of what the rows' variances were divided by
            beforehand, to make them those of their components.
    """

    jacobian: sparse.csr_array
    residual: Array
    component: NDArray[np.int64]
    n_chain: int
    bandwidth: int
    log_variance: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Quadratic:
    """Normal equations of one component with unit variance."""

    band: Array
    border: Array
    corner: Array
    gradient: Array
    squares: float
    count: int


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
    likelihood = _Likelihood.of(rows, guess)
    logs = np.log(start[~guess.given])
    if len(logs):
        found = optimize.minimize(
            likelihood.penalised,
            logs,
            method="L-BFGS-B",
            bounds=[(value - _BOUND, value + _BOUND) for value in likelihood.centre],
            options={"eps": _STEP, "ftol": _TOLERANCE},
        )
        logs = found.x
    deviance, factor = likelihood.at(logs)
    return Estimate(
        variances=np.exp(likelihood.all_logs(logs)),
        covariance=factor.covariance(wanted),
        step=factor.step,
        deviance=deviance + rows.log_variance,
    )


def degrees_of_freedom(
    rows: ChainRows, guess: Guess, variances: Array, wanted: Sequence[int]
) -> float:
    """Satterthwaite's: of the chi-square whose relative variance is that of the covariance's size.

    The size is the mean variance of the wanted unknowns relative to the estimate; its variance
    follows from the curvature of the likelihood in the logarithms of the variances. Infinite where
    all variances are given.
    """
    likelihood = _Likelihood.of(rows, guess)
    logs = np.log(variances[~guess.given])
    if len(logs) == 0:
        return float("inf")
    steps = _WIDE_STEP * np.eye(len(logs))
    inverse = np.linalg.pinv(likelihood.at(logs)[1].covariance(wanted), hermitian=True)

    def size(at: Array) -> float:
        return float(np.sum(inverse * likelihood.at(at)[1].covariance(wanted))) / len(inverse)

    gradient = np.array([size(logs + h) - size(logs - h) for h in steps]) / (2.0 * _WIDE_STEP)
    curvature = np.array(
        [
            [
                likelihood.penalised(logs + h + g)
                - likelihood.penalised(logs + h - g)
                - likelihood.penalised(logs - h + g)
                + likelihood.penalised(logs - h - g)
                for g in steps
            ]
            for h in steps
        ]
    ) / (4.0 * _WIDE_STEP**2)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    # The deviance is twice a log likelihood. A variance is not less certain than its prior makes it.
    spread = 2.0 / np.maximum(values, _PRIOR_WEIGHT)
    return 2.0 / max(float(np.sum(spread * (vectors.T @ gradient) ** 2)), 1e-12)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Likelihood:
    """The restricted likelihood as a function of the logarithms of the variances to be found."""

    parts: Sequence[_Quadratic]
    guess: Guess

    @classmethod
    def of(cls, rows: ChainRows, guess: Guess) -> "_Likelihood":
        indices = range(-1, len(guess.variances))
        return cls(parts=[_quadratic(rows, index) for index in indices], guess=guess)

    @property
    def centre(self) -> Array:
        """The guess."""
        return np.log(self.guess.variances[~self.guess.given])

    def all_logs(self, logs: Array) -> Array:
        """With those of the given variances."""
        everything = np.log(self.guess.variances)
        everything[~self.guess.given] = logs
        return everything

    def at(self, logs: Array) -> tuple[float, "_Factor"]:
        """Deviance, and the factorised information matrix."""
        return _deviance(self.parts, self.all_logs(logs))

    def penalised(self, logs: Array) -> float:
        """The deviance with the prior of the variances; huge where the matrix is not definite."""
        ratio = logs - self.centre
        prior = _PRIOR_WEIGHT * float(np.sum(ratio + np.exp(-ratio)))
        try:
            return self.at(logs)[0] + prior
        except ConvergenceError:
            return _HUGE


def _quadratic(rows: ChainRows, component: int) -> _Quadratic:
    """Normal equations of a component's rows, banded in the chain."""
    which = rows.component == component
    jacobian, residual = rows.jacobian[which], rows.residual[which]
    hessian = sparse.csr_array(jacobian.T @ jacobian)
    n = rows.n_chain
    chain = hessian[:n, :n]
    band = np.zeros((rows.bandwidth + 1, n))
    for offset in range(rows.bandwidth + 1):
        diagonal = chain.diagonal(-offset)
        band[offset, : len(diagonal)] = diagonal
    return _Quadratic(
        band=band,
        border=hessian[:n, n:].toarray(),
        corner=hessian[n:, n:].toarray(),
        gradient=np.asarray(jacobian.T @ residual),
        squares=float(residual @ residual),
        count=int(np.count_nonzero(which)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Factor:
    """A factorised information matrix: its chain part, and what is left for the shared part."""

    chain: Array
    border: Array
    chain_inverse_border: Array
    shared_inverse: Array
    step: Array

    def covariance(self, wanted: Sequence[int]) -> Array:
        """Block of the inverse for the wanted columns."""
        n = len(self.border)
        unit = np.zeros((n + self.border.shape[1], len(wanted)))
        unit[list(wanted), range(len(wanted))] = 1.0
        shared = self.shared_inverse @ (unit[n:] - self.chain_inverse_border.T @ unit[:n])
        chain = linalg.cho_solve_banded((self.chain, True), unit[:n] - self.border @ shared)
        block = np.concatenate([chain, shared])[list(wanted)]
        return np.asarray(0.5 * (block + block.T))


def _deviance(parts: Sequence[_Quadratic], logs: Array) -> tuple[float, _Factor]:
    """Minus twice the restricted log likelihood at logarithms of the variances."""
    weights = np.concatenate([[1.0], np.exp(-logs)])
    band, border, corner, gradient = (
        sum(weight * getattr(part, name) for weight, part in zip(weights, parts, strict=True))
        for name in ("band", "border", "corner", "gradient")
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
    squares = float(weights @ [part.squares for part in parts]) + float(gradient @ step)
    deviance = float(logs @ [part.count for part in parts[1:]]) + determinant + squares
    factor = _Factor(
        chain=chain,
        border=border,
        chain_inverse_border=solved[:, :-1],
        shared_inverse=shared_inverse,
        step=step,
    )
    return deviance, factor
