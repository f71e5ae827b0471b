"""Whether a robot and a camera turn alike: R_A R_X = R_X R_B, with one R_X whatever the mounting.

It needs no scale, no translations and no X, so that it can tell right camera motions from wrong ones
before anything is calibrated; entry points ``agreement`` and ``pose_agreement``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array, orthonormalised, quaternions
from handeye_fg.options import Setup
from handeye_fg.types import Indices

# Two views of a small or flat object give their turn to some degrees.
_WITHIN = np.deg2rad(4.0)
# Turns by less have no clear axis.
_LEAST = np.deg2rad(5.0)
_SAMPLES = 1000
_ROUNDS = 3
# By chance, with the best R_X, a tenth of wrong turns by the right angle agree, and of few a handful.
_CHANCE, _HANDFUL = 0.1, 6
# More pairs of poses add time and no certainty.
_MOST_PAIRS = 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotTurns:
    """How the robot turned from image to image.

    Attributes:
        rotations: of the reported poses (n, 3, 3), in the form of the equations: for eye-to-hand of
            gripper_T_base.
        setup: how the camera is said to be mounted.
    """

    rotations: Array
    setup: Setup

    def between(self, i: Indices, j: Indices) -> Array:
        """Turns (k, 3, 3) from poses i to poses j."""
        return np.asarray(np.swapaxes(self.rotations[i], 1, 2) @ self.rotations[j])

    def only(self, which: Indices | NDArray[np.bool_]) -> "RobotTurns":
        """Those of some of the images."""
        return RobotTurns(rotations=self.rotations[which], setup=self.setup)

    def inverted(self) -> "RobotTurns":
        """The turns if the camera were mounted the other way."""
        other: Setup = "eye-in-hand" if self.setup == "eye-to-hand" else "eye-to-hand"
        return RobotTurns(rotations=np.swapaxes(self.rotations, 1, 2), setup=other)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Agreement:
    """Turns of robot and camera between the same two instants, held against each other.

    Attributes:
        agrees: (k,) which agree with the R_X that most agree with.
        significant: whether more do than would by chance.
    """

    agrees: NDArray[np.bool_]
    significant: bool


def agreement(robot: Array, camera: Array, seed: int = 0, within: float = _WITHIN) -> Agreement:
    """Find the R_X that the most turns agree with.

    Args:
        robot: turns R_A (k, 3, 3) of the robot.
        camera: turns R_B (k, 3, 3) of the camera between the same instants.
        seed: of the samples.
        within: largest angle between turns that agree, radians.
    """
    q_a, q_b = quaternions(robot), quaternions(camera)
    turn_a, turn_b = _angles(q_a), _angles(q_b)
    # A turn keeps its angle whatever the mounting is.
    likely = np.flatnonzero((np.abs(turn_a - turn_b) < within) & (turn_a > _LEAST))
    if len(likely) < 2:
        return Agreement(agrees=np.zeros(len(robot), dtype=bool), significant=False)
    rng = np.random.default_rng(seed)
    samples = likely[rng.integers(0, len(likely), (_SAMPLES, 2))]
    agrees = _agrees(_mountings(q_a[samples], q_b[samples]), q_a, q_b, within)
    best = agrees[np.argmax(agrees.sum(axis=1))]
    for _ in range(_ROUNDS):
        best = _agrees(_mountings(q_a[best][None], q_b[best][None]), q_a, q_b, within)[0]
        if best.sum() < 2:
            break
    # Turns that say nothing of the axis agree with everything.
    telling = int(np.count_nonzero(best & (turn_a > _LEAST)))
    return Agreement(agrees=best, significant=telling > _HANDFUL + _CHANCE * len(likely))


def pose_agreement(
    robot: RobotTurns, fragments: Sequence[tuple[Indices, Array]], seed: int = 0
) -> float:
    """Part of the pairs of poses in a fragment whose turns agree, all with one R_X.

    Args:
        robot: the robot's turns.
        fragments: for each the instants (n,) and the camera poses (n, 4, 4) in a world of its own.
        seed: of the samples.
    """
    found = [_pairs(len(rows), seed) for rows, _ in fragments]
    within = list(zip(fragments, found, strict=True))
    i, j = (np.concatenate([rows[pair[k]] for (rows, _), pair in within]) for k in (0, 1))
    camera = np.concatenate(
        [np.swapaxes(poses[i, :3, :3], 1, 2) @ poses[j, :3, :3] for (_, poses), (i, j) in within]
    )
    return float(np.mean(agreement(robot.between(i, j), camera, seed).agrees))


def _pairs(n: int, seed: int) -> tuple[Indices, Indices]:
    """All pairs of n poses, or a sample."""
    pairs = np.array(list(combinations(range(n), 2))).reshape(-1, 2)
    if len(pairs) > _MOST_PAIRS:
        pairs = np.random.default_rng(seed).choice(pairs, _MOST_PAIRS, replace=False)
    return pairs[:, 0], pairs[:, 1]


def _angles(q: Array) -> Array:
    """Angles (k,) of quaternions (k, 4), scalar first and not negative."""
    return np.asarray(2.0 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), q[:, 0]))


def _mountings(q_a: Array, q_b: Array) -> Array:
    """The R_X (s, 3, 3) that best carry the axes of turns (s, m, 4) onto each other."""
    return orthonormalised(np.einsum("smi,smj->sij", q_a[..., 1:], q_b[..., 1:]))


def _agrees(R_X: Array, q_a: Array, q_b: Array, within: float) -> NDArray[np.bool_]:
    """Which turns (k,) agree with each of the R_X (s, 3, 3)."""
    turned = np.einsum("sij,kj->ski", R_X, q_b[:, 1:])
    # Half the angle between two turns; both signs of a quaternion are the same turn.
    cosine = np.abs(q_a[:, 0] * q_b[:, 0] + np.einsum("ski,ki->sk", turned, q_a[:, 1:]))
    return np.asarray(cosine > np.cos(0.5 * within))
