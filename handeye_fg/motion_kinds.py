"""Of what kind a set of robot motions is: the rows of the table of what motions determine.

Entry point ``classify``. What the motions of a calibration determine in numbers, camera and noise included,
says ``handeye_fg.observability``; this module has the words.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array, quaternions, rotation_vectors
from handeye_fg.motions import MotionPairs, PosePairs, as_motions, with_weight

Flags = NDArray[np.bool_]
Kind = Literal["none", "translations", "rotations", "planar", "general", "mixed"]

# Motions within so many standard deviations of rest are noise: of 70,000 one lies beyond.
_SIGNIFICANT = 5.0
# Among many motions a few hardly turn or move by chance; a set is mixed from this share on.
_SHARE = 0.1
# An ordinary arm: radians and metres per axis and pose.
_TYPICAL_ROTATION, _TYPICAL_TRANSLATION = float(np.deg2rad(0.02)), 1e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionKind:
    """The kind of a set of motions of the gripper.

    Attributes:
        kind: "none": the gripper rests. "translations": it never turns. "rotations": it only turns,
            about its own origin. "planar": it turns about one axis and moves across it only.
            "mixed": a tenth or more are without rotation, or rotations about its own origin.
            "general": anything else.
        n_axes: rotation axes that the motions span: 0, 1, or 2 for two and more.
        axes: the axes, strongest first, in the columns of a matrix (3, n_axes), gripper frame; of
            two and more the two strongest.
    """

    kind: Kind
    n_axes: int
    axes: Array


def classify(
    data: PosePairs | MotionPairs,
    *,
    rotation_noise: float = _TYPICAL_ROTATION,
    translation_noise: float = _TYPICAL_TRANSLATION,
) -> MotionKind:
    """Tell the kind of the robot's motions, with its noise considered.

    Args:
        data: two poses or one motion at least; the camera's are not used.
        rotation_noise: standard deviation of a reported orientation per axis, radians.
        translation_noise: of a reported position per axis, metres.
    """
    motions = with_weight(as_motions(data)).gi_T_gj
    vectors = rotation_vectors(quaternions(motions[:, :3, :3]))
    # A motion has the noise of two poses; a length of three such components is up to 5 sigma.
    rotation = _SIGNIFICANT * np.sqrt(2.0) * rotation_noise
    translation = _SIGNIFICANT * np.sqrt(2.0) * translation_noise
    turns = np.linalg.norm(vectors, axis=1) > rotation
    moves = np.linalg.norm(motions[:, :3, 3], axis=1) > translation
    _, _, vt = np.linalg.svd(vectors[turns] if turns.any() else np.zeros((1, 3)))
    n_axes = 0
    if turns.any():
        across = vectors[turns] - np.outer(vectors[turns] @ vt[0], vt[0])
        n_axes = 2 if np.linalg.norm(across, axis=1).max() > rotation else 1
    # Across one axis a tilt of the axis within the noise carries a motion along it, too.
    lengths = np.linalg.norm(motions[:, :3, 3], axis=1)
    along = np.abs(motions[:, :3, 3] @ vt[0]) > translation + rotation * lengths
    return MotionKind(
        kind=_kind(turns, moves, n_axes, planar=not along.any()),
        n_axes=n_axes,
        axes=np.asarray(vt[:n_axes].T),
    )


def _kind(turns: Flags, moves: Flags, n_axes: int, *, planar: bool) -> Kind:
    """The kind, from which motions (k,) turn and which move."""
    if not turns.any():
        return "translations" if moves.any() else "none"
    if not moves.any():
        return "rotations"
    if n_axes == 1 and planar:
        return "planar"
    if max(np.mean(turns & ~moves), np.mean(moves & ~turns)) >= _SHARE:
        return "mixed"
    return "general"
