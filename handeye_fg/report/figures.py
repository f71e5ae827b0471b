"""Figures of the report: inline SVG that follows the page's colours, light or dark."""

import io
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from markupsafe import Markup, escape
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from handeye_fg import frames
from handeye_fg.io.camera_results import std_rotation_deg, std_translation_mm
from handeye_fg.io.results import ImageReport, Result
from handeye_fg.report import wording

# Stand-ins that matplotlib draws with and the page replaces by its own colours.
_INK, _MUTED, _GRID = "#010101", "#020202", "#030303"
_FIRST, _SECOND, _BAD = "#040404", "#050505", "#060606"
_VARIABLES = {
    _INK: "var(--ink)",
    _MUTED: "var(--muted)",
    _GRID: "var(--line)",
    _FIRST: "var(--first)",
    _SECOND: "var(--second)",
    _BAD: "var(--bad)",
}
# Any: the keys' type is a literal of all settings.
_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "handeye-fg",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "text.color": _INK,
    "text.parse_math": False,
    "text.usetex": False,
    "axes.edgecolor": _MUTED,
    "axes.labelcolor": _INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": _GRID,
    "grid.linewidth": 0.6,
    "xtick.color": _MUTED,
    "ytick.color": _MUTED,
    "xtick.labelcolor": _INK,
    "ytick.labelcolor": _INK,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
}
_MOST_NAMES = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """A figure ready for the page.

    Attributes:
        title: its heading.
        caption: what it shows and how to read it.
        svg: the drawing, safe markup.
        small: whether it needs less than the width of the page.
    """

    title: str
    caption: str
    svg: Markup
    small: bool


def drawings(result: Result) -> tuple[Drawing, ...]:
    """All figures that the result has data for."""
    placed = tuple(image for image in result.images if image.base_T_camera is not None)
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        # A name in a script that the measuring font lacks is still drawn by the browser's font.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        candidates = (
            _residuals(result),
            _centres(result, placed),
            _reprojection(placed),
            _influence(result),
            _correlations(result),
        )
    return tuple(drawing for drawing in candidates if drawing is not None)


def _residuals(result: Result) -> Drawing | None:
    shown = [image for image in result.images if image.residual_translation is not None]
    if not shown:
        return None
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    millimetres = [1000.0 * (image.residual_translation or 0.0) for image in shown]
    degrees = [np.degrees(image.residual_rotation or 0.0) for image in shown]
    _bars(upper, shown, millimetres, "position, mm")
    _bars(lower, shown, degrees, "orientation, deg")
    _name_axis(lower, shown)
    worst = int(np.argmax(millimetres))
    if result.sfm is not None:
        title = "Reported against refined robot pose"
        what = "each robot pose as reported and as refined"
    else:
        title = "Robot against camera"
        what = "where robot and camera put the camera, in each row"
    return _drawing(
        figure,
        "residuals",
        title=title,
        caption=f"Distance and angle between {what}. "
        f"Largest distance: {wording.number(millimetres[worst])} mm at "
        f"{wording.printable(shown[worst].name)}. Rejected poses are hatched; a bar that is cut off has its value above it.",
    )


def _reprojection(images: Sequence[ImageReport]) -> Drawing | None:
    shown = [image for image in images if image.reprojection_rms is not None]
    if not shown:
        return None
    figure = Figure(figsize=(7.2, 2.8), layout="constrained")
    axes = figure.subplots()
    values = [image.reprojection_rms or 0.0 for image in shown]
    _bars(axes, shown, values, "rms, px")
    _name_axis(axes, shown)
    worst = int(np.argmax(values))
    return _drawing(
        figure,
        "reprojection",
        title="Reprojection error by image",
        caption="Root mean square distance between seen and predicted points. "
        f"Largest: {wording.number(values[worst])} px at {wording.printable(shown[worst].name)}.",
    )


def _influence(result: Result) -> Drawing | None:
    """Of the most influential poses, the largest first."""
    shown = [image for image in result.images if image.influence_translation is not None]
    if not shown:
        return None
    shown = sorted(shown, key=lambda image: image.influence_translation or 0.0, reverse=True)
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    names = shown[:_MOST_NAMES]
    millimetres = [1000.0 * (image.influence_translation or 0.0) for image in names]
    degrees = [np.degrees(image.influence_rotation or 0.0) for image in names]
    _bars(upper, names, millimetres, "position, mm")
    _bars(lower, names, degrees, "orientation, deg")
    _name_axis(lower, names)
    return _drawing(
        figure,
        "influence",
        title="Influence of each robot pose on X",
        caption="How far X would move without the pose, the most influential first. Largest: "
        f"{wording.number(millimetres[0])} mm at {wording.printable(names[0].name)}. Where one pose "
        "moves X by far more than the others do, X rests on it: take more images like it.",
    )


def _centres(result: Result, images: Sequence[ImageReport]) -> Drawing | None:
    if not images or result.setup != "eye-in-hand":
        return None
    base_T_camera = np.array([image.base_T_camera for image in images])
    base_T_gripper = base_T_camera @ frames.inverse(result.matrix)
    cameras, grippers = base_T_camera[:, :3, 3], base_T_gripper[:, :3, 3]
    extent = float(np.ptp(np.concatenate([cameras, grippers]), axis=0).max())
    ends = cameras + 0.12 * extent * base_T_camera[:, :3, 2]

    figure = Figure(figsize=(7.2, 5.4), layout="constrained")
    # Any: the 3D axes of matplotlib are found by a name, their type is not in its stubs.
    axes: Any = figure.add_subplot(projection="3d")
    for camera, gripper, end in zip(cameras, grippers, ends, strict=True):
        axes.plot(*np.transpose([gripper, camera]), color=_MUTED, linewidth=0.8)
        axes.plot(*np.transpose([camera, end]), color=_SECOND, linewidth=1.6)
    axes.scatter(*grippers.T, color=_FIRST, marker="s", s=14, depthshade=False, label="gripper")
    axes.scatter(*cameras.T, color=_SECOND, marker="o", s=16, depthshade=False, label="camera")
    for axis, label in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_pane_color((0.0, 0.0, 0.0, 0.0))
        axis.line.set_color(_MUTED)
        axis.set_label_text(f"{label}, m")
        axis.set_major_locator(MaxNLocator(5))
    axes.set_aspect("equal")
    axes.legend(loc="upper left")
    return _drawing(
        figure,
        "centres",
        title="Where the camera was",
        caption="Positions in the base frame: gripper (squares), camera (discs), the "
        "viewing direction as a short stroke. Motions about several axes determine X well.",
    )


def _correlations(result: Result) -> Drawing | None:
    if result.covariance is None:
        return None
    sigmas = np.sqrt(np.maximum(np.diag(result.covariance), 0.0))
    stds = (*std_rotation_deg(result), *std_translation_mm(result))
    known = np.array([std is not None and std > 0.0 for std in stds])
    divisor = np.where(known, sigmas, 1.0)
    correlations = result.covariance / np.outer(divisor, divisor)
    labels = ["rot x", "rot y", "rot z", "tra x", "tra y", "tra z"]
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    axes = figure.subplots()
    for i in range(6):
        for j in range(6):
            if not (known[i] and known[j]):
                text = wording.MISSING
            else:
                value = float(np.clip(correlations[i, j], -1.0, 1.0))
                text = wording.number(value, 2)
                axes.add_patch(
                    Rectangle(
                        (j - 0.48, i - 0.48),
                        0.96,
                        0.96,
                        facecolor=_FIRST if value > 0 else _SECOND,
                        # Never so full that the figure in the cell is hard to read.
                        alpha=0.45 * abs(value),
                        linewidth=0,
                    )
                )
            axes.text(j, i, text, ha="center", va="center")
    axes.set_xlim(-0.5, 5.5)
    axes.set_ylim(5.5, -0.5)
    axes.set_xticks(range(6), labels)
    axes.set_yticks(range(6), labels)
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.set_aspect("equal")
    for spine in axes.spines.values():
        spine.set_visible(False)
    return _drawing(
        figure,
        "correlation",
        title="Correlation of the components of X",
        caption="Rotation, then translation, along the camera's axes. Values near 1 or -1: the "
        "motions do not tell the two apart well.",
    )


def _bars(axes: Any, images: Sequence[ImageReport], values: Sequence[float], label: str) -> None:
    bars = axes.bar(range(len(values)), values, color=_FIRST, width=0.7)
    for bar, image in zip(bars, images, strict=True):
        if image.outlier:
            bar.set(facecolor="none", edgecolor=_BAD, hatch="////", linewidth=0.8)
    kept = [value for value, image in zip(values, images, strict=True) if not image.outlier]
    limit = 1.6 * max(kept, default=0.0)
    if 0.0 < limit < max(values):
        # Else one bad pose makes all others invisible.
        axes.set_ylim(0.0, limit)
        for i, value in enumerate(values):
            if value > limit:
                axes.text(
                    i, limit, wording.significant(value), ha="center", va="bottom", color=_BAD
                )
    axes.set_ylabel(label)
    axes.grid(visible=False, axis="x")
    axes.margins(x=0.01)


def _name_axis(axes: Any, images: Sequence[ImageReport]) -> None:
    """Names under the bars; where they are too many, only every k-th."""
    step = -(-len(images) // _MOST_NAMES)
    ticks = range(0, len(images), step)
    names = [wording.shortened(wording.printable(images[i].name)) for i in ticks]
    axes.set_xticks(ticks, names, rotation=90, fontsize=7)


def _drawing(figure: Figure, identifier: str, *, title: str, caption: str) -> Drawing:
    """Render a figure and make it part of a page: its colours, its own ids, a description."""
    buffer = io.BytesIO()
    metadata = {"Creator": None, "Date": None, "Format": None, "Type": None}
    figure.savefig(buffer, format="svg", metadata=metadata)
    text = buffer.getvalue().decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
    for stand_in, variable in _VARIABLES.items():
        text = text.replace(stand_in, variable)
    # Ids are unique in a page, not only in a figure.
    text = re.sub(r'\bid="', f'id="{identifier}-', text)
    text = text.replace("url(#", f"url(#{identifier}-")
    text = re.sub(r'xlink:href="#', f'href="#{identifier}-', text)
    body = text.split(">", 1)[1]
    width, height = 72.0 * figure.get_size_inches()
    label = escape(f"{title}. {caption}")
    # matplotlib escapes the text it draws; the label is escaped here.
    svg = Markup(f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{label}">{body}')
    return Drawing(title=title, caption=caption, svg=svg, small=bool(width < 400.0))
