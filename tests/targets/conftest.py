"""Images of known targets, rendered from a pose with a camera: every pixel's ray meets the plane."""

from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from handeye_fg.frames import Array, inverse, pose
from handeye_fg.patterns import AprilTagGrid, Charuco, Grid, Pattern, Target, corners_target
from handeye_fg.simulate import project
from handeye_fg.types import CameraModel

PIXELS_PER_METRE = 3000
MARGIN_M = 0.02
OVERSAMPLING = 3

PATTERNS = {
    "charuco": Charuco(
        squares_x=7, squares_y=5, square_m=0.03, marker_m=0.022, dictionary="DICT_4X4_50"
    ),
    "chessboard": Grid(kind="chessboard", columns=7, rows=6, spacing_m=0.025),
    "circles": Grid(kind="circles", columns=7, rows=5, spacing_m=0.025),
    "acircles": Grid(kind="acircles", columns=4, rows=9, spacing_m=0.018),
    "apriltag_grid": AprilTagGrid(
        tags_x=4, tags_y=3, tag_m=0.04, gap_m=0.012, family="DICT_APRILTAG_36h11"
    ),
}


def raster(pattern: Pattern) -> tuple[NDArray[np.uint8], Array]:
    """The printed target, grey, and the place (2,) of its first pixel's corner in the target frame."""
    scale = PIXELS_PER_METRE
    if isinstance(pattern, Charuco):
        size = pattern.squares_x, pattern.squares_y
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.dictionary))
        board = cv2.aruco.CharucoBoard(size, pattern.square_m, pattern.marker_m, dictionary)
        pixels = [round(n * pattern.square_m * scale) for n in size]
        printed, origin = board.generateImage(tuple(pixels)), np.zeros(2)
    elif isinstance(pattern, AprilTagGrid):
        size = pattern.tags_x, pattern.tags_y
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, pattern.family))
        board = cv2.aruco.GridBoard(size, pattern.tag_m, pattern.gap_m, dictionary)
        pixels = [round((n * pattern.tag_m + (n - 1) * pattern.gap_m) * scale) for n in size]
        printed, origin = board.generateImage(tuple(pixels)), np.zeros(2)
    else:
        printed, origin = drawn(pattern)
    margin = round(MARGIN_M * scale)
    framed = cv2.copyMakeBorder(
        printed, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255
    )
    return framed, origin - margin / scale


def drawn(pattern: Grid) -> tuple[NDArray[np.uint8], Array]:
    """A chessboard, or circles, whose first corner is one spacing from the border."""
    corners, scale = corners_target(pattern)[:, :2], PIXELS_PER_METRE
    extent = np.ptp(corners, axis=0) + 2 * pattern.spacing_m
    width, height = np.round(extent * scale).astype(int)
    x, y = (np.arange(width) + 0.5) / scale, (np.arange(height) + 0.5) / scale
    if pattern.kind == "chessboard":
        square = np.add.outer(y // pattern.spacing_m, x // pattern.spacing_m)
        image = np.where(square % 2 == 0, 0, 255).astype(np.uint8)
    else:
        image = np.full((height, width), 255, np.uint8)
        radius = 0.3 * pattern.spacing_m
        shift = 4  # cv2 draws to sixteenths of a pixel
        for centre in (corners + pattern.spacing_m) * scale - 0.5:
            at = tuple(np.round(centre * 2**shift).astype(int).tolist())
            size = round(radius * scale * 2**shift)
            cv2.circle(image, at, size, 0, -1, cv2.LINE_AA, shift)
    return image, np.array([-pattern.spacing_m, -pattern.spacing_m])


@lru_cache(maxsize=4)
def line_of_sight(width: int, height: int, params: tuple[float, ...]) -> Array:
    """Rays (n, 3) of all pixels of the finer image, row by row, of an OPENCV camera."""
    fx, fy, cx, cy, *distortion = params
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    u, v = np.meshgrid(
        (np.arange(width * OVERSAMPLING) + 0.5) / OVERSAMPLING,
        (np.arange(height * OVERSAMPLING) + 0.5) / OVERSAMPLING,
    )
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), K, np.array(distortion)).reshape(-1, 2)
    return np.column_stack([rays, np.ones(len(rays))])


def rendered(pattern: Pattern, camera: CameraModel, target_T_camera: Array) -> NDArray[np.uint8]:
    """What the camera sees: the target on a grey wall."""
    print_, first = raster(pattern)
    rays = line_of_sight(camera.width, camera.height, tuple(camera.params))
    rays = rays @ target_T_camera[:3, :3].T
    centre = target_T_camera[:3, 3]
    on_plane = centre[:2] - centre[2] * rays[:, :2] / rays[:, 2:]
    place = ((on_plane - first) * PIXELS_PER_METRE - 0.5).astype(np.float32)
    maps = place.T.reshape(2, camera.height * OVERSAMPLING, camera.width * OVERSAMPLING)
    fine = cv2.remap(
        print_, maps[0], maps[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=128
    )
    image = cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(image)


def looking_at(middle: Array, distance: float, tilt: float, azimuth: float, roll: float) -> Array:
    """target_T_camera (4, 4) of a camera in front of the target (at negative z) that sees its middle."""
    away = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)])
    z = -away
    x = np.cross(np.array([np.sin(roll), np.cos(roll), 0.0]), z)
    x /= np.linalg.norm(x)
    return pose(np.stack([x, np.cross(z, x), z], axis=1), middle + distance * away)


def views(pattern: Pattern, n: int, rng: np.random.Generator) -> Array:
    """Poses (n, 4, 4) all around the target, upside down too."""
    middle = corners_target(pattern).mean(axis=0)
    return np.array(
        [
            looking_at(
                middle + rng.uniform(-0.01, 0.01, 3) * [1, 1, 0],
                rng.uniform(0.38, 0.46),
                rng.uniform(0.2, 0.6),
                rng.uniform(0, 2 * np.pi),
                2 * np.pi * i / n + rng.uniform(-0.2, 0.2),
            )
            for i in range(n)
        ]
    )


def projected(pattern: Pattern, camera: CameraModel, target_T_camera: Array) -> Array:
    """True pixels (k, 2) of all corners."""
    camera_T_target = inverse(target_T_camera)
    corners = corners_target(pattern) @ camera_T_target[:3, :3].T + camera_T_target[:3, 3]
    return project(camera, corners)


@pytest.fixture
def camera() -> CameraModel:
    """640x480 with the distortion of a usual lens."""
    params = np.array([700.0, 702.0, 322.3, 236.8, -0.08, 0.04, 0.0005, -0.0004])
    return CameraModel(model="OPENCV", width=640, height=480, params=params)


@pytest.fixture(params=list(PATTERNS))
def pattern(request: pytest.FixtureRequest) -> Pattern:
    return PATTERNS[request.param]


@pytest.fixture
def patterns() -> dict[str, Pattern]:
    return PATTERNS


@pytest.fixture
def render() -> Callable[[Pattern, CameraModel, Array], NDArray[np.uint8]]:
    return rendered


@pytest.fixture
def around() -> Callable[[Pattern, int, np.random.Generator], Array]:
    return views


@pytest.fixture
def true_pixels() -> Callable[[Pattern, CameraModel, Array], Array]:
    return projected


@pytest.fixture
def target(pattern: Pattern) -> Target:
    return Target(pattern=pattern)
