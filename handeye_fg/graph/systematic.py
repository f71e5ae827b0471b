"""The covariance that stays honest where the robot's noise is not white; entry point ``systematic``.

Errors that are smooth functions of the pose make X less certain than white noise of the same size, for
two reasons:

- Neighbouring poses repeat each other. Leaving out blocks of them shows what that makes of X: with A the
  derivative of X by the residuals r and H their leverages, the scatter of ``A_g (I - H_g)^-1/2 r_g`` over
  the blocks g (R. M. Bell, D. F. McCaffrey, "Bias reduction in standard errors for linear regression with
  multi-stage samples", Survey Methodology 28, 2002). Along each direction the larger of this covariance
  and the model's counts.
- Errors of the last link move all poses alike in the gripper, as X does, and errors in proportion to the
  distance look like another scale: no residual shows them, and no resampling. What is hidden so is about as
  large as what shows: of simulated arms whose links are all alike imperfect, the error of X that remains
  with very many poses has 0.4 to 1.3 times the variance of the residuals on average over the axes, and up
  to 2.3 times along the worst one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.graph.certainty import Certainty, enlarged
from handeye_fg.graph.noise import Solution
from handeye_fg.graph.reduced import Linearised, predicted_together
from handeye_fg.graph.whiteness import (
    NEAR_ANGLE,
    NEAR_METRES,
    robot_residuals_after,
    robot_sigmas,
)

_BLOCKS = 8
_LEAST_LEFT = 0.1  # part of a block's residual that is left, in the weakest direction
# Variance of hidden errors of X over that of the residuals. Errors of a scale are hidden in the same
# proportion where those at half the arm's distances from the middle are.
_HIDDEN = 2.0
_HIDDEN_SCALE = 0.25
_HIDDEN_FREEDOM = 10.0  # an arm has no more links from which to tell how good they are


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Systematic:
    """What errors of the arm that are not white make of one camera's certainty.

    Attributes:
        certainty: of (X, ln scale).
        resampled_ratio: largest ratio of a standard deviation from blocks of poses to that of the model.
        hidden_rotation, hidden_translation: standard deviation, an axis, of X's error that no residual
            shows; radians and metres.
    """

    certainty: Certainty
    resampled_ratio: float
    hidden_rotation: float
    hidden_translation: float


def systematic(
    base_T_gripper: Array,
    linearised: Linearised,
    solution: Solution,
    white: Certainty,
    derivative: Array,
    gripper_T_camera: Array,
    spread_metres: float,
) -> Systematic:
    """Enlarge a certainty that holds for white noise.

    Args:
        base_T_gripper: poses (n, 4, 4) of the robot residuals, metres.
        linearised: the problem around its optimum.
        solution: its solution.
        white: certainty of (X, ln scale) with white noise.
        derivative: of (X, ln scale) by the shared unknowns (7, d).
        gripper_T_camera: X (4, 4), metres.
        spread_metres: root mean square distance of the camera centres from their mean.
    """
    robot = linearised.robot
    towards = solution.covariance @ derivative.T
    whitened = (robot.jacobian @ towards[robot.columns]).reshape(-1, len(derivative))
    whitened /= robot_sigmas(solution, len(robot.residual))[:, None]
    of_images = white.expected - whitened.T @ whitened
    by_blocks = _by_blocks(base_T_gripper, linearised, solution, towards)
    expected, ratio = _larger(white.expected, of_images + by_blocks)
    freedom = np.maximum(solution.redundancy[1:3], 1.0)
    rotation, translation = _HIDDEN * np.array(solution.squares[1:3]) / freedom
    to_camera = frames.adjoint(frames.inverse(gripper_T_camera))
    hidden = np.zeros((7, 7))
    hidden[:6, :6] = to_camera @ np.diag(np.repeat([rotation, translation], 3)) @ to_camera.T
    hidden[6, 6] = _HIDDEN_SCALE * translation / spread_metres**2
    return Systematic(
        certainty=enlarged(white, expected, hidden, _HIDDEN_FREEDOM),
        resampled_ratio=ratio,
        hidden_rotation=float(np.sqrt(rotation)),
        hidden_translation=float(np.sqrt(translation)),
    )


def _blocks(base_T_gripper: Array) -> NDArray[np.int64]:
    """A block for each pose (n,): neighbours of a few poses that are far from each other."""
    R, t = base_T_gripper[:, :3, :3], base_T_gripper[:, :3, 3]

    def distance(pose: int) -> Array:
        angles = frames.rotation_angle(R[pose].T @ R)
        metres = np.linalg.norm(t - t[pose], axis=1)
        return np.asarray((angles / NEAR_ANGLE) ** 2 + (metres / NEAR_METRES) ** 2)

    distances = [distance(0)]
    while len(distances) < min(_BLOCKS, len(t) // 2):
        distances.append(distance(int(np.min(distances, axis=0).argmax())))
    return np.asarray(np.argmin(distances, axis=0))


def _by_blocks(
    base_T_gripper: Array, linearised: Linearised, solution: Solution, towards: Array
) -> Array:
    """What the robot's errors make of a covariance (k, k), from leaving out blocks of poses.

    ``towards`` (d, k) are the covariances of the shared unknowns with those in question.
    """
    block = _blocks(base_T_gripper)
    result = np.zeros((towards.shape[1], towards.shape[1]))
    for g in range(block.max() + 1):
        rows = linearised.robot.only(block == g)
        sigmas = robot_sigmas(solution, len(rows.residual))
        predicted = predicted_together(rows, solution.covariance) / np.outer(sigmas, sigmas)
        values, vectors = np.linalg.eigh(np.eye(len(sigmas)) - 0.5 * (predicted + predicted.T))
        values = np.maximum(values, _LEAST_LEFT)
        adjusted = (vectors / np.sqrt(values)) @ (
            vectors.T @ (robot_residuals_after(rows, solution) / sigmas)
        )
        pull = np.einsum("nij,ni->nj", rows.jacobian, (adjusted / sigmas).reshape(-1, 6))
        effect = np.einsum("njk,nj->k", towards[rows.columns], pull)
        result += np.outer(effect, effect)
    return result


def _larger(covariance: Array, other: Array) -> tuple[Array, float]:
    """The larger of two covariances (k, k) along each of their common directions, and the largest ratio.

    The ratio is that of the other's standard deviation to the first one's.
    """
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    root = std[:, None] * vectors * np.sqrt(np.maximum(values, np.finfo(float).eps))
    inverse = (vectors / np.sqrt(np.maximum(values, np.finfo(float).eps))).T / std
    ratios, directions = np.linalg.eigh(inverse @ other @ inverse.T)
    grown = root @ (directions * np.maximum(ratios, 1.0)) @ directions.T @ root.T
    return 0.5 * (grown + grown.T), float(np.sqrt(max(ratios[-1], 0.0)))
