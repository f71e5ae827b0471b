"""The interactive 3D view: what plotly.js draws, as data; entry point ``view``."""

import base64
import html
from collections.abc import Sequence

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.io.camera_results import std_translation_mm
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result
from handeye_fg.report import wording

Trace = dict[str, object]

_FRUSTUM = 0.06  # length of a camera's pyramid, part of the extent of the cameras
_AXES = 0.15  # of the frames' axes
_ELLIPSOID = 0.05  # largest half axis of the drawn ellipsoids
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 25)
# Points further from the middle than so many times the distance within which so many are make all others small.
_FAR, _MOST = 1.3, 0.95


def view(result: Result) -> dict[str, object] | None:
    """Traces and pictures for the page, or None where nothing was placed.

    Colours are names of the page's own colours, which it fills in.
    """
    placed = [image for image in result.images if image.base_T_camera is not None]
    if not placed:
        return None
    moving = result.setup == "eye-to-hand"
    poses = np.array([_pose(image) for image in placed])
    centres = poses[:, :3, 3]
    extent = max(float(np.ptp(centres, axis=0).max()), 1e-3)
    grippers = poses @ frames.inverse(result.matrix)
    traces = [
        *_points(result, centres, extent),
        _frame("base" if not moving else "gripper", np.eye(4), _AXES * extent),
        _frusta(poses, _FRUSTUM * extent, result),
        _cameras(placed, centres),
    ]
    if not moving:
        traces += [_links(centres, grippers[:, :3, 3]), _grippers(placed, grippers[:, :3, 3])]
    ellipsoids, magnified = _ellipsoids(result, poses, _ELLIPSOID * extent)
    traces += ellipsoids
    thumbnails = {} if result.scene is None else result.scene.thumbnails
    return {
        "traces": traces,
        "pictures": [
            base64.b64encode(thumbnails[image.name]).decode() if image.name in thumbnails else None
            for image in placed
        ],
        "names": [wording.printable(image.name) for image in placed],
        "told": [": ".join((_told(image)[0], ", ".join(_told(image)[1:]))) for image in placed],
        "bad": [image.outlier for image in placed],
        "centres": np.round(centres, 6).tolist(),
        "caption": _caption(result, magnified),
    }


def _pose(image: ImageReport) -> Array:
    """Where an image was taken: in the base; where the camera stands still, in the gripper."""
    pose = image.base_T_camera if image.gripper_T_camera is None else image.gripper_T_camera
    return np.asarray(pose)


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


def _points(result: Result, centres: Array, extent: float) -> list[Trace]:
    if result.scene is None:
        return []
    points = result.scene.points
    if not len(points):
        return []
    middle = np.median(np.concatenate([points, centres]), axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    reach = max(extent, _FAR * float(np.quantile(away, _MOST)))
    near = points[away < reach]
    return [_markers(near, "scene points", "muted", 1.2, "circle", ())]


def _frame(name: str, pose: Array, length: float) -> Trace:
    origin, axes = pose[:3, 3], pose[:3, :3].T * length
    return _lines(
        [np.stack([origin, origin + axis]) for axis in axes], f"axes of the {name}", "ink", 5
    )


def _frusta(poses: Array, length: float, result: Result) -> Trace:
    """The pyramid that each camera looks through."""
    camera = result.camera
    half = (0.5, 0.4)
    if camera is not None:
        half = (0.5 * camera.width / camera.params[0], 0.5 * camera.height / camera.params[0])
    corners = length * np.array([[sx * half[0], sy * half[1], 1.0] for sx, sy in _CORNERS])
    apex = np.zeros(3)
    outline = np.array(
        [apex, corners[0], corners[1], apex, corners[2], corners[3], apex, corners[3]]
    )
    outline = np.vstack([outline, corners[0], corners[1], corners[2]])
    segments = [outline @ pose[:3, :3].T + pose[:3, 3] for pose in poses]
    return _lines(segments, "views", "second", 2)


_CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def _cameras(placed: Sequence[ImageReport], centres: Array) -> Trace:
    colours = ["bad" if image.outlier else "second" for image in placed]
    return _markers(centres, "cameras", colours, 4, "circle", [_hover(image) for image in placed])


def _grippers(placed: Sequence[ImageReport], origins: Array) -> Trace:
    colours = ["bad" if image.outlier else "first" for image in placed]
    return _markers(origins, "gripper", colours, 4, "square", [_hover(image) for image in placed])


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


def _ellipsoids(result: Result, poses: Array, size: float) -> tuple[list[Trace], float]:
    """One standard deviation of X's position at each camera, magnified; and by how much."""
    if result.covariance is None or any(std is None for std in std_translation_mm(result)):
        return [], 0.0
    values, vectors = np.linalg.eigh(result.covariance[3:, 3:])
    axes = vectors * np.sqrt(np.maximum(values, 0.0))
    longest = float(np.sqrt(max(values[-1], 0.0)))
    if longest == 0.0:
        return [], 0.0
    magnified = float(f"{size / longest:.1g}")
    circle = np.stack([np.cos(_CIRCLE), np.sin(_CIRCLE)], axis=1)
    rings = [magnified * circle @ axes[:, [i, j]].T for i, j in ((0, 1), (0, 2), (1, 2))]
    segments = [ring @ pose[:3, :3].T + pose[:3, 3] for pose in poses for ring in rings]
    return [_lines(segments, "uncertainty of X, magnified", "first", 1)], magnified


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
