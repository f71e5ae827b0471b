"""YAML and JSON documents, arrays of NumPy and the text of tf_echo as tables of poses."""

import io
import json
import re
import tokenize
import warnings
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.poses.table import Table
from handeye_fg.io.yaml_files import parse_yaml

_LARGEST_YAML = 3_000_000  # characters: some 15000 messages, read in about 5 s
_LARGEST_ARRAY = 10_000_000  # entries
_MOST_COLUMNS = 1000
_LISTS = ("poses", "samples", "frames", "transforms", "data")
_MAGIC = b"\x93NUMPY"

# What NumPy raises on damaged files.
_DAMAGED = (
    ValueError,
    TypeError,
    EOFError,
    OSError,
    MemoryError,
    SyntaxError,
    OverflowError,
    LookupError,
    RecursionError,
    tokenize.TokenError,
)

_TF_POSE = re.compile(
    r"(?:At time[ \t]+(?P<time>[^\s]+)[^\[\]]{0,200})?"
    r"Translation:[ \t]*\[(?P<translation>[^\[\]\n]{0,200})\]"
    r"[^\[\]]{0,200}Quaternion(?:[ \t]*\(xyzw\))?[ \t]*\[(?P<quaternion>[^\[\]\n]{0,200})\]"
)


def is_array(data: bytes) -> bool:
    """Whether the content is that of a .npy file."""
    return data.startswith(_MAGIC)


def array_table(data: bytes, source: str) -> Table:
    """The poses of a .npy file, of shape (n, 4, 4), (n, 3, 4), (4, 4), (3, 4) or (n, k).

    Raises:
        InputDataError: it is damaged, or holds no numbers of such a shape.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # remarks on headers of old files
            shape, kind = _claimed(data)
            if kind.kind not in "fiu" or np.prod(shape, dtype=float) > _LARGEST_ARRAY:
                raise InputDataError(
                    f"{source}: {kind} of shape {shape}, but must be numbers of shape (n, 4, 4)"
                )
            array = np.load(io.BytesIO(data), allow_pickle=False).astype(np.float64)
    except _DAMAGED as error:
        raise InputDataError(
            f"{source}: not an array of numbers ({reason(error)}); save one with numpy.save, of shape"
            " (n, 4, 4)"
        ) from error
    if array.ndim == 2 and array.shape in {(4, 4), (3, 4)}:
        array = array[None]
    if array.ndim == 3 and array.size and array.shape[1:] in {(4, 4), (3, 4)}:
        array = array.reshape(len(array), -1)
    if array.ndim != 2 or not array.size or array.shape[1] > _MOST_COLUMNS:
        raise InputDataError(f"{source}: {array.shape=}, but must be (n, 4, 4) or (n, 3, 4)")
    rows = tuple(tuple(map(repr, row)) for row in array.tolist())
    places = _places(source, "pose", len(rows))
    return Table(source=source, header_place=source, header=(), rows=rows, places=places)


def _claimed(data: bytes) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """The shape and type that the header of a .npy file claims."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0
    shape, _, kind = read(file) if version == (1, 0) else np.lib.format.read_array_header_2_0(file)
    return shape, kind


def is_transform_echo(text: str) -> bool:
    """Whether the text is what tf_echo or tf2_echo prints."""
    return "Translation: [" in text and "Quaternion" in text


def transform_table(text: str, source: str) -> Table:
    """The transforms that tf_echo or tf2_echo printed.

    Raises:
        InputDataError: there is none.
    """
    found = list(_TF_POSE.finditer(text))
    rows = [
        (match["time"] or "", *match["translation"].split(","), *match["quaternion"].split(","))
        for match in found
    ]
    for i, row in enumerate(rows):
        if len(row) != 8:
            raise InputDataError(
                f"{source}, transform {i + 1}: found {len(row) - 1} numbers, but must be 3 of the"
                " translation and 4 of the quaternion; correct it or leave it out"
            )
    if not rows:
        raise InputDataError(
            f"{source}: no transform with Translation: [...] and Quaternion [...] is whole; give the text"
            " of tf_echo"
        )
    timed = all(row[0] for row in rows)
    header = (
        *(("time [s]",) if timed else ()),
        *(f"translation.{axis}" for axis in "xyz"),
        *(f"rotation.{axis}" for axis in "xyzw"),
    )
    cells = tuple(row if timed else row[1:] for row in rows)
    places = _places(source, "transform", len(rows))
    return Table(source=source, header_place=source, header=header, rows=cells, places=places)


def document_tables(text: str, source: str, *, is_json: bool) -> tuple[Table, ...]:
    """The ways in which YAML or JSON can hold poses: one for each document, entry of a list, or name.

    Raises:
        InputDataError: it is neither, or too large.
    """
    roots = _json(text, source) if is_json else _yaml(text, source)
    try:
        tables = [
            _flat(source, labels, entries, what)
            for what, labels, entries in _ways(roots)
            if entries and all(isinstance(entry, dict | list) for entry in entries)
        ]
    except RecursionError as error:
        raise InputDataError(f"{source}: nested too deeply; give a file of poses") from error
    if not tables:
        raise InputDataError(
            f"{source}: found {shown(roots[0] if len(roots) == 1 else roots)}, but wanted poses: mappings"
            " or matrices; give a file of poses"
        )
    return tuple(tables)


def _json(text: str, source: str) -> list[object]:
    try:
        return [json.loads(text, object_pairs_hook=_once)]
    except (ValueError, RecursionError) as error:
        raise InputDataError(
            f"{source}: not valid JSON ({reason(error)}); correct the file"
        ) from error


def _once(pairs: Sequence[tuple[str, object]]) -> dict[str, object]:
    """A JSON object without double keys."""
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"{shown(max(keys, key=keys.count))} occurs twice")
    return values


def _yaml(text: str, source: str) -> list[object]:
    if len(text) > _LARGEST_YAML:
        raise InputDataError(
            f"{source}: {len(text)} characters of YAML are too many, at most {_LARGEST_YAML} were"
            " expected; give the poses as CSV"
        )
    return parse_yaml(text, source, "correct the file")


def _ways(
    roots: Sequence[object],
) -> Iterator[tuple[str, tuple[str, ...] | None, Sequence[object]]]:
    """Kinds of entries, their names if any, and the entries."""
    root = roots[0] if len(roots) == 1 else None
    if len(roots) != 1:
        yield "document", None, roots
    elif isinstance(root, list):
        if (root and all(isinstance(item, int | float) for item in root)) or (
            len(root) in {3, 4} and all(_is_row(item) for item in root)
        ):
            yield "matrix", None, [root]
        else:
            yield "entry", None, root
    elif isinstance(root, dict):
        yield "document", None, [root]
        for key in _LISTS:
            if isinstance(root.get(key), list):
                yield "entry", None, root[key]
            elif isinstance(root.get(key), dict):
                yield "entry", tuple(map(str, root[key])), list(root[key].values())
        # A bare list of each is easier to tell from a mapping of one pose than a mapping is.
        yield "entry", tuple(map(str, root)), list(root.values())


def _is_row(item: object) -> bool:
    return isinstance(item, list) and len(item) == 4 and not any(isinstance(x, list) for x in item)


def _flat(
    source: str, labels: tuple[str, ...] | None, entries: Sequence[object], what: str
) -> Table:
    """A table with a column for each path to a value."""
    flat = [dict(_leaves(entry, "")) for entry in entries]
    header = list(dict.fromkeys(key for values in flat for key in values))
    if len(header) > _MOST_COLUMNS:
        raise InputDataError(
            f"{source}: found {len(header)} different values in an entry, but a pose has at most 16; give"
            " a file of poses"
        )
    places = _places(source, what, len(entries))
    if labels is not None:
        places = tuple(f"{source}, {what} {shown(label)}" for label in labels)
    return Table(
        source=source,
        header_place=source,
        header=tuple(header),
        rows=tuple(tuple(values.get(key, "") for key in header) for values in flat),
        places=places,
        labels=labels,
    )


def _leaves(value: object, path: str) -> Iterator[tuple[str, str]]:
    """Paths and values, with the entries of nested lists of numbers counted through."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _leaves(item, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list):
        for i, item in enumerate(_entries(value)):
            yield from _leaves(item, f"{path or 'matrix'}.{i}")
    else:
        yield path, _cell(value)


def _entries(value: Sequence[object]) -> list[object]:
    """The items of lists in lists."""
    return [
        inner for item in value for inner in (_entries(item) if isinstance(item, list) else [item])
    ]


def _cell(value: object) -> str:
    """A scalar as text."""
    if isinstance(value, bool) or value is None:
        return ""
    if (
        isinstance(value, int) and value.bit_length() > 128
    ):  # Python prints no more than 4300 digits
        return "too large"
    return value if isinstance(value, str) else repr(value)


def _places(source: str, what: str, count: int) -> tuple[str, ...]:
    if count == 1:
        return (source,)
    return tuple(f"{source}, {what} {i + 1}" for i in range(count))
