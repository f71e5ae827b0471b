"""Data by path or by fsspec URL: what identifies its content, and how it comes and goes."""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

import fsspec  # type: ignore[import-untyped]  # it has no types

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown


def is_url(place: str) -> bool:
    """Whether a place is a URL and not a path."""
    return "://" in place


def signature(place: str) -> list[tuple[str, str]]:
    """(relative name, what identifies the content) of each file of a folder, or of the one file.

    Of a path it is the SHA-256 of the content; of a URL what the store says of the file (size, time,
    checksum), so that nothing is fetched. What is no regular file counts by its name only.

    Raises:
        InputDataError: a file cannot be read.
    """
    if is_url(place):
        return [(name, _sha256(repr(sorted(info.items())))) for name, info in _listed(place)]
    root = Path(place)
    paths = sorted(root.rglob("*")) if root.is_dir() else [root]
    try:
        return [(path.relative_to(root).as_posix(), _content(path)) for path in paths]
    except OSError as error:
        raise InputDataError(f"{place}: cannot be read ({reason(error)}); check it") from error


def fetched(place: str, folder: Path) -> str:
    """The path itself, or that of a copy of what a URL names.

    Args:
        place: path or URL of a file or a folder.
        folder: where a copy goes; made if needed.

    Raises:
        InputDataError: it cannot be fetched.
    """
    if not is_url(place):
        return place
    last = PurePosixPath(place).name
    if last == "..":
        raise InputDataError(f"{place}: names no file or folder, but ..; give its whole URL")
    target = folder / last
    with _translated(place):
        system, _ = fsspec.core.url_to_fs(place)
        for name, info in _listed(place):
            copy = target if name == "." else target / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            system.get_file(info["name"], str(copy))
    return str(target)


def put(folder: Path, place: str, last: str, left_out: str) -> None:
    """Copy a folder's files to a URL, one of them at the end: where it is, all are.

    Args:
        folder: the folder.
        place: URL of the copy.
        last: name of the file that is copied last.
        left_out: name of a folder in it that stays here; so do hidden files.

    Raises:
        InputDataError: they cannot be written.
    """
    with _translated(place):
        system, root = fsspec.core.url_to_fs(place)
        inside = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
        files = [
            path.as_posix()
            for path in inside
            if path.parts[0] != left_out and not path.name.startswith(".")
        ]
        for name in sorted(files, key=lambda name: (name == last, name)):
            target = f"{root.rstrip('/')}/{name}"
            system.makedirs(target.rpartition("/")[0], exist_ok=True)
            system.put_file(str(folder / name), target)


def write(place: str, content: str) -> None:
    """Write a text file at a URL.

    Raises:
        InputDataError: it cannot be written.
    """
    with _translated(place):
        system, path = fsspec.core.url_to_fs(place)
        system.makedirs(path.rpartition("/")[0], exist_ok=True)
        system.pipe_file(path, content.encode("utf-8", "backslashreplace"))


def exists(place: str) -> bool:
    """Whether a path or URL names something.

    Raises:
        InputDataError: the store does not answer.
    """
    if not is_url(place):
        return Path(place).exists()
    with _translated(place):
        system, path = fsspec.core.url_to_fs(place)
        return bool(system.exists(path))


def _listed(url: str) -> list[tuple[str, dict[str, Any]]]:
    """(relative name, what the store says) of each file under a URL; "." is the URL itself."""
    with _translated(url):
        system, root = fsspec.core.url_to_fs(url)
        found = system.find(root, detail=True)
        result = []
        for path, info in sorted(found.items()):
            name = path[len(root) :].strip("/") if path != root else ""
            # A store's names are free: none may lead out of the folder that gets the copy.
            if ".." in PurePosixPath(name).parts or "\\" in name:
                raise InputDataError(
                    f"{url}: {shown(name)} leads out of its folder; rename it in the store"
                )
            result.append((name or ".", info))
    if not result:
        raise InputDataError(f"{url}: there is no such file or folder; check the URL")
    return result


@contextmanager
def _translated(url: str) -> Iterator[None]:
    """Every store fails in its own way."""
    try:
        yield
    except InputDataError:
        raise
    except Exception as error:
        raise InputDataError(
            f"{url}: the store refused ({type(error).__name__}: {reason(error)}); check the URL, the "
            "network and the credentials"
        ) from error


def _content(path: Path) -> str:
    """SHA-256 of a regular file's content; opening anything else, such as a pipe, could block."""
    if not path.is_file():
        return "folder" if path.is_dir() else "nothing to read"
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
