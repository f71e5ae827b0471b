"""Calibration from pose pairs alone: robot and camera poses, or motions, without images; ``solve``."""

import hashlib
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from handeye_fg.errors import ConvergenceError, InputDataError, UnobservableError
from handeye_fg.frames import Array, scaled
from handeye_fg.io.pose_pairs import NamedPairs, PoseList, read_pairs
from handeye_fg.io.results import ImageReport, Result, parent_frame
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.observability import Observability, analyse
from handeye_fg.options import Prior
from handeye_fg.progress import Stopwatch
from handeye_fg.solvers import (
    METHODS,
    Solution,
    first_order_covariance,
    only,
    partial,
    row_residuals,
    start_of,
    trusted_rows,
)
from handeye_fg.types import LinearStart, Setup

Rows = NDArray[np.bool_]

_PACKAGES = ("handeye-fg", "numpy", "scipy")
# Robot and camera that differ by more than this contradict each other: other conventions, units or
# rows; the noise of poses that are of any use is smaller. Radians, and a part of the camera's own
# motion (root mean squares over motions).
_CONTRADICTION_ROTATION = math.radians(15.0)
_CONTRADICTION_TRANSLATION = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Answer:
    """A solution of the trusted rows, and what they determine."""

    start: LinearStart
    observability: Observability
    metres_per_world_unit_std: float


def solve(
    base_T_gripper: PoseList,
    world_T_camera: PoseList,
    method: str = "andreff_scale",
    *,
    motions: bool = False,
    weights: Array | None = None,
    setup: Setup = "eye-in-hand",
    robust: bool = True,
    priors: Sequence[Prior] = (),
    names: Sequence[str] | None = None,
    seed: int = 0,
) -> Result:
    """Find the pose of a camera on a robot arm from poses of the robot and of the camera.

    Eye-in-hand: ``world_T_camera`` is the pose of the camera in anything that stands still (a
    board, a map, a structure-from-motion model), and X = gripper_T_camera. Eye-to-hand: the camera
    stands still, ``world_T_camera`` is its pose in what moves with the gripper (of a board on the
    gripper: the inverse of the board's pose in the camera), and X = base_T_camera.

    Args:
        base_T_gripper: robot poses (n, 4, 4) in metres, in the order in which they were taken; or
            with names: a CSV file, or a mapping.
        world_T_camera: camera poses of the same instants, in the same form; paired by order, or by
            name. Translations in metres, or in any unit for ``andreff_scale``.
        method: one of ``METHODS``.
        motions: whether both are motions, gi_T_gj and ci_T_cj (k, 4, 4). For eye-to-hand the
            robot's are base_T_gripper_i inverse(base_T_gripper_j).
        weights: relative weights (n,) of the squared residuals of the rows.
        setup: camera on the gripper, or static camera.
        robust: whether rows that disagree with the majority are left out, and named.
        priors: what else is known of X; with priors X is found by least squares.
        names: of the rows (n,) of arrays; None: "row 0", "row 1", ...
        seed: of the samples that tell wrong rows from right ones.

    Returns:
        The result; where the motions leave directions free, what they determine of X ("partial").

    Raises:
        InputDataError: the input breaks its format, does not fit together, or follows another
            convention.
        UnobservableError: the robot or the camera did not move.
        ConvergenceError: robot and camera contradict each other.
    """
    if method not in METHODS:
        raise InputDataError(f"unknown method {method!r}: choose one of {', '.join(METHODS)}")
    clock = Stopwatch()
    # 1. Read everything, and pair the rows.
    pairs = read_pairs(
        base_T_gripper,
        world_T_camera,
        names=names,
        weights=weights,
        setup=setup,
        motions=motions,
    )
    clock.lap("input")
    # 2. Leave out the rows that disagree with the majority.
    trusted = _trusted(pairs.data, method, seed, robust=robust)
    clock.lap("wrong rows")
    # 3. Solve the rest, or what it determines.
    answer = _answer(only(pairs.data, trusted), method, priors, parent_frame(setup))
    clock.lap("solution")
    # 4. X, its covariance, and what is to be known of every row.
    free = answer.observability.free_directions
    return Result(
        status="partial" if free else "ok",
        setup=setup,
        message=_message(pairs, trusted, answer),
        matrix=answer.start.gripper_T_camera,
        covariance=answer.observability.covariance,
        free_directions=free,
        metres_per_world_unit=answer.start.metres_per_world_unit,
        metres_per_world_unit_std=answer.metres_per_world_unit_std,
        base_T_world=answer.start.base_T_world,
        initial=answer.start,
        images=_rows(pairs, trusted, answer.start, setup),
        observability={
            "weakest_std_over_limit": answer.observability.weakest_std,
            "rows_used": float(np.count_nonzero(trusted)),
        },
        timing_s=clock.timing_s,
        provenance={
            **{name: version(name) for name in _PACKAGES},
            "method": method,
            "robust": "yes" if robust else "no",
            "input_digest": _digest(pairs),
            "seed": seed,
        },
    )


def _trusted(data: PosePairs | MotionPairs, method: str, seed: int, *, robust: bool) -> Rows:
    """The rows (n,) that are used: those with a weight, less those that disagree with the others."""
    trusted = np.asarray(data.weights) > 0.0
    if robust and trusted.any():
        trusted[trusted] = trusted_rows(
            only(data, trusted), scale_known=METHODS[method].scale_known, seed=seed
        )
    return trusted


def _answer(
    data: PosePairs | MotionPairs, method: str, priors: Sequence[Prior], frame: str
) -> _Answer:
    """The method's solution, if there are no priors and the motions determine everything; else partial."""
    scale_known = METHODS[method].scale_known

    def analysed(solution: Solution, name: str, priors: Sequence[Prior]) -> _Answer:
        start = start_of(data, solution, name)
        _require_agreement(data, start)
        covariance = first_order_covariance(data, solution, scale_known=scale_known, priors=priors)
        observability = analyse(covariance, start.gripper_T_camera, frame)
        log_scale_std = math.nan if scale_known else observability.log_scale_std
        std = start.metres_per_world_unit * log_scale_std
        return _Answer(start=start, observability=observability, metres_per_world_unit_std=std)

    answer: _Answer | None = None
    with suppress(UnobservableError):
        answer = analysed(METHODS[method].solve(data), method, ())
    if answer is None or answer.observability.free_directions or priors:
        answer = analysed(partial(data, scale_known=scale_known, priors=priors), "partial", priors)
    return answer


def _require_agreement(data: PosePairs | MotionPairs, start: LinearStart) -> None:
    """Refuse an answer in which robot and camera contradict each other.

    Raises:
        ConvergenceError: they differ by more than the noise of any poses.
    """
    moved = np.linalg.norm(as_motions(data).ci_T_cj[:, :3, 3], axis=1)
    motion = start.metres_per_world_unit * float(np.sqrt(np.mean(moved**2)))
    if (
        start.residual_rotation > _CONTRADICTION_ROTATION
        or start.residual_translation > _CONTRADICTION_TRANSLATION * motion
    ):
        raise ConvergenceError(
            f"robot and camera contradict each other: over the motions they differ by "
            f"{math.degrees(start.residual_rotation):.2g} deg and "
            f"{1e3 * start.residual_translation:.3g} mm, and the camera moved by {1e3 * motion:.3g} "
            "mm; check that rows belong together, the conventions, and the units (only andreff_scale "
            "takes camera translations that are not in metres)"
        )


def _message(pairs: NamedPairs, trusted: Rows, answer: _Answer) -> str:
    """What came out, in a few sentences."""
    what = "motions" if isinstance(pairs.data, MotionPairs) else "pose pairs"
    method = answer.start.method
    how = "least squares" if method == "partial" else method
    parts = [f"Solved by {how} from {np.count_nonzero(trusted)} of {len(trusted)} {what}."]
    if pairs.left_out:
        parts.append(f"{len(pairs.left_out)} rows without partner were left out.")
    weights = np.asarray(pairs.data.weights)
    bad = [
        name
        for name, use, weight in zip(pairs.names, trusted, weights, strict=True)
        if weight and not use
    ]
    if bad:
        parts.append(f"Left out, in disagreement with the others: {', '.join(bad)}.")
    parts.append("The covariance is approximate: first order, with the noise of the residuals.")
    parts += [direction.description for direction in answer.observability.free_directions]
    return " ".join(parts)


def _rows(
    pairs: NamedPairs, trusted: Rows, start: LinearStart, setup: Setup
) -> tuple[ImageReport, ...]:
    """One report for each row of the input: those with a partner, then the others."""
    X, Z, scale = start.gripper_T_camera, start.base_T_world, start.metres_per_world_unit
    angles, distances = row_residuals(pairs.data, X, scale, Z)
    base_T_camera: list[Array | None] = [None] * len(trusted)
    if isinstance(pairs.data, PosePairs) and Z is not None:
        placed = Z @ scaled(pairs.data.world_T_camera, scale)
        # For eye-to-hand the camera stands still: X is its pose in every row.
        base_T_camera = list(placed) if setup == "eye-in-hand" else [X] * len(trusted)
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


def _digest(pairs: NamedPairs) -> str:
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
