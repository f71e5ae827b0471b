"""The interactive 3D view: what plotly.js draws, as data; entry point ``view``."""

import base64
import html
from collections.abc import Sequence

import numpy as np

from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Uncertain, std_translation_mm
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result
from handeye_fg.report import wording
from handeye_fg.report.placed import Placed, placed

Trace = dict[str, object]

# Length of a camera's pyramid, part of the extent of the cameras, if it were alone: of many each is smaller.
_FRUSTUM, _LONGEST_FRUSTUM = 0.5, 0.15
_AXES = 0.15  # of the frames' axes
_ELLIPSOID = 0.05  # largest half axis of the drawn ellipsoids
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 25)
# Points further from the middle than so many times the distance within which so many are make all others small.
_FAR, _MOST = 1.5, 0.95


def view(result: Result) -> dict[str, object] | None:
    """Traces and pictures for the page, or None where nothing was placed.

    Colours are names of the page's own colours, which it fills in.
    """
    shown = placed(result)
    if not shown:
        return None
    moving = result.setup == "eye-to-hand"
    centres = np.array([one.centre for one in shown])
    extent = max(float(np.ptp(centres, axis=0).max()), 1e-3)
    corners = _corners(shown, extent)
    traces = [
        *_points(result, centres),
        _frame("base" if not moving else "gripper", np.eye(4), _AXES * extent),
        _frusta(centres, corners),
        _cameras(shown, centres),
    ]
    if not moving:
        grippers = np.array([one.gripper for one in shown])
        traces += [_links(centres, grippers), _grippers(shown, grippers)]
    ellipsoids, magnified = _ellipsoids(shown, _ELLIPSOID * extent)
    traces += ellipsoids
    thumbnails = {} if result.scene is None else result.scene.thumbnails
    told = [_told(one.image) for one in shown]
    return {
        "traces": traces,
        "pictures": [
            base64.b64encode(thumbnails[one.image.name]).decode()
            if one.image.name in thumbnails
            else None
            for one in shown
        ],
        "corners": np.round(corners, 6).tolist(),
        "names": [wording.printable(one.image.name) for one in shown],
        "told": [": ".join((parts[0], ", ".join(parts[1:]))) for parts in told],
        "hover": [_hover(one.image) for one in shown],
        "bad": [one.image.outlier for one in shown],
        "centres": np.round(centres, 6).tolist(),
        "caption": _caption(result, magnified),
    }


def _lines(segments: Sequence[Array], name: str, colour: str, width: float) -> Trace:
    """Polylines (k, 3) in one trace, broken between them."""
    gap = np.full((1, 3), np.nan)
    joined = np.concatenate([part for segment in segments for part in (segment, gap)])
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": name,
        "hoverinfo": "skip",
        **_coordinates(joined),
        "line": {"color": colour, "width": width},
    }


def _markers(
    points: Array, name: str, colour: object, size: float, symbol: str, texts: Sequence[str]
) -> Trace:
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": name,
        **_coordinates(points),
        "marker": {"color": colour, "size": size, "symbol": symbol},
        **({"text": list(texts), "hoverinfo": "text"} if texts else {"hoverinfo": "skip"}),
    }


def _coordinates(points: Array) -> dict[str, object]:
    return {
        axis: {
            "dtype": "f4",
            "bdata": base64.b64encode(np.ascontiguousarray(column, dtype="<f4").tobytes()).decode(),
        }
        for axis, column in zip("xyz", points.T, strict=True)
    }


def _points(result: Result, centres: Array) -> list[Trace]:
    if result.scene is None:
        return []
    points = result.scene.points
    if not len(points):
        return []
    middle = np.median(np.concatenate([points, centres]), axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    near = points[away <= _FAR * float(np.quantile(away, _MOST))]
    return [_markers(near, "scene points", "muted", 1.2, "circle", ())]


def _frame(name: str, pose: Array, length: float) -> Trace:
    origin, axes = pose[:3, 3], pose[:3, :3].T * length
    return _lines(
        [np.stack([origin, origin + axis]) for axis in axes], f"axes of the {name}", "ink", 5
    )


def _corners(shown: Sequence[Placed], extent: float) -> Array:
    """Corners (n, 4, 3) of the images where their cameras' pyramids end."""
    size = extent * min(_LONGEST_FRUSTUM, _FRUSTUM / np.sqrt(len(shown)))
    return np.array([one.corners(size) for one in shown])


def _frusta(centres: Array, corners: Array) -> Trace:
    """The pyramid that each camera looks through."""
    segments = [
        np.stack([apex, a, b, apex, c, d, apex, d, a, b, c])
        for apex, (a, b, c, d) in zip(centres, corners, strict=True)
    ]
    return _lines(segments, "views", "second", 2)


def _cameras(shown: Sequence[Placed], centres: Array) -> Trace:
    colours = ["bad" if one.image.outlier else "second" for one in shown]
    return _markers(centres, "cameras", colours, 4, "circle", [_hover(one.image) for one in shown])


def _grippers(shown: Sequence[Placed], origins: Array) -> Trace:
    colours = ["bad" if one.image.outlier else "first" for one in shown]
    return _markers(origins, "gripper", colours, 4, "square", [_hover(one.image) for one in shown])


def _links(centres: Array, origins: Array) -> Trace:
    pairs = [np.stack(pair) for pair in zip(origins, centres, strict=True)]
    return _lines(pairs, "gripper to camera", "muted", 1.5)


def _told(image: ImageReport) -> list[str]:
    """The name and what is known of the image, as plain text."""
    parts = [wording.printable(image.name)]
    if image.residual_translation is not None and image.residual_rotation is not None:
        parts.append(
            f"{wording.number(1e3 * image.residual_translation)} mm and "
            f"{wording.number(float(np.rad2deg(image.residual_rotation)))} deg from the reported pose"
        )
    if image.reprojection_rms is not None:
        parts.append(f"reprojection {wording.number(image.reprojection_rms)} px")
    if image.outlier:
        parts.append("robot pose rejected")
    return parts


def _hover(image: ImageReport) -> str:
    """The same for plotly, which reads markup in it."""
    return "<br>".join(html.escape(part, quote=False) for part in _told(image))


def _ellipsoids(shown: Sequence[Placed], size: float) -> tuple[list[Trace], float]:
    """One standard deviation of X's position at each camera, magnified; and by how much."""
    axes = [_half_axes(one.camera) for one in shown]
    longest = max(
        (float(np.linalg.norm(a, axis=0).max()) for a in axes if a is not None), default=0.0
    )
    if longest == 0.0:
        return [], 0.0
    magnified = float(f"{size / longest:.1g}")
    circle = magnified * np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
    segments = [
        circle @ a[:, pair].T @ one.pose[:3, :3].T + one.centre
        for one, a in zip(shown, axes, strict=True)
        if a is not None
        for pair in ([0, 1], [0, 2], [1, 2])
    ]
    return [_lines(segments, "uncertainty of X, magnified", "first", 1)], magnified


def _half_axes(camera: Uncertain) -> Array | None:
    """Half axes (3, 3), as columns, of the ellipsoid of its position in its frame; None where one is free."""
    if camera.covariance is None or any(std is None for std in std_translation_mm(camera)):
        return None
    values, vectors = np.linalg.eigh(camera.covariance[3:, 3:])
    axes: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return axes


def _caption(result: Result, magnified: float) -> str:
    parts = [
        "Drag to turn, scroll to come closer; a click in the legend hides a part. Red: the robot pose was rejected."
    ]
    if magnified:
        parts.append(
            f"Ellipsoids: one standard deviation of X's position, {magnified:g} times as large."
        )
    scene = result.scene
    if scene is not None and scene.n_points > len(scene.points):
        parts.append(f"{len(scene.points)} of {scene.n_points} points are shown.")
    if scene is not None and 0 < len(scene.thumbnails) < len(scene.names):
        parts.append(
            f"There are small pictures of {len(scene.thumbnails)} of {len(scene.names)} images."
        )
    return " ".join(parts)
