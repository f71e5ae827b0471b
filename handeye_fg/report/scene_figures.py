"""Figures of the report that need the refined scene, or the errors' distribution."""

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from handeye_fg import frames
from handeye_fg.io.results import Result
from handeye_fg.io.scene_file import RefinedScene
from handeye_fg.report import wording
from handeye_fg.report.drawing import FIRST, INK, MUTED, SECOND, WIDTH, Drawing

_CELLS = 10  # across the image
_FEWEST = 5  # observations in a cell, or poses in a histogram
_TAIL = 4.5  # sigma


def image_plane(result: Result) -> Drawing | None:
    """Mean reprojection error over the image: what the lens model leaves."""
    scene, camera = result.scene, result.camera
    if scene is None or camera is None or result.cameras or not len(scene.pixels):
        return None
    across = _CELLS * np.array([1.0, camera.height / camera.width])
    size = np.array([camera.width, camera.height]) / np.round(across)
    cells = (scene.pixels // size).astype(int)
    keys, cell = np.unique(cells, axis=0, return_inverse=True)
    cell = cell.ravel()
    counts = np.bincount(cell)
    means = np.stack([np.bincount(cell, e) for e in scene.errors.T], axis=1) / counts[:, None]
    shown = counts >= _FEWEST
    if not shown.any():
        return None
    centres, means = (keys[shown] + 0.5) * size, means[shown]
    lengths = np.linalg.norm(means, axis=1)
    longest = float(lengths.max())
    figure = Figure(
        figsize=(WIDTH, 0.9 * WIDTH * camera.height / camera.width + 0.4), layout="constrained"
    )
    axes = figure.subplots()
    x, y = scene.pixels.T
    axes.scatter(x, y, s=0.2, color=MUTED, alpha=0.35, linewidths=0, rasterized=True)
    axes.quiver(
        *centres.T,
        *means.T,
        color=SECOND,
        angles="xy",
        scale_units="xy",
        scale=max(longest, 1e-9) / (0.9 * float(size.min())),
        width=0.005,
    )
    axes.set_xlim(0, camera.width)
    axes.set_ylim(camera.height, 0)
    axes.set_aspect("equal")
    axes.set_xlabel("x, px")
    axes.set_ylabel("y, px")
    return Drawing(
        figure=figure,
        name="image-plane",
        title="Reprojection errors over the image",
        caption=f"Mean error (predicted minus observed) in each part of the image; the longest arrow is "
        f"{wording.number(longest)} px, a single observation has {wording.significant(float(np.median(scene.sigmas)))} px. "
        f"Arrows that form a pattern are distortion that the camera model does not describe. Grey: {_some(scene)}.",
    )


def _some(scene: RefinedScene) -> str:
    """Which observations are shown."""
    if scene.n_observations <= len(scene.pixels):
        return "the observations"
    return f"{len(scene.pixels)} of {scene.n_observations} observations"


def histograms(result: Result) -> Drawing | None:
    """Errors of the images and of the robot poses against what noise would give."""
    w_tests = [image.w_test for image in result.images if image.w_test is not None]
    scene = result.scene
    panels = [len(w_tests) >= _FEWEST, scene is not None and len(scene.pixels) >= _FEWEST]
    if not any(panels):
        return None
    figure = Figure(figsize=(WIDTH, 2.6), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, sum(panels))))
    if scene is not None and panels[1]:
        left = axes.pop(0)
        grid = np.linspace(-_TAIL, _TAIL, 200)
        values = np.clip((scene.errors / scene.sigmas[:, None]).ravel(), -_TAIL, _TAIL)
        left.hist(values, bins=60, density=True, color=FIRST, alpha=0.6)
        left.plot(grid, stats.norm.pdf(grid), color=INK, linewidth=1.2)
        left.set_xlabel("image errors / std")
        left.set_yticks([])
    if panels[0]:
        (right,) = axes
        grid = np.linspace(0.0, max(_TAIL, 1.1 * min(max(w_tests), 3 * _TAIL)), 200)
        # The larger of two lengths, each chi distributed with three degrees of freedom.
        density = 2.0 * stats.chi.pdf(grid, 3) * stats.chi.cdf(grid, 3)
        bins = int(np.clip(len(w_tests) // 3, 6, 24))
        right.hist(np.clip(w_tests, 0.0, grid[-1]), bins=bins, density=True, color=FIRST, alpha=0.6)
        right.plot(grid, density, color=INK, linewidth=1.2)
        right.set_xlabel("w of the robot poses")
        right.set_yticks([])
    return Drawing(
        figure=figure,
        name="histograms",
        title="Errors against the assumed distributions",
        caption="Bars: what was found; line: what independent normal noise gives. Bars far to the right "
        "are wrong poses; image errors with long tails or a narrow peak mean that features differ in quality.",
    )


def convergence(result: Result) -> Drawing | None:
    """How far X was from its final value after each step."""
    scene = result.scene
    if scene is None or len(scene.path) < 2:
        return None
    millimetres, degrees = _distances(scene, result)
    figure = Figure(figsize=(WIDTH, 2.8), layout="constrained")
    axes = figure.subplots()
    steps = np.arange(len(millimetres))
    axes.semilogy(steps, millimetres, color=FIRST, marker="o", markersize=3, label="position, mm")
    axes.semilogy(steps, degrees, color=SECOND, marker="s", markersize=3, label="rotation, deg")
    axes.set_xlabel("step of the refinement (0: the linear start)")
    axes.set_xticks(steps[:: max(1, len(steps) // 8)])
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.legend()
    return Drawing(
        figure=figure,
        name="convergence",
        title="From the linear start to the result",
        caption=f"Distance of X from its final value: the linear start was {wording.number(millimetres[0])} mm and "
        f"{wording.number(degrees[0])} deg away.",
    )


def _distances(scene: RefinedScene, result: Result) -> tuple[list[float], list[float]]:
    """Millimetres and degrees from the final X, no less than a logarithmic axis can show."""
    apart = frames.log(frames.inverse(scene.path) @ result.matrix)
    position = np.linalg.norm(scene.path[:, :3, 3] - result.matrix[:3, 3], axis=1)
    degrees = np.rad2deg(np.linalg.norm(apart[:, :3], axis=1))
    return np.maximum(1e3 * position, 1e-7).tolist(), np.maximum(degrees, 1e-8).tolist()
