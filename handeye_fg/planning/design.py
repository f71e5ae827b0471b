"""Which of many poses together make X most certain; entry point ``best``.

A camera whose pose in the scene is known from its image with information Q, and whose gripper the arm
reports with noise N, measures (X, the place and the size of the scene): with a right perturbation xi of
X, delta of the scene's place and l of the logarithm of its size, the residual of the reported pose is

    Ad (delta' - xi),   delta' = Ad(C^-1) delta + (0, R_C' t_C) l,   noise N + Ad Q^-1 Ad'

with C = (R_C, t_C) the camera, and Ad the adjoint of X (of C, with the sign reversed, where the camera
is static and the scene moves). With k cameras on the arm these are 6 k + 7 unknowns, and N is common to the
images of a pose; information adds up over the poses. The points are taken as known here: good enough to
choose, while ``graph.forecast`` says what comes of it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.known import rows
from handeye_fg.observability import WIDE
from handeye_fg.priors import PosePrior, Prior

# Variances count by this power: nearly the largest alone, yet smooth.
_POWER = 8
# Information on a camera's pose that is none: ten radians, ten metres.
_NOTHING = 0.01
_MOST_EXCHANGES = 4
# Poses nearer to each other than this, and than this part of the standoff, are one.
_SAME_ANGLE, _SAME_PLACE = float(np.deg2rad(5.0)), 0.05


def pose_information(
    cameras: Array,
    of_image: Array,
    gripper_T_cameras: Array,
    centre: Array,
    noise: NoiseLevels,
    *,
    static: bool,
) -> Array:
    """What images with their robot poses say of the u = 6 k + 7 unknowns: (n, u, u).

    Args:
        cameras: k at each of n poses (n, k, 4, 4) in the scene's frame, metres.
        of_image: information (n, k, 6, 6) of the images on them; zero where there is no image.
        gripper_T_cameras: X of each (k, 4, 4), metres.
        centre: a point (3,) about which the scene turns, any.
        noise: of the robot.
        static: the cameras stand still.
    """
    robot = np.repeat([noise.robot_rotation, noise.robot_translation], 3) ** 2
    n, k = cameras.shape[:2]
    lever = frames.adjoint(cameras if static else np.broadcast_to(gripper_T_cameras, (n, k, 4, 4)))
    about = np.array(cameras)
    about[..., :3, 3] -= centre
    derivative = np.zeros((n, k, 6, 6 * k + 7))
    for i in range(k):
        derivative[:, i, :, 6 * i : 6 * i + 6] = -np.eye(6)
    derivative[..., 6 * k : -1] = frames.adjoint(frames.inverse(about))
    derivative[..., 3:, -1] = np.einsum("nkji,nkj->nki", about[..., :3, :3], about[..., :3, 3])
    derivative = (lever @ derivative).reshape(n, 6 * k, -1)
    of_cameras = lever @ np.linalg.inv(of_image + _NOTHING * np.eye(6)) @ np.swapaxes(lever, 2, 3)
    covariance = np.tile(np.diag(robot), (n, k, k))
    for i in range(k):
        own = slice(6 * i, 6 * i + 6)
        covariance[:, own, own] += of_cameras[:, i]
    return np.asarray(np.swapaxes(derivative, 1, 2) @ np.linalg.solve(covariance, derivative))


def prior_information(
    priors: tuple[Prior | PosePrior, ...], gripper_T_cameras: Array, standoff: float
) -> Array:
    """What is known without any pose (u, u): wide limits, and the user's priors of the first X."""
    wide = [*np.tile(WIDE[:6], len(gripper_T_cameras)), *[3.0] * 3, *[10.0 * standoff + 1.0] * 3]
    information = np.diag(np.append(wide, WIDE[6:]) ** -2.0)
    for prior in priors:
        derivative = rows(prior, gripper_T_cameras[0], 0.0)[1][:, :6]
        information[:6, :6] += derivative.T @ derivative
    return information


def uncertainty(information: Array) -> Array:
    """How uncertain X is (...,): a smooth worst standard deviation of rotation times that of position, of all cameras.

    A per cent of the one counts as much as a per cent of the other, whatever their units: what counts at the
    distance of the work alone leaves the rotation to what is good for the position.

    Args:
        information: of the unknowns (..., u, u).

    Returns:
        The square root of the product, of radians and metres.
    """
    variances = np.diagonal(np.linalg.inv(information), axis1=-2, axis2=-1)[..., :-7]
    by_kind = variances.reshape(*variances.shape[:-1], -1, 2, 3)  # camera, kind, axis
    worst = np.mean(by_kind**_POWER, axis=(-3, -1)) ** (0.5 / _POWER)
    return np.asarray(np.sqrt(np.prod(worst, axis=-1)))


def best(
    known: Array,
    gains: Array,
    poses: Array,
    taken: Array,
    count: int,
    standoff: float,
    start: Sequence[int] = (),
) -> NDArray[np.int64]:
    """The poses that together leave X least uncertain, the one that helps most first.

    Greedy, then each is exchanged for a better one while there is any.

    Args:
        known: information (u, u) of what is there.
        gains: information (n, u, u) that each pose adds.
        poses: the poses (n, 4, 4), metres.
        taken: those (m, 4, 4) that exist; none is chosen again.
        count: how many to choose.
        standoff: of the camera, metres.
        start: a choice to begin with.

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
        return int(open_[np.argmin(uncertainty(present + gains[open_]))])

    chosen = list(start)
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
    return np.array(_helpful_first(known, gains, chosen), dtype=np.int64)


def _helpful_first(known: Array, gains: Array, chosen: list[int]) -> list[int]:
    ordered: list[int] = []
    left = list(chosen)
    while left:
        present = known + gains[ordered].sum(axis=0)
        ordered.append(left.pop(int(np.argmin(uncertainty(present + gains[left])))))
    return ordered


def _near(poses: Array, others: Array, standoff: float) -> NDArray[np.bool_]:
    """Which of some poses (n, 4, 4) are about the same as others (m, 4, 4): (n, m)."""
    if len(others) == 0:
        return np.zeros((len(poses), 0), dtype=bool)
    trace = np.einsum("nij,mij->nm", poses[:, :3, :3], others[:, :3, :3])
    angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    place = np.linalg.norm(poses[:, None, :3, 3] - others[None, :, :3, 3], axis=2)
    return np.asarray((angle < _SAME_ANGLE) & (place < _SAME_PLACE * standoff))
