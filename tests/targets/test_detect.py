import cv2
import numpy as np
import pytest

from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.patterns import AprilTagGrid, Grid, ambiguities, corners_target, renumberings
from handeye_fg.targets import find_target
from handeye_fg.targets.detect import detector


def test_corners_are_found_where_they_are(pattern, camera, render, around, true_pixels):
    """OpenCV's convention of pixels not converted would be off by 0.7 px."""
    numberings = ambiguities(pattern)
    for pose in around(pattern, 3, np.random.default_rng(1)):
        numbers, pixels = detector(pattern)(render(pattern, camera, pose))
        assert len(numbers) == len(corners_target(pattern))
        expected = true_pixels(pattern, camera, pose)
        worst = min(
            np.linalg.norm(pixels - expected[turn[numbers]], axis=1).max() for turn in numberings
        )
        # The centre of a circle's image is not the image of its centre: 0.15 px.
        # A square corner comes out 0.2 px inside of a tag, as blur rounds it.
        assert worst < 0.4


@pytest.mark.parametrize(
    ("kind", "columns", "rows", "sides"),
    [
        ("circles", 7, 5, 2),
        ("circles", 6, 6, 4),
        ("acircles", 4, 9, 1),
        ("acircles", 4, 8, 2),
        ("chessboard", 8, 5, 1),  # 9 x 6 squares: dark and light corners tell the ends apart
        ("chessboard", 7, 5, 2),
        ("chessboard", 6, 6, 4),  # 7 x 7 squares
        ("chessboard", 7, 7, 2),  # 8 x 8 squares: a quarter turn swaps the colours
    ],
)
def test_from_how_many_sides_a_pattern_looks_the_same(kind, columns, rows, sides):
    pattern = Grid(kind=kind, columns=columns, rows=rows, spacing_m=0.02)
    found = ambiguities(pattern)
    assert len(found) == sides
    assert (found[0] == np.arange(columns * rows)).all()
    assert all(sorted(turn) == list(range(columns * rows)) for turn in found)


def test_a_numbered_pattern_looks_the_same_from_one_side(patterns):
    for kind in ("charuco", "apriltag_grid"):
        turned, mirrored = renumberings(patterns[kind])
        assert len(turned) == 1
        assert len(mirrored) == 0


@pytest.mark.parametrize("columns", [6, 8, 9])
def test_a_chessboard_with_two_ends_is_numbered_from_the_same_one(
    columns, camera, render, around, true_pixels
):
    pattern = Grid(kind="chessboard", columns=columns, rows=5, spacing_m=0.025)
    if len(ambiguities(pattern)) > 1:
        pattern = Grid(kind="chessboard", columns=columns, rows=6, spacing_m=0.025)
    for pose in around(pattern, 4, np.random.default_rng(2)):
        numbers, pixels = detector(pattern)(render(pattern, camera, pose))
        assert (
            np.linalg.norm(pixels - true_pixels(pattern, camera, pose)[numbers], axis=1).max() < 0.3
        )


def test_no_numbering_shows_the_target_from_behind(camera, render, around):
    """A square grid may come out transposed: a camera in front of it sees x to y clockwise."""
    pattern = Grid(kind="circles", columns=6, rows=6, spacing_m=0.025)
    for pose in around(pattern, 6, np.random.default_rng(3)):
        numbers, pixels = detector(pattern)(render(pattern, camera, pose))
        place = pixels[np.argsort(numbers)]
        along, down = place[5] - place[0], place[30] - place[0]
        assert along[0] * down[1] - along[1] * down[0] > 0


def test_a_mirrored_numbering_is_turned_round(camera, render, around, true_pixels, monkeypatch):
    pattern = Grid(kind="circles", columns=7, rows=5, spacing_m=0.025)
    pose = around(pattern, 1, np.random.default_rng(4))[0]
    seen = true_pixels(pattern, camera, pose) - 0.5
    mirrored = seen.reshape(5, 7, 2)[:, ::-1].reshape(-1, 1, 2).astype(np.float32)
    monkeypatch.setattr(cv2, "findCirclesGrid", lambda *_, **__: (True, mirrored))
    numbers, pixels = detector(pattern)(np.zeros((480, 640), np.uint8))
    off = [np.abs(pixels - (seen + 0.5)[turn[numbers]]).max() for turn in ambiguities(pattern)]
    assert min(off) < 1e-3


def test_nothing_is_found_where_nothing_is(pattern):
    noise = np.random.default_rng(5).integers(0, 255, (240, 320)).astype(np.uint8)
    for grey in (noise, np.full((240, 320), 200, np.uint8)):
        numbers, pixels = detector(pattern)(grey)
        assert len(numbers) == 0
        assert pixels.shape == (0, 2)


def test_tags_of_another_grid_are_not_taken(camera, render, around, patterns):
    pattern = patterns["apriltag_grid"]
    pose = around(pattern, 1, np.random.default_rng(6))[0]
    image = render(pattern, camera, pose)
    values = {name: getattr(pattern, name) for name in ("tags_x", "tags_y", "tag_m", "gap_m")}
    other = AprilTagGrid(**values, family=pattern.family, first_id=10)
    numbers, _ = detector(other)(image)
    assert sorted(set(numbers // 4)) == [0, 1]
    numbers, _ = detector(AprilTagGrid(**values, family=pattern.family, first_id=500))(image)
    assert len(numbers) == 0


def test_images_with_and_without_the_target(tmp_path, camera, render, around, patterns):
    pattern = patterns["charuco"]
    pose = around(pattern, 1, np.random.default_rng(7))[0]
    cv2.imwrite(str(tmp_path / "a.png"), render(pattern, camera, pose))
    cv2.imwrite(str(tmp_path / "b.png"), np.full((480, 640), 90, np.uint8))
    told = []
    found = find_target(tmp_path, ["a.png", "b.png"], pattern, lambda *args: told.append(args))
    assert found.names == ("a.png",)
    assert told == [("target", 1, 2), ("target", 2, 2)]
    numbers, pixels = found.of(0)
    assert len(numbers) == len(pixels) == 24

    with pytest.raises(ReconstructionError, match="found in none of the 1 images") as caught:
        find_target(tmp_path, ["b.png"], pattern)
    assert str(caught.value).count(". ") == 0
    with pytest.raises(InputDataError, match=r"missing\.png: cannot be decoded"):
        find_target(tmp_path, ["missing.png"], pattern)
