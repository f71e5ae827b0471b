"""Normal equations of a long chain of unknowns and a few shared ones, factorised.

A measurement touches neighbours of the chain (true poses of a sequence) and shared unknowns (X, Z,
scale). Time and memory grow linearly with the chain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from handeye_fg.errors import ConvergenceError
from handeye_fg.frames import Array


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
class Normal:
    """Normal equations of each component (first: of the priors) with unit variance.

    Attributes:
        bands: chain part (k + 1, 2 block, n_chain), lower band.
        borders: between chain and shared unknowns (k + 1, n_chain, s).
        corners: shared part (k + 1, s, s).
        gradients: (k + 1, n_chain + s).
        squares: sums of squared residuals (k + 1,).
        counts: of rows (k + 1,).
        component: of each row (m,), the priors' zero.
    """

    bands: Array
    borders: Array
    corners: Array
    gradients: Array
    squares: Array
    counts: Array
    component: NDArray[np.int64]

    @classmethod
    def of(cls, rows: ChainRows, n_components: int) -> "Normal":
        """Of measurements with ``n_components`` unknown variances."""
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
            squares=_summed(component, rows.residual**2, n_components + 1),
            counts=np.bincount(component, minlength=n_components + 1).astype(np.float64),
            component=component,
        )

    def summed(self, values: Array) -> Array:
        """Sums of values (m,) by component."""
        return _summed(self.component, values, len(self.counts))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Factor:
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


def factorised(normal: Normal, logs: Array) -> Factor:
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
        scale = 1.0 / np.sqrt(_positive(np.diag(shared)))
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
    return Factor(
        chain=chain,
        border=border,
        chain_inverse_border=solved[:, :-1],
        shared_inverse=shared_inverse,
        weights=weights,
        step=step,
        deviance=float(logs @ normal.counts[1:]) + determinant + squares,
    )


def _summed(component: NDArray[np.int64], values: Array, n: int) -> Array:
    return np.bincount(component, values, n).astype(np.float64)


def _positive(diagonal: Array) -> Array:
    """The diagonal of a matrix that may be definite."""
    if not np.all(diagonal > 0.0):
        raise linalg.LinAlgError("a diagonal entry is not positive")
    return diagonal
