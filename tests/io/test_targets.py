from pathlib import Path

import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.io.targets import read_target
from handeye_fg.patterns import AprilTagGrid, Charuco, Grid, Target

CHARUCO = """kind: charuco
squares_x: 9
squares_y: 6
square_m: 3e-2
marker_m: 0.022
dictionary: DICT_5X5_100
"""


def read(folder: Path, text: str) -> Target:
    path = folder / "board.yaml"
    path.write_text(text, encoding="utf-8")
    return read_target(path)


def test_charuco(tmp_path: Path) -> None:
    pattern = Charuco(
        squares_x=9, squares_y=6, square_m=0.03, marker_m=0.022, dictionary="DICT_5X5_100"
    )
    assert read(tmp_path, "# comment\n" + CHARUCO) == Target(pattern=pattern, accuracy_m=1e-4)
    legacy = read(tmp_path, CHARUCO + "legacy: true\naccuracy_m: 0.0005\n")
    assert isinstance(legacy.pattern, Charuco)
    assert legacy.pattern.legacy
    assert legacy.accuracy_m == 5e-4


def test_chessboard_counts_squares(tmp_path: Path) -> None:
    target = read(tmp_path, "kind: chessboard\nsquares_x: 9\nsquares_y: 7\nsquare_m: 0.025")
    assert target.pattern == Grid(kind="chessboard", columns=8, rows=6, spacing_m=0.025)


@pytest.mark.parametrize("kind", ["circles", "acircles"])
def test_circles(tmp_path: Path, kind: str) -> None:
    target = read(tmp_path, f"kind: {kind}\ncolumns: 4\nrows: 11\nspacing_m: 0.02")
    assert target.pattern == Grid(kind=kind, columns=4, rows=11, spacing_m=0.02)  # type: ignore[arg-type]  # kind is parametrised


def test_apriltag_grid(tmp_path: Path) -> None:
    text = "kind: apriltag_grid\ntags_x: 6\ntags_y: 6\ntag_m: 0.088\ngap_m: 0.0264\nfamily: 36h11\n"
    pattern = AprilTagGrid(
        tags_x=6, tags_y=6, tag_m=0.088, gap_m=0.0264, family="DICT_APRILTAG_36h11"
    )
    assert read(tmp_path, text).pattern == pattern
    later = read(tmp_path, text + "first_id: 36\n").pattern
    assert isinstance(later, AprilTagGrid)
    assert later.first_id == 36


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("kind: charuco", "", "kind is missing"),
        ("kind: charuco", "kind: dots", "kind is 'dots', but must be one of 'charuco'"),
        ("squares_x: 9", "", "squares_x is missing"),
        ("squares_x: 9", "squares_x: 2", "squares_x is 2"),
        ("squares_x: 9", "squares_x: 9.5", "squares_x is 9.5"),
        ("square_m: 3e-2", "square_m: 30", "square_m is 30, but must be a length"),
        ("square_m: 3e-2", "square_m: -0.03", "square_m is -0.03"),
        ("square_m: 3e-2", "square_m: .nan", "square_m is nan"),
        ("marker_m: 0.022", "marker_m: 0.03", "less than square_m"),
        ("DICT_5X5_100", "DICT_5X5", "dictionary is 'DICT_5X5'"),
        ("squares_y: 6", "squares_y: 6\nrows: 5", "rows is 5, but must be left out"),
        ("squares_y: 6", "squares_y: 6\nlegacy: 1", "legacy is 1"),
        ("squares_y: 6", "squares_y: 6\naccuracy_m: 0", "accuracy_m is 0"),
        (CHARUCO, "", "the file is empty"),
        (CHARUCO, "- charuco", "wanted one mapping"),
        (CHARUCO, "kind: [", "not valid YAML"),
        (CHARUCO, "kind: !!python/object:os.system charuco", "not valid YAML"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    with pytest.raises(InputDataError) as caught:
        read(tmp_path, CHARUCO.replace(old, new))
    message = str(caught.value)
    assert message.startswith(f"target file {tmp_path / 'board.yaml'}")
    assert said in message
    assert "\n" not in message
    assert ". " not in message


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="no such file"):
        read_target(tmp_path / "none.yaml")
