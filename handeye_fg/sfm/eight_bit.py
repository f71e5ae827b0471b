"""Images with 16 bits a pixel that use fewer, such as 12 of an industrial camera; entry point ``readable``.

COLMAP takes the upper eight bits: of such images it would see next to nothing.
"""

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from handeye_fg.sfm.stages import Stage, open_stage

_ALL_BITS = 16
_BITS_PER_SAMPLE = 258  # TIFF's tag
_DEPTH_AT = 24  # in a PNG file


def readable(
    stages: Path, images: Path, files: Mapping[str, Sequence[str | None]]
) -> tuple[Path, Mapping[str, Sequence[str | None]]]:
    """The folder of images that COLMAP can use: the given one, or copies with the used bits.

    Args:
        stages: folder of all stages.
        images: folder of the images.
        files: digests of all that is in the files, by the names of the images.

    Returns:
        The folder, and the digests of what is in it.

    Raises:
        InputDataError: the copies cannot be written.
    """
    deep = [name for name in files if _is_deep(images / name)]
    if not deep:
        return images, files

    def build(folder: Path, _: tuple[Stage, ...]) -> Mapping[str, Any]:
        # The same for all images: their brightness stays comparable.
        bits = max(int(_levels(images / name).max()).bit_length() for name in deep)
        if bits < _ALL_BITS:
            for name in files:
                copy = folder / "images" / name
                copy.parent.mkdir(parents=True, exist_ok=True)
                if name in deep:
                    levels = np.right_shift(_levels(images / name), max(bits - 8, 0))
                    if not cv2.imwrite(str(copy), levels.astype(np.uint8)):
                        raise OSError(f"{copy.name} could not be written")
                else:
                    shutil.copyfile(images / name, copy)
        return {"bits": bits}

    stage = open_stage(stages, "images", {"files": {n: files[n][0] for n in files}}, build)
    stage.finish()
    bits = stage.facts["bits"]
    if bits >= _ALL_BITS:
        return images, files
    return stage.folder / "images", {n: (*one, f"{bits} bits") for n, one in files.items()}


def _is_deep(path: Path) -> bool:
    """Whether a PNG or TIFF file has 16 bits a pixel and channel."""
    try:
        if path.suffix.lower() == ".png":
            with path.open("rb") as file:
                header = file.read(_DEPTH_AT + 1)
            return header[_DEPTH_AT:] == bytes([_ALL_BITS])
        if path.suffix.lower() in {".tif", ".tiff"}:
            with Image.open(path) as image:
                return _ALL_BITS in np.atleast_1d(image.getexif().get(_BITS_PER_SAMPLE, 8))
    except (OSError, SyntaxError, TypeError, ValueError):
        pass  # damaged: COLMAP will tell
    return False


def _levels(path: Path) -> NDArray[np.uint16]:
    """Grey levels (h, w), all bits; a zero where they cannot be read."""
    flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    levels = cv2.imread(str(path), flags)
    return np.zeros((1, 1), np.uint16) if levels is None else levels.astype(np.uint16)
