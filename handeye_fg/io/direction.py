"""The one sentence on which way X maps points, with a worked number; every output carries it."""

import numpy as np

from handeye_fg.frames import Array

_AHEAD = 0.5  # metres in front of the camera: where arms pick things up


def direction(a_T_camera: Array, parent: str, ahead: float = 1.0) -> str:
    """What X does to a point, and where it puts one that lies in front of the camera.

    Args:
        a_T_camera: X (4, 4), metres.
        parent: the frame a, "gripper" or "base".
        ahead: -1 where the camera looks along its -z, as in OpenGL.
    """
    example = a_T_camera @ np.array([0.0, 0.0, ahead * _AHEAD, 1.0])
    numbers = ", ".join(f"{round(value, 6) + 0.0:.6f}" for value in example[:3])
    return (
        f"Put a point given in camera coordinates into {parent} coordinates: "
        f"p_{parent} = {parent}_T_camera p_camera; the point {_AHEAD:g} m in front of the camera, "
        f"(0, 0, {ahead * _AHEAD:g}), is at ({numbers}) m in the {parent} frame."
    )
