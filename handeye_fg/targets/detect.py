"""Corners of a known target in images, by OpenCV; entry point ``find_target``.

OpenCV puts the centre of the first pixel at (0, 0), we at (0.5, 0.5): converted here, and only here.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.patterns import (
    AprilTagGrid,
    Charuco,
    Detections,
    Grid,
    Pattern,
    corners_target,
    renumberings,
)
from handeye_fg.progress import Progress, silent
from handeye_fg.types import Indices

Grey = NDArray[np.uint8]
Detector = Callable[[Grey], tuple[Indices, Array]]
"""From a grey image to the numbers (c,) and pixels (c, 2) of the corners that it shows."""

# Fewer corners than this leave a pose to chance: four determine it, two more test it.
FEWEST_CORNERS = 6
# Half of the window of the subpixel search, as a part of the way to the next edge, and its limits in
# pixels. OpenCV's own window for ChArUco boards reaches into the markers: 0.1 px instead of 0.04 px.
_WINDOW_PART, _WINDOW_LIMITS = 0.8, (2, 8)
_SUBPIXEL = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
_TO_OURS = 0.5  # pixels


def find_target(
    images: Path, names: Sequence[str], pattern: Pattern, progress: Progress = silent
) -> Detections:
    """Find the corners of a target in a set of images.

    Where a pattern looks the same from several sides, so that its corners' numbers depend on the
    image, they are numbered from one of these sides.

    Args:
        images: folder of the images.
        names: the images to search.
        pattern: of the target.
        progress: told "target" after each image.

    Returns:
        The corners; images with fewer than 6 of them are not in it.

    Raises:
        InputDataError: an image cannot be read.
        ReconstructionError: no image shows the target.
    """
    detect = detector(pattern)
    found: dict[str, tuple[Indices, Array]] = {}
    for k, name in enumerate(names):
        numbers, pixels = detect(_grey(images / name))
        if len(numbers) >= FEWEST_CORNERS:
            found[name] = numbers, pixels
        progress("target", k + 1, len(names))
    if not found:
        raise ReconstructionError(
            f"the target was found in none of the {len(names)} images: a pattern of kind "
            f"{pattern.kind} was looked for, with the counts of the target file; check these and the "
            "dictionary, and that the images show the target"
        )
    counts = [len(numbers) for numbers, _ in found.values()]
    return Detections(
        names=tuple(found),
        image_index=np.repeat(np.arange(len(counts)), counts),
        corner=np.concatenate([numbers for numbers, _ in found.values()]),
        pixels=np.concatenate([pixels for _, pixels in found.values()]),
    )


def _grey(path: Path) -> Grey:
    """The image as stored: an orientation tag is not applied, as nowhere in this package."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imread(str(path), flags)
    if image is None:
        raise InputDataError(f"image {path}: cannot be decoded; copy it again or leave it out")
    # Of more than 8 bits the upper ones that are used.
    unused = max(int(image.max()).bit_length() - 8, 0)
    return np.right_shift(image, unused).astype(np.uint8)


def detector(pattern: Pattern) -> Detector:
    """The search for a pattern."""
    if isinstance(pattern, Charuco):
        return _charuco(pattern)
    if isinstance(pattern, AprilTagGrid):
        return _apriltag_grid(pattern)
    return _grid(pattern)


def _charuco(pattern: Charuco) -> Detector:
    size = pattern.squares_x, pattern.squares_y
    board = cv2.aruco.CharucoBoard(
        size, pattern.square_m, pattern.marker_m, _dictionary(pattern.dictionary)
    )
    board.setLegacyPattern(pattern.legacy)
    searches = [cv2.aruco.CharucoDetector(board)]
    # Dirty or overprinted markers, where clean ones are too few: their corners are tested later.
    tolerant = cv2.aruco.DetectorParameters()
    tolerant.errorCorrectionRate, tolerant.maxErroneousBitsInBorderRate = 1.0, 0.6
    searches.append(cv2.aruco.CharucoDetector(board, cv2.aruco.CharucoParameters(), tolerant))
    free = 0.5 * (
        1.0 - pattern.marker_m / pattern.square_m
    )  # from a corner to a marker, in squares

    def detect(grey: Grey) -> tuple[Indices, Array]:
        for search in searches:
            pixels, numbers, _, _ = search.detectBoard(grey)
            if _any(numbers) and len(numbers) >= FEWEST_CORNERS:
                break
        else:
            return _NOTHING
        corners = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
        square = float(np.min(np.asarray(KDTree(corners).query(corners, k=2)[0])[:, 1]))
        return numbers.ravel().astype(np.int64), _ours(_refined(grey, corners, free * square))

    return detect


def _apriltag_grid(pattern: AprilTagGrid) -> Detector:
    dictionary = _dictionary(pattern.family)
    search = cv2.aruco.ArucoDetector(dictionary)
    bit = 1.0 / (dictionary.markerSize + 2)  # width of the black border, in sides
    n_tags = pattern.tags_x * pattern.tags_y

    def detect(grey: Grey) -> tuple[Indices, Array]:
        tags, ids, _ = search.detectMarkers(grey)
        if not _any(ids):
            return _NOTHING
        places = ids.ravel().astype(np.int64) - pattern.first_id
        squares = [np.asarray(tag, dtype=np.float64).reshape(4, 2) for tag in tags]
        known = [k for k, place in enumerate(places) if 0 <= place < n_tags]
        if not known:
            return _NOTHING
        numbers = (4 * places[known, None] + np.arange(4)).ravel()
        corners = [_refined(grey, squares[k], bit * _side(squares[k])) for k in known]
        return numbers, _ours(np.concatenate(corners))

    return detect


def _side(tag: Array) -> float:
    """The shortest side of a tag (4, 2) in pixels."""
    return float(np.linalg.norm(tag - np.roll(tag, 1, axis=0), axis=1).min())


def _any(found: object) -> bool:
    """Whether OpenCV found something: it returns None otherwise, which its types do not say."""
    return found is not None


def _refined(grey: Grey, corners: Array, free_px: float) -> Array:
    """Corners (c, 2) to subpixels, from a window that stays within ``free_px`` of them."""
    half = int(np.clip(_WINDOW_PART * free_px, *_WINDOW_LIMITS))
    start = corners.astype(np.float32).reshape(-1, 1, 2)
    return np.asarray(cv2.cornerSubPix(grey, start, (half, half), (-1, -1), _SUBPIXEL))


def _grid(pattern: Grid) -> Detector:
    size = pattern.columns, pattern.rows
    corners = corners_target(pattern)[:, :2]
    turned, mirrored = renumberings(pattern)

    def search(grey: Grey) -> tuple[bool, object]:
        if pattern.kind == "chessboard":
            # Not exhaustive: that search takes seconds where there is no board.
            return cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_ACCURACY)
        layout = (
            cv2.CALIB_CB_SYMMETRIC_GRID
            if pattern.kind == "circles"
            else cv2.CALIB_CB_ASYMMETRIC_GRID
        )
        found, pixels = cv2.findCirclesGrid(grey, size, flags=layout)
        if not found:  # slower, and equal to stronger perspective and clutter
            found, pixels = cv2.findCirclesGrid(grey, size, flags=layout | cv2.CALIB_CB_CLUSTERING)
        return found, pixels

    def detect(grey: Grey) -> tuple[Indices, Array]:
        found, pixels = search(grey)
        if not found:
            return _NOTHING
        pixels = _ours(pixels)
        numbers = np.arange(len(corners))
        if len(mirrored) and _from_behind(corners, pixels):
            numbers = mirrored[0]
        if pattern.kind == "chessboard":
            numbers = _dark_first(grey, pixels, numbers, turned, pattern.columns)
        return numbers, pixels

    return detect


def _from_behind(corners: Array, pixels: Array) -> bool:
    """Whether the numbering makes the image show the target from behind: no camera sees it so."""
    (ax, ay), (bx, by) = np.linalg.lstsq(corners - corners.mean(0), pixels - pixels.mean(0))[0]
    return bool(ax * by - ay * bx < 0)


def _dark_first(
    grey: Grey, pixels: Array, numbers: Indices, turned: Indices, columns: int
) -> Indices:
    """The numbering, turned where needed so that the square at corner 0 is dark.

    This tells the sides of a chessboard apart unless it looks the same when it is turned.
    """
    for turn in turned:
        candidate = turn[numbers]
        place = np.argsort(candidate)  # of each number
        first = [place[k] for k in (0, 1, columns, columns + 1)]
        second = [place[k] for k in (1, 2, columns + 1, columns + 2)]
        if _brightness(grey, pixels[first]) < _brightness(grey, pixels[second]):
            return np.asarray(candidate)
    return numbers


def _brightness(grey: Grey, square: Array) -> float:
    """Mean grey level around the middle of a square with the corners (4, 2)."""
    x, y = square.mean(axis=0)
    half = max(1, int(0.15 * np.linalg.norm(square[1] - square[0])))
    top, left = max(int(y) - half, 0), max(int(x) - half, 0)
    return float(grey[top : int(y) + half + 1, left : int(x) + half + 1].mean())


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _ours(pixels: object) -> Array:
    """OpenCV's positions as ours (c, 2)."""
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2) + _TO_OURS


_NOTHING: tuple[Indices, Array] = (np.empty(0, np.int64), np.empty((0, 2)))
