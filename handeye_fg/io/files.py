"""Files that appear whole or not at all."""

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from handeye_fg.errors import InputDataError

LOCK = ".handeye-fg.lock"
# What a process that was killed may take to be gone.
_WAIT_S = 3.0

_LARGEST_FILE = 100_000_000  # bytes; a transforms.json of ten thousand images has some ten million


def write_atomic(path: Path, content: str | bytes) -> Path:
    """Write a file so that a reader sees the old content or the new one, never a part.

    The content goes to a temporary file in the same folder, which then takes the place of ``path``.
    Missing folders are created.

    Args:
        path: where the file is to appear.
        content: bytes, or text that is written as UTF-8 with its line ends as they are.

    Returns:
        The path.

    Raises:
        InputDataError: the folder or the file cannot be written.
    """
    data = content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content
    temporary = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise InputDataError(
            f"{path}: cannot be written ({error.strerror}); choose another output folder"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()
    return path


@contextlib.contextmanager
def sole_use(folder: Path) -> Iterator[None]:
    """Keep other runs out of an output folder until the end; the end of the process ends it in any case.

    Raises:
        InputDataError: another run writes there, or nothing can be written.
    """
    lock = FileLock(folder / LOCK, timeout=_WAIT_S)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise InputDataError(
            f"{folder}: another run is writing there; wait until it ends, or choose another output folder"
        ) from error
    except OSError as error:
        raise InputDataError(
            f"{folder}: cannot be written ({error.strerror}); choose another output folder"
        ) from error
    try:
        yield
    finally:
        lock.release()


def read_text(path: Path, what: str, *, may_be_empty: bool = False) -> str:
    r"""Read a UTF-8 text file, with or without a byte order mark.

    Args:
        path: the file.
        what: its name in error messages, such as "poses file".
        may_be_empty: whether a file without content is accepted.

    Returns:
        The text, line ends as ``\n``.

    Raises:
        InputDataError: the file is missing, unreadable, too large, empty or not text.
    """
    return decode_text(read_bytes(path, what), f"{what} {path}", may_be_empty=may_be_empty)


def read_bytes(path: Path, what: str) -> bytes:
    """Read a file of bounded size.

    Args:
        path: the file.
        what: its name in error messages, such as "poses file".

    Raises:
        InputDataError: the file is missing, unreadable or too large.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise InputDataError(f"{what} {path}: no such file; check the path") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputDataError(f"{what} {path}: cannot be read ({error}); check the path") from error
    if len(data) > _LARGEST_FILE:
        raise InputDataError(
            f"{what} {path}: more than {_LARGEST_FILE} bytes are too many; give a smaller file"
        )
    return data


def decode_text(data: bytes, where: str, *, may_be_empty: bool = False) -> str:
    r"""The text of a UTF-8 file's content, line ends as ``\n``.

    Args:
        data: the content, with or without a byte order mark.
        where: the start of an error message.
        may_be_empty: whether no content is accepted.

    Raises:
        InputDataError: it is empty or no text.
    """
    try:
        text = data.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise InputDataError(
            f"{where}: byte {error.start} is not UTF-8 text; save the file as UTF-8"
        ) from error
    if "\0" in text:
        raise InputDataError(
            f"{where}: character {text.index(chr(0))} is a null byte, so this is no text"
            " file; give the text file itself"
        )
    if not may_be_empty and not text.strip():
        raise InputDataError(f"{where}: the file is empty; write its content first")
    return text
