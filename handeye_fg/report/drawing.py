"""How figures of the report are drawn: inline SVG in the page's colours, or files in those of paper."""

import io
import re
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import png  # type: ignore[import-untyped]  # it has no annotations
from markupsafe import Markup, escape
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex, to_rgb, to_rgba_array
from matplotlib.figure import Figure

from handeye_fg.io.image_results import ImageReport
from handeye_fg.report import wording

# Stand-ins that matplotlib draws with and that are replaced: in the page by its own colours, light or dark.
INK, MUTED, GRID = "#010101", "#020202", "#030303"
FIRST, SECOND, BAD = "#040404", "#050505", "#060606"
_NAMES = {INK: "ink", MUTED: "muted", GRID: "line", FIRST: "first", SECOND: "second", BAD: "bad"}
_ON_PAPER = {
    INK: "#1a2027",
    MUTED: "#55606c",
    GRID: "#d5dbe1",
    FIRST: "#1f5fa8",
    SECOND: "#b3541e",
    BAD: "#b3261e",
}
# Any: the keys' type is a literal of all settings.
_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "handeye-fg",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "text.color": INK,
    "text.parse_math": False,
    "text.usetex": False,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
}
MOST_NAMES = 36
WIDTH = 4.6  # inches of a figure: two stand side by side
_DPI = 200  # of figures in pixels


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """A figure ready for the page.

    Attributes:
        name: short and unique, fit for a file.
        title: its heading.
        caption: what it shows and how to read it.
        figure: the drawing, in stand-ins for colours.
    """

    name: str
    title: str
    caption: str
    figure: Figure

    @property
    def svg(self) -> Markup:
        """The drawing as safe markup, part of a page: its colours, its own ids, a description."""
        text = _svg(self.figure)
        text = text[text.index("<svg") :]
        text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL)
        for stand_in, variable in _NAMES.items():
            text = text.replace(stand_in, f"var(--{variable})")
        # Ids are unique in a page, not only in a figure.
        text = re.sub(r'\bid="', f'id="{self.name}-', text)
        text = text.replace("url(#", f"url(#{self.name}-")
        text = re.sub(r'xlink:href="#', f'href="#{self.name}-', text)
        body = text.split(">", 1)[1]
        width, height = 72.0 * self.figure.get_size_inches()
        label = escape(f"{self.title}. {self.caption}")
        # matplotlib escapes the text it draws; the label is escaped here.
        return Markup(
            f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{label}">{body}'
        )

    def content(self, form: str) -> bytes:
        """The drawing as a file, on white: "svg" or "png"."""
        text = _svg(self.figure)
        if form == "svg":
            for stand_in, colour in _ON_PAPER.items():
                text = text.replace(stand_in, colour)
            return text.encode("utf-8", "backslashreplace")
        return _png(self.figure)


@contextmanager
def style() -> Iterator[None]:
    """Settings that all figures are made with."""
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        # A name in a script that the measuring font lacks is still drawn by the browser's font.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        yield


def _svg(figure: Figure) -> str:
    buffer = io.BytesIO()
    metadata = {"Creator": None, "Date": None, "Format": None, "Type": None}
    with style():
        figure.savefig(buffer, format="svg", metadata=metadata)
    return buffer.getvalue().decode()


def _png(figure: Figure) -> bytes:
    """Pixels in which each stand-in, a shade of black, is its colour on paper."""
    for artist in figure.findobj():
        _recolour(artist)
    figure.set_dpi(_DPI)
    figure.set_facecolor("white")
    canvas = FigureCanvasAgg(figure)
    with style():
        canvas.draw()  # type: ignore[no-untyped-call]  # matplotlib's
    pixels = np.asarray(canvas.buffer_rgba())[:, :, :3]  # type: ignore[no-untyped-call]  # likewise
    buffer = io.BytesIO()
    # Not with Pillow, whose PNG writer breaks where COLMAP's library was loaded before it.
    png.from_array(pixels.reshape(len(pixels), -1), "RGB").write(buffer)
    return buffer.getvalue()


def _recolour(artist: Any) -> None:  # artists have no common type for their colours
    for kind in ("color", "facecolor", "edgecolor", "markerfacecolor", "markeredgecolor"):
        get, put = getattr(artist, f"get_{kind}", None), getattr(artist, f"set_{kind}", None)
        if get is not None and put is not None:
            found = _on_paper(get())
            if found is not None:
                put(found)


def _on_paper(colour: Any) -> Any:
    """The colour for a stand-in, or None for any other colour."""
    try:
        rgba = np.atleast_2d(to_rgba_array(colour))
    except (ValueError, TypeError):
        return None
    names = [to_hex(row) for row in rgba]
    if not names or not all(name in _ON_PAPER for name in names):
        return None
    found = [(*to_rgb(_ON_PAPER[name]), row[3]) for name, row in zip(names, rgba, strict=True)]
    return found[0] if len(found) == 1 else found


def bars(axes: Any, images: Sequence[ImageReport], values: Sequence[float], label: str) -> None:
    """A bar for each image; hatched where its robot pose was rejected."""
    drawn = axes.bar(range(len(values)), values, color=FIRST, width=0.7)
    for bar, image in zip(drawn, images, strict=True):
        if image.outlier:
            bar.set(facecolor="none", edgecolor=BAD, hatch="////", linewidth=0.8)
    kept = [value for value, image in zip(values, images, strict=True) if not image.outlier]
    limit = 1.6 * max(kept, default=0.0)
    if 0.0 < limit < max(values):
        # Else one bad pose makes all others invisible.
        axes.set_ylim(0.0, limit)
        for i, value in enumerate(values):
            if value > limit:
                axes.text(i, limit, wording.significant(value), ha="center", va="bottom", color=BAD)
    axes.set_ylabel(label)
    axes.grid(visible=False, axis="x")
    axes.margins(x=0.01)


def name_axis(axes: Any, images: Sequence[ImageReport]) -> None:
    """Names under the bars; where they are too many, only every k-th."""
    step = -(-len(images) // MOST_NAMES)
    ticks = range(0, len(images), step)
    names = [wording.shortened(wording.printable(images[i].name)) for i in ticks]
    axes.set_xticks(ticks, names, rotation=90, fontsize=7 if len(names) <= 24 else 5.5)
