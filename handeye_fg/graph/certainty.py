"""What estimated noise levels leave of the certainty of X and the scale; entry point ``certainty``.

The covariance C of some unknowns depends on the variances of the noise, which are estimates
themselves. With ``C_k = B' Q_k B`` its derivative in the logarithm of variance k (Q_k the information
of measurements of kind k, B the covariance of all unknowns with the wanted ones) and S the covariance
of these logarithms:

- C is too small at first, since it is a concave function of the variances, and by as much again, since
  the weights are not the best ones (M. G. Kenward, J. H. Roger, "Small sample inference for fixed
  effects from restricted maximum likelihood", Biometrics 53, 1997);
- a component is t distributed with ``2 (sum C_k)^2 / sum S_kl C_k C_l`` degrees of freedom
  (F. E. Satterthwaite, "An approximate distribution of estimates of variance components", Biometrics
  Bulletin 2, 1946), and the mean Mahalanobis square of all together grows by ``sum S_kl tr(C^-1 C_k
  C^-1 C_l)``.
"""

from dataclasses import dataclass

import numpy as np
from scipy import special

from handeye_fg.frames import Array

_SINGULAR = 1e-12  # relative: part of a covariance that is rounding
_FEWEST = 3.0  # degrees of freedom; with two or fewer a t distribution has no covariance
_LEVEL = 0.95  # of the intervals


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Certainty:
    """How certain some unknowns are with estimated variances.

    Attributes:
        expected: covariance (d, d) of the errors that is expected with the true variances.
        covariance: that of a t distribution, so that the mean of the Mahalanobis squares of the
            unknowns that are judged together is their number.
        freedom: degrees of freedom of these; infinite where all variances are given.
        freedoms: those of each unknown (d,).
        together: how many unknowns, the first ones, are judged together.
    """

    expected: Array
    covariance: Array
    freedom: float
    freedoms: Array
    together: int

    @property
    def growths(self) -> Array:
        """By how much the variance (d,) of a t distribution is larger than expected, relatively."""
        return _growths(self.freedom, self.freedoms, self.together)

    @property
    def half_widths(self) -> Array:
        """Of the 95 % interval of each unknown (d,)."""
        quantiles = special.stdtrit(np.minimum(self.freedoms, 1e9), 0.5 + 0.5 * _LEVEL)
        return np.asarray(quantiles * np.sqrt(np.diag(self.expected)))


def _growths(freedom: float, freedoms: Array, together: int) -> Array:
    own = np.append(np.full(together, freedom), freedoms[together:])
    return np.asarray(2.0 / (np.maximum(own, _FEWEST) - 2.0))


def given(covariance: Array, together: int) -> Certainty:
    """Of unknowns whose covariance (d, d) depends on no estimate, the first of them judged together."""
    return Certainty(
        expected=covariance,
        covariance=covariance,
        freedom=float("inf"),
        freedoms=np.full(len(covariance), np.inf),
        together=together,
    )


def certainty(
    covariance: Array, first: Array, second: Array, spread: Array, together: int
) -> Certainty:
    """Of unknowns whose covariance depends on estimated variances.

    Args:
        covariance: with the variances as estimated (d, d).
        first: ``C_k`` (k, d, d) of the k estimated variances.
        second: ``B' Q_k Sigma Q_l B`` (k, k, d, d), Sigma the covariance of all unknowns.
        spread: S (k, k).
        together: how many unknowns, the first ones, are judged together; the others each by itself.
    """
    estimated = first.sum(axis=0)
    std = np.sqrt(np.diag(covariance))
    part = slice(0, together)
    values, vectors = np.linalg.eigh((covariance / np.outer(std, std))[part, part])
    whitener = vectors / np.sqrt(np.maximum(values, _SINGULAR)) / std[part, None]
    relative = whitener.T @ first[:, part, part] @ whitener
    growth = float(np.einsum("kl,kij,lji", spread, relative, relative))
    freedom = 2.0 * float(np.einsum("kii->", relative)) / max(growth, 1e-12)
    shares = np.einsum("kii->ki", first) / std**2
    own = np.einsum("kl,ki,li->i", spread, shares, shares)
    freedoms = 2.0 * shares.sum(axis=0) ** 2 / np.maximum(own, 1e-12)
    lacking = np.einsum("kk,kij->ij", spread, first) - np.einsum("kl,klij->ij", spread, second)
    expected = covariance + lacking + lacking.T
    root = np.sqrt(_growths(freedom, freedoms, together))
    return Certainty(
        expected=expected,
        covariance=expected + np.outer(root, root) * estimated,
        freedom=freedom,
        freedoms=freedoms,
        together=together,
    )


def enlarged(white: Certainty, expected: Array, extra: Array, freedom: float) -> Certainty:
    """A certainty with another expected covariance, and errors of another source on top of it.

    Args:
        white: the certainty.
        expected: what is expected instead (d, d), with the same degrees of freedom.
        extra: covariance (d, d) of the other errors.
        freedom: degrees of freedom from which that is known.
    """
    shown, unseen = np.diag(expected), np.diag(extra)
    freedoms = (shown + unseen) ** 2 / (shown**2 / white.freedoms + unseen**2 / freedom)
    share = float(np.mean((unseen / (shown + unseen))[: white.together]))
    root = np.sqrt(1.0 + white.growths)
    grown = white.covariance + np.outer(root, root) * (expected - white.expected)
    return Certainty(
        expected=expected + extra,
        covariance=grown + freedom / (freedom - 2.0) * extra,
        freedom=1.0 / max((1.0 - share) ** 2 / white.freedom + share**2 / freedom, 1e-12),
        freedoms=freedoms,
        together=white.together,
    )
