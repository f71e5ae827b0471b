"""Known targets: their patterns, where their corners are, and what images show of them.

Target frame: in the plane of the pattern, x to the right and y down as the pattern is printed, z into
it; metres. Corners are numbered row by row from the top left. The origin of a ChArUco board and of
an AprilTag grid is the outer corner at the top left, as in OpenCV; that of the other patterns is
corner 0. A corner is whatever the pattern locates: a crossing of squares, the centre of a circle, a
corner of a tag.
"""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from scipy.spatial import KDTree

from handeye_fg.frames import Array
from handeye_fg.types import Indices, frozen_array, frozen_indices

TargetKind = Literal["charuco", "chessboard", "circles", "acircles", "apriltag_grid"]

# Where a symmetric pattern is laid upon itself, corners meet to rounding; others miss by a spacing.
_COINCIDENT = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class Charuco:
    """A chessboard with an ArUco marker in each white square.

    Attributes:
        squares_x, squares_y: numbers of squares.
        square_m, marker_m: sides of a square and of a marker.
        dictionary: of the markers, by OpenCV's name.
        legacy: whether the top left square of a board with an even number of rows is white.
    """

    kind: ClassVar = "charuco"
    squares_x: int
    squares_y: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Corners in columns and rows that carry no numbers.

    Attributes:
        kind: inner corners of a chessboard, circles at the crossings of a square grid, or circles of
            which every other row is shifted to the right by half of the distance within a row.
        columns, rows: numbers of corners; of a shifted grid ``columns`` is the number in one row.
        spacing_m: distance of neighbouring rows; within a row circles of a shifted grid are two apart.
    """

    kind: Literal["chessboard", "circles", "acircles"]
    columns: int
    rows: int
    spacing_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AprilTagGrid:
    """AprilTags in columns and rows, numbered row by row, upright as OpenCV draws them.

    Attributes:
        tags_x, tags_y: numbers of tags.
        tag_m: side of a tag, measured along its black border.
        gap_m: distance between neighbouring tags.
        family: by OpenCV's name, such as DICT_APRILTAG_36h11.
        first_id: number of the tag at the top left.
    """

    kind: ClassVar = "apriltag_grid"
    tags_x: int
    tags_y: int
    tag_m: float
    gap_m: float
    family: str
    first_id: int = 0


Pattern = Charuco | Grid | AprilTagGrid


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A known target.

    Attributes:
        pattern: what is printed.
        accuracy_m: standard deviation of a corner's position on the real target, per axis, and of
            the length of the whole target.
    """

    pattern: Pattern
    accuracy_m: float = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Detections:
    """Corners of the target in images, as a structure of arrays.

    Attributes:
        names: the images (n,) that show the target.
        image_index: for each observation the index (m,) of its image.
        corner: for each observation the number (m,) of its corner.
        pixels: observed positions (m, 2).
    """

    names: tuple[str, ...]
    image_index: Indices
    corner: Indices
    pixels: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "pixels", frozen_array(self.pixels, (None, 2), "pixels"))
        for name in ("image_index", "corner"):
            indices = frozen_indices(getattr(self, name), len(self.pixels), name)
            object.__setattr__(self, name, indices)

    def of(self, image: int) -> tuple[Indices, Array]:
        """Numbers (c,) and pixels (c, 2) of an image's corners."""
        seen = self.image_index == image
        return self.corner[seen], self.pixels[seen]


def corners_target(pattern: Pattern) -> Array:
    """Positions (k, 3) of the corners in the target frame, by number."""
    if isinstance(pattern, AprilTagGrid):
        side, pitch = pattern.tag_m, pattern.tag_m + pattern.gap_m
        tags = _lattice(pattern.tags_x, pattern.tags_y) * pitch
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * side
        plane = (tags[:, None] + square[None]).reshape(-1, 2)
    elif isinstance(pattern, Charuco):
        inner = _lattice(pattern.squares_x - 1, pattern.squares_y - 1)
        plane = (inner + 1.0) * pattern.square_m
    else:
        plane = _lattice(pattern.columns, pattern.rows) * 1.0
        if pattern.kind == "acircles":
            plane[:, 0] = 2 * plane[:, 0] + plane[:, 1] % 2
        plane *= pattern.spacing_m
    return np.column_stack([plane, np.zeros(len(plane))])


def _lattice(columns: int, rows: int) -> Array:
    """Column and row (columns * rows, 2) of the places of a grid, row by row."""
    y, x = np.mgrid[:rows, :columns]
    return np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)


def renumberings(pattern: Pattern) -> tuple[Indices, Indices]:
    """The numberings under which the layout of the corners is the same; colours are not looked at.

    Returns:
        Turned: (r, k), new number of every corner, the unchanged numbering first; the target turned
        in its plane. Mirrored: (s, k), the target seen from behind. Patterns whose corners carry
        their numbers have only the unchanged one.
    """
    corners = corners_target(pattern)[:, :2]
    identity = np.arange(len(corners))[None]
    if not isinstance(pattern, Grid):
        return identity, identity[:0]
    centred = corners - (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    tree = KDTree(centred)
    turned: list[Indices] = []
    mirrored: list[Indices] = []
    for quarter in range(4):
        turn = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarter)
        for flip, found in ((np.eye(2), turned), (np.diag([-1.0, 1.0]), mirrored)):
            distance, number = tree.query(centred @ (turn @ flip).T)
            if np.max(distance) < _COINCIDENT:
                found.append(np.asarray(number))
    k = len(corners)
    return np.array(turned).reshape(-1, k), np.array(mirrored, np.int64).reshape(-1, k)


def ambiguities(pattern: Pattern) -> Indices:
    """The numberings (r, k) that no image tells apart, the unchanged one first."""
    turned, _ = renumberings(pattern)
    if not isinstance(pattern, Grid) or pattern.kind != "chessboard":
        return turned
    # A square has the colour of the first one where column and row of its first corner sum up even.
    columns = pattern.columns
    first = turned[:, [0, 1, columns, columns + 1]].min(axis=1)
    return np.asarray(turned[(first // columns + first % columns) % 2 == 0])
