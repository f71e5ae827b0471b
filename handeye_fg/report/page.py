"""``report.html``: one file that needs no network; light and dark, on paper too."""

from importlib import resources
from pathlib import Path

from markupsafe import Markup

from handeye_fg.export_options import ExportOptions
from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.exports import export_text
from handeye_fg.io.files import write_atomic
from handeye_fg.io.results import Result
from handeye_fg.report import judgement, tables, wording
from handeye_fg.report.figures import drawings
from handeye_fg.report.filling import asset, fill
from handeye_fg.report.noise import levels, remarks
from handeye_fg.report.ties import none_tied, ties
from handeye_fg.report.view import view

REPORT_NAME = "report.html"
_LONGEST = 24  # letters of a version or a digest; result.json has all
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
    template = resources.files(__package__).joinpath("template.html").read_text(encoding="utf-8")
    return fill(template, **_content(result))


def _content(result: Result) -> dict[str, object]:
    """What the template shows, as text."""
    matrix, shown = result.matrix, view(result)
    return {
        "ok": result.status == "ok",
        "good": judgement.good_enough(result),
        "message": result.message,
        "verdict": judgement.verdict(result),
        "advice": judgement.advice(result),
        "limits": judgement.limits(result),
        "ties": ties(result),
        "none_tied": none_tied(result),
        "steps": judgement.next_steps(result),
        "name": wording.transform_name(result),
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
        "matrix": [wording.numbers(row, 7) for row in matrix],
        "translation": wording.numbers(matrix[:3, 3], 6),
        "quaternion": wording.numbers(quaternion_xyzw(matrix[:3, :3]), 6),
        "copies": _copies(result),
        "uncertainty": tables.uncertainty(result),
        "convention": wording.COVARIANCE_CONVENTION,
        "scale": wording.scale_text(result),
        "at_work": tables.at_work(result),
        "accuracy": tables.accuracy(result),
        "holdout": tables.holdout(result),
        "noise": levels(result),
        "noise_remarks": remarks(result),
        "noise_estimated": result.noise is not None and result.noise.estimated,
        "intrinsics": tables.intrinsics(result),
        "cameras": [tables.camera(camera) for camera in result.cameras],
        "start": tables.start(result),
        "second": wording.second_start(result),
        "sfm": result.sfm,
        "target": None if result.target is None else wording.target_text(result.target),
        "extent": wording.extent(result),
        "used": wording.used(result),
        "rejected": wording.rejected(result),
        "read_as": [(whose, str(one)) for whose, one in result.poses_read_as.items()],
        "images": tables.images(result),
        "kept_out": len(wording.kept_out(result)),
        "figures": {drawing.name: drawing for drawing in drawings(result)},
        "view": shown,
        "scripts": _scripts(shown),
        "base_T_world": tables.rows(result.base_T_world, ".7f"),
        "observability": tables.pairs(result.observability),
        "timing": tables.pairs(result.timing_s, 1),
        "provenance": [
            (key, wording.shortened(str(value), _LONGEST))
            for key, value in sorted(result.provenance.items())
        ],
    }


def _scripts(shown: object) -> list[Markup]:
    """What the page runs: its own script, and the library that draws the 3D view where there is one."""
    library = ["plotly-gl3d.min.js"] if shown is not None else []
    return [asset(name) for name in (*library, "report.js")]


def _copies(result: Result) -> list[tuple[str, str]]:
    """X in the forms that people paste, each under its name."""
    forms = [("Matrix (Python)", _python_text(result.matrix))]
    first = ExportOptions(camera=result.cameras[0].name if result.cameras else "")
    return forms + [(title, export_text(result, form, first)) for form, title in _COPIED.items()]


def _python_text(matrix: Array) -> str:
    """The matrix with all digits, as Python reads it."""
    rows = ["[" + ", ".join(repr(float(value)) for value in row) + "]" for row in matrix]
    return "[" + ",\n ".join(rows) + "]"
