"""Whether poses are as they are said to be, held against the camera's; entry point ``judge``."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handeye_fg.conventions.evidence import Evidence, evidence_of, extent_of
from handeye_fg.conventions.parts import Parts, parts_of
from handeye_fg.conventions.reading import Reading
from handeye_fg.conventions.readings import converted, readings
from handeye_fg.conventions.screening import likely
from handeye_fg.conventions.sizes import Sizes, unit_of
from handeye_fg.conventions.whole_poses import UNITS
from handeye_fg.frames import Array, inverse
from handeye_fg.types import Indices, RobotPoses, Setup

Kind = Literal["right", "wrong", "undecided", "contradiction"]

# A reading is preferred to another if it is as many times (natural logarithm) more likely. Among
# hundreds of readings, with errors that are not quite normal, less is chance.
_DECISIVE = 20.0
# So good a fit needs no comparison: radians, part of the extent, part of the rows, rows.
_PLAIN_ROTATION, _PLAIN_TRANSLATION, _PLAIN_ROWS = math.radians(2.0), 0.02, 0.8
_PLAIN_POSES = 8
# Readings up to this rank are tried even if one fits beyond doubt.
_USUAL = 1.0
# An X shorter than this (metres) is on a gripper, one longer is beside a base.
_ON_GRIPPER, _BESIDE_BASE = 0.3, 0.4
# A gripper that moves by less than this part of the extent rests.
_RESTS = 0.02
# A reading that is preferred by so much (natural logarithm) makes the poses as given doubtful.
_DOUBTFUL = 6.0
# Rows in a row that are wrong and may have another tool.
_BLOCK = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """A reading and what speaks for it."""

    reading: Reading
    evidence: Evidence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """What poses are.

    Attributes:
        kind: "right": as given. "wrong": otherwise, see ``best``. "undecided": robot and camera agree, but the
            motions do not tell some readings from others, see ``alike``. "contradiction": no
            reading fits.
        given: the poses as given.
        best: the reading that the data prefer, of those that fit alike the least far-fetched.
        alike: the others that fit alike.
        unit: of the positions under the best reading, as ``sizes`` names it; "" for metres.
        parts: rows that agree among themselves but not with the others; None without such.
        tried: all readings that were held against the camera, best first.
        n_readings: how many were considered.
        setup: how the camera is said to be mounted.
    """

    kind: Kind
    given: Judged
    best: Judged
    alike: tuple[Judged, ...]
    unit: str
    parts: Parts | None
    tried: tuple[Judged, ...]
    n_readings: int
    setup: Setup

    @property
    def convention(self) -> str:
        """The conversion that makes the poses right, as for ``--convention``; "" for none."""
        name = "" if self.best is self.given else self.best.reading.name
        return ",".join(filter(None, (name, self.unit)))

    @property
    def fixable(self) -> bool:
        """Whether the data alone say how to convert the poses."""
        return (
            self.kind == "wrong"
            and self.parts is None
            and self.best.reading.fixable
            and not self.alike
            and not (self.best.reading.name == "inverted" and not self._mounted_as_said)
        )

    def converted(self, poses: RobotPoses) -> RobotPoses:
        """The poses that were judged, as the best reading and unit have them."""
        taken = RobotPoses(names=poses.names, base_T_gripper=self.best.reading.convert(poses))
        return converted(taken, self.unit)

    @property
    def doubtful(self) -> bool:
        """Whether the poses may be right, but another reading is likelier by far.

        Never of turns about fewer than two axes: so many readings fit them that chance prefers one.
        """
        given = self.given.evidence
        ahead = self.tried[0].evidence.log_likelihood - given.log_likelihood
        return self.kind == "undecided" and given.several_axes and ahead > _DOUBTFUL

    @property
    def _mounted_as_said(self) -> bool:
        return self.mounted_on_gripper is (self.setup == "eye-in-hand")

    @property
    def mounted_on_gripper(self) -> bool | None:
        """Whether X is that of a camera on the gripper, by its length; None where this does not tell."""
        length = float(np.linalg.norm(self.best.evidence.gripper_T_camera[:3, 3]))
        length *= UNITS.get(self.unit, 1.0)
        if _ON_GRIPPER < length < _BESIDE_BASE:
            return None
        return length <= _ON_GRIPPER


def judge(
    poses: RobotPoses,
    rows: Indices,
    world_T_camera: Array,
    *,
    setup: Setup = "eye-in-hand",
    others: Sequence[Reading] = (),
    depth: float | None = None,
    scale_known: bool = False,
    sizes: bool = True,
    thorough: bool = False,
) -> Verdict:
    """Hold every reading of the poses against the camera's.

    Args:
        poses: base_T_gripper as read, whatever the setup, in the order of the file.
        rows: which of them (n,) the camera poses belong to.
        world_T_camera: camera poses (n, 4, 4), n of 3 or more, up to a similarity.
        setup: how the camera is said to be mounted.
        others: further readings, such as those of a file's numbers.
        depth: typical distance of the scene from the camera, world units.
        scale_known: whether the world unit is the metre.
        sizes: whether the sizes of usual arms and scenes tell the unit of the positions.
        thorough: try all readings, even where the poses as given fit beyond doubt.
    """

    def in_equations(reading: Reading) -> Array:
        taken = reading.convert(poses)[rows]
        return taken if setup == "eye-in-hand" else inverse(taken)

    def judged(reading: Reading) -> Judged:
        return Judged(
            reading=reading,
            evidence=evidence_of(in_equations(reading), world_T_camera, extent),
        )

    def verdict(
        kind: Kind,
        best: Judged,
        alike: Sequence[Judged] = (),
        tried: Sequence[Judged] = (),
        parts: Parts | None = None,
    ) -> Verdict:
        unit = ""
        if sizes or scale_known:
            unit = _unit(
                best.evidence, in_equations(best.reading), setup, depth, scale_known=scale_known
            )
        return Verdict(
            kind="wrong" if unit and kind in ("right", "undecided") else kind,
            given=given,
            best=best,
            alike=tuple(alike),
            unit=unit,
            parts=parts,
            tried=tuple(tried) or (given,),
            n_readings=len(all_readings),
            setup=setup,
        )

    first, *by_matrices = readings(poses)
    all_readings = (first, *others, *by_matrices)
    extent = extent_of(in_equations(first))
    given = judged(first)
    if not (_moves(in_equations(first)) and _moves(world_T_camera)):
        return verdict("undecided", given)
    if not thorough and _plain(given.evidence, extent):
        return verdict("right", given)
    tried = [given]
    for reading in _possible(all_readings, in_equations, world_T_camera):
        enough = not thorough and any(_plain(one.evidence, extent) for one in tried)
        if enough and reading.rank > _USUAL:
            break
        tried.append(judged(reading))
    tried.sort(key=lambda one: -one.evidence.log_likelihood)
    most = tried[0].evidence.log_likelihood
    # Of a reading that nobody claims more is asked.
    fitting = [
        one for one in tried if one.evidence.fits and (one is given or one.evidence.fits_well)
    ]
    near = [one for one in fitting if one.evidence.log_likelihood > most - _DECISIVE]
    near.sort(key=lambda one: one.reading.rank)
    best = near[0] if near else tried[0]
    parts = None
    if not near or not _plain(best.evidence, extent):
        parts = parts_of(in_equations(first), world_T_camera, extent, given.evidence, most)
    if parts is not None:
        return verdict("wrong", given, (), tried, parts)
    if not near:
        return verdict("contradiction", given, (), tried)
    if best is given:
        return verdict("undecided" if near[1:] else "right", given, near[1:], tried)
    return verdict("wrong", best, near[1:], tried)


def _possible(
    all_readings: Sequence[Reading],
    in_equations: Callable[[Reading], Array],
    world_T_camera: Array,
) -> list[Reading]:
    """The readings but the first that differ from it and from each other, and turn as the camera does."""
    distinct: dict[bytes, tuple[Reading, Array]] = {}
    for reading in sorted(all_readings, key=lambda one: one.rank):
        taken = in_equations(reading)
        distinct.setdefault(np.round(taken, 6).tobytes(), (reading, taken[:, :3, :3]))
    found = list(distinct.values())
    chosen = likely(
        [rotation for _, rotation in found],
        [reading.rank for reading, _ in found],
        world_T_camera[:, :3, :3],
    )
    return [found[k][0] for k in chosen if found[k][0] is not all_readings[0]]


def _moves(poses: Array) -> bool:
    """Whether poses (n, 4, 4) are not all the same."""
    return not np.allclose(poses, poses[0], rtol=0.0, atol=1e-9)


def _plain(evidence: Evidence, extent: float) -> bool:
    """Whether poses fit beyond doubt, with no block of wrong rows."""
    right = evidence.right
    return (
        evidence.fits
        and len(right) >= _PLAIN_POSES
        and evidence.several_axes
        and evidence.rotation < _PLAIN_ROTATION
        and evidence.translation < _PLAIN_TRANSLATION * extent
        and float(right.mean()) >= _PLAIN_ROWS
        and not _has_block(~right)
    )


def _has_block(wrong: NDArray[np.bool_]) -> bool:
    """Whether several rows in a row are wrong."""
    run = 0
    for each in wrong.tolist():
        run = run + 1 if each else 0
        if run >= _BLOCK:
            return True
    return False


def _unit(
    evidence: Evidence,
    base_T_gripper: Array,
    setup: Setup,
    depth: float | None,
    *,
    scale_known: bool,
) -> str:
    if not evidence.fits:
        return ""
    scale = evidence.metres_per_world_unit
    positions = (
        base_T_gripper[:, :3, 3] if setup == "eye-in-hand" else inverse(base_T_gripper)[:, :3, 3]
    )
    moved = math.sqrt(float(np.sum(np.var(positions, axis=0))))
    if not scale_known and moved < _RESTS * extent_of(base_T_gripper):
        return ""  # of a gripper that only turns no scale is known
    return unit_of(
        Sizes(
            extent=moved,
            offset=float(np.linalg.norm(evidence.gripper_T_camera[:3, 3])),
            depth=None if depth is None else scale * depth,
            scale=scale if scale_known else None,
        )
    )
