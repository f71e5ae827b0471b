"""The ellipsoid of the error that X causes, seen from two sides; entry point ``ellipses``."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from handeye_fg.io.results import Result, parent_frame
from handeye_fg.point_errors import PointError
from handeye_fg.report import wording
from handeye_fg.report.drawing import FIRST, MUTED, SECOND, WIDTH, Drawing

_SIDES = (("x", "y"), ("x", "z"))


def ellipses(result: Result) -> Drawing | None:
    """Outlines of one standard deviation, at the tool and at the work."""
    if result.accuracy is None:
        return None
    tool, work = result.accuracy.tool, result.accuracy.at_work
    places = (
        (tool, SECOND, "--", f"at the {parent_frame(result.setup)}"),
        (work, FIRST, "-", f"at {wording.significant(1e3 * work.distance)} mm"),
    )
    stds = [1e3 * float(np.sqrt(np.diag(error.covariance).max())) for error in (tool, work)]
    reach = 1.25 * max(*stds, 1e-06)
    figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
    for axes, side in zip(figure.subplots(1, 2), _SIDES, strict=True):
        for error, colour, line, label in places:
            axes.add_patch(_outline(error, side, edgecolor=colour, linestyle=line, label=label))
        axes.plot(0.0, 0.0, marker="+", color=MUTED)
        axes.set_xlim(-reach, reach)
        # As in the image: y downwards.
        axes.set_ylim(*((reach, -reach) if side[1] == "y" else (-reach, reach)))
        axes.set_aspect("equal")
        axes.set_xlabel(f"{side[0]}, mm")
        axes.set_ylabel(f"{side[1]}, mm")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return Drawing(
        figure=figure,
        name="ellipses",
        title="The ellipsoid of that error",
        caption="One standard deviation, along the axes of the camera: left as the camera sees it, right from "
        f"above with the view upwards. 95 % of the errors at the work are within {wording.number(1e3 * work.within_95)} mm.",
    )


def _outline(error: PointError, side: tuple[str, str], **style: Any) -> Ellipse:
    """The ellipsoid as seen along the third axis, millimetres."""
    chosen = ["xyz".index(axis) for axis in side]
    values, vectors = np.linalg.eigh(error.covariance[np.ix_(chosen, chosen)])
    width, height = 2e3 * np.sqrt(np.maximum(values, 0.0))
    angle = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    return Ellipse((0.0, 0.0), width, height, angle=angle, facecolor="none", linewidth=1.6, **style)
