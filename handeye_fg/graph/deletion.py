"""Each robot pose against the solution without it, and that solution: no problem is solved again.

With J the derivative of a pose's residual r by the shared unknowns, C their covariance, e the residual
after the fit, S the covariance of a reported pose and R = S - J C J' that of e, the solution without
the pose differs by ``C J' R^-1 e`` (a downdate of rank 6), and its covariance by ``C J' R^-1 J C``. The residual of
the pose against it is ``S R^-1 e``, with the covariance ``S R^-1 S``: larger than e, since no solution is
drawn to a pose that it is not part of. With the noise levels held, all this is exact for the linearised problem.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.graph.noise import Solution
from handeye_fg.graph.reduced import Linearised, predicted_covariance

# A pose of whose residual less than this part is left, in some direction, is not controlled by the rest. An
# image that two points hold agrees with every robot pose as far as the linearised problem can tell; beside other
# cameras such a pose, taken in, moves what the cameras share, by degrees. Of one camera nothing else hangs on it.
_LEAST_CONTROL = 1e-6
_ROUNDING = 1e-12  # relative: part of a covariance that is rounding


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Deletions:
    """All robot poses, each against the solution without it; NaN where the rest does not determine it.

    Attributes:
        lengths: of the standardised residual's rotation and translation (n, 2). Its square is
            chi-square of 3 degrees of freedom for a good pose (Baarda's test for a wrong part).
        x_step: how far X moves (n, 6) without the pose, as a right perturbation; NaN for poses that
            are not used.
        growth: by how much (n,) the standard deviation of X in some direction is larger without the pose, at
            most, relatively; NaN likewise.
    """

    lengths: Array
    x_step: Array
    growth: Array


def deletions(linearised: Linearised, solution: Solution, trusted: NDArray[np.bool_]) -> Deletions:
    """Leave out each pose in turn.

    Args:
        linearised: the problem around its optimum, with the trusted poses.
        solution: its solution.
        trusted: (n,) which of the poses are used.
    """
    rows, noise = linearised.reported, solution.noise
    sigmas = np.repeat([noise.robot_rotation, noise.robot_translation], 3)
    steps = np.einsum("nij,nj->ni", rows.jacobian, solution.step[rows.columns])
    residual = (rows.residual + steps) / sigmas
    predicted = predicted_covariance(rows, solution.covariance) / np.outer(sigmas, sigmas)
    # In units of the sigmas: R of the poses that are used, and (R^-1)^-1 = I + J C J' of the others.
    left = np.eye(6) - np.where(trusted, 1.0, -1.0)[:, None, None] * predicted
    left = (left + np.swapaxes(left, 1, 2)) / 2.0  # exact poses leave little but rounding
    x_columns = linearised.layout.x_columns()
    lengths, x_step = np.full((len(left), 2), np.nan), np.full((len(left), 6), np.nan)
    growth = np.full(len(left), np.nan)
    whitener = _whitener(solution.covariance[x_columns][:, x_columns])
    several = linearised.layout.n_cameras > 1
    for i in np.flatnonzero(np.isfinite(left).all(axis=(1, 2))):
        least, *_, most = np.linalg.eigvalsh(left[i])
        if (1.0 / most if several and not trusted[i] else least) < _LEAST_CONTROL:
            continue
        if trusted[i]:
            covariance = np.linalg.inv(left[i])
            weighted = covariance @ residual[i]
            pull = rows.jacobian[i].T @ (weighted / sigmas)
            by_pose = solution.covariance[np.ix_(x_columns, rows.columns[i])]
            x_step[i] = by_pose @ pull
            seen = whitener @ by_pose @ (rows.jacobian[i] / sigmas[:, None]).T
            growth[i] = np.sqrt(1.0 + np.linalg.eigvalsh(seen @ covariance @ seen.T)[-1]) - 1.0
        else:
            covariance, weighted = left[i], residual[i]
        for k, part in enumerate((slice(0, 3), slice(3, 6))):
            square = weighted[part] @ np.linalg.solve(covariance[part, part], weighted[part])
            lengths[i, k] = np.sqrt(square)
    return Deletions(lengths=lengths, x_step=x_step, growth=growth)


def _whitener(covariance: Array) -> Array:
    """W with W C W' = 1 for a covariance (k, k) whose rows have very different units."""
    stds = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(stds, stds))
    return np.asarray((vectors / np.sqrt(np.maximum(values, _ROUNDING))).T / stds)
