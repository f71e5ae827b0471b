"""Whether the binary files of a COLMAP model are whole: COLMAP itself reads a damaged count without end.

The layouts are those of COLMAP 3 and 4 (which adds rigs and frames); entry point ``check_model_files``.
"""

import mmap
import struct
from collections.abc import Callable
from pathlib import Path

from handeye_fg.errors import InputDataError

_SUB_FOLDERS = (".", "sparse/0", "sparse", "0", "colmap/sparse/0", "sfm")
_POSE = 7 * 8
_POINT2D, _ELEMENT = 2 * 8 + 8, 2 * 4


class _DamagedError(Exception):
    """The file does not have the layout."""


class _Bytes:
    """A file that is read from front to back."""

    def __init__(self, data: mmap.mmap | bytes) -> None:
        self._data = data
        self._at = 0

    def read(self, layout: str) -> int:
        """The number at the place, of one of struct's types."""
        try:
            (value,) = struct.unpack_from(f"<{layout}", self._data, self._at)
        except struct.error as error:
            raise _DamagedError(
                f"it ends after {len(self._data)} bytes, within an entry"
            ) from error
        self._at += struct.calcsize(layout)
        return int(value)

    def skip(self, n: int) -> None:
        """Go n bytes on."""
        self._at += n
        if self._at > len(self._data):
            raise _DamagedError(f"it ends after {len(self._data)} bytes, within an entry")

    def skip_text(self) -> None:
        """Go behind a text that ends with a null byte."""
        end = self._data.find(b"\0", self._at)
        if end < 0:
            raise _DamagedError("a name has no end")
        try:
            self._data[self._at : end].decode()
        except UnicodeDecodeError as error:
            raise _DamagedError("a name is not UTF-8 text") from error
        self._at = end + 1

    def require_end(self) -> None:
        """Refuse what follows the last entry."""
        if self._at != len(self._data):
            raise _DamagedError(f"{len(self._data) - self._at} bytes follow its last entry")


def model_folder(path: Path) -> Path | None:
    """The folder of a COLMAP model at or below a path, where such models usually lie; None: there is none."""
    for name in _SUB_FOLDERS:
        folder = path / name
        if any((folder / f"images.{suffix}").is_file() for suffix in ("bin", "txt")):
            return folder
    return None


def check_model_files(folder: Path) -> None:
    """Refuse a model whose binary files are cut off or otherwise damaged.

    Raises:
        InputDataError: one is.
    """
    for name, skip_entry in _ENTRIES.items():
        path = folder / name
        if not path.is_file():
            continue
        try:
            with path.open("rb") as file:
                size = path.stat().st_size
                data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
                _check(_Bytes(data), skip_entry)
        except _DamagedError as error:
            raise InputDataError(
                f"COLMAP model {folder}: {name} is damaged ({error}); export the model again"
            ) from error
        except (OSError, ValueError) as error:
            raise InputDataError(
                f"COLMAP model {folder}: {name} cannot be read ({error}); check the path"
            ) from error


def _check(data: _Bytes, skip_entry: Callable[[_Bytes], None]) -> None:
    for _ in range(data.read("Q")):
        skip_entry(data)
    data.require_end()


def _skip_rig(data: _Bytes) -> None:
    data.skip(4)
    sensors = data.read("I")
    if sensors:
        data.skip(8)  # of the reference: kind and number
    for _ in range(sensors - 1):
        data.skip(8)
        if data.read("B"):
            data.skip(_POSE)


def _skip_frame(data: _Bytes) -> None:
    data.skip(8 + _POSE)
    data.skip(16 * data.read("I"))


def _skip_image(data: _Bytes) -> None:
    data.skip(4 + _POSE + 4)
    data.skip_text()
    data.skip(_POINT2D * data.read("Q"))


def _skip_point(data: _Bytes) -> None:
    data.skip(8 + 3 * 8 + 3 + 8)
    data.skip(_ELEMENT * data.read("Q"))


# The cameras' entries depend on their models; COLMAP stops at one that it does not know.
_ENTRIES: dict[str, Callable[[_Bytes], None]] = {
    "rigs.bin": _skip_rig,
    "frames.bin": _skip_frame,
    "images.bin": _skip_image,
    "points3D.bin": _skip_point,
}
