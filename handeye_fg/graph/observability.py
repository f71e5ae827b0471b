"""What the data determine of X and of the scale, from their joint covariance in scaled units."""

from dataclasses import dataclass

import numpy as np

from handeye_fg.frames import Array
from handeye_fg.types import FreeDirection

# A camera pose less certain than this serves no purpose: such a direction counts as undetermined.
_USELESS_ROTATION = np.deg2rad(5.0)
_USELESS_TRANSLATION = 0.05
_USELESS_LOG_SCALE = 0.2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observability:
    """Determined part of X.

    Attributes:
        covariance: of X (6, 6) on the determined subspace, zero along the free directions.
        free_directions: the rest.
        weakest_std: standard deviation of the weakest direction of X, in units of the limits above.
    """

    covariance: Array
    free_directions: tuple[FreeDirection, ...]
    weakest_std: float


def _words(values: Array) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values + 0.0) + ")"


def _describe(kind: str, vector: Array, frame: str) -> str:
    if kind == "scale":
        return (
            "The scale of the scene is not determined: the robot only turned about the camera or "
            "hardly moved. Add poses that move the camera by 100 mm or more."
        )
    if kind == "translation":
        return (
            f"The camera's position along the {frame} axis {_words(vector)} is not determined: all "
            "rotations share this axis. Add two poses tilted by 20 degrees or more about another "
            "axis, or measure that distance."
        )
    return (
        f"The camera's rotation about the {frame} axis {_words(vector)} is not determined: the "
        "motions do not turn enough. Add poses that turn by 20 degrees or more about two different "
        "axes."
    )


def analyse(covariance: Array, gripper_T_camera: Array, frame: str) -> Observability:
    """Split the joint covariance (7, 7) of (X, ln scale) into determined and free directions.

    Args:
        covariance: order (rotation, translation, ln scale); X's part a right perturbation.
        gripper_T_camera: X (4, 4), to give directions in its parent frame.
        frame: name of the parent frame.
    """
    limits = np.array([_USELESS_ROTATION] * 3 + [_USELESS_TRANSLATION] * 3)
    scaled = covariance[:6, :6] / np.outer(limits, limits)
    variances, vectors = np.linalg.eigh(scaled)
    free = variances > 1.0
    rotation = gripper_T_camera[:3, :3]
    directions = []
    for vector in vectors[:, free].T:
        kind = (
            "rotation" if np.linalg.norm(vector[:3]) > np.linalg.norm(vector[3:]) else "translation"
        )
        part = rotation @ (vector[:3] if kind == "rotation" else vector[3:])
        axis = part / np.linalg.norm(part) * (1.0 if part[np.abs(part).argmax()] > 0 else -1.0)
        directions.append((kind, axis))
    if covariance[6, 6] > _USELESS_LOG_SCALE**2:
        directions.append(("scale", np.zeros(3)))
    kept = vectors[:, ~free] * limits[:, None]
    return Observability(
        covariance=kept @ np.diag(variances[~free]) @ kept.T,
        free_directions=tuple(
            FreeDirection(
                kind=kind,  # type: ignore[arg-type]  # one of the three by construction
                vector=axis,
                frame=frame,
                description=_describe(kind, axis, frame),
            )
            for kind, axis in directions
        ),
        weakest_std=float(np.sqrt(variances[-1])),
    )
