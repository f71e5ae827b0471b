"""Robot poses that disagree with the others: found one by one and left out (data snooping)."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg.frames import Array
from handeye_fg.graph.noise import Solution, estimate_noise
from handeye_fg.graph.reduced import Linearised, predicted_covariance
from handeye_fg.options import NoiseOptions

_FALSE_ALARM = 1e-3  # probability that any pose of a good set is left out
_MOST = 0.3  # part of the poses; beyond it there is no majority to trust


def disagreeing(
    linearised: Linearised, solution: Solution, options: NoiseOptions
) -> NDArray[np.bool_]:
    """Which of the trusted poses (n,) are to be left out.

    The pose with the most improbable residual is taken out of the linearised problem, the rest is
    solved again, noise levels included, and the pose is compared with what the rest predicts for
    it: since a bad pose inflates the noise levels and draws the solution to itself, it cannot be
    judged by a solution that it is part of. If it fails, the next one is tried.

    Args:
        linearised: the problem around its optimum.
        solution: its solution with all trusted poses.
        options: the noise levels that the user knows.
    """
    trusted = np.ones(len(linearised.robot.residual), dtype=bool)
    allowed = int(_MOST * len(trusted))
    level = _FALSE_ALARM / len(trusted)
    while np.count_nonzero(~trusted) < allowed:
        squares = _squares(_residuals(linearised, solution), solution.robot_covariance)
        worst = int(np.flatnonzero(trusted)[squares[trusted].argmax()])
        rest = trusted.copy()
        rest[worst] = False
        without = estimate_noise(_only(linearised, rest), solution.noise, options)
        if not _improbable(linearised, without, worst, level):
            break
        trusted, solution = rest, _for_all(linearised, without)
    return ~trusted


def _only(linearised: Linearised, trusted: NDArray[np.bool_]) -> Linearised:
    """The problem with some of the robot poses."""
    return replace(linearised, robot=linearised.robot.only(trusted))


def _for_all(linearised: Linearised, solution: Solution) -> Solution:
    """A solution of some poses, with the residual covariances of all poses under it."""
    predicted = predicted_covariance(linearised.robot, solution.covariance)
    return replace(solution, robot_covariance=_measured(solution) + predicted)


def _measured(solution: Solution) -> Array:
    """Covariance (6, 6) of a reported pose."""
    sigmas = [solution.noise.robot_rotation, solution.noise.robot_translation]
    return np.diag(np.repeat(sigmas, 3) ** 2.0)


def _residuals(linearised: Linearised, solution: Solution) -> Array:
    """Residuals (n, 6) of all poses after the solution's step."""
    robot = linearised.robot
    steps = np.einsum("nij,nj->ni", robot.jacobian, solution.step[robot.columns])
    return np.asarray(robot.residual + steps)


def _squares(residuals: Array, covariance: Array) -> Array:
    """Mahalanobis squares (n,), in scaled units."""
    scale = np.sqrt(np.abs(np.diagonal(covariance, axis1=1, axis2=2)))
    shaped = covariance / (scale[:, :, None] * scale[:, None, :])
    whitened = residuals / scale
    weighted = np.einsum("nij,nj->ni", np.linalg.pinv(shaped, hermitian=True), whitened)
    return np.asarray(np.sum(weighted * whitened, axis=1))


def _improbable(linearised: Linearised, without: Solution, pose: int, level: float) -> bool:
    """Whether a pose disagrees with a solution that it is not part of.

    Rotation and translation are tested each with the degrees of freedom of its sigma (F), or with
    chi-square where the user gave the sigmas.
    """
    residual = _residuals(linearised, without)[pose]
    covariance = _for_all(linearised, without).robot_covariance[pose]
    for part, redundancy in zip((slice(0, 3), slice(3, 6)), without.redundancy[1:3], strict=True):
        square = _squares(residual[None, part], covariance[None, part, part])[0] / 3.0
        if without.noise.estimated:
            limit = special.fdtri(3, max(redundancy, 1.0), 1.0 - level / 2.0)
        else:
            limit = special.chdtri(3, level / 2.0) / 3.0
        if square > limit:
            return True
    return False
