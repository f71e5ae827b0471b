"""Rows that fall into two parts, each right in itself: another tool or another base; ``parts_of``.

A controller reports the flange or the active tool: where the tool was set midway, the poses before and
after differ by a fixed offset. The parts then have one world and one scale, but an X each.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handeye_fg.conventions.evidence import Evidence, evidence_of
from handeye_fg.frames import Array, inverse, rotation_angle, scaled
from handeye_fg.solvers import average_base_T_world

# Each part has an X of its own; fewer rows would determine it hardly.
_FEWEST = 5
# So much more likely (natural logarithm) than the poses as a whole, with what the parts have of their own.
_DECISIVE = 20.0
# Scales of one reconstruction, as the logarithm of their ratio.
_SAME_SCALE = 0.1
# Offsets below these (radians; part of the extent) are none.
_SAME_ROTATION, _SAME_POSITION = math.radians(3.0), 0.03
_FITS_ROWS = 0.8
# Places of the change that are tried, of those that the angles allow.
_MOST = 12
# An offset of the position alone shows in fewer rows.
_FEWEST_SHIFTED = 3
_ENTROPY = 0.5 * math.log(2.0 * math.pi * math.e)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Parts:
    """Two parts of the rows.

    Attributes:
        row: the first of the second part.
        change: what differs: the tool (X), the base (Z), or both.
        rotation: of the offset, radians.
        translation: of the offset, metres.
    """

    row: int
    change: Literal["tool", "base", "tool and base"]
    rotation: float
    translation: float


def parts_of(
    base_T_gripper: Array,
    world_T_camera: Array,
    extent: float,
    whole: Evidence,
    log_likelihood: float,
) -> Parts | None:
    """The two parts that the rows fall into, or None.

    Args:
        base_T_gripper: poses (n, 4, 4) as given, in the form of the equations and the order of the rows.
        world_T_camera: camera poses (n, 4, 4).
        extent: as for ``evidence_of``.
        whole: what speaks for the poses as given, as a whole.
        log_likelihood: of the best reading of all rows.
    """
    separate = _separate(base_T_gripper, world_T_camera, extent, log_likelihood)
    if separate is not None:
        return separate
    return _shifted(base_T_gripper, world_T_camera, extent, whole)


def _separate(
    base_T_gripper: Array, world_T_camera: Array, extent: float, log_likelihood: float
) -> Parts | None:
    """Parts that are calibrated one by one."""
    splits = [
        (
            row,
            evidence_of(base_T_gripper[:row], world_T_camera[:row], extent),
            evidence_of(base_T_gripper[row:], world_T_camera[row:], extent),
        )
        for row in _likely(base_T_gripper, world_T_camera)
    ]
    fitting = [
        (row, first, second)
        for row, first, second in splits
        if min(_share(first), _share(second)) >= _FITS_ROWS
        and abs(math.log(first.metres_per_world_unit / second.metres_per_world_unit)) < _SAME_SCALE
    ]
    if not fitting:
        return None
    row, first, second = max(fitting, key=lambda split: _sum(*split[1:]))
    if not _sum(first, second) > log_likelihood + _DECISIVE:
        return None
    tool = inverse(first.gripper_T_camera) @ second.gripper_T_camera
    base = _moved_base(base_T_gripper, world_T_camera, row, first, second)
    tool_differs, base_differs = (_differs(offset, extent) for offset in (tool, base))
    if not (tool_differs or base_differs):
        return None
    offset = tool if tool_differs else base
    change: Literal["tool", "base", "tool and base"] = "tool and base"
    if tool_differs != base_differs:
        change = "tool" if tool_differs else "base"
    return Parts(
        row=row,
        change=change,
        rotation=float(rotation_angle(offset[:3, :3])),
        translation=float(np.linalg.norm(offset[:3, 3])),
    )


def _shifted(
    base_T_gripper: Array, world_T_camera: Array, extent: float, whole: Evidence
) -> Parts | None:
    """Parts whose tools differ in their position alone, where the rotations fit as they are.

    ``p + R (t_X + offset) = lambda R_Z c + t_Z`` is linear in all that is unknown, the rotations known.
    """
    if not whole.fits:
        return None
    scale = whole.metres_per_world_unit
    left = base_T_gripper @ whole.gripper_T_camera
    Z = average_base_T_world(left[whole.right], scaled(world_T_camera[whole.right], scale))
    places = world_T_camera[:, :3, 3] @ Z[:3, :3].T * scale
    turns, positions = base_T_gripper[:, :3, :3], base_T_gripper[:, :3, 3]
    rest = np.broadcast_to(np.eye(3), turns.shape)
    columns = np.concatenate([turns, -places[:, :, None], -rest], axis=2)
    used = whole.right
    one, _ = _fitted(columns, positions, used)
    best = (one, 0, np.zeros(3))
    for row in range(_FEWEST_SHIFTED, len(turns) - _FEWEST_SHIFTED + 1):
        later = np.arange(len(turns)) >= row
        if min(np.count_nonzero(used & later), np.count_nonzero(used & ~later)) < _FEWEST_SHIFTED:
            continue
        stepped = np.concatenate([columns, turns * later[:, None, None]], axis=2)
        likelihood, solution = _fitted(stepped, positions, used)
        best = max(best, (likelihood, row, solution[7:]), key=lambda each: each[0])
    likelihood, row, offset = best
    distance = float(np.linalg.norm(offset))
    if likelihood < one + _DECISIVE or distance < _SAME_POSITION * extent:
        return None
    return Parts(row=row, change="tool", rotation=0.0, translation=distance)


def _fitted(columns: Array, positions: Array, used: NDArray[np.bool_]) -> tuple[float, Array]:
    """Restricted log-likelihood, and the solution of ``columns x = -positions``, of some rows."""
    matrix, right = columns[used].reshape(-1, columns.shape[2]), -positions[used].reshape(-1)
    solution, *_ = np.linalg.lstsq(matrix, right)
    squares = float(np.sum((matrix @ solution - right) ** 2))
    freedom = max(len(right) - matrix.shape[1], 1)
    sigma = math.sqrt(squares / freedom)
    return -freedom * (math.log(max(sigma, 1e-12)) + _ENTROPY), np.asarray(solution, dtype=float)


def _likely(base_T_gripper: Array, world_T_camera: Array) -> list[int]:
    """The rows where a second part may start: within the parts robot and camera turn by the same angles."""
    n = len(base_T_gripper)
    i, j = np.triu_indices(n, k=1)
    robot, camera = (
        rotation_angle(np.swapaxes(poses[i, :3, :3], 1, 2) @ poses[j, :3, :3])
        for poses in (base_T_gripper, world_T_camera)
    )
    agree = np.abs(robot - camera) < _SAME_ROTATION
    shares = {
        row: float(agree[(i >= row) == (j >= row)].mean())
        for row in range(_FEWEST, n - _FEWEST + 1)
    }
    rows = [row for row, share in shares.items() if share > _FITS_ROWS**2]
    return sorted(rows, key=lambda row: -shares[row])[:_MOST]


def _share(evidence: Evidence) -> float:
    """Part of the rows that are right, of a fit."""
    return float(evidence.right.mean()) if evidence.fits else 0.0


def _sum(first: Evidence, second: Evidence) -> float:
    return first.log_likelihood + second.log_likelihood


def _moved_base(
    base_T_gripper: Array, world_T_camera: Array, row: int, first: Evidence, second: Evidence
) -> Array:
    """How the second part's base moves the camera's places, about their centre, (4, 4) in metres."""
    worlds = [
        average_base_T_world(
            base_T_gripper[part] @ one.gripper_T_camera,
            scaled(world_T_camera[part], one.metres_per_world_unit),
        )
        for part, one in ((slice(None, row), first), (slice(row, None), second))
    ]
    centre = np.append(world_T_camera[:, :3, 3].mean(axis=0), 1.0)
    places = [
        Z @ (centre * [*[one.metres_per_world_unit] * 3, 1.0])
        for Z, one in zip(worlds, (first, second), strict=True)
    ]
    moved = inverse(worlds[0]) @ worlds[1]
    moved[:3, 3] = (places[1] - places[0])[:3]
    return np.asarray(moved)


def _differs(offset: Array, extent: float) -> bool:
    """Whether an offset is more than noise."""
    return bool(
        rotation_angle(offset[:3, :3]) > _SAME_ROTATION
        or np.linalg.norm(offset[:3, 3]) > _SAME_POSITION * extent
    )
