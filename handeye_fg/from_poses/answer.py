"""From the answer of pose pairs to what users are told: message, rows, digest of the input."""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from handeye_fg.findings import LinearStart, NoiseLevels
from handeye_fg.frames import Array, scaled
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.pose_pairs import NamedPairs
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.observability import Observability
from handeye_fg.solvers import row_residuals
from handeye_fg.types import Setup


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """X of the trusted rows, and what they determine.

    Attributes:
        method: how X was found, in words.
        start: the closed form; X itself, where nothing refines it.
        gripper_T_camera, base_T_world, metres_per_world_unit: X, Z and the scale.
        observability: what is determined.
        trusted: the rows (n,) that were used.
        note: about the uncertainty, in words.
        noise: noise levels, where they are modelled.
        figures: named figures.
    """

    method: str
    start: LinearStart
    gripper_T_camera: Array
    base_T_world: Array | None
    metres_per_world_unit: float
    observability: Observability
    trusted: NDArray[np.bool_]
    note: str
    noise: NoiseLevels | None = None
    figures: Mapping[str, float] = field(default_factory=dict)


def message(pairs: NamedPairs, answer: Answer) -> str:
    """What came out, in a few sentences."""
    what = "motions" if isinstance(pairs.data, MotionPairs) else "pose pairs"
    n, weights = len(pairs.names), np.asarray(pairs.data.weights)
    parts = [f"Solved by {answer.method} from {np.count_nonzero(answer.trusted)} of {n} {what}."]
    if pairs.left_out:
        parts.append(f"{len(pairs.left_out)} rows without partner were left out.")
    bad = [pairs.names[i] for i in np.flatnonzero(~answer.trusted & (weights > 0.0))]
    if bad:
        parts.append(f"Left out, in disagreement with the others: {', '.join(bad)}.")
    parts.append(answer.note)
    parts += [direction.description for direction in answer.observability.free_directions]
    return " ".join(parts)


def row_reports(pairs: NamedPairs, answer: Answer, setup: Setup) -> tuple[ImageReport, ...]:
    """One report for each row of the input: those with a partner, then the others."""
    X, Z = answer.gripper_T_camera, answer.base_T_world
    scale, trusted = answer.metres_per_world_unit, answer.trusted
    angles, distances = row_residuals(pairs.data, X, scale, Z)
    base_T_camera: list[Array | None] = [None] * len(trusted)
    gripper_T_camera = list(base_T_camera)
    if isinstance(pairs.data, PosePairs) and Z is not None:
        placed: list[Array | None] = list(Z @ scaled(pairs.data.world_T_camera, scale))
        if setup == "eye-in-hand":
            base_T_camera = placed
        else:  # the camera stands still: X is its pose in every row
            base_T_camera, gripper_T_camera = [X] * len(trusted), placed
    weights = np.asarray(pairs.data.weights)
    reports = [
        ImageReport(
            name=name,
            registered=True,
            base_T_camera=base_T_camera[i],
            residual_rotation=float(angles[i]),
            residual_translation=float(distances[i]),
            outlier=bool(weights[i] and not trusted[i]),
            reason=_reason(float(weights[i]), float(angles[i]), float(distances[i]))
            if not trusted[i]
            else "",
            gripper_T_camera=gripper_T_camera[i],
        )
        for i, name in enumerate(pairs.names)
    ]
    reports += [
        ImageReport(name=name, registered=False, reason=reason) for name, reason in pairs.left_out
    ]
    return tuple(reports)


def _reason(weight: float, angle: float, distance: float) -> str:
    """Why a row was not used."""
    if not weight:
        return "its weight is zero"
    return (
        f"robot and camera disagree by {math.degrees(angle):.3g} deg and {1e3 * distance:.3g} mm, "
        "far more than in the other rows, so it was left out; check that they belong together"
    )


def digest(pairs: NamedPairs) -> str:
    """SHA-256 over names, poses and weights."""
    total = hashlib.sha256("\n".join(pairs.names).encode("utf-8", "backslashreplace"))
    data = pairs.data
    matrices = (
        (data.base_T_gripper, data.world_T_camera)
        if isinstance(data, PosePairs)
        else (data.gi_T_gj, data.ci_T_cj)
    )
    for array in (*matrices, np.asarray(data.weights)):
        total.update(array.tobytes())
    return total.hexdigest()
