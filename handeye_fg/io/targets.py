"""Target files: which known target (board) the images show."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from handeye_fg.io.fields import Fields
from handeye_fg.io.yaml_files import read_yaml
from handeye_fg.patterns import AprilTagGrid, Charuco, Grid, Pattern, Target

_REMEDY = "correct the target file"
_WANTED = (
    "a target file with the key kind, one of charuco, chessboard, circles, acircles, apriltag_grid"
)
_LARGEST_COUNT = 100
_LARGEST_M = 10.0
# A length below a tenth of a millimetre, or a board of more than 10 m, was not given in metres.
_SMALLEST_M = 1e-4
_FAMILIES = ("16h5", "25h9", "36h10", "36h11")
_DICTIONARIES = (
    "DICT_ARUCO_ORIGINAL",
    "DICT_ARUCO_MIP_36h12",
    *(f"DICT_{bits}X{bits}_{n}" for bits in (4, 5, 6, 7) for n in (50, 100, 250, 1000)),
    *(f"DICT_APRILTAG_{family}" for family in _FAMILIES),
)
_COMMON = ("kind", "accuracy_m")


def read_target(path: Path) -> Target:
    """Read a target file.

    Its key ``kind`` says which of the others there are; lengths are metres:

    - ``charuco``: squares_x, squares_y, square_m, marker_m, dictionary, optionally legacy (true for
      boards as OpenCV before 4.6 drew them);
    - ``chessboard``: squares_x, squares_y, square_m;
    - ``circles`` (square grid) and ``acircles`` (every other row shifted): columns, rows, spacing_m;
    - ``apriltag_grid``: tags_x, tags_y, tag_m, gap_m, family (such as 36h11), optionally first_id.

    With any of them ``accuracy_m``, the standard deviation of the corners' positions on the real
    target, may be given; it is 0.1 mm otherwise, that of a good print.

    Args:
        path: the file.

    Raises:
        InputDataError: the file is missing, not YAML or of another kind, a key is missing or unknown,
            or a value is impossible.
    """
    fields = read_yaml(path, "target file", _WANTED, _REMEDY)
    read, keys = _READERS[fields.text("kind", tuple(_READERS))]
    unknown = [key for key in fields.values if key not in (*_COMMON, *keys)]
    if unknown:
        raise fields.error(unknown[0], f"left out, as only {', '.join((*keys, *_COMMON))} are read")
    pattern = read(fields)
    if "accuracy_m" not in fields.values:
        return Target(pattern=pattern)
    return Target(pattern=pattern, accuracy_m=_length(fields, "accuracy_m", least=1e-6))


def _charuco(fields: Fields) -> Pattern:
    square, marker = _length(fields, "square_m"), _length(fields, "marker_m")
    if marker >= square:
        raise fields.error("marker_m", f"less than square_m ({square:g})")
    return Charuco(
        squares_x=_count(fields, "squares_x", least=3),
        squares_y=_count(fields, "squares_y", least=3),
        square_m=square,
        marker_m=marker,
        dictionary=fields.text("dictionary", _DICTIONARIES),
        legacy=fields.flag("legacy") if "legacy" in fields.values else False,
    )


def _chessboard(fields: Fields) -> Pattern:
    return Grid(
        kind="chessboard",
        columns=_count(fields, "squares_x", least=4) - 1,
        rows=_count(fields, "squares_y", least=4) - 1,
        spacing_m=_length(fields, "square_m"),
    )


def _circles(kind: Literal["circles", "acircles"]) -> Callable[[Fields], Pattern]:
    def read(fields: Fields) -> Pattern:
        return Grid(
            kind=kind,
            columns=_count(fields, "columns", least=3),
            rows=_count(fields, "rows", least=3),
            spacing_m=_length(fields, "spacing_m"),
        )

    return read


def _apriltag_grid(fields: Fields) -> Pattern:
    return AprilTagGrid(
        tags_x=_count(fields, "tags_x", least=1),
        tags_y=_count(fields, "tags_y", least=1),
        tag_m=_length(fields, "tag_m"),
        gap_m=_length(fields, "gap_m"),
        family=f"DICT_APRILTAG_{fields.text('family', _FAMILIES)}",
        first_id=fields.integer("first_id", most=10_000) if "first_id" in fields.values else 0,
    )


_READERS: Mapping[str, tuple[Callable[[Fields], Pattern], tuple[str, ...]]] = MappingProxyType(
    {
        "charuco": (
            _charuco,
            ("squares_x", "squares_y", "square_m", "marker_m", "dictionary", "legacy"),
        ),
        "chessboard": (_chessboard, ("squares_x", "squares_y", "square_m")),
        "circles": (_circles("circles"), ("columns", "rows", "spacing_m")),
        "acircles": (_circles("acircles"), ("columns", "rows", "spacing_m")),
        "apriltag_grid": (
            _apriltag_grid,
            ("tags_x", "tags_y", "tag_m", "gap_m", "family", "first_id"),
        ),
    }
)


def _count(fields: Fields, key: str, *, least: int) -> int:
    return fields.integer(key, least=least, most=_LARGEST_COUNT)


def _length(fields: Fields, key: str, *, least: float = _SMALLEST_M) -> float:
    length = fields.number(key)
    if not least <= length <= _LARGEST_M:
        raise fields.error(key, f"a length from {least:g} to {_LARGEST_M:g} metres")
    return length
