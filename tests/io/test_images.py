import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handeye_fg.errors import InputDataError
from handeye_fg.io import images
from handeye_fg.io.images import (
    check_masks,
    list_cameras,
    list_images,
    pair_names,
    pose_name,
    read_image_set,
)


def image(path: Path, size: tuple[int, int] = (32, 24), mode: str = "RGB") -> Path:
    channels = () if mode == "L" else (3,)
    pixels = np.random.default_rng(0).integers(0, 255, (size[1], size[0], *channels), np.uint8)
    Image.fromarray(pixels).save(path)
    return path


def size_of(path: Path) -> tuple[int, int]:
    return read_image_set(path.parent, [path.name]).size


def test_listing_takes_images_by_suffix_and_sorts(tmp_path: Path) -> None:
    names = ["b.JPG", "a.jpeg", "c.png", "d.TIF", "e.tiff", "f.Bmp", "<b>&.png"]
    for name in [*names, "notes.txt", ".hidden.jpg", "png"]:
        (tmp_path / name).touch()
    (tmp_path / "folder.png").mkdir()
    assert list_images(tmp_path) == tuple(sorted(names))


def test_listing_needs_a_folder_with_images(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match=r"image folder .*none: cannot be read \(No such"):
        list_images(tmp_path / "none")
    with pytest.raises(InputDataError, match=r"no image found, but files named \.bmp \.jpeg"):
        list_images(tmp_path)


def test_sub_folders_with_images_are_cameras(tmp_path: Path) -> None:
    for name in ("right/b.jpg", "right/a.jpg", "left/a.jpg", ".old/a.jpg", "notes/a.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert list_cameras(tmp_path) == ("left/a.jpg", "right/a.jpg", "right/b.jpg")
    (tmp_path / "c.jpg").touch()
    with pytest.raises(
        InputDataError, match="1 images lie in it and others in its sub-folder 'left'"
    ):
        list_cameras(tmp_path)


def test_a_folder_without_sub_folders_is_one_camera(tmp_path: Path) -> None:
    with pytest.raises(InputDataError, match="no image found"):
        list_cameras(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.jpg").touch()
    assert list_cameras(tmp_path) == ("a.jpg",)
    with pytest.raises(InputDataError, match="cannot be read"):
        list_cameras(tmp_path / "none")


def test_images_of_several_cameras_share_a_pose() -> None:
    images = ("left/a.jpg", "left/b.jpg", "right/a.jpg", "right/c.jpg")
    pairing = pair_names(images, ("a.jpg", "c.jpg", "d.jpg", "left/b.jpg"))
    assert pairing.paired == images
    assert pairing.poses_without_image == ("d.jpg",)
    assert pairing.images_without_pose == ()
    # A pose under the whole name comes before that of the file's.
    assert pose_name("left/a.jpg", ("a.jpg", "left/a.jpg")) == "left/a.jpg"
    assert pose_name("left/a.jpg", ("right/a.jpg",)) is None


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "bmp"])
def test_whole_images_give_their_size(tmp_path: Path, suffix: str) -> None:
    assert size_of(image(tmp_path / f"a.{suffix}")) == (32, 24)


def test_an_orientation_tag_does_not_change_the_size(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags[0x0112] = 6  # to be turned by 90 degrees
    Image.new("RGB", (32, 24)).save(tmp_path / "a.jpg", exif=tags)
    assert size_of(tmp_path / "a.jpg") == (32, 24)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif", "bmp"])
@pytest.mark.parametrize("kept", [0.02, 0.5, 0.9])
def test_truncated_images_are_refused(tmp_path: Path, suffix: str, kept: float) -> None:
    path = image(tmp_path / f"a.{suffix}")
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content))])
    with pytest.raises(InputDataError, match=rf"^image .*a\.{suffix}: cannot be decoded \(.+\)"):
        size_of(path)


def test_other_unusable_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.png").touch()
    with pytest.raises(InputDataError, match=r"empty\.png: cannot be decoded \(the file is empty"):
        size_of(tmp_path / "empty.png")
    (tmp_path / "text.png").write_text("no image")
    with pytest.raises(InputDataError, match=r"text\.png: cannot be decoded \(cannot identify"):
        size_of(tmp_path / "text.png")
    with pytest.raises(InputDataError, match=r"none\.png: no such file"):
        size_of(tmp_path / "none.png")
    with pytest.raises(InputDataError, match=r"cannot be decoded \(.*directory"):
        size_of(tmp_path)


def test_damaged_bytes_give_a_size_or_an_input_data_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for suffix in ("jpg", "png", "tif", "bmp"):
        content = bytearray(image(tmp_path / f"a.{suffix}").read_bytes())
        for _ in range(40):
            damaged = bytearray(content)
            for place in rng.integers(0, min(len(damaged), 300), 3):
                damaged[place] = int(rng.integers(256))
            (tmp_path / f"b.{suffix}").write_bytes(damaged)
            try:
                width, height = size_of(tmp_path / f"b.{suffix}")
            except InputDataError:
                continue
            assert width > 0
            assert height > 0


@pytest.mark.parametrize("factor", [0.4, 0.9])  # Pillow raises above twice the limit, else warns
def test_decompression_bombs_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: float
) -> None:
    monkeypatch.setattr(images.Image, "MAX_IMAGE_PIXELS", int(factor * 32 * 24))
    with pytest.raises(InputDataError, match=r"a\.png: too large to decode safely \(Image size"):
        size_of(image(tmp_path / "a.png"))


def test_an_image_set_is_read_whole(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        image(tmp_path / name)
    calls: list[tuple[str, int, int | None]] = []
    found = read_image_set(tmp_path, ["a.png", "b.png"], lambda *call: calls.append(call))
    assert found.size == (32, 24)
    assert list(found.looks) == ["a.png", "b.png"]
    assert found.unusable == ()
    assert calls == [("images", 1, 2), ("images", 2, 2)]


def test_images_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    names = [f"{k}.png" for k in range(7)]
    for name in names[:5]:
        image(tmp_path / name)
    whole = image(tmp_path / "5.png").read_bytes()
    (tmp_path / "5.png").write_bytes(whole[: len(whole) // 2])
    image(tmp_path / "6.png", (24, 32))
    found = read_image_set(tmp_path, names)
    assert list(found.looks) == names[:5]
    (damaged, why), (turned, size) = found.unusable
    assert (damaged, turned) == ("5.png", "6.png")
    assert why.startswith("cannot be decoded (image file is truncated")
    assert size == "24 x 32 pixels, but the others have 32 x 24"


def test_an_image_set_of_several_sizes_is_refused(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        image(tmp_path / name)
    image(tmp_path / "c.png", (24, 32))
    with pytest.raises(
        InputDataError, match=r"c\.png: 24 x 32 pixels, but a\.png has 32 x 24, as 2"
    ):
        read_image_set(tmp_path, ["a.png", "b.png", "c.png"])


def test_a_set_without_any_image_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    with pytest.raises(InputDataError, match=r"a\.png: cannot be decoded \(the file is empty"):
        read_image_set(tmp_path, ["a.png"])


def test_sixteen_bits_look_as_eight(tmp_path: Path) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (24, 32)).astype(np.uint16)
    Image.fromarray(levels.astype(np.uint8)).save(tmp_path / "a.png")
    Image.fromarray(levels << 8).save(tmp_path / "b.png")
    looks = read_image_set(tmp_path, ["a.png", "b.png"]).looks
    assert looks["a.png"].content == looks["b.png"].content


def test_masks(tmp_path: Path) -> None:
    mask = tmp_path / "a.jpg.png"
    with pytest.raises(InputDataError, match=r"a\.jpg\.png: no such file, but image a\.jpg needs"):
        check_masks(tmp_path, ["a.jpg"], (32, 24))
    image(mask, mode="L")
    check_masks(tmp_path, ["a.jpg"], (32, 24))
    with pytest.raises(InputDataError, match="32 x 24 pixels, but the images have 64 x 48"):
        check_masks(tmp_path, ["a.jpg"], (64, 48))
    for mode in ("L", "RGB", "RGBA", "P", "1", "I;16"):
        Image.new(mode, (32, 24), (0, 0, 0, 255) if mode == "RGBA" else None or 0).save(mask)
        with pytest.raises(InputDataError, match=r"a\.jpg\.png: all black"):
            check_masks(tmp_path, ["a.jpg"], (32, 24))
    mask.write_bytes(mask.read_bytes()[:40])
    with pytest.raises(InputDataError, match=r"^mask .*a\.jpg\.png: cannot be decoded"):
        check_masks(tmp_path, ["a.jpg"], (32, 24))


def test_pairing_is_by_name_and_says_what_is_left_out() -> None:
    pairing = pair_names(["a", "b", "c"], ["d", "c", "a"])
    assert pairing.paired == ("a", "c")
    assert pairing.images_without_pose == ("b",)
    assert pairing.poses_without_image == ("d",)


def test_nothing_to_pair_shows_examples() -> None:
    with pytest.raises(InputDataError, match=r"like 'a\.png', poses like 'a';"):
        pair_names(["a.png", "b.png"], ["a", "b"])
    with pytest.raises(InputDataError, match=r"like 'a\.png', poses like \(none\)"):
        pair_names(["a.png"], [])


def test_names_that_are_not_unicode_can_be_listed_and_shown(tmp_path: Path) -> None:
    name = os.fsdecode(b"frame_\xff.png")
    image(tmp_path / "a.png").rename(tmp_path / name)
    assert list_images(tmp_path) == (name,)
    with pytest.raises(InputDataError, match="udcff"):
        pair_names(list_images(tmp_path), ["a.png"])


def test_tags_that_would_turn_images_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    image(tmp_path / "a.jpg")
    read_image_set(tmp_path, ["a.jpg"])
    assert not caplog.records
    exif = Image.Exif()
    exif[0x0112] = 3
    Image.new("RGB", (32, 24)).save(tmp_path / "b.jpg", exif=exif)
    read_image_set(tmp_path, ["a.jpg", "b.jpg"])
    assert "1 images, b.jpg first, have a tag" in caplog.text
    assert "used as stored" in caplog.text


@pytest.mark.parametrize("mode", ["F", "I"])
def test_pixels_of_32_bits_are_refused(tmp_path: Path, mode: str) -> None:
    Image.new(mode, (32, 24)).save(tmp_path / "a.tif")
    with pytest.raises(InputDataError, match=r"a\.tif: pixels of 32 bits, but 8 or 16 were wanted"):
        size_of(tmp_path / "a.tif")
