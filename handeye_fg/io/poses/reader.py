"""Poses from files of every format; entries ``read_poses`` and ``open_poses``."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.files import decode_text
from handeye_fg.io.poses.columns import Columns, column_names
from handeye_fg.io.poses.documents import (
    array_table,
    document_tables,
    is_array,
    is_transform_echo,
    transform_table,
)
from handeye_fg.io.poses.names import check_name
from handeye_fg.io.poses.notation import notation_of, notation_table
from handeye_fg.io.poses.pairing import partners, time_ns
from handeye_fg.io.poses.recognise import columns_of, split
from handeye_fg.io.poses.rows import PoseFile, PoseRows
from handeye_fg.io.poses.table import Table, read_table
from handeye_fg.io.read_as import ReadAs
from handeye_fg.options import PoseFileOptions, PoseFormatName
from handeye_fg.types import Indices, RobotPoses

_LARGEST_FILE = 50_000_000  # bytes
_MOST_FILES = 10_000
_SUFFIXES = (".csv", ".json", ".npy", ".txt", ".yaml", ".yml")
_YAML = re.compile(r"\s*(#[^\n]*\n\s*)*(---|%YAML|(- )?[A-Za-z_][\w. /-]*:(\s|$))")


def read_poses(
    path: str | Path,
    format: PoseFormatName = "auto",  # noqa: A002  # the name of the flag
    *,
    images: Sequence[str] | None = None,
    **known: Any,
) -> RobotPoses:
    r"""Robot poses from a file, or from a folder with a file for each pose.

    Args:
        path: the file or folder.
        format: its format; "auto": recognised.
        images: names of the images, needed where the file has none of its own: rows are then paired
            with them by time or, if ``pair_by`` asks for it, by number or order. None: rows are named
            by the file, by their time, or by their number.
        **known: what else is known of the file: the other fields of ``PoseFileOptions``, such as
            ``units="mm"``.

    Returns:
        The poses base_T_gripper in metres, by image name.

    Raises:
        InputDataError: the file is missing, damaged, of no known format or of one that cannot be told;
            a row is no pose; or rows and images cannot be paired.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> import handeye_fg as hf
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder) / "poses.csv"
        ...     _ = path.write_text("image,x,y,z,qx,qy,qz,qw\na.jpg,500,0,300,0,0,0,1\n")
        ...     poses = hf.read_poses(path, units="mm")
        >>> poses.names, poses.base_T_gripper[0, :3, 3].tolist()
        (('a.jpg',), [0.5, 0.0, 0.3])
    """
    try:
        options = PoseFileOptions(format=format, **known)
    except (TypeError, ValueError) as error:
        raise InputDataError(f"options of poses file {path}: {reason(error)}") from error
    return open_poses(path, options, images).poses()


def open_poses(
    path: str | Path,
    options: PoseFileOptions | None = None,
    images: Sequence[str] | None = None,
) -> PoseFile:
    """Like ``read_poses``, but the numbers stay as they are written, to be read in other ways too.

    Raises:
        InputDataError: as for ``read_poses``.
    """
    options, path = options or PoseFileOptions(), Path(path)
    tables = _folder(path) if path.is_dir() else _file(path, f"poses file {path}")
    table, columns = columns_of(tables, options)
    rows = _rows(table, columns)
    return PoseFile(
        read_as=ReadAs(
            format=columns.format.name,
            recognised=options.format == "auto",
            numbers=str(columns.convention),
        ),
        convention=columns.convention,
        rows=rows,
        partners=partners(rows, images, options),
    )


def _file(path: Path, source: str) -> tuple[Table, ...]:
    """The ways in which a file can be taken apart, the likeliest first."""
    data = _content(path, source)
    if is_array(data):
        return (array_table(data, source),)
    text = decode_text(data, source)
    if is_transform_echo(text):
        return (transform_table(text, source),)
    is_yaml = path.suffix in {".yaml", ".yml"}
    notation = None if is_yaml or path.suffix == ".json" else notation_of(text)
    if notation is not None:
        return (notation_table(text, source, notation),)
    if path.suffix == ".json" or (not is_yaml and text.lstrip().startswith(("{", "["))):
        return document_tables(text, source, is_json=True)
    if is_yaml or _YAML.match(text):
        tables = document_tables(text, source, is_json=False)
        return _indexed(path, tables[0]) if _is_index(tables[0]) else tables
    return (read_table(text, source),)


def _content(path: Path, source: str) -> bytes:
    """The file's bytes."""
    try:
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise InputDataError(
                f"{source}: {size} bytes are too many, at most {_LARGEST_FILE} were expected; give the"
                " poses near the images only"
            )
        return path.read_bytes()
    except FileNotFoundError as error:
        raise InputDataError(f"{source}: no such file; check the path") from error
    except (OSError, ValueError) as error:  # ValueError: a null character in the path
        raise InputDataError(
            f"{source}: cannot be read ({reason(error)}); check the path"
        ) from error


def _folder(path: Path) -> tuple[Table, ...]:
    """The poses of a folder with a file for each, under the names of the files."""
    files = sorted(
        entry
        for entry in path.iterdir()
        if entry.suffix.lower() in _SUFFIXES and not entry.name.startswith(".")
    )
    if not 0 < len(files) <= _MOST_FILES:
        raise InputDataError(
            f"poses folder {path}: {len(files)} files named {' '.join(_SUFFIXES)} found, but a file for each"
            f" pose was wanted, at most {_MOST_FILES}; give the folder that holds only them, or one file"
        )
    return _gathered(f"poses folder {path}", [(file.stem, file) for file in files])


def _gathered(source: str, files: Sequence[tuple[str, Path]]) -> tuple[Table, ...]:
    """One table of files that hold one pose each, under their labels."""
    tables = [_file(file, f"poses file {file}")[0] for _, file in files]
    for table in tables:
        if len(table.rows) != 1:
            raise InputDataError(
                f"{table.source}: holds {len(table.rows)} poses, but of a folder each file holds one; give"
                " the file instead of the folder, or move it elsewhere"
            )
        if table.header != tables[0].header or len(table.rows[0]) != len(tables[0].rows[0]):
            raise InputDataError(
                f"{table.source}: has other content than {tables[0].source}; give a folder with files of one"
                " format"
            )
    return (
        Table(
            source=source,
            header_place=tables[0].source,
            header=tables[0].header,
            rows=tuple(table.rows[0] for table in tables),
            places=tuple(table.source for table in tables),
            labels=tuple(label for label, _ in files),
        ),
    )


def _is_index(table: Table) -> bool:
    return {"image", "pose"} <= set(table.header)


def _indexed(path: Path, index: Table) -> tuple[Table, ...]:
    """The poses of the files that an index names, under their images."""
    image, pose = index.header.index("image"), index.header.index("pose")
    files = []
    for row, place in zip(index.rows, index.places, strict=True):
        check_name(row[pose], f"{place}, pose")
        check_name(row[image], f"{place}, image")
        files.append((row[image], path.parent / row[pose]))
    if any(file.suffix not in _SUFFIXES for _, file in files):
        raise InputDataError(
            f"{index.source}: names pose files that do not end in {' '.join(_SUFFIXES)}; correct the index"
        )
    (table,) = _gathered(index.source, files)
    header = (*table.header, "image")
    rows = tuple((*row, name) for row, (name, _) in zip(table.rows, files, strict=True))
    return (replace(table, header=header, rows=rows, labels=None),)


def _rows(table: Table, columns: Columns) -> PoseRows:
    """The numbers of a table, with the names and times of its rows."""
    positions, rotations = split(table, columns)
    names = table.labels
    if columns.image is not None:
        names = tuple(row[columns.image] for row in table.rows)
    if names is not None:
        _check_names(names, table.places)
    return PoseRows(
        source=table.source,
        places=table.places,
        positions=positions,
        rotations=rotations,
        columns=",".join(column_names(table, columns)[3:]) if columns.format.matrix is None else "",
        names=names,
        file_names=columns.image is None and names is not None,
        times_ns=None if names is not None else _times(table, columns),
    )


def _check_names(names: Sequence[str], places: Sequence[str]) -> None:
    """Refuse names of no file, and those that occur again."""
    first: dict[str, str] = {}
    for name, place in zip(names, places, strict=True):
        check_name(name, f"{place}, column image")
        other = first.setdefault(name, place)
        if other != place:
            raise InputDataError(
                f"{place}, column image: {shown(name)} is already in {other.rsplit(', ', 1)[-1]}, but each"
                " image has one pose; remove one of the two rows"
            )


def _times(table: Table, columns: Columns) -> Indices | None:
    """Nanoseconds of each row, or None."""
    if not columns.time:
        return None
    times = []
    for row, place in zip(table.rows, table.places, strict=True):
        cells = [row[i].strip() for i in columns.time]
        if len(cells) == 2 and all(re.fullmatch(r"\d{1,10}", cell, re.ASCII) for cell in cells):
            times.append(int(cells[0]) * 10**9 + int(cells[1]))
            continue
        value = time_ns(cells[0], columns.tick_ns) if len(cells) == 1 else None
        if value is None:
            raise InputDataError(
                f"{place}: {shown(' '.join(cells))} is no time; give seconds, or whole nanoseconds"
            )
        times.append(value)
    return np.array(times, dtype=np.int64)
