"""The parts of ``result.json`` that tell what the intrinsics do to X; degrees and millimetres there."""

import math
from collections.abc import Sequence
from typing import Literal, cast

from handeye_fg.findings import FocalOffset, OtherIntrinsics
from handeye_fg.io.fields import Fields

_KINDS = ("free", "fixed")


def other_document(
    other: OtherIntrinsics | None,
    std_rotation_deg: Sequence[float | None],
    std_translation_mm: Sequence[float | None],
) -> dict[str, object] | None:
    """X with the other choice of intrinsics, with its standard deviations by axis."""
    if other is None:
        return None
    return {
        "kind": other.kind,
        "matrix": other.gripper_T_camera.tolist(),
        "covariance": other.covariance.tolist(),
        "std_rotation_deg": list(std_rotation_deg),
        "std_translation_mm": list(std_translation_mm),
        "shift_rotation_deg": math.degrees(other.shift_rotation),
        "shift_translation_mm": 1e3 * float(other.shift_translation),
        "shift_sigma": float(other.shift_sigma),
    }


def offset_document(offset: FocalOffset | None) -> dict[str, object] | None:
    """How focal length and the position along the optical axis are tied."""
    if offset is None:
        return None
    return {
        "correlation": float(offset.correlation),
        "std_factor": float(offset.std_factor),
        "mm_per_percent": 1e3 * float(offset.metres_per_percent),
        "confounded": bool(offset.confounded),
    }


def read_other(fields: Fields | None) -> OtherIntrinsics | None:
    """What ``other_document`` wrote."""
    if fields is None:
        return None
    return OtherIntrinsics(
        kind=cast("Literal['free', 'fixed']", fields.text("kind", _KINDS)),
        gripper_T_camera=fields.array("matrix", (4, 4)),
        covariance=fields.array("covariance", (6, 6)),
        shift_rotation=math.radians(fields.number("shift_rotation_deg")),
        shift_translation=fields.number("shift_translation_mm") / 1e3,
        shift_sigma=fields.number("shift_sigma"),
    )


def read_offset(fields: Fields | None) -> FocalOffset | None:
    """What ``offset_document`` wrote."""
    if fields is None:
        return None
    return FocalOffset(
        correlation=fields.number("correlation"),
        std_factor=fields.number("std_factor"),
        metres_per_percent=fields.number("mm_per_percent") / 1e3,
        confounded=fields.flag("confounded"),
    )
