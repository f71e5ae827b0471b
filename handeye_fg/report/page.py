"""``report.html``: one file that needs no network; light and dark, on paper too."""

import math
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from handeye_fg import frames
from handeye_fg.export_options import ExportOptions
from handeye_fg.findings import LevelCertainty
from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.camera_results import (
    CameraReport,
    Stds,
    relative_std_rotation_deg,
    relative_std_translation_mm,
    std_rotation_deg,
    std_translation_mm,
)
from handeye_fg.io.exports import export_text
from handeye_fg.io.files import write_atomic
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.report import wording
from handeye_fg.report.figures import drawings
from handeye_fg.report.view import view

REPORT_NAME = "report.html"
# Two-sided 95 % point of the normal distribution.
_NORMAL_95 = 1.959964
_COPIED = {
    "ros2": "ROS 2 command",
    "ros1": "ROS 1 command",
    "urdf": "URDF joint",
    "easy-handeye2": "easy_handeye2",
    "json": "JSON",
}


def write_report(result: Result, folder: str | Path) -> Path:
    """Write ``report.html``.

    Args:
        result: what to report.
        folder: where; made if missing.

    Returns:
        The path of the page.

    Raises:
        InputDataError: the folder cannot be written.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from tempfile import TemporaryDirectory
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=10)
        >>> result = hf.solve(robot, camera)
        >>> with TemporaryDirectory() as folder:
        ...     hf.write_report(result, folder).name
        'report.html'
    """
    return write_atomic(Path(folder) / REPORT_NAME, render(result))


def render(result: Result) -> str:
    """``report.html`` as text; the same result gives the same text.

    Args:
        result: what to report.

    Returns:
        A page of HTML that needs no other file.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=10)
        >>> page = hf.render_report(hf.solve(robot, camera))
        >>> "p_gripper = gripper_T_camera p_camera" in page
        True
    """
    source = _asset("template.html")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["printable"] = wording.printable
    template = environment.from_string(source)
    page = template.render(_context(result))
    # A name may hold half a surrogate pair (a file name that is not UTF-8); the page is UTF-8.
    return page.encode("utf-8", "backslashreplace").decode("utf-8")


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def _scripts(shown: object) -> list[Markup]:
    """What the page runs: its own script, and the library that draws the 3D view where there is one."""
    library = ["assets/plotly-gl3d.min.js"] if shown is not None else []
    return [Markup(_asset(name)) for name in (*library, "assets/report.js")]  # files of the package


def _copies(result: Result) -> list[tuple[str, str]]:
    """X in the forms that people paste, each under its name."""
    forms = [("Matrix (Python)", _python_text(result.matrix))]
    first = ExportOptions(camera=result.cameras[0].name if result.cameras else "")
    return forms + [(title, export_text(result, form, first)) for form, title in _COPIED.items()]


def _context(result: Result) -> dict[str, object]:
    """What the template shows, as text."""
    std_rotation, std_translation = std_rotation_deg(result), std_translation_mm(result)
    half_rotation, half_translation = _half_widths(result, std_rotation, std_translation)
    matrix, shown = result.matrix, view(result)
    return {
        "ok": result.status == "ok",
        "message": result.message,
        "verdict": wording.verdict(result),
        "advice": wording.advice(result),
        "accuracy": _accuracy(result),
        "name": wording.transform_name(result),
        "parent": parent_frame(result.setup),
        "setup": result.setup,
        "meaning": wording.meaning(result),
        "direction": wording.direction(result),
        "free_directions": [
            {
                "kind": item.kind,
                "vector": ", ".join(wording.numbers(item.vector)) if item.vector.any() else "",
                "frame": item.frame,
                "description": item.description,
            }
            for item in result.free_directions
        ],
        "std_rotation": wording.numbers(std_rotation, 4),
        "std_translation": wording.numbers(std_translation, 3),
        "interval_rotation": _interval(half_rotation, 4),
        "interval_translation": _interval(half_translation, 3),
        "intervals": wording.intervals_text(result.certainty),
        "robot_errors": None if result.certainty is None else result.certainty.robot.reason,
        "worst_rotation": _largest(std_rotation, half_rotation, 4, "deg"),
        "worst_translation": _largest(std_translation, half_translation, 3, "mm"),
        "matrix": [wording.numbers(row, 7) for row in matrix],
        "translation": wording.numbers(matrix[:3, 3], 6),
        "quaternion": wording.numbers(quaternion_xyzw(matrix[:3, :3]), 7),
        "base_T_world": _rows(result.base_T_world, ".7f"),
        "convention": wording.COVARIANCE_CONVENTION,
        "covariance": _rows(result.covariance, ".3e"),
        "scale": wording.scale_text(result),
        "noise": _noise(result),
        "intrinsics": _intrinsics(result),
        "cameras": [_camera(camera) for camera in result.cameras],
        "start": _start(result),
        "second": wording.second_start(result),
        "sfm": result.sfm,
        "target": None if result.target is None else wording.target_text(result.target),
        "extent": wording.extent(result),
        "rejected": wording.rejected(result),
        "images": [_image(image) for image in result.images],
        "figures": drawings(result),
        "view": shown,
        "scripts": _scripts(shown),
        "copies": _copies(result),
        "observability": _pairs(result.observability),
        "timing": _pairs(result.timing_s, 1),
        "provenance": [
            *((f"{whose} poses read as", str(one)) for whose, one in result.poses_read_as.items()),
            *((key, str(value)) for key, value in sorted(result.provenance.items())),
        ],
    }


def _accuracy(result: Result) -> list[dict[str, object]]:
    """The error that X causes at the tool and over the distance."""
    found = result.accuracy
    if found is None:
        return []
    places = [(f"at the {parent_frame(result.setup)}'s origin", found.tool)]
    places += [("on the optical axis", error) for error in found.along_axis]
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


def _largest(
    sigmas: tuple[float | None, ...],
    half_widths: tuple[float | None, ...],
    digits: int,
    unit: str,
) -> str | None:
    """The largest standard deviation and interval of the determined components; None without any."""
    known = [sigma for sigma in sigmas if sigma is not None]
    half = [width for width in half_widths if width is not None]
    if not known or not half:
        return None
    std = wording.number(max(known), digits)
    return f"{std} {unit} (95 %: ± {wording.number(max(half), digits)} {unit})"


def _python_text(matrix: Array) -> str:
    """The matrix with all digits, as Python reads it."""
    rows = ["[" + ", ".join(repr(float(value)) for value in row) + "]" for row in matrix]
    return "[" + ",\n ".join(rows) + "]"


def _rows(matrix: Array | None, form: str) -> list[list[str]] | None:
    """A matrix as text."""
    return None if matrix is None else [[f"{value:{form}}" for value in row] for row in matrix]


def _noise(result: Result) -> dict[str, object] | None:
    noise = result.noise
    if noise is None:
        return None
    levels = {} if result.certainty is None else result.certainty.levels
    rows = [
        ("image observation", "pixel", 1.0, "px"),
        ("corner of the target", "corner", 1.0, "px"),
        ("reported robot orientation", "robot_rotation", math.degrees(1.0), "deg"),
        ("reported robot position", "robot_translation", 1000.0, "mm"),
    ]
    return {
        "estimated": noise.estimated,
        "inflation": wording.significant(noise.image_inflation),
        "alike": noise.image_inflation > 1.0,
        "rows": [
            (what, wording.significant(unit * sigma), name, *_level(levels.get(key), unit * sigma))
            for what, key, unit, name in rows
            if (sigma := getattr(noise, key)) is not None and math.isfinite(sigma)
        ],
    }


def _level(level: LevelCertainty | None, sigma: float) -> tuple[str, str]:
    """The 95 % interval of a noise level, and what it rests on."""
    if level is None:
        return "", ""
    if level.source == "user":
        return "", "given"
    ends = f"{wording.significant(level.low * sigma)} to {wording.significant(level.high * sigma)}"
    if level.source == "prior":
        return ends, "the data say next to nothing: a prior for usual arms decided"
    return ends, f"{wording.significant(level.degrees_of_freedom, 3)} degrees of freedom"


def _intrinsics(result: Result) -> dict[str, object] | None:
    camera, stds = result.camera, result.intrinsics_std
    if camera is None or stds is None:
        return None
    return {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
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
                wording.parameter_names(camera.model, len(camera.params)),
                camera.params,
                stds,
                strict=True,
            )
        ],
    }


def _start(result: Result) -> dict[str, object]:
    """The linear start in the same words as the final answer."""
    initial, final = result.initial, result.matrix
    start = initial.gripper_T_camera
    difference = frames.inverse(start) @ final
    return {
        "method": initial.method,
        "translation": _side_by_side(start[:3, 3], final[:3, 3], 6),
        "quaternion": _side_by_side(
            quaternion_xyzw(start[:3, :3]), quaternion_xyzw(final[:3, :3]), 6
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
            1000.0 * float(np.linalg.norm(final[:3, 3] - start[:3, 3])), 2
        ),
    }


def _side_by_side(start: Array, final: Array, digits: int) -> tuple[str, str]:
    return "  ".join(wording.numbers(start, digits)), "  ".join(wording.numbers(final, digits))


def _camera(camera: CameraReport) -> dict[str, object]:
    numbers = ", ".join(wording.numbers(camera.camera.params, 4))
    return {
        "name": camera.name,
        "own": _pose_row(
            camera.name, camera.matrix, std_rotation_deg(camera), std_translation_mm(camera)
        ),
        "relative": _pose_row(
            camera.name,
            camera.first_T_camera,
            relative_std_rotation_deg(camera),
            relative_std_translation_mm(camera),
        ),
        "intrinsics": f"image observations ± {wording.significant(camera.pixel)} px per axis; "
        f"{camera.camera.model} {numbers}. {camera.intrinsics_note}",
    }


def _pose_row(name: str, matrix: Array, rotation: Stds, translation: Stds) -> dict[str, str]:
    return {
        "name": name,
        "translation": ", ".join(wording.numbers(matrix[:3, 3], 6)),
        "quaternion": ", ".join(wording.numbers(quaternion_xyzw(matrix[:3, :3]), 6)),
        "std_rotation": ", ".join(wording.numbers(rotation, 4)),
        "std_translation": ", ".join(wording.numbers(translation, 3)),
    }


def _image(image: ImageReport) -> dict[str, object]:
    return {
        "name": image.name,
        "registered": image.registered,
        "rotation": _in_degrees(image.residual_rotation, 3),
        "translation": _in_millimetres(image.residual_translation),
        "reprojection": wording.number(image.reprojection_rms),
        "outlier": image.outlier,
        "w_test": wording.number(image.w_test, 1),
        "influence_rotation": _in_degrees(image.influence_rotation),
        "influence_translation": _in_millimetres(image.influence_translation),
        "reason": image.reason,
    }


def _in_degrees(radians: float | None, digits: int = 4) -> str:
    return wording.number(None if radians is None else math.degrees(radians), digits)


def _in_millimetres(metres: float | None) -> str:
    return wording.number(None if metres is None else 1000.0 * metres)


def _pairs(values: Mapping[str, float], digits: int | None = None) -> list[tuple[str, str]]:
    return [
        (
            key.replace("_", " "),
            wording.significant(value, 4) if digits is None else wording.number(value, digits),
        )
        for key, value in values.items()
    ]
