"""Which of several possible camera poses each image has, by the robot's motion: ``agreeing``.

Patterns that look the same when they are turned, and small boards, of which a plane seen from two
sides fits nearly as well, leave several poses to an image. The right ones turn the camera, from image
to image, by the same angles as the robot: ``angle(A) = angle(B)`` whatever X is.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.types import Indices

# Larger differences all count the same: a wrong pose, of the robot or of the camera, is wrong.
_LARGEST = np.deg2rad(10.0)
# An image is not decided where another pose fits nearly as well and is another pose indeed.
_MARGIN = np.deg2rad(1.0)
_OTHER_POSE = np.deg2rad(5.0)
_MAX_SWEEPS = 20


def agreeing(
    base_T_gripper: Array, candidates: Sequence[Array]
) -> tuple[Indices, NDArray[np.bool_]]:
    """Choose the poses whose motions turn by the robot's angles.

    Args:
        base_T_gripper: robot poses (n, 4, 4) of the images; the inverses serve as well.
        candidates: for each image its possible poses target_T_camera (h, 4, 4), at least one.

    Returns:
        The index (n,) of the chosen pose, and whether the motion decides for it (n,).
    """
    n = len(candidates)
    owner = np.repeat(np.arange(n), [len(poses) for poses in candidates])
    of_image = [np.flatnonzero(owner == i) for i in range(n)]
    camera = _angles(np.concatenate(candidates)[:, :3, :3])
    robot = _angles(base_T_gripper[:, :3, :3])[np.ix_(owner, owner)]
    misfit = np.minimum(np.abs(camera - robot), _LARGEST)

    chosen, least = of_image, np.inf
    for anchor in range(len(owner)):
        start = np.array([rows[misfit[anchor, rows].argmin()] for rows in of_image])
        total = misfit[np.ix_(start, start)].sum()
        if total < least:
            chosen, least = list(start), total
    picked = np.array(chosen)

    def mean_misfit(rows: Indices) -> Array:
        """Of possible poses against the chosen ones of the other images."""
        others = picked[owner[picked] != owner[rows[0]]]
        return np.asarray(misfit[np.ix_(rows, others)].sum(axis=1) / max(n - 1, 1))

    for _ in range(_MAX_SWEEPS):
        before = picked.copy()
        for i, rows in enumerate(of_image):
            picked[i] = rows[mean_misfit(rows).argmin()]
        if np.array_equal(before, picked):
            break
    decided = np.ones(n, dtype=bool)
    for i, rows in enumerate(of_image):
        others = rows[camera[rows, picked[i]] > _OTHER_POSE]
        if len(others):
            decided[i] = mean_misfit(others).min() > mean_misfit(picked[i : i + 1])[0] + _MARGIN
    return picked - np.array([rows[0] for rows in of_image]), decided


def _angles(rotations: Array) -> Array:
    """Angles (n, n) in radians from each of the rotations (n, 3, 3) to each."""
    traces = np.einsum("ikl,jkl->ij", rotations, rotations)
    return np.asarray(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)))
