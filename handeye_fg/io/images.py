"""Image and mask files: what is in a folder, whether it can be decoded, and pairing by name."""

import logging
import struct
import warnings
import zlib
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown
from handeye_fg.looks import Look, look_at
from handeye_fg.progress import Progress, silent

_log = logging.getLogger(__name__)

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff")

# More images of another size than this part are no slip: then it is not clear which size is meant.
_MOST_OF_OTHER_SIZE = 0.2
# Pillow's modes of integers and numbers of 32 bits.
_TOO_DEEP = ("F", "I")
_ORIENTATION, _UPRIGHT = 0x0112, 1  # an EXIF tag

# What Pillow's decoders raise on damaged files.
_DAMAGED = (
    OSError,
    SyntaxError,
    ValueError,
    TypeError,
    EOFError,
    LookupError,
    ArithmeticError,
    MemoryError,
    struct.error,
    zlib.error,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pairing:
    """Images and poses put together by name.

    Attributes:
        paired: names with an image and a pose, in the order of the images.
        images_without_pose, poses_without_image: names that are left out.
    """

    paired: tuple[str, ...]
    images_without_pose: tuple[str, ...]
    poses_without_image: tuple[str, ...]


def list_images(folder: Path) -> tuple[str, ...]:
    """Names of the JPEG, PNG, TIFF, BMP, PGM and PPM files of a folder, sorted.

    Files are chosen by suffix in upper or lower case. Subfolders and hidden files are left out.

    Args:
        folder: where the images are.

    Returns:
        The names, at least one.

    Raises:
        InputDataError: there is no such folder or no image in it.
    """
    names = _images(folder)
    if not names:
        raise InputDataError(
            f"image folder {folder}: no image found, but files named {' '.join(SUFFIXES)} were"
            " wanted; give the folder that holds the images"
        )
    return names


def _images(folder: Path) -> tuple[str, ...]:
    """Names of the images in a folder, sorted."""
    try:
        return tuple(
            sorted(
                entry.name
                for entry in folder.iterdir()
                if entry.suffix.lower() in SUFFIXES
                and not entry.name.startswith(".")
                and entry.is_file()
            )
        )
    except (OSError, ValueError) as error:
        raise InputDataError(
            f"image folder {folder}: cannot be read ({reason(error)}); give the folder that holds the images"
        ) from error


def list_cameras(folder: Path) -> tuple[str, ...]:
    """Names of the images of one camera, or of several cameras, each with a sub-folder.

    Args:
        folder: holds the images, or sub-folders that do; those without images, and hidden ones, are
            left out.

    Returns:
        The names, sorted, at least one; with sub-folders in the form ``cam0/000.jpg``.

    Raises:
        InputDataError: there is no image, or images lie both in the folder and in sub-folders.
    """
    single = _images(folder)
    several = {
        entry.name: _images(entry)
        for entry in sorted(folder.iterdir())
        if entry.is_dir() and not entry.name.startswith(".")
    }
    with_images = [name for name, images in several.items() if images]
    if single and with_images:
        raise InputDataError(
            f"image folder {folder}: {len(single)} images lie in it and others in its sub-folder "
            f"{shown(with_images[0])}; give each camera a sub-folder of its own, or move the"
            " sub-folders elsewhere if they are no cameras"
        )
    if not with_images:
        return list_images(folder)
    return tuple(f"{name}/{image}" for name in with_images for image in several[name])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageSet:
    """The images of one camera.

    Attributes:
        size: width and height of all of them, pixels.
        looks: of those that can be used, by name.
        unusable: (name, reason) of those that cannot be decoded or have another size.
    """

    size: tuple[int, int]
    looks: Mapping[str, Look]
    unusable: tuple[tuple[str, str], ...]


def read_image_set(folder: Path, names: Sequence[str], progress: Progress = silent) -> ImageSet:
    """Decode all images, and tell those that cannot be used.

    Args:
        folder: where the images are.
        names: names of the files, at least one.
        progress: told of stage "images" after each image.

    Raises:
        InputDataError: no image can be decoded, or more than a fifth have another size than most.
    """
    looks: dict[str, Look] = {}
    sizes: dict[str, tuple[int, int]] = {}
    damaged: dict[str, InputDataError] = {}
    tagged: list[str] = []
    for k, name in enumerate(names):
        try:
            image = _decoded(folder / name, "image")
            tagged += [name] if image.getexif().get(_ORIENTATION, _UPRIGHT) != _UPRIGHT else []
            sizes[name], looks[name] = image.size, look_at(_grey(image))
        except InputDataError as error:
            damaged[name] = error
        progress("images", k + 1, len(names))
    if not looks:
        raise damaged[names[0]]
    if tagged:
        _log.warning(
            "%d images, %s first, have a tag that says how to turn them for display; they are used as stored, and "
            "the camera file must be for stored images (OpenCV turns them when it reads them)",
            len(tagged),
            tagged[0],
        )
    size, n_of_size = Counter(sizes.values()).most_common(1)[0]
    usual = next(name for name in looks if sizes[name] == size)
    other = [name for name in looks if sizes[name] != size]
    if len(other) > _MOST_OF_OTHER_SIZE * len(looks):
        raise InputDataError(
            f"image {folder / other[0]}: {_text(sizes[other[0]])} pixels, but {usual} has {_text(size)}, as"
            f" {n_of_size} of {len(looks)} images; give images of one camera in one resolution and"
            " orientation"
        )
    reasons = {
        name: str(error).removeprefix(f"image {folder / name}: ") for name, error in damaged.items()
    } | {name: f"{_text(sizes[name])} pixels, but the others have {_text(size)}" for name in other}
    return ImageSet(
        size=size,
        looks={name: look for name, look in looks.items() if name not in reasons},
        unusable=tuple((name, reasons[name]) for name in names if name in reasons),
    )


def check_masks(mask_folder: Path, names: Sequence[str], size: tuple[int, int]) -> None:
    """Check the masks ``NAME.png`` (for instance ``frame_0001.jpg.png``): white = use, black = not.

    Args:
        mask_folder: where the masks are.
        names: image names.
        size: width and height of the images.

    Raises:
        InputDataError: the mask of an image is missing, cannot be decoded, has another size or is
            all black.
    """
    for name in names:
        path = mask_folder / f"{name}.png"
        if not path.is_file():
            raise InputDataError(
                f"mask {path}: no such file, but image {name} needs a mask; add it (white = use)"
            )
        mask = _decoded(path, "mask")
        if mask.size != size:
            raise InputDataError(
                f"mask {path}: {_text(mask.size)} pixels, but the images have {_text(size)}; make"
                " the mask as large as its image"
            )
        if mask.getbbox() is None:
            raise InputDataError(
                f"mask {path}: all black, so nothing of the image would be used; paint white what"
                " is to be used, or leave the image out"
            )


def pair_names(images: Sequence[str], poses: Sequence[str]) -> Pairing:
    """Pair images and poses by name, never by order.

    Args:
        images: names of the images; with the folder of a camera, the pose of the name with the
            folder counts, or else that of the file's name.
        poses: image names of the poses.

    Returns:
        What is paired, and what is left out on either side.

    Raises:
        InputDataError: nothing can be paired.
    """
    with_pose = set(poses)
    pose = {name: pose_name(name, with_pose) for name in images}
    paired = tuple(name for name in images if pose[name] is not None)
    if not paired:
        raise InputDataError(
            f"no pose has the name of an image: images are named like {_example(images)}, poses"
            f" like {_example(poses)}; write the images' file names, with suffix, into the poses"
        )
    return Pairing(
        paired=paired,
        images_without_pose=tuple(name for name in images if pose[name] is None),
        poses_without_image=tuple(name for name in poses if name not in set(pose.values())),
    )


def pose_name(image: str, poses: Container[str]) -> str | None:
    """The name under which an image has its robot pose: its own, or without the camera's folder."""
    names = (image, PurePosixPath(image).name)
    return next((name for name in names if name in poses), None)


def _decoded(path: Path, what: str) -> Image.Image:
    """The whole image; a mask as grey levels."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # remarks on metadata; the pixels are decoded here
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                image.load()
                if what == "mask":
                    return image.convert("L")
                if image.mode in _TOO_DEEP:
                    raise InputDataError(
                        f"{what} {path}: pixels of 32 bits, but 8 or 16 were wanted; save it again with 16"
                    )
                return image
    except FileNotFoundError as error:
        raise InputDataError(f"{what} {path}: no such file; check the name") from error
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise InputDataError(
            f"{what} {path}: too large to decode safely ({reason(error)}); use a smaller resolution"
        ) from error
    except _DAMAGED as error:
        why = "the file is empty" if _is_empty(path) else reason(error)
        raise InputDataError(
            f"{what} {path}: cannot be decoded ({why}); copy it again or leave it out"
        ) from error


def _grey(image: Image.Image) -> NDArray[np.uint8]:
    """Grey levels (h, w); of 16 bits the upper eight."""
    if image.mode.startswith("I;16"):
        return (np.asarray(image) >> 8).astype(np.uint8)
    return np.asarray(image.convert("L"))


def _is_empty(path: Path) -> bool:
    return path.is_file() and path.stat().st_size == 0


def _text(size: tuple[int, int]) -> str:
    return f"{size[0]} x {size[1]}"


def _example(names: Sequence[str]) -> str:
    return shown(names[0]) if names else "(none)"
