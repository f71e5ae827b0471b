"""Checks of the fields of frozen records."""

import math

import numpy as np

from handeye_fg.frames import Array


def set_array(owner: object, name: str, shape: tuple[int, ...]) -> None:
    """Replace an array by a checked, read-only copy."""
    array = np.array(getattr(owner, name), dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name}: {array.shape=} but expected finite numbers of shape {shape}")
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def set_pose(owner: object, name: str) -> None:
    """Replace a pose by a checked, read-only copy."""
    set_array(owner, name, (4, 4))
    matrix: Array = getattr(owner, name)
    rotation = matrix[:3, :3]
    is_rigid = (
        np.abs(rotation).max() < 2.0  # else its square may overflow
        and np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-6)
        and np.linalg.det(rotation) > 0.0
        and np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
    )
    if not is_rigid:
        raise ValueError(f"{name}: not a rigid transform")


def check_finite(owner: object, name: str) -> None:
    """Refuse a field that is not finite."""
    if not math.isfinite(getattr(owner, name)):
        raise ValueError(f"{name} is {getattr(owner, name)} but expected a finite number")
