"""``summary.csv`` and ``summary.html`` of a batch."""

import csv
import io
import math
from importlib import resources
from pathlib import Path
from urllib.parse import quote

from handeye_fg.batching import sources
from handeye_fg.batching.rows import Batch, Figures, Row
from handeye_fg.comparison import Comparison, Difference
from handeye_fg.frames import quaternion_xyzw
from handeye_fg.io.files import write_atomic
from handeye_fg.report import wording
from handeye_fg.report.filling import fill

CSV_NAME, PAGE_NAME = "summary.csv", "summary.html"

_FIGURES = (
    *("n_images", "n_registered", "n_rejected", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"),
    *(f"std_rotation_{axis}_deg" for axis in "xyz"),
    *(f"std_translation_{axis}_mm" for axis in "xyz"),
    *("metres_per_world_unit", "pixel_px", "robot_rotation_deg", "robot_translation_mm"),
)
_DRIFT = (
    *("drift_rotation_deg", "drift_translation_mm", "drift_distance", "drift_directions"),
    *("drift_probability", "drifted"),
)
COLUMNS = ("name", "status", *_FIGURES, *_DRIFT, "kept", "seconds", "worker", "message")
"""Of ``summary.csv``; a cell is empty where there is no such figure."""


def write(batch: Batch, output: str) -> None:
    """Write both files.

    Args:
        batch: what to tell of.
        output: path or URL of the folder.

    Raises:
        InputDataError: they cannot be written.
    """
    for name, content in ((CSV_NAME, table(batch)), (PAGE_NAME, page(batch))):
        if sources.is_url(output):
            sources.write(f"{output.rstrip('/')}/{name}", content)
        else:
            write_atomic(Path(output) / name, content)


def records(batch: Batch) -> list[dict[str, object]]:
    """The columns of ``summary.csv`` for each data set, None where there is no such figure."""
    return [_record(row) for row in batch.rows]


def table(batch: Batch) -> str:
    """The text of ``summary.csv``."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    for record in records(batch):
        writer.writerow({key: _cell(value) for key, value in record.items()})
    return text.getvalue()


def page(batch: Batch) -> str:
    """The text of ``summary.html``: one file, no network, no scripts."""
    source = resources.files(__package__).joinpath("summary.html").read_text(encoding="utf-8")
    rows = [_shown(row) for row in batch.rows]
    return fill(
        source,
        rows=rows,
        attention=[row for row in rows if row["attention"]],
        counts=[
            (len([row for row in batch.rows if row.status == "ok"]), "calibrated"),
            (len(batch.partial), "partial"),
            (len([row for row in batch.rows if row.status == "failed"]), "failed"),
            (len(batch.drifted), "drifted"),
        ],
        good=not any((batch.failed, batch.partial, batch.drifted)),
        levels=sorted({row.drift.significance for row in batch.rows if row.drift is not None}),
    )


def _record(row: Row) -> dict[str, object]:
    figures: dict[str, object] = dict.fromkeys((*_FIGURES, *_DRIFT))
    if row.figures is not None:
        figures |= zip(_FIGURES, _values(row.figures), strict=True)
    if row.drift is not None:
        figures |= zip(_DRIFT, (*_drift_values(row.drift), row.drifted), strict=True)
    ends = {"kept": row.kept, "seconds": round(row.seconds, 3), "worker": row.worker}
    message = f"{row.message} {row.drift_problem}".strip()
    return {"name": row.name, "status": row.status, **figures, **ends, "message": message}


def _values(figures: Figures) -> tuple[object, ...]:
    noise = figures.noise
    levels: tuple[float | None, ...] = (None, None, None)
    if noise is not None:
        pixel = noise.pixel if math.isfinite(noise.pixel) else None
        levels = (pixel, math.degrees(noise.robot_rotation), 1e3 * noise.robot_translation)
    return (
        *(figures.n_images, figures.n_registered, figures.n_rejected),
        *figures.matrix[:3, 3].tolist(),
        *quaternion_xyzw(figures.matrix[:3, :3]).tolist(),
        *figures.std_rotation_deg,
        *figures.std_translation_mm,
        figures.metres_per_world_unit,
        *levels,
    )


def _drift_values(drift: Comparison) -> tuple[object, ...]:
    moved = _worst(drift)
    return (
        moved.rotation_deg,
        moved.translation_mm,
        moved.distance,
        moved.directions,
        drift.probability,
    )


def _worst(drift: Comparison) -> Difference:
    """The difference of the camera of which it is the least probable."""

    def probability(item: Difference) -> float:
        return 1.0 if item.probability is None else item.probability

    return min(drift.differences, key=probability)


def _cell(value: object) -> str:
    if value is None:
        return ""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _shown(row: Row) -> dict[str, object]:
    """A row of the page, as text."""
    figures = row.figures
    moved = None if row.drift is None else _worst(row.drift)
    return {
        "name": row.name,
        "link": None if figures is None else f"{quote(row.name)}/report.html",
        "status": row.status,
        "drifted": row.drifted,
        "attention": row.status != "ok" or row.drifted or row.drift_problem != "",
        "message": row.message,
        "drift_problem": row.drift_problem,
        "images": "" if figures is None else f"{figures.n_registered} of {figures.n_images}",
        "rotation": "" if figures is None else _largest(figures.std_rotation_deg, 4),
        "translation": "" if figures is None else _largest(figures.std_translation_mm, 3),
        "drift": None
        if moved is None or row.drift is None
        else {
            "message": row.drift.message,
            "rotation": wording.number(moved.rotation_deg, 3),
            "translation": wording.number(moved.translation_mm, 2),
            "distance": f"{wording.number(moved.distance, 1)} in {moved.directions}",
            "probability": wording.significant(row.drift.probability, 2),
        },
        "seconds": wording.number(row.seconds, 1),
        "kept": row.kept,
    }


def _largest(stds: tuple[float | None, ...], digits: int) -> str:
    known = [std for std in stds if std is not None]
    return wording.number(max(known), digits) if known else wording.MISSING
