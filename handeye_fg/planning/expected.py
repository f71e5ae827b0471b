"""How certain X is going to be; entry points ``of_model``, ``of_result`` and ``corrected``."""

import itertools
import math
from dataclasses import dataclass

from handeye_fg.findings import FreeDirection
from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Stds, Uncertain, std_rotation_deg, std_translation_mm
from handeye_fg.observability import Observability


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Expected:
    """How certain X is, or is going to be.

    Attributes:
        std_rotation_deg, std_translation_mm: standard deviations about and along the camera's axes; None
            where free.
        free_directions: what is not determined.
    """

    std_rotation_deg: Stds
    std_translation_mm: Stds
    free_directions: tuple[FreeDirection, ...]

    @property
    def worst(self) -> tuple[float | None, float | None]:
        """The largest standard deviations, degrees and millimetres; None where one is free."""
        return _largest(self.std_rotation_deg), _largest(self.std_translation_mm)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pose:
    """X with its uncertainty."""

    matrix: Array
    covariance: Array | None
    free_directions: tuple[FreeDirection, ...]


def _told(x: Uncertain) -> Expected:
    return Expected(
        std_rotation_deg=std_rotation_deg(x),
        std_translation_mm=std_translation_mm(x),
        free_directions=x.free_directions,
    )


def of_model(X: Array, found: Observability) -> Expected:
    """As a linearised problem at X (4, 4) has it."""
    return _told(
        _Pose(matrix=X, covariance=found.covariance, free_directions=found.free_directions)
    )


def of_result(result: Uncertain) -> Expected:
    """As a calibration reports it, of its X or of a camera's."""
    return _told(result)


def corrected(reported: Expected, now: Expected, later: Expected, *, white: bool) -> Expected:
    """What the model expects, by as much better or worse as the result is than what it expects now.

    Where the arm's errors are not white, what they add to the model's variances is taken to stay: part of
    it shows in no residual, whatever the number of images.
    """

    def one(found: float | None, before: float | None, after: float | None) -> float | None:
        if found is None or before is None or after is None or before == 0.0:
            return after
        if white:
            return after * found / before
        return math.sqrt(after**2 + max(found**2 - before**2, 0.0))

    def all_(name: str) -> Stds:
        return tuple(
            itertools.starmap(
                one, zip(*(getattr(x, name) for x in (reported, now, later)), strict=True)
            )
        )

    return Expected(
        std_rotation_deg=all_("std_rotation_deg"),
        std_translation_mm=all_("std_translation_mm"),
        free_directions=later.free_directions,
    )


def _largest(stds: Stds) -> float | None:
    known = [std for std in stds if std is not None]
    return max(known) if len(known) == len(stds) else None
