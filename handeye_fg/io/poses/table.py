"""Text tables of poses with any delimiter as cells; entry ``read_table``."""

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np
import pandas as pd

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.fields import reason, shown

Cells = tuple[str, ...]

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"([+-]?\d*),(\d+([eE][+-]?\d{1,3})?)", re.ASCII)
_RAGGED = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
_DELIMITERS = (",", ";", "\t", "|", " ")
_TRIED_LINES = 30
_LONGEST_NUMBER = 100  # characters
_MOST_COLUMNS = 1000
_MOST_LINES = 1_000_000
_FEWEST_NUMBERS = (
    3  # a row of poses has at least six; a header of single letters might hold a digit
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Cells of a pose file, whatever its form.

    Attributes:
        source: the file, as the start of an error message.
        header_place: where the header stands, in the same way.
        header: names of the columns; empty for none.
        rows: the cells of each row, all of one length.
        places: where each row stands, as the start of an error message.
        labels: name of each row that stands beside the cells, such as that of its file; None: none do.
        delimiter: of a text table; "" for other forms.
        told: the one format that the form of the file leaves; "" for any.
    """

    source: str
    header_place: str
    header: Cells
    rows: tuple[Cells, ...]
    places: tuple[str, ...]
    labels: tuple[str, ...] | None = None
    delimiter: str = ""
    told: str = ""


def number(cell: str) -> float | None:
    """The finite number in a cell, with a point or a comma for decimals; None if there is none."""
    text = cell.strip()
    if len(text) > _LONGEST_NUMBER:
        return None
    if not _NUMBER.fullmatch(text):
        comma = _DECIMAL_COMMA.fullmatch(text)
        if comma is None:
            return None
        text = f"{comma[1]}.{comma[2]}"
    value = float(text)
    return value if abs(value) < float("inf") else None


def numbers(table: Table, columns: Sequence[int], names: Sequence[str]) -> Array:
    """The numbers (n, k) in columns.

    Raises:
        InputDataError: a cell holds no finite number.
    """
    values = np.empty((len(table.rows), len(columns)))
    for i, row in enumerate(table.rows):
        for k, column in enumerate(columns):
            value = number(row[column])
            if value is None:
                raise InputDataError(
                    f"{table.places[i]}, column {names[k]}: {shown(row[column])} is not a finite"
                    " number; correct the value or remove the row"
                )
            values[i, k] = value
    return values


def read_table(text: str, source: str) -> Table:
    """The cells of a text table.

    The delimiter is the one that leaves most numbers: comma, semicolon, tab, bar or blanks. Lines that
    start with # or % are comments; the last of them before the rows is the header, if there is no
    other and it has as many names as the rows have cells. Four rows of four numbers each, or three,
    are taken for one row: a matrix.

    Raises:
        InputDataError: it is no table.
    """
    if text.count("\n") > _MOST_LINES:
        raise InputDataError(
            f"{source}: {text.count(chr(10))} lines are too many, at most {_MOST_LINES} were expected; give"
            " the poses near the images only"
        )
    content = _Content(text)
    if not content.lines:
        raise InputDataError(f"{source}: there are only comments; write one row for each pose")
    delimiter = max(_DELIMITERS, key=lambda candidate: _merit(content.lines, candidate))
    n_columns = len(content.lines[0].split(None if delimiter == " " else delimiter))
    if n_columns > _MOST_COLUMNS:
        raise InputDataError(
            f"{source}, line {content.first_line}: found {n_columns} fields, but a pose has at most 16; give"
            " a file of poses"
        )
    if n_columns < 2:
        delimiter = ","
    frame = _frame(content, delimiter, source)
    rows, places = [], []
    line = content.first_line
    for cells in frame.itertuples(index=False, name=None):
        if any(cell.strip() for cell in cells):
            rows.append(cells)
            places.append(f"{source}, line {line}")
        line += 1 + sum(cell.count("\n") for cell in cells)
    if not rows:
        raise InputDataError(f"{source}: all cells are empty; write one row for each pose")
    header, header_place = _stripped(rows[0]), places[0]
    if sum(number(cell) is not None for cell in header) < _FEWEST_NUMBERS:
        rows, places = rows[1:], places[1:]
    else:
        header = _stripped(content.comment.split(None if delimiter == " " else delimiter))
        header = header if len(header) == len(rows[0]) else ()
    if not rows:
        raise InputDataError(
            f"{source}: there is no row after the header; write one row for each image"
        )
    table = Table(
        source=source,
        header_place=header_place,
        header=header,
        rows=tuple(rows),
        places=tuple(places),
        delimiter=delimiter,
    )
    return table if header else _matrices(table)


class _Content:
    """The lines of a file from the first that is no comment on; later comments are blank.

    Attributes:
        lines: the lines that are neither blank nor comments, the first of them.
        text: everything from the first of them on.
        first_line: its number.
        comment: the last comment before it, without its sign.
    """

    def __init__(self, text: str) -> None:
        kept: list[str] = []
        self.lines: list[str] = []
        self.comment = ""
        self.first_line = 1
        quoted = False
        for line in text.split("\n"):
            if not quoted and line.lstrip().startswith(("#", "%")):
                if not kept:
                    self.comment = line.lstrip().lstrip("#%").strip()
                line = ""  # noqa: PLW2901  # keeps the numbers of the lines after it
            quoted ^= line.count('"') % 2 == 1
            if not kept and not line.strip():
                self.first_line += 1
                continue
            kept.append(line)
            if line.strip() and len(self.lines) < _TRIED_LINES:
                self.lines.append(line)
        self.text = "\n".join(kept)


def _merit(lines: Sequence[str], delimiter: str) -> tuple[float, int]:
    """How many numbers a delimiter leaves in a row, and how many cells in the first line."""
    split = [line.split(None if delimiter == " " else delimiter) for line in lines]
    counts = [sum(number(cell) is not None for cell in cells) for cells in split[1:] or split]
    return median(counts), len(split[0])


def _frame(content: _Content, delimiter: str, source: str) -> pd.DataFrame:
    """All cells as strings; "" where a row is too short."""
    try:
        return pd.read_csv(
            io.StringIO(content.text),
            sep=r"\s+" if delimiter == " " else delimiter,
            header=None,
            dtype=str,
            na_filter=False,
            skip_blank_lines=False,
            skipinitialspace=True,
        )
    except pd.errors.ParserError as error:
        ragged = _RAGGED.search(str(error))
        if ragged is None:
            raise InputDataError(
                f"{source}: not a table ({reason(error)}); close the quotes"
            ) from error
        line = int(ragged[2]) + content.first_line - 1
        raise InputDataError(
            f"{source}, line {line}: found {ragged[3]} fields, but line {content.first_line} has"
            f" {ragged[1]}; remove the surplus, or quote a name that contains the delimiter"
        ) from error


def _stripped(cells: Sequence[str]) -> Cells:
    return tuple(cell.strip() for cell in cells)


def _matrices(table: Table) -> Table:
    """Matrices written in lines of four numbers each as rows; other tables as they are."""
    if len(table.rows[0]) != 4:
        return table
    last = [[number(cell) for cell in row] for row in table.rows[3::4]]
    right = [number(row[3]) for row in table.rows]
    n = len(table.rows)
    if n % 4 == 0 and (
        all(row == [0.0, 0.0, 0.0, 1.0] for row in last) or right == [0.0, 0.0, 0.0, 1.0] * (n // 4)
    ):
        height = 4
    elif n % 3 == 0:
        height = 3
    else:
        return table
    joined = [sum(table.rows[i : i + height], ()) for i in range(0, n, height)]
    return replace(table, rows=tuple(joined), places=table.places[::height])
