"""Whether the robot's noise is white; entry point ``whiteness``.

An arm repeats better than it is accurate: its links are not quite as long and its joints not quite as
straight as the controller has them, so that the errors of its poses are smooth functions of the joint
angles. They leave two traces in the residuals: the rotation and the position error of a pose belong
together, and neighbouring poses have similar errors as the arm sees them. The three figures
that show this are held against those of residuals drawn from the white model of the same problem.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.graph.noise import Solution
from handeye_fg.graph.reduced import Linearised, Rows, predicted_together

NEAR_ANGLE, NEAR_METRES = 1.0, 0.4
"""Distances from which on two poses have little in common."""

_SIGNIFICANT = 0.05
_DRAWS = 999
_SEED = 0
_MOST_POSES = 100  # that are tested; more make the test slow, and hardly surer
_RIDGE = 0.3  # keeps the mean square of few residuals regular


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Whiteness:
    """The test of the robot's residuals.

    Attributes:
        probability: of residuals as structured as these if the robot's noise is white.
        coupled, alike: by how many standard deviations rotation and position errors of a pose belong
            together more, and neighbours are more alike, than with white noise.
    """

    probability: float
    coupled: float
    alike: float

    @property
    def rejected(self) -> bool:
        """Whether the noise is not white."""
        return self.probability <= _SIGNIFICANT


def whiteness(base_T_gripper: Array, linearised: Linearised, solution: Solution) -> Whiteness:
    """Test whether the robot's noise is white.

    Args:
        base_T_gripper: poses (n, 4, 4) of the robot residuals, metres.
        linearised: the problem around its optimum.
        solution: its solution.
    """
    n = len(base_T_gripper)
    tested = np.unique(np.linspace(0, n - 1, min(n, _MOST_POSES)).astype(int))
    rows, poses = _chosen(linearised.robot, tested), base_T_gripper[tested]
    sigmas = robot_sigmas(solution, len(tested))
    predicted = predicted_together(rows, solution.covariance) / np.outer(sigmas, sigmas)
    left = np.eye(len(sigmas)) - predicted
    # The residuals of well determined poses have no freedom of their own: their covariance is singular.
    values, vectors = np.linalg.eigh(0.5 * (left + left.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    normal = np.random.default_rng(_SEED).standard_normal((len(sigmas), _DRAWS))
    found = (robot_residuals_after(rows, solution) / sigmas)[:, None]
    drawn = _statistics(poses, _normalised(root @ normal))
    observed = _statistics(poses, _normalised(found))[:, 0]
    scores = (observed - drawn.mean(axis=1)) / drawn.std(axis=1)
    sums = ((drawn - drawn.mean(axis=1)[:, None]) / drawn.std(axis=1)[:, None]).sum(axis=0)
    return Whiteness(
        probability=float((1 + np.count_nonzero(sums >= scores.sum())) / (1 + _DRAWS)),
        coupled=float(scores[:2].max()),
        alike=float(scores[2]),
    )


def _chosen(rows: Rows, poses: NDArray[np.int64]) -> Rows:
    which = np.zeros(len(rows.residual), dtype=bool)
    which[poses] = True
    return rows.only(which)


def robot_sigmas(solution: Solution, n: int) -> Array:
    """Standard deviations (6 n,) of the residuals of n poses."""
    noise = solution.noise
    return np.tile(np.repeat([noise.robot_rotation, noise.robot_translation], 3), n)


def robot_residuals_after(rows: Rows, solution: Solution) -> Array:
    """Residuals (6 n,) after the fit."""
    steps = np.einsum("nij,nj->ni", rows.jacobian, solution.step[rows.columns])
    return np.asarray((rows.residual + steps).ravel())


def _normalised(whitened: Array) -> Array:
    """Residuals (6 n, draws) as (n, 6, draws), rotations and positions each with a mean square of one."""
    parts = whitened.reshape(-1, 2, 3, whitened.shape[-1])
    mean_squares = np.mean(parts**2, axis=(0, 2), keepdims=True)
    result = parts / np.sqrt(np.maximum(mean_squares, np.finfo(float).tiny))
    return np.asarray(result.reshape(-1, 6, whitened.shape[-1]))


def _statistics(base_T_gripper: Array, residuals: Array) -> Array:
    """Three figures (3, draws) of normalised residuals (n, 6, draws); large if they are structured.

    - The likelihood ratio of a covariance that all poses share, in the base's axes, against the unit matrix.
    - How far position errors are those of a lever that ends at the base: a joint that turns too far moves
      the gripper about the joint's axis.
    - The similarity of neighbours in the axes of the arm (outwards, sideways, up), which the errors of the
      arm follow when its first joint turns.
    """
    R, n = base_T_gripper[:, :3, :3], len(base_T_gripper)
    positions = base_T_gripper[:, :3, 3]
    in_base = np.einsum("nij,npjb->nipb", R, residuals.reshape(n, 2, 3, -1))
    turned_by, moved_by = in_base[:, :, 0], in_base[:, :, 1]
    lever = np.sum(np.cross(turned_by, positions[:, :, None], axis=1) * moved_by, axis=(0, 1))
    outwards = np.arctan2(positions[:, 1], positions[:, 0])
    turned = np.stack([np.zeros(n), np.zeros(n), -outwards, *np.zeros((3, n))], axis=1)
    in_arm = np.einsum("nij,njpb->nipb", frames.exp(turned)[:, :3, :3], in_base).reshape(n, -1)
    angles = frames.rotation_angle(np.swapaxes(R, 1, 2)[:, None] @ R[None])
    metres = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    near = np.exp(-0.5 * (angles / NEAR_ANGLE) ** 2 - 0.5 * (metres / NEAR_METRES) ** 2)
    alike = np.sum((in_arm * (near @ in_arm)).reshape(n * 6, -1), axis=0)
    return np.array([_coupling(in_base), lever, alike])


def _coupling(residuals: Array) -> Array:
    """Minus the logarithm of the determinant of the residuals' mean square, with a ridge; by draw."""
    n, draws = len(residuals), residuals.shape[-1]
    flat = residuals.reshape(n, 6, draws)
    squares = np.einsum("nib,njb->bij", flat, flat, optimize=True) / n
    return np.asarray(-np.linalg.slogdet(squares + _RIDGE * np.eye(6))[1])
