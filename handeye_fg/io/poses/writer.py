"""Poses to files of every format that can be read; entry ``write_poses``."""

import io
import json
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import yaml

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.fields import shown
from handeye_fg.io.files import write_atomic
from handeye_fg.io.poses.convention import Convention, from_poses
from handeye_fg.io.poses.formats import FORMATS, PoseFormat
from handeye_fg.io.poses.names import check_name
from handeye_fg.io.poses.pairing import time_of_name
from handeye_fg.io.poses.recognise import told_convention
from handeye_fg.options import PoseFileOptions
from handeye_fg.types import RobotPoses

_ZIVID = {"serializer": 1, "data": 1}


def write_poses(
    poses: RobotPoses,
    path: str | Path,
    options: PoseFileOptions | None = None,
    times_ns: Sequence[int] | None = None,
) -> Path:
    """Write poses in any format that ``read_poses`` reads; every number comes back to rounding.

    Formats without image names lose them: their poses are in the given order, or have times. Those
    that have a file for each pose are folders; with "robot-cal-tools" the path is an index, and the
    poses are in a folder beside it. "matrix" becomes an array or JSON where the path ends in .npy or .json,
    "ros" becomes CSV where it ends in .csv.

    Args:
        poses: base_T_gripper in metres, by image name.
        path: the file or folder.
        options: the format ("auto": "csv") and how its numbers are to be read.
        times_ns: times for formats that have them; None: those in the images' names, else the poses are
            one second apart from 0 on.

    Returns:
        The path.

    Raises:
        InputDataError: a file cannot be written, or two images would have one file.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from tempfile import TemporaryDirectory
        >>> poses = hf.RobotPoses(names=("a.jpg", "b.jpg"), base_T_gripper=np.stack([np.eye(4)] * 2))
        >>> with TemporaryDirectory() as folder:
        ...     path = hf.write_poses(poses, f"{folder}/poses.csv")
        ...     hf.read_poses(path).names
        ('a.jpg', 'b.jpg')
    """
    options, path = options or PoseFileOptions(), Path(path)
    entry = FORMATS["csv" if options.format == "auto" else options.format]
    for name in poses.names:
        check_name(name, f"poses file {path}")
    convention = told_convention(entry, entry.convention, options, f"poses file {path}")
    positions, rotations = from_poses(poses.base_T_gripper, convention)
    numbers = _listed(entry, positions, rotations)
    times = _times(poses.names, times_ns) if entry.key == "time" else []
    if entry.name == "matrix" and path.suffix == ".npy":
        buffer = io.BytesIO()
        np.save(buffer, numbers.reshape(-1, 4, 4), allow_pickle=False)
        return write_atomic(path, buffer.getvalue())
    if entry.name == "matrix" and path.suffix == ".json":
        matrices = numbers.reshape(-1, 4, 4).tolist()
        return write_atomic(path, json.dumps(dict(zip(poses.names, matrices, strict=True))))
    match entry.container:
        case "stream" if path.suffix == ".csv":
            rows = [
                [*map(str, divmod(time, 10**9)), "base", *map(repr, row)]
                for time, row in zip(times, numbers.tolist(), strict=True)
            ]
            return write_atomic(path, _lines(rows, ","))
        case "stream":
            messages = map(_message, times, numbers.tolist())
            return write_atomic(path, yaml.safe_dump_all(messages, **_STYLE))
        case "list":
            samples = [{"effector_wrt_world": row} for row in numbers.tolist()]
            return write_atomic(path, yaml.safe_dump(samples, **_STYLE))
        case "folder" | "index":
            return _write_files(entry, path, poses.names, numbers)
        case "text":
            return write_atomic(path, _text(entry, convention, poses.names, times, numbers))


def tum_text(poses: RobotPoses) -> tuple[str, tuple[str, ...]]:
    """A trajectory of TUM, and the time stamp of each row: that in the image's name, or its number.

    Args:
        poses: metres, by image name.
    """
    entry = FORMATS["tum"]
    times = _times(poses.names, None)
    numbers = _listed(entry, *from_poses(poses.base_T_gripper, entry.convention))
    text = _text(entry, entry.convention, poses.names, times, numbers)
    return text, tuple(map(_seconds, times))


_STYLE: dict[str, Any] = {"default_flow_style": None, "sort_keys": False, "width": 1000}


def _listed(entry: PoseFormat, positions: Array, rotations: Array) -> Array:
    """The numbers (n, k) of each pose in the format's order."""
    if entry.matrix is None:
        return np.hstack([positions, rotations])
    matrices = np.zeros((len(positions), 4, 4))
    matrices[:, :3, :3] = rotations.reshape(-1, 3, 3)
    matrices[:, :3, 3] = positions
    matrices[:, 3, 3] = 1.0
    if entry.matrix == "columns":
        matrices = np.swapaxes(matrices, 1, 2)
    return matrices.reshape(-1, 16)[:, : len(entry.numbers)]


def _times(names: Sequence[str], times_ns: Sequence[int] | None) -> list[int]:
    """Nanoseconds of each pose."""
    if times_ns is not None:
        return [int(time) for time in times_ns]
    found = [time_of_name(name) for name in names]
    times = [time for time in found if time is not None]
    return times if len(times) == len(names) else [i * 10**9 for i in range(len(names))]


def _text(
    entry: PoseFormat,
    convention: Convention,
    names: Sequence[str],
    times: Sequence[int],
    numbers: Array,
) -> str:
    """A text table."""
    keys: list[list[str]] = [[] for _ in names]
    if entry.key == "image":
        keys = [[_quoted(name, entry.delimiter)] for name in names]
    elif entry.key == "time" and entry.columns[0].endswith("[ns]"):
        keys = [[str(time)] for time in times]
    elif entry.key == "time":
        keys = [[_seconds(time)] for time in times]
    rows = [[*key, *map(repr, row)] for key, row in zip(keys, numbers.tolist(), strict=True)]
    if entry.header == "none":
        return _lines(rows, entry.delimiter)
    columns = _headed(entry, convention)
    first = columns[0] if entry.header == "names" else f"# {columns[0]}"
    return _lines([[first, *columns[1:]], *rows], entry.delimiter)


def _seconds(time_ns: int) -> str:
    return f"{time_ns // 10**9}.{time_ns % 10**9:09d}"


def _headed(entry: PoseFormat, convention: Convention) -> list[str]:
    """The names of the columns, with the units that are not the format's own."""
    columns, gap = list(entry.columns), "" if entry.delimiter == " " else " "
    if entry.matrix is not None:
        return columns
    if convention.unit != entry.convention.unit:
        columns[1:4] = [
            f"{name.removesuffix(' [m]')}{gap}[{convention.unit}]" for name in columns[1:4]
        ]
    if convention.has_angles and convention.angles != entry.convention.angles:
        columns[4:] = [f"{name}{gap}[{convention.angles}]" for name in columns[4:]]
    return columns


def _lines(rows: Sequence[Sequence[str]], delimiter: str) -> str:
    return "".join(f"{delimiter.join(row)}\n" for row in rows)


def _quoted(name: str, delimiter: str) -> str:
    """A name as a cell of a text table, in quotes where it needs them."""
    plain = not name.startswith(("#", "%", " ", "\t")) and not {delimiter, '"', "\n"} & set(name)
    return name if plain else '"' + name.replace('"', '""') + '"'


def _message(time: int, row: Sequence[float]) -> dict[str, object]:
    """A geometry_msgs/PoseStamped."""
    seconds, nanoseconds = divmod(time, 10**9)
    return {
        "header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "base"},
        "pose": {
            "position": dict(zip("xyz", row[:3], strict=True)),
            "orientation": dict(zip("xyzw", row[3:], strict=True)),
        },
    }


def _write_files(entry: PoseFormat, path: Path, names: Sequence[str], numbers: Array) -> Path:
    """A file for each pose, under its image's name, and the index of them if the format has one."""
    folder = path.with_name(f"{path.stem}_poses") if entry.container == "index" else path
    files = [f"{PurePosixPath(name).name}.yaml" for name in names]
    if len(set(files)) < len(files):
        twice = next(file for file in files if files.count(file) > 1)
        raise InputDataError(
            f"poses folder {folder}: two images would have the file {shown(twice)}; write the poses of each"
            " camera into a folder of their own"
        )
    for file, row in zip(files, numbers.tolist(), strict=True):
        write_atomic(folder / file, yaml.safe_dump(_one(entry, row), **_STYLE))
    if entry.container == "index":
        index = [
            {"pose": f"{folder.name}/{file}", "image": name}
            for name, file in zip(names, files, strict=True)
        ]
        write_atomic(path, yaml.safe_dump(index, **_STYLE))
    return path


def _one(entry: PoseFormat, row: Sequence[float]) -> dict[str, object]:
    """The document of one pose."""
    match entry.name:
        case "zivid":
            matrix = [list(row[i : i + 4]) for i in range(0, 16, 4)]
            return {"__version__": _ZIVID, "FloatMatrix": {"Data": matrix}}
        case "visp":
            return {"rows": 6, "cols": 1, "data": [[value] for value in row]}
        case _:
            return dict(zip(entry.columns, row, strict=True))
