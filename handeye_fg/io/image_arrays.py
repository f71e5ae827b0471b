"""Images that are arrays, as the files that structure from motion reads; entry point ``as_folder``."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import shown
from handeye_fg.io.images import SUFFIXES
from handeye_fg.io.poses.names import check_name

Pixels = NDArray[np.uint8] | NDArray[np.bool_]
ImageArrays = Mapping[str, Pixels]
"""Images by name: grey (h, w) or RGB (h, w, 3), uint8; masks (h, w) may be boolean."""


@contextmanager
def as_folder(images: str | Path | ImageArrays, suffix: str = "") -> Iterator[Path]:
    """A folder with the images: that which is given, or for arrays one that is gone in the end.

    Args:
        images: folder, or arrays by name; of several cameras with folders in the names.
        suffix: what the file's name has after the image's: ".png" for masks.

    Raises:
        InputDataError: a name is none of an image, or an array holds no image.
    """
    if isinstance(images, str | Path):
        yield Path(images)
        return
    with TemporaryDirectory() as scratch:
        for name, pixels in images.items():
            check_name(name, "images")
            if Path(name).suffix.lower() not in SUFFIXES:
                raise InputDataError(
                    f"images: the name {shown(name)} does not end in {', '.join(SUFFIXES)}; name the images as files"
                )
            path = Path(scratch) / f"{name}{suffix}"
            path.parent.mkdir(parents=True, exist_ok=True)
            # Without loss whatever the name says: readers look at the content.
            Image.fromarray(_checked(pixels, name)).save(path, format="PNG", compress_level=1)
        yield Path(scratch)


def _checked(pixels: object, name: str) -> NDArray[np.uint8]:
    array = np.asarray(pixels)
    if array.dtype == np.bool_:
        array = 255 * array.astype(np.uint8)
    is_image = array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)
    if array.dtype != np.uint8 or not is_image or not array.size:
        raise InputDataError(
            f"image {shown(name)}: is an array of {array.dtype} and shape {array.shape}, but must be uint8 of shape "
            "(height, width) or (height, width, 3); convert it"
        )
    return np.ascontiguousarray(array)
