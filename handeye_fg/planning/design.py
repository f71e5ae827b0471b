"""Which of many poses together make X most certain; entry point ``best``.

A camera whose pose in the scene is known from its image with information Q, and whose gripper the arm
reports with noise N, measures (X, the place and the size of the scene): with a right perturbation xi of
X, delta of the scene's place and l of the logarithm of its size, the residual of the reported pose is

    Ad (delta' - xi),   delta' = Ad(C^-1) delta + (0, R_C' t_C) l,   noise N + Ad Q^-1 Ad'

with C = (R_C, t_C) the camera, and Ad the adjoint of X (of C, with the sign reversed, where the camera
is static and the scene moves). These are 13 unknowns, and information adds up over the poses. The
points are taken as known here: good enough to choose, while ``graph.forecast`` says what comes of it.
"""

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.known import rows
from handeye_fg.observability import WIDE
from handeye_fg.priors import PosePrior, Prior

UNKNOWNS = 13
# The eigenvalues of the covariance count by this power: nearly the largest alone, yet smooth.
_POWER = 4
_MOST_EXCHANGES = 4
# Poses nearer to each other than this, and than this part of the standoff, are one.
_SAME_ANGLE, _SAME_PLACE = float(np.deg2rad(5.0)), 0.05


def pose_information(
    cameras: Array,
    of_image: Array,
    X: Array,
    centre: Array,
    noise: NoiseLevels,
    *,
    static: bool,
) -> Array:
    """What images with their robot poses say of the 13 unknowns: (n, 13, 13).

    Args:
        cameras: (n, 4, 4) in the scene's frame, metres.
        of_image: information (n, 6, 6) of the images on them.
        X: (4, 4), metres.
        centre: a point (3,) about which the scene turns, any.
        noise: of the robot.
        static: the camera stands still.
    """
    robot = np.repeat([noise.robot_rotation, noise.robot_translation], 3) ** 2
    n = len(cameras)
    lever = frames.adjoint(cameras if static else np.broadcast_to(X, (n, 4, 4)))
    about = np.array(cameras)
    about[:, :3, 3] -= centre
    derivative = np.zeros((n, 6, UNKNOWNS))
    derivative[:, :, :6] = -np.eye(6)
    derivative[:, :, 6:12] = frames.adjoint(frames.inverse(about))
    derivative[:, 3:, 12] = np.einsum("nji,nj->ni", about[:, :3, :3], about[:, :3, 3])
    derivative = lever @ derivative
    covariance = np.diag(robot) + lever @ np.linalg.inv(of_image) @ np.swapaxes(lever, 1, 2)
    return np.asarray(np.swapaxes(derivative, 1, 2) @ np.linalg.solve(covariance, derivative))


def prior_information(priors: tuple[Prior | PosePrior, ...], X: Array, standoff: float) -> Array:
    """What is known without any pose (13, 13): wide limits, and the user's priors of X."""
    wide = np.concatenate([WIDE[:6], [3.0] * 3, [10.0 * standoff + 1.0] * 3, WIDE[6:]])
    information = np.diag(wide**-2.0)
    for prior in priors:
        derivative = rows(prior, X, 0.0)[1][:, :6]
        information[:6, :6] += derivative.T @ derivative
    return information


def uncertainty(information: Array, standoff: float) -> Array:
    """How uncertain X is (...,), metres at a distance of the standoff: a smooth worst standard deviation.

    Args:
        information: of the 13 unknowns (..., 13, 13).
        standoff: distance from the camera at which a rotation counts, metres.
    """
    scale = np.repeat([standoff, 1.0], 3)
    covariance = np.linalg.inv(information)[..., :6, :6] * np.outer(scale, scale)
    variances = np.linalg.eigvalsh(covariance)
    return np.asarray(np.mean(variances**_POWER, axis=-1) ** (0.5 / _POWER))


def best(
    known: Array, gains: Array, poses: Array, taken: Array, count: int, standoff: float
) -> NDArray[np.int64]:
    """The poses that together leave X least uncertain, the one that helps most first.

    Greedy, then each is exchanged for a better one while there is any.

    Args:
        known: information (13, 13) of what is there.
        gains: information (n, 13, 13) that each pose adds.
        poses: the poses (n, 4, 4), metres.
        taken: those (m, 4, 4) that exist; none is chosen again.
        count: how many to choose.
        standoff: of the camera, metres.

    Returns:
        Indices of the poses; fewer where too few differ from each other.
    """
    allowed = ~_near(poses, taken, standoff).any(axis=1)
    near = _near(poses, poses, standoff)

    def added(chosen: list[int]) -> int | None:
        open_ = np.flatnonzero(allowed & ~near[chosen].any(axis=0))
        if len(open_) == 0:
            return None
        present = known + gains[chosen].sum(axis=0)
        return int(open_[np.argmin(uncertainty(present + gains[open_], standoff))])

    chosen: list[int] = []
    while len(chosen) < count and (one := added(chosen)) is not None:
        chosen.append(one)
    for _ in range(_MOST_EXCHANGES):
        before = sorted(chosen)
        for _ in range(len(chosen)):
            rest = chosen[1:]
            one = added(rest)
            chosen = [*rest, chosen[0] if one is None else one]
        if sorted(chosen) == before:
            break
    return np.array(_helpful_first(known, gains, chosen, standoff), dtype=np.int64)


def _helpful_first(known: Array, gains: Array, chosen: list[int], standoff: float) -> list[int]:
    ordered: list[int] = []
    left = list(chosen)
    while left:
        present = known + gains[ordered].sum(axis=0)
        ordered.append(left.pop(int(np.argmin(uncertainty(present + gains[left], standoff)))))
    return ordered


def _near(poses: Array, others: Array, standoff: float) -> NDArray[np.bool_]:
    """Which of some poses (n, 4, 4) are about the same as others (m, 4, 4): (n, m)."""
    if len(others) == 0:
        return np.zeros((len(poses), 0), dtype=bool)
    trace = np.einsum("nij,mij->nm", poses[:, :3, :3], others[:, :3, :3])
    angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    place = np.linalg.norm(poses[:, None, :3, 3] - others[None, :, :3, 3], axis=2)
    return np.asarray((angle < _SAME_ANGLE) & (place < _SAME_PLACE * standoff))
