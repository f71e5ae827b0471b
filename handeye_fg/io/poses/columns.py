"""Which columns of a table are a format's: by their names, or by their number and kind."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from handeye_fg.io.poses.convention import AngleUnit, Convention, Unit
from handeye_fg.io.poses.formats import PoseFormat
from handeye_fg.io.poses.table import Table, number

# Other names of a column, the first that is found counts. One with a dot may have more before it:
# pose.position.x.
_IMAGE = ("image", "image_name", "name", "file", "filename", "file_name", "img", "image_file")
_STAMP = ("stamp.sec", "stamp.nanosec"), ("stamp.secs", "stamp.nsecs")
_TIME = ("header.stamp", "timestamp", "time", "stamp", "t")
_ALIASES = {
    **{
        axis: (
            *(f"{word}{axis}" for word in ("", "t", "p", "pos_", "position_", "p_", "t_")),
            *(f"{word}_{axis}" for word in ("p_rs_r", "translation")),
            *(f"{word}.{axis}" for word in ("position", "translation")),
            f"base_ee_meas_p{axis}",
        )
        for axis in "xyz"
    },
    **{
        f"q{axis}": (
            *(f"{word}{axis}" for word in ("q", "q_", "quat_", "q_rs_", "base_ee_meas_q")),
            *(f"{word}.{axis}" for word in ("orientation", "rotation", "quaternion")),
        )
        for axis in "xyzw"
    },
    **{f"tu{axis}": (f"tu{axis}", f"rv{axis}", f"rotvec_{axis}") for axis in "xyz"},
}
_SAME = {
    **{f"t{axis}": axis for axis in "xyz"},
    **{f"p_rs_r_{axis}": axis for axis in "xyz"},
    **{f"base_ee_meas_p{axis}": axis for axis in "xyz"},
    **{f"pose.position.{axis}": axis for axis in "xyz"},
    **{
        f"{word}{axis}": f"q{axis}"
        for word in ("q_", "q_rs_", "base_ee_meas_q", "pose.orientation.")
        for axis in "xyzw"
    },
}
_STEMS = ("matrix", "transform", "transform_matrix", "pose", "base_t_gripper", "t", "poses")
_BRACKETS = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]$")
_LONGEST_NAME = 200
_INDEX = re.compile(r"\[(\d+)\]")
_SUFFIX = re.compile(r"_(m|mm|deg|rad|s|ms|us|ns)$")
_UNITS: dict[str, Unit] = {"m": "m", "mm": "mm"}
_TICKS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_ANGLES: dict[str, AngleUnit] = {"deg": "deg", "rad": "rad", "°": "deg"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Where a format's numbers stand in a table.

    Attributes:
        format: the format.
        convention: what the numbers mean, with the units that the header states.
        stated: whether the header states the unit of positions, and that of angles.
        image: column of the image's name, or None.
        time: columns of the time: none, one, or seconds and nanoseconds.
        tick_ns: nanoseconds in the unit of one column of time; None: its digits tell.
        numbers: columns of position and rotation, or of the 12 or 16 entries of a matrix by the format.
    """

    format: PoseFormat
    convention: Convention
    stated: tuple[bool, bool]
    image: int | None
    time: tuple[int, ...]
    tick_ns: int | None
    numbers: tuple[int, ...]


def by_header(table: Table, format_: PoseFormat) -> Columns | str:
    """A format's columns by their names; the name of a column that is missing or not the only one."""
    names = [_canonical(cell) for cell in table.header]
    bare = [name for name, _ in names]
    found: list[int] = []
    wanted = ""
    for wanted in _wanted(format_, bare):
        index = _find(bare, _ALIASES.get(wanted, (wanted,)))
        if index is None:
            return wanted
        found.append(index)
    stem, _, last = wanted.rpartition(".")
    if last.isdecimal() and _find(bare, (f"{stem}.{int(last) + 1}",)) is not None:
        return f"{stem} with {int(last) + 1} numbers and no more"
    image = _find(bare, _IMAGE)
    time = _time(bare)
    if set(time) & set(found):  # t is the third angle of Kawasaki
        time = ()
    units = {_UNITS.get(names[i][1]) for i in found[:3]}
    angles = {_ANGLES.get(names[i][1]) for i in found[3:]}
    unit, angle = (
        units.pop() if len(units) == 1 else None,
        angles.pop() if len(angles) == 1 else None,
    )
    if format_.matrix:
        unit = angle = None
    return Columns(
        format=format_,
        convention=replace(
            format_.convention,
            unit=unit or format_.convention.unit,
            angles=angle or format_.convention.angles,
        ),
        stated=(unit is not None, angle is not None),
        image=image,
        time=time,
        tick_ns=_tick(names, time),
        numbers=tuple(found),
    )


def by_shape(table: Table, format_: PoseFormat) -> Columns | None:
    """A format's columns in a table without header: an image name or a time, if any, and its numbers."""
    first = [number(cell) for row in table.rows[:1] for cell in row]
    texts = [i for i, value in enumerate(first) if value is None]
    rest = [i for i in range(len(first)) if i not in texts]
    sizes = {len(format_.numbers)} | ({12, 16} if format_.name == "matrix" else set())
    image: int | None = None
    time: tuple[int, ...] = ()
    if format_.name == "ros" and texts and rest[:2] == [0, 1] and len(rest) == 9:
        time, rest = (0, 1), rest[2:]  # seconds, nanoseconds, one or two frames
    elif len(texts) == 1:
        image = texts[0]
    elif texts:
        return None
    if len(rest) - 1 in sizes and image is None and not time:
        time, rest = (rest[0],), rest[1:]
    if len(rest) not in sizes:
        return None
    return Columns(
        format=format_,
        convention=format_.convention,
        stated=(False, False),
        image=image,
        time=time,
        tick_ns=1 if format_.name == "euroc" else None,
        numbers=tuple(rest),
    )


def column_names(table: Table, columns: Columns) -> tuple[str, ...]:
    """The names of the number columns for error messages."""
    if table.header:
        return tuple(table.header[i] for i in columns.numbers)
    return tuple(str(i + 1) for i in columns.numbers)


def meaning(columns: Columns) -> tuple[object, ...]:
    """What two formats have in common that read the same poses from a table."""
    kind: str = columns.convention.rotation
    order = columns.numbers
    if kind in {"xyzw", "wxyz"}:
        by_x = order[3:] if kind == "xyzw" else (*order[4:], order[3])
        order, kind = (*order[:3], *by_x), "quaternion"
    return (
        kind,
        order,
        columns.format.matrix,
        columns.convention.unit,
        columns.convention.angles if columns.convention.has_angles else "",
    )


def _wanted(format_: PoseFormat, header: Sequence[str]) -> Sequence[str]:
    """The bare names of the columns of a format's numbers."""
    names = [_SAME.get(name, name) for name, _ in map(_canonical, format_.numbers)]
    if format_.name == "visp" and _find(header, ("data.0",)) is None:
        return ("x", "y", "z", "tux", "tuy", "tuz")
    if format_.name == "matrix":
        for stem in _STEMS:
            for count in (16, 12):
                entries = [f"{stem}.{i}" for i in range(count)]
                if all(_find(header, (entry,)) is not None for entry in entries):
                    return entries
    return names


def _canonical(cell: str) -> tuple[str, str]:
    """A column's name in small letters without its unit, and the unit."""
    if len(cell) > _LONGEST_NAME:
        return cell, ""
    name = _INDEX.sub(r".\1", cell.strip().lower())
    brackets = _BRACKETS.search(name)
    if brackets:
        return name[: brackets.start()], brackets[1]
    suffix = _SUFFIX.search(name)
    if suffix:
        return name[: suffix.start()], suffix[1]
    return name, ""


def _find(header: Sequence[str], aliases: Sequence[str]) -> int | None:
    """The one column that has the first alias that occurs; None if there is none or several."""
    for alias in aliases:
        found = [
            i
            for i, name in enumerate(header)
            if name == alias or ("." in alias and name.endswith(f".{alias}"))
        ]
        if found:
            return found[0] if len(found) == 1 else None
    return None


def _tick(names: Sequence[tuple[str, str]], time: Sequence[int]) -> int | None:
    """Nanoseconds in the unit of the time that a header states; rostopic's stamps are nanoseconds."""
    if len(time) != 1:
        return None
    name, unit = names[time[0]]
    return 1 if name.endswith("header.stamp") else _TICKS.get(unit)


def _time(header: Sequence[str]) -> tuple[int, ...]:
    """The columns of the time: none, one, or seconds and nanoseconds."""
    for names in _STAMP:
        pair = [_find(header, (name,)) for name in names]
        if pair[0] is not None and pair[1] is not None:
            return (pair[0], pair[1])
    one = _find(header, _TIME)
    return () if one is None else (one,)
