"""The tables of the page: figures of a result as text, grouped as the page shows them."""

import math
from collections.abc import Mapping

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.camera_results import (
    CameraReport,
    Stds,
    relative_std_rotation_deg,
    relative_std_translation_mm,
    std_rotation_deg,
    std_translation_mm,
)
from handeye_fg.io.holdout import HoldoutReport
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.report import wording

Table = dict[str, object]
# Two-sided 95 % point of the normal distribution.
_NORMAL_95 = 1.959964


def uncertainty(result: Result) -> Table:
    """Standard deviations and 95 % intervals of X along the camera's axes."""
    std_rotation, std_translation = std_rotation_deg(result), std_translation_mm(result)
    half_rotation, half_translation = _half_widths(result, std_rotation, std_translation)
    return {
        "rows": [
            ("rotation, std (deg)", wording.numbers(std_rotation, 4)),
            ("rotation, 95 % (deg)", _interval(half_rotation, 4)),
            ("position, std (mm)", wording.numbers(std_translation, 3)),
            ("position, 95 % (mm)", _interval(half_translation, 3)),
        ],
        "rotation": _largest(std_rotation, half_rotation, 4, "deg"),
        "translation": _largest(std_translation, half_translation, 3, "mm"),
        "covered": wording.covered(result),
        "covariance": rows(result.covariance, ".3e"),
    }


def _half_widths(
    result: Result,
    std_rotation: tuple[float | None, ...],
    std_translation: tuple[float | None, ...],
) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
    """Half widths of the 95 % intervals: degrees and millimetres."""
    if result.certainty is None:
        normal = [
            tuple(None if std is None else _NORMAL_95 * std for std in stds)
            for stds in (std_rotation, std_translation)
        ]
        return normal[0], normal[1]
    half = result.certainty.half_widths
    rotation = tuple(float(v) if math.isfinite(v) else None for v in np.rad2deg(half[:3]))
    return rotation, tuple(float(v) if math.isfinite(v) else None for v in 1e3 * half[3:6])


def _interval(half_widths: tuple[float | None, ...], digits: int) -> tuple[str, ...]:
    return tuple(
        wording.MISSING if half is None else f"± {wording.number(half, digits)}"
        for half in half_widths
    )


def _largest(sigmas: Stds, half_widths: Stds, digits: int, unit: str) -> tuple[str, str] | None:
    """The largest standard deviation of the determined components, and interval; None without any."""
    known = [sigma for sigma in sigmas if sigma is not None]
    half = [width for width in half_widths if width is not None]
    if not known or not half:
        return None
    return (
        f"{wording.number(max(known), digits)} {unit}",
        f"± {wording.number(max(half), digits)} {unit}",
    )


def at_work(result: Result) -> tuple[str, str] | None:
    """The error that X causes at the work, and where that is."""
    if result.accuracy is None:
        return None
    work = result.accuracy.at_work
    return (
        f"{wording.significant(1e3 * work.within_95, 2)} mm",
        f"{wording.significant(1e3 * work.distance)} mm from the camera",
    )


def accuracy(result: Result) -> list[Table]:
    """The error that X causes at the tool and over the distance."""
    found = result.accuracy
    if found is None:
        return []
    places = [(f"the {parent_frame(result.setup)}'s origin", found.tool)]
    places += [("the work" if error is found.at_work else "", error) for error in found.along_axis]
    return [
        {
            "place": place,
            "distance": wording.number(1e3 * error.distance, 0),
            "std": wording.numbers(1e3 * np.sqrt(np.diag(error.covariance))),
            "within": wording.number(1e3 * error.within_95),
            "work": error is found.at_work,
        }
        for place, error in places
    ]


def holdout(result: Result) -> Table | None:
    """How X predicts what it has not seen, beside what is to be expected."""
    found = result.holdout
    if found is None:
        return None
    return {
        "rows": holdout_rows(found),
        "images": [
            (
                one.name,
                (
                    wording.number(math.degrees(one.rotation), 4),
                    wording.number(1e3 * one.translation),
                    wording.number(one.reprojection_rms, 2),
                    wording.number(one.expected_reprojection, 2),
                ),
            )
            for one in found.images
        ],
        "sentence": wording.holdout_text(found),
        "translation": f"{wording.significant(1e3 * found.translation, 2)} mm",
        "expected": f"{wording.significant(1e3 * found.expected_translation, 2)} mm expected",
    }


def holdout_rows(found: HoldoutReport) -> list[tuple[str, str, str]]:
    """Errors of all held-out poses together, beside those that are to be expected."""
    kinds = (
        ("orientation (deg)", math.degrees(found.rotation), math.degrees(found.expected_rotation)),
        ("position (mm)", 1e3 * found.translation, 1e3 * found.expected_translation),
        ("points in the image (px)", found.reprojection_rms, found.expected_reprojection),
    )
    return [
        (what, wording.significant(error, 2), wording.significant(expected, 2))
        for what, error, expected in kinds
    ]


def intrinsics(result: Result) -> Table | None:
    """Parameters of the camera."""
    model, stds = result.camera, result.intrinsics_std
    if model is None or stds is None:
        return None
    return {
        "model": model.model,
        "width": model.width,
        "height": model.height,
        "refined": result.intrinsics_refined,
        "note": result.intrinsics_note,
        "other": wording.other_intrinsics_text(result),
        "rows": [
            (
                name,
                wording.number(float(value), 6),
                wording.significant(float(std), 2) if std > 0.0 else "fixed",
            )
            for name, value, std in zip(
                wording.parameter_names(model.model, len(model.params)),
                model.params,
                stds,
                strict=True,
            )
        ],
    }


def start(result: Result) -> Table:
    """The linear start in the same words as the final answer."""
    initial, final = result.initial, result.matrix
    first = initial.gripper_T_camera
    difference = frames.inverse(first) @ final
    return {
        "method": initial.method,
        "translation": _side_by_side(first[:3, 3], final[:3, 3], 6),
        "quaternion": _side_by_side(
            quaternion_xyzw(first[:3, :3]), quaternion_xyzw(final[:3, :3]), 6
        ),
        "scale": (
            wording.significant(initial.metres_per_world_unit, 7),
            wording.significant(result.metres_per_world_unit, 7),
        ),
        "residual": wording.residual_text(result),
        "moved_rotation": wording.number(
            math.degrees(float(frames.rotation_angle(difference[:3, :3]))), 3
        ),
        "moved_translation": wording.number(
            1000.0 * float(np.linalg.norm(final[:3, 3] - first[:3, 3])), 2
        ),
    }


def _side_by_side(first: Array, final: Array, digits: int) -> tuple[str, str]:
    return "  ".join(wording.numbers(first, digits)), "  ".join(wording.numbers(final, digits))


def camera(report: CameraReport) -> Table:
    """One of several cameras."""
    numbers = ", ".join(wording.numbers(report.camera.params, 4))
    return {
        "name": report.name,
        "own": _pose_row(
            report.name, report.matrix, std_rotation_deg(report), std_translation_mm(report)
        ),
        "relative": _pose_row(
            report.name,
            report.first_T_camera,
            relative_std_rotation_deg(report),
            relative_std_translation_mm(report),
        ),
        "intrinsics": f"image observations ± {wording.significant(report.pixel)} px per axis; "
        f"{report.camera.model} {numbers}. {report.intrinsics_note} {wording.other_intrinsics_text(report)}",
    }


def _pose_row(name: str, matrix: Array, rotation: Stds, translation: Stds) -> dict[str, str]:
    return {
        "name": name,
        "translation": ", ".join(wording.numbers(matrix[:3, 3], 6)),
        "quaternion": ", ".join(wording.numbers(quaternion_xyzw(matrix[:3, :3]), 6)),
        "std_rotation": ", ".join(wording.numbers(rotation, 4)),
        "std_translation": ", ".join(wording.numbers(translation, 3)),
    }


def images(result: Result) -> list[Table]:
    """All images, in the order of the input."""
    held = wording.kept_out(result)
    return [_image_row(image, held_out=image.name in held) for image in result.images]


def _image_row(image: ImageReport, *, held_out: bool) -> Table:
    """One image, with a word on what became of it."""
    return {
        "name": image.name,
        "verdict": wording.became(image, held_out=held_out),
        "bad": image.outlier or not (image.registered or held_out),
        "rotation": _in_degrees(image.residual_rotation, 3),
        "translation": _in_millimetres(image.residual_translation),
        "reprojection": wording.number(image.reprojection_rms),
        "w_test": wording.number(image.w_test, 1),
        "influence_rotation": _in_degrees(image.influence_rotation),
        "influence_translation": _in_millimetres(image.influence_translation),
        "growth": wording.number(None if image.std_growth is None else 100.0 * image.std_growth, 1),
        "reason": image.reason,
    }


def _in_degrees(radians: float | None, digits: int = 4) -> str:
    return wording.number(None if radians is None else math.degrees(radians), digits)


def _in_millimetres(metres: float | None) -> str:
    return wording.number(None if metres is None else 1000.0 * metres)


def pairs(values: Mapping[str, float], digits: int | None = None) -> list[tuple[str, str]]:
    """Named numbers."""
    return [
        (
            key.replace("_", " "),
            wording.significant(value, 4) if digits is None else wording.number(value, digits),
        )
        for key, value in values.items()
    ]


def rows(matrix: Array | None, form: str) -> list[list[str]] | None:
    """A matrix as text."""
    return None if matrix is None else [[f"{value:{form}}" for value in row] for row in matrix]
