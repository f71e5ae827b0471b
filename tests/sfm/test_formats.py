"""Image files of all kinds: what COLMAP sees in them is what we see."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from numpy.typing import NDArray
from PIL import Image

from handeye_fg.io.images import read_image_set
from handeye_fg.options import SfmOptions
from handeye_fg.progress import silent
from handeye_fg.sfm.cache import file_digests
from handeye_fg.sfm.eight_bit import readable
from handeye_fg.sfm.features import STRICT, find_features
from handeye_fg.sfm.stages import prepare
from handeye_fg.targets.detect import _grey
from tabletop import TABLETOP

Grey = NDArray[np.uint8]
IMAGE = TABLETOP / "images" / "frame_0000.jpg"


@pytest.fixture(scope="module")
def grey() -> Grey:
    whole = cv2.imread(str(IMAGE), cv2.IMREAD_GRAYSCALE)
    assert whole is not None
    return np.asarray(cv2.resize(whole, (320, 240), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def opencv(change: Callable[[Grey], NDArray[np.generic]]) -> Callable[[Path, Grey], object]:
    return lambda path, grey: cv2.imwrite(str(path), change(grey))


def pillow(mode: str = "L", **how: object) -> Callable[[Path, Grey], None]:
    return lambda path, grey: Image.fromarray(grey).convert(mode).save(path, **how)


def colour(grey: Grey) -> NDArray[np.generic]:
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


ORIENTED = Image.Exif()
ORIENTED[0x0112] = 6

EXACT: dict[str, Callable[[Path, Grey], object]] = {
    "grey.png": opencv(lambda grey: grey),
    "grey of 16 bits.png": opencv(lambda grey: grey.astype(np.uint16) * 257),
    "grey of 12 bits in 16.png": opencv(lambda grey: grey.astype(np.uint16) * 16 + 7),
    "grey of 10 bits in 16.tif": opencv(lambda grey: grey.astype(np.uint16) * 4),
    "grey of 16 bits.TIFF": opencv(lambda grey: grey.astype(np.uint16) * 257),
    "colour ü日.PNG": opencv(colour),
    "colour of 16 bits.png": opencv(lambda grey: colour(grey).astype(np.uint16) * 257),
    "colour of 12 bits in 16.png": opencv(lambda grey: colour(grey).astype(np.uint16) * 16),
    "colour with alpha.png": opencv(lambda grey: cv2.cvtColor(grey, cv2.COLOR_GRAY2BGRA)),
    "grey.bmp": pillow(),
    "palette.Bmp": pillow("P"),
    "colour.bmp": pillow("RGB"),
    "packed.tif": pillow(compression="tiff_lzw"),
    "grey with alpha.tif": pillow("LA"),
    "turned.tif": pillow(exif=ORIENTED),
    "grey.pgm": pillow(),
    "colour.ppm": pillow("RGB"),
}


def features(path: Path, out: Path) -> tuple[NDArray[np.float32], pycolmap.Camera]:
    stages = prepare(out / "stages")
    images, files = readable(stages, path.parent, file_digests(path.parent, [path.name], None))
    stage = find_features(
        stages,
        images,
        files,
        masks=None,
        sensitivity=STRICT,
        options=SfmOptions(max_features=500, threads=1),
        progress=silent,
    )
    with pycolmap.Database.open(stage.database) as db:
        (image,) = db.read_all_images()
        assert image.name == path.name
        return np.asarray(db.read_keypoints(image.image_id)), db.read_all_cameras()[0]


@pytest.fixture(scope="module")
def expected(grey: Grey, tmp_path_factory: pytest.TempPathFactory) -> NDArray[np.float32]:
    folder = tmp_path_factory.mktemp("expected")
    cv2.imwrite(str(folder / "a.png"), grey)
    found, _ = features(folder / "a.png", folder)
    assert len(found) > 200
    return found


@pytest.mark.parametrize("name", EXACT)
def test_all_formats_show_the_same(
    name: str, grey: Grey, expected: NDArray[np.float32], tmp_path: Path
) -> None:
    path = tmp_path / "images" / name
    path.parent.mkdir()
    EXACT[name](path, grey)
    assert read_image_set(path.parent, [path.name]).size == (320, 240)
    found, _ = features(path, tmp_path)
    if "colour" in name and ".png" not in name.lower():
        # Weights of red, green and blue that add up to a little less than 1.
        assert abs(len(found) - len(expected)) < 10
    else:
        np.testing.assert_array_equal(found, expected)
    if "turned" not in name:  # OpenCV does not read this file
        np.testing.assert_allclose(_grey(path), grey, atol=1)


@pytest.mark.parametrize("kind", [{}, {"exif": ORIENTED}])
def test_jpeg_is_used_as_stored(
    kind: dict[str, Image.Exif], grey: Grey, expected: NDArray[np.float32], tmp_path: Path
) -> None:
    """An orientation tag is applied by none of the readers."""
    path = tmp_path / "images" / "a.JPEG"
    path.parent.mkdir()
    pillow(quality=100, **kind)(path, grey)
    assert read_image_set(path.parent, [path.name]).size == (320, 240)
    assert _grey(path).shape == (240, 320)
    found, camera = features(path, tmp_path)
    assert (camera.width, camera.height) == (320, 240)
    assert abs(len(found) - len(expected)) < 20


def test_focal_length_of_the_file_is_the_start_without_a_camera(grey: Grey, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA405] = 28  # mm, of a film 36 mm wide
    path = tmp_path / "images" / "a.jpg"
    path.parent.mkdir()
    pillow(exif=exif)(path, grey)
    _, camera = features(path, tmp_path)
    # COLMAP goes by the diagonals: 400 pixels, 43.27 mm.
    assert camera.focal_length_x == pytest.approx(28 * 400 / 43.27, rel=1e-3)


def test_copies_with_fewer_bits_are_of_one_brightness(grey: Grey, tmp_path: Path) -> None:
    """The bits that the brightest image needs count for all."""
    folder = tmp_path / "images"
    folder.mkdir()
    cv2.imwrite(str(folder / "bright.png"), grey.astype(np.uint16) * 16)
    cv2.imwrite(str(folder / "dim.png"), grey.astype(np.uint16) * 4)
    cv2.imwrite(str(folder / "plain.png"), grey)
    names = ["bright.png", "dim.png", "plain.png"]
    stages = prepare(tmp_path / "stages")
    images, files = readable(stages, folder, file_digests(folder, names, None))
    assert images != folder
    assert all(one[-1] == "12 bits" for one in files.values())
    read = [cv2.imread(str(images / name), cv2.IMREAD_UNCHANGED) for name in names]
    np.testing.assert_array_equal(read[0], grey)
    np.testing.assert_array_equal(read[1], grey // 4)
    np.testing.assert_array_equal(read[2], grey)
