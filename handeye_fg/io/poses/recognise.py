"""Which format a table of poses has; several that fit are refused, never guessed; entry ``columns_of``."""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.fields import shown
from handeye_fg.io.poses.columns import Columns, by_header, by_shape, column_names, meaning
from handeye_fg.io.poses.convention import Convention, to_poses
from handeye_fg.io.poses.formats import FORMATS, PoseFormat
from handeye_fg.io.poses.table import Table, number, numbers
from handeye_fg.options import PoseFileOptions

_TRIED_ROWS = 50
_SECONDS = 1e11  # a time below is in seconds: the year is before 5138
_NEAR = 5.0  # positions of an arm: in metres below, in millimetres above
_FEWEST_ANGLES = 3


def columns_of(tables: Sequence[Table], options: PoseFileOptions) -> tuple[Table, Columns]:
    """The table and the columns that the options' format, or the one format that fits, has.

    Args:
        tables: the ways in which the file may be taken apart, the likeliest first.
        options: the format, or "auto", and what else the user knows.

    Raises:
        InputDataError: no format fits, several do, or the named one does not.
    """
    if options.format != "auto":
        table, columns = _named(tables, FORMATS[options.format])
        told = _as_told(columns, table, options)
        _require_plausible(told, table, options)
        return table, told
    for table in tables:
        fitting = _fitting(table)
        different = {meaning(columns): columns for columns in _likeliest_last(table, fitting)}
        if len(different) == 1:
            (columns,) = different.values()
            told = _as_told(columns, table, options)
            _require_plausible(told, table, options)
            return table, told
        if different:
            raise _ambiguous(table, [columns.format for columns in fitting])
    raise _unknown(tables[0])


def _named(tables: Sequence[Table], format_: PoseFormat) -> tuple[Table, Columns]:
    """The first table that has the format's columns."""
    for table in tables:
        found = by_header(table, format_) if table.header else by_shape(table, format_)
        if isinstance(found, Columns):
            return table, found
    table = tables[0]
    if table.header:
        raise _missing(table, format_)
    raise InputDataError(
        f"{table.places[0]}: found {len(table.rows[0])} columns, but {format_}; give a file of this format, or another --pose-format"
    )


def _fitting(table: Table) -> list[Columns]:
    """The formats whose columns the table has and whose rotations its first rows are."""
    formats = [entry for entry in FORMATS.values() if table.header or _tells(table, entry)]
    formats = [FORMATS[table.told]] if table.told else formats
    found = [
        by_header(table, entry) if table.header else by_shape(table, entry) for entry in formats
    ]
    fitting = [columns for columns in found if isinstance(columns, Columns)]
    few = replace(table, rows=table.rows[:_TRIED_ROWS], places=table.places[:_TRIED_ROWS])
    for suits in (_are_poses, _are_numbers):
        suiting = [columns for columns in fitting if suits(few, columns)]
        if suiting:
            return suiting
    return fitting


def _likeliest_last(table: Table, fitting: Sequence[Columns]) -> list[Columns]:
    """Sorted by in how much else the file is as the format's: what tells the image, and text or documents."""

    def likeness(columns: Columns) -> int:
        key = "image" if columns.image is not None else "time" if columns.time else "none"
        is_text = columns.format.container == "text"
        return (columns.format.key == key) + (is_text == bool(table.delimiter))

    return sorted(fitting, key=likeness, reverse=True)[::-1]


def _tells(table: Table, format_: PoseFormat) -> bool:
    """Whether a table without header can be told to have this format; see also ``_ambiguous``."""
    values = [number(cell) for cell in table.rows[0]]
    eight = len(values) == 8 and None not in values
    match format_.name:
        case "tum":
            return eight and table.delimiter == " " and _in_seconds(values)
        case "eth":
            return eight and table.delimiter == "," and _in_seconds(values)
        case "ros":
            return None in values and len(values) >= 10
        case _:
            return format_.name in {"kitti", "franka", "matrix"}


def _in_seconds(values: Sequence[float | None]) -> bool:
    return values[0] is not None and abs(values[0]) < _SECONDS


def _are_poses(table: Table, columns: Columns) -> bool:
    """Whether the rows are poses as the format has them."""
    with suppress(InputDataError):
        positions, rotations = split(table, columns)
        to_poses(positions, rotations, columns.convention, table.places)
        return True
    return False


def _are_numbers(table: Table, columns: Columns) -> bool:
    """Whether the rows are numbers, and matrices end as those of poses do."""
    with suppress(InputDataError):
        split(table, columns)
        return True
    return False


def split(table: Table, columns: Columns) -> tuple[Array, Array]:
    """Positions (n, 3) and rotations (n, k) as they are written.

    Raises:
        InputDataError: a cell holds no finite number, or the last row of a matrix is not 0, 0, 0, 1.
    """
    values = numbers(table, columns.numbers, column_names(table, columns))
    if columns.format.matrix is None:
        return values[:, :3], values[:, 3:]
    matrices = np.zeros((len(values), 4, 4))
    if values.shape[1] == 16:
        matrices[:] = values.reshape(-1, 4, 4)
        if columns.format.matrix == "columns":
            matrices = np.swapaxes(matrices, 1, 2)
    else:
        matrices[:, :3] = values.reshape(-1, 3, 4)
        matrices[:, 3, 3] = 1.0
    for matrix, place in zip(matrices, table.places, strict=True):
        if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
            other = "franka (by columns)" if columns.format.matrix == "rows" else "matrix (by rows)"
            raise InputDataError(
                f"{place}: the matrix's last row is {matrix[3].tolist()}, but must be [0, 0, 0, 1];"
                f" if the translation is there, give --pose-format {other}"
            )
    return matrices[:, :3, 3], matrices[:, :3, :3].reshape(-1, 9)


def _as_told(columns: Columns, table: Table, options: PoseFileOptions) -> Columns:
    """The columns with what the user says of their meaning."""
    convention = columns.convention
    for told, stated, own, what in (
        (options.units, columns.stated[0], convention.unit, "units"),
        (options.angles, columns.stated[1], convention.angles, "angles"),
    ):
        if told != "auto" and stated and told != own:
            raise InputDataError(
                f"{table.source}: its header says {own}, but --{what} says {told}; correct one of them"
            )
    return replace(
        columns, convention=told_convention(columns.format, convention, options, table.source)
    )


def told_convention(
    format_: PoseFormat, convention: Convention, options: PoseFileOptions, source: str
) -> Convention:
    """A format's convention with what the user says of it.

    Raises:
        InputDataError: the rotation that the user names has another count of numbers.
    """
    told = Convention(
        rotation=convention.rotation if options.rotation == "auto" else options.rotation,
        unit=convention.unit if options.units == "auto" else options.units,
        angles=convention.angles if options.angles == "auto" else options.angles,
        inverted=options.inverted,
    )
    if told.size != convention.size:
        raise InputDataError(
            f"{source}: rotation {options.rotation} has {told.size} numbers, but {format_.name} has"
            f" {convention.size}; give another --rotation or --pose-format"
        )
    return told


def _require_plausible(columns: Columns, table: Table, options: PoseFileOptions) -> None:
    """Refuse units that are only the format's custom and do not suit the numbers."""
    convention = columns.convention
    positions, rotations = split(table, columns)
    middle = float(np.median([math.hypot(*position) for position in positions]))  # never overflows
    known = options.units != "auto" or columns.stated[0]
    if convention.unit == "mm" and not known and middle < _NEAR:
        raise InputDataError(
            f"{table.source}: {columns.format.title} has millimetres, but the middle distance from the base is"
            f" {middle:.3g}; say which unit it is with --units m or --units mm"
        )
    known = options.angles != "auto" or columns.stated[1]
    if (
        convention.has_angles
        and convention.angles == "deg"
        and not known
        and len(rotations) >= _FEWEST_ANGLES
        and np.abs(rotations).max() <= 2.0 * np.pi
    ):
        raise InputDataError(
            f"{table.source}: {columns.format.title} has degrees, but no angle is above"
            f" {np.abs(rotations).max():.3g}; say which unit they have with --angles deg or --angles rad"
        )


def _ambiguous(table: Table, formats: Iterable[PoseFormat]) -> InputDataError:
    """The refusal of a table that several formats fit."""
    what = f"the columns {','.join(table.header)}" if table.header else "the rows"
    choices = "; ".join(f"--pose-format {entry.name} ({entry.convention})" for entry in formats)
    return InputDataError(
        f"{table.header_place}: {shown(what)[1:-1]} fit several formats, which give different poses; say which:"
        f" {choices}"
    )


def _unknown(table: Table) -> InputDataError:
    """The refusal of a table that no format fits for certain."""
    if table.header:
        best = max(FORMATS.values(), key=lambda entry: _present(table, entry))
        return _missing(table, best)
    shaped = [
        entry
        for entry in FORMATS.values()
        if entry.container == "text" and by_shape(table, entry) is not None
    ]
    if shaped:
        return _ambiguous(table, shaped)
    return InputDataError(
        f"{table.places[0]}: found {len(table.rows[0])} columns, but no known format has so many;"
        f" write {','.join(FORMATS['csv'].columns)} with this header, or name the format with"
        " --pose-format"
    )


def _missing(table: Table, format_: PoseFormat) -> InputDataError:
    """The refusal of a header that lacks a column."""
    column = by_header(table, format_)
    repeated = [cell.strip() for cell in table.header].count(str(column)) > 1
    return InputDataError(
        f"{table.header_place}: column {column} {'occurs more than once' if repeated else 'is missing'}; found"
        f" {shown(','.join(table.header))}, but {format_}; correct"
        " the header, or name another --pose-format"
    )


def _present(table: Table, format_: PoseFormat) -> int:
    """How many of a format's columns a header names."""
    names = {cell.strip().lower() for cell in table.header}
    return sum(column.lower() in names for column in format_.columns)
