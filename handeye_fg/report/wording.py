"""The words and the numbers that the page and the terminal share."""

import math
from collections.abc import Sequence

import numpy as np

from handeye_fg.frames import Array
from handeye_fg.io.results import Result

MISSING = "—"
COVARIANCE_CONVENTION = (
    "Order (rotation, translation); right perturbation in the camera frame: "
    "X = mean · Exp(ξ), ξ ~ N(0, covariance), as in GTSAM."
)


def parent(result: Result) -> str:
    """The frame in which X places the camera."""
    return "gripper" if result.setup == "eye-in-hand" else "base"


def transform_name(result: Result) -> str:
    """X by its frames, such as gripper_T_camera."""
    return f"{parent(result)}_T_camera"


def meaning(result: Result) -> str:
    """One sentence on what X is."""
    carrier = "mounted on the gripper" if result.setup == "eye-in-hand" else "standing in the cell"
    return (
        f"X = {transform_name(result)} is the pose of the camera, {carrier}, in the "
        f"{parent(result)} frame (camera frame: z forward, x right, y down)."
    )


def direction(result: Result) -> str:
    """One sentence on which way X maps points."""
    frame = parent(result)
    return (
        f"Put a point given in camera coordinates into {frame} coordinates: "
        f"p_{frame} = {transform_name(result)} p_camera."
    )


def standard_deviations(
    result: Result,
) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """Standard deviations of X along the camera's axes; None where the data leave one free.

    Returns:
        Three of the rotation in degrees and three of the translation in millimetres.
    """
    sigmas = np.sqrt(np.maximum(np.diag(result.covariance), 0.0))
    parent_R_camera = result.matrix[:3, :3]
    free = np.zeros(6, dtype=bool)
    for item in result.free_directions:
        touched = np.abs(parent_R_camera.T @ item.vector) > 1e-6
        if item.kind == "rotation":
            free[:3] |= touched
        elif item.kind == "translation":
            free[3:] |= touched
    rotation = np.degrees(sigmas[:3])
    translation = 1000.0 * sigmas[3:]
    return (
        tuple(None if free[i] else float(rotation[i]) for i in range(3)),
        tuple(None if free[3 + i] else float(translation[i]) for i in range(3)),
    )


def scale_is_free(result: Result) -> bool:
    """Whether the data leave the scale undetermined."""
    return any(item.kind == "scale" for item in result.free_directions)


def number(value: float | None, digits: int = 3) -> str:
    """A number with fixed digits, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:.{digits}f}"
    # No "-0.000": the sign of a zero says nothing.
    return text.removeprefix("-") if float(text) == 0.0 else text


def significant(value: float | None, digits: int = 3) -> str:
    """A number with significant digits, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{value:.{digits}g}"


def numbers(values: Sequence[float | None] | Array, digits: int = 3) -> tuple[str, ...]:
    """Several numbers with fixed digits."""
    return tuple(number(None if value is None else float(value), digits) for value in values)


def printable(text: str) -> str:
    """Text with every character that a terminal or a font cannot show as an escape."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode() for char in text
    )


def shortened(text: str, length: int = 22) -> str:
    """Text with its middle left out where it is longer than a label may be."""
    if len(text) <= length:
        return text
    half = (length - 1) // 2
    return f"{text[:half]}…{text[-half:]}"
