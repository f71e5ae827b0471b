"""Figures of the report that show the result itself."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from handeye_fg.io.camera_results import std_rotation_deg, std_translation_mm
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result
from handeye_fg.report import wording
from handeye_fg.report.drawing import (
    BAD,
    FIRST,
    MOST_NAMES,
    MUTED,
    SECOND,
    WIDTH,
    Drawing,
    bars,
    name_axis,
    style,
)
from handeye_fg.report.ellipses import ellipses
from handeye_fg.report.placed import placed
from handeye_fg.report.scene_figures import convergence, histograms, image_plane


def drawings(result: Result) -> tuple[Drawing, ...]:
    """All figures that the result has data for."""
    shown = tuple(image for image in result.images if image.base_T_camera is not None)
    with style():
        candidates = (
            _over_distance(result),
            ellipses(result),
            _residuals(result),
            _centres(result),
            histograms(result),
            image_plane(result),
            _reprojection(shown),
            _influence(result),
            _correlations(result),
            convergence(result),
        )
    return tuple(drawing for drawing in candidates if drawing is not None)


def _over_distance(result: Result) -> Drawing | None:
    """The error that X causes, over the distance from the camera."""
    found = result.accuracy
    if found is None:
        return None
    distances = [1e3 * error.distance for error in found.along_axis]
    work = found.at_work
    figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
    axes = figure.subplots()
    axes.plot(
        distances,
        [1e3 * error.within_95 for error in found.along_axis],
        color=FIRST,
        marker="o",
        markersize=3,
        label="95 % of errors within",
    )
    stds = 1e3 * np.sqrt(np.array([np.diag(error.covariance) for error in found.along_axis]))
    axes.plot(distances, stds[:, :2].max(axis=1), color=SECOND, label="std across the view")
    axes.plot(distances, stds[:, 2], color=SECOND, linestyle="--", label="std along the view")
    if found.tolerance is not None:
        axes.axhline(1e3 * found.tolerance, color=BAD, linewidth=0.9, label="tolerance")
    axes.axvline(1e3 * work.distance, color=MUTED, linewidth=0.9)
    axes.set_ylim(0.0, 1.35 * axes.get_ylim()[1])  # room for the legend
    axes.set_xlabel("distance from the camera, mm")
    axes.set_ylabel("error, mm")
    axes.legend(loc="upper left", ncols=2, fontsize=7.5)
    return Drawing(
        figure=figure,
        name="distance",
        title="The error that X causes, over the distance",
        caption=f"Of a point on the optical axis. At the work, {wording.number(1e3 * work.distance, 0)} mm from the "
        f"camera, 95 % of the errors are within {wording.number(1e3 * work.within_95)} mm.",
    )


def _residuals(result: Result) -> Drawing | None:
    shown = [image for image in result.images if image.residual_translation is not None]
    if not shown:
        return None
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True)
    millimetres = [1000.0 * (image.residual_translation or 0.0) for image in shown]
    degrees = [np.degrees(image.residual_rotation or 0.0) for image in shown]
    bars(upper, shown, millimetres, "position, mm")
    bars(lower, shown, degrees, "orientation, deg")
    name_axis(lower, shown)
    worst = int(np.argmax(millimetres))
    if result.sfm is not None:
        title = "Reported against refined robot pose"
        what = "each robot pose as reported and as refined"
    else:
        title = "Robot against camera"
        what = "where robot and camera put the camera, in each row"
    return Drawing(
        figure=figure,
        name="residuals",
        title=title,
        caption=f"Distance and angle between {what}. "
        f"Largest distance: {wording.number(millimetres[worst])} mm at "
        f"{wording.printable(shown[worst].name)}. Rejected poses are hatched; a bar that is cut off has its value above it.",
    )


def _reprojection(images: Sequence[ImageReport]) -> Drawing | None:
    shown = [image for image in images if image.reprojection_rms is not None]
    if not shown:
        return None
    figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
    axes = figure.subplots()
    values = [image.reprojection_rms or 0.0 for image in shown]
    bars(axes, shown, values, "rms, px")
    name_axis(axes, shown)
    worst = int(np.argmax(values))
    return Drawing(
        figure=figure,
        name="reprojection",
        title="Reprojection error by image",
        caption="Root mean square distance between seen and predicted points. "
        f"Largest: {wording.number(values[worst])} px at {wording.printable(shown[worst].name)}.",
    )


def _influence(result: Result) -> Drawing | None:
    """What X rests on: the most influential poses, the largest first."""
    shown = [image for image in result.images if image.influence_translation is not None]
    if not shown:
        return None
    shown = sorted(shown, key=lambda image: image.influence_translation or 0.0, reverse=True)
    names = shown[:MOST_NAMES]
    grown = [image for image in shown if image.std_growth is not None]  # not of earlier versions
    figure = Figure(figsize=(WIDTH, 3.6 if grown else 2.2), layout="constrained")
    upper, *lower = figure.subplots(2 if grown else 1, 1, sharex=True, squeeze=False)[:, 0]
    millimetres = [1000.0 * (image.influence_translation or 0.0) for image in names]
    bars(upper, names, millimetres, "X moves, mm")
    for axes in lower:
        bars(axes, names, [100.0 * (image.std_growth or 0.0) for image in names], "std grows, %")
    name_axis((upper, *lower)[-1], names)
    caption = "Without a pose: how far X would move, the most influential first"
    largest = f"{wording.number(millimetres[0])} mm at {wording.printable(names[0].name)}"
    if grown:
        richest = max(grown, key=lambda image: image.std_growth or 0.0)
        caption += ", and by how much the standard deviation of X would grow in the direction that loses most"
        largest += (
            f", {wording.number(100.0 * (richest.std_growth or 0.0), 0)} % at "
            f"{wording.printable(richest.name)}"
        )
    return Drawing(
        figure=figure,
        name="influence",
        title="Which poses carry the result",
        caption=f"{caption}. Largest: {largest}. Where one pose is far above the others, X rests on it: take "
        "more images like it.",
    )


def _centres(result: Result) -> Drawing | None:
    shown = placed(result)
    if not shown or result.setup != "eye-in-hand":
        return None
    cameras = np.array([one.centre for one in shown])
    grippers = np.array([one.gripper for one in shown])
    extent = float(np.ptp(np.concatenate([cameras, grippers]), axis=0).max())
    ends = cameras + 0.12 * extent * np.array([one.pose[:3, 2] for one in shown])

    figure = Figure(figsize=(WIDTH, 3.8), layout="constrained")
    # Any: the 3D axes of matplotlib are found by a name, their type is not in its stubs.
    axes: Any = figure.add_subplot(projection="3d")
    for camera, gripper, end in zip(cameras, grippers, ends, strict=True):
        axes.plot(*np.transpose([gripper, camera]), color=MUTED, linewidth=0.8)
        axes.plot(*np.transpose([camera, end]), color=SECOND, linewidth=1.6)
    axes.scatter(*grippers.T, color=FIRST, marker="s", s=14, depthshade=False, label="gripper")
    axes.scatter(*cameras.T, color=SECOND, marker="o", s=16, depthshade=False, label="camera")
    for axis, label in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_pane_color((0.0, 0.0, 0.0, 0.0))
        axis.line.set_color(MUTED)
        axis.set_label_text(f"{label}, m")
        axis.set_major_locator(MaxNLocator(5))
    axes.set_aspect("equal")
    axes.legend(loc="upper left")
    return Drawing(
        figure=figure,
        name="centres",
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
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
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
                        facecolor=FIRST if value > 0 else SECOND,
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
    return Drawing(
        figure=figure,
        name="correlation",
        title="Correlation of the components of X",
        caption="Rotation, then translation, along the camera's axes. Values near 1 or -1: the "
        "motions do not tell the two apart well.",
    )
