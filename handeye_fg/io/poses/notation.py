"""Poses in the notation of a controller's own language, one in a line; entry ``notation_table``.

Universal Robots ``p[x, y, z, rx, ry, rz]``, KUKA ``{X 500, Y 0, Z 400, A 90, B 0, C 180}`` and ABB
``[[x, y, z], [q1, q2, q3, q4], ...]`` say themselves what their numbers are.
"""

import re

from handeye_fg.errors import InputDataError
from handeye_fg.io.poses.formats import FORMATS
from handeye_fg.io.poses.table import Table

_N = r"\s*([+-]?[\d.]{1,40}(?:[eE][+-]?\d{1,3})?)\s*"
_NOTATIONS = {
    "ur": re.compile(rf"p\[{_N},{_N},{_N},{_N},{_N},{_N}\]"),
    "kuka": re.compile(
        r"\{[^{}]{0,40}?" + ",".join(rf"\s*{axis}{_N}" for axis in "XYZABC") + r"[^{}]{0,200}\}"
    ),
    "abb": re.compile(rf"\[\s*\[{_N},{_N},{_N}\]\s*,\s*\[{_N},{_N},{_N},{_N}\]"),
}
_LONGEST_LINE = 2000
_AROUND_NAME = " \t,;:|=\"'"


def notation_of(text: str) -> str | None:
    """The format whose notation the first line with content has, or None."""
    first = next((line for line in text.split("\n") if line.strip() and line[0] not in "#%"), "")
    if len(first) > _LONGEST_LINE:
        return None
    return next((name for name, pattern in _NOTATIONS.items() if pattern.search(first)), None)


def notation_table(text: str, source: str, name: str) -> Table:
    """The poses of lines in one notation; what stands before a pose names its image.

    Args:
        text: the file's content.
        source: the file, as the start of an error message.
        name: of the format with this notation.

    Raises:
        InputDataError: a line holds no pose, or some lines name their image and others do not.
    """
    rows, places = [], []
    for line, content in enumerate(text.split("\n"), 1):
        if not content.strip() or content.startswith(("#", "%")):
            continue
        found = _NOTATIONS[name].search(content) if len(content) <= _LONGEST_LINE else None
        if found is None:
            raise InputDataError(
                f"{source}, line {line}: no pose of {FORMATS[name].title} as in the lines before it; correct"
                " it or remove the line"
            )
        if _NOTATIONS[name].search(content, found.end()):
            raise InputDataError(
                f"{source}, line {line}: holds several poses; give each its own line"
            )
        rows.append((content[: found.start()].strip(_AROUND_NAME), *found.groups()))
        places.append(f"{source}, line {line}")
    unnamed = [place for place, row in zip(places, rows, strict=True) if not row[0]]
    if unnamed and len(unnamed) < len(rows):
        raise InputDataError(
            f"{unnamed[0]}: names no image before its pose, but other lines do; name all or none"
        )
    skipped = 1 if unnamed else 0
    return Table(
        source=source,
        header_place=source,
        header=FORMATS[name].columns[skipped:],
        rows=tuple(row[skipped:] for row in rows),
        places=tuple(places),
        told=name,
    )
