"""Options as TOML: ``config.toml`` beside each result, and ``--config run.toml``.

Any frozen dataclass of booleans, numbers, strings, literals, tuples of one kind, optional ones of them and
further dataclasses will do: the fields' annotations say what a file may hold.
"""

import dataclasses
import hashlib
import json
import math
import tomllib
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import tomli_w

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import reason, shown
from handeye_fg.io.files import read_text, write_atomic
from handeye_fg.options import Options

_T = TypeVar("_T")
_NAMES = {bool: "true or false", int: "an integer", float: "a finite number", str: "a string"}


def write_config(options: Options, path: Path) -> Path:
    """Write options as TOML, whole or not at all; options that are None are left out.

    Args:
        options: the options.
        path: the file.

    Returns:
        The path.

    Raises:
        InputDataError: the file cannot be written.
    """
    return write_atomic(path, tomli_w.dumps(_table(options)))


def read_config(path: Path) -> Options:
    """Read options; what the file leaves out has its default.

    Args:
        path: a TOML file.

    Returns:
        The options.

    Raises:
        InputDataError: the file is missing, not TOML, has an unknown key or a value that the option
            cannot have.
    """
    where = f"config file {path}"
    try:
        table = tomllib.loads(read_text(path, "config file", may_be_empty=True))
    except (ValueError, RecursionError) as error:
        raise InputDataError(
            f"{where}: not valid TOML ({reason(error)}); correct the file"
        ) from error
    return _block(Options, table, where, "")


def options_digest(options: Options) -> str:
    """SHA-256, in hexadecimal, of the options; the same for options that are equal."""
    text = json.dumps(_table(options), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def _table(block: Any) -> dict[str, Any]:
    """Nested dicts of a dataclass, without None; numbers of float fields are floats."""
    hints = get_type_hints(type(block))
    return {
        field.name: _plain(value, hints[field.name])
        for field in dataclasses.fields(block)
        if (value := getattr(block, field.name)) is not None
    }


def _plain(value: Any, hint: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return _table(value)
    if isinstance(value, tuple):
        return [_plain(item, get_args(hint)[0]) for item in value]
    return float(value) if float in (hint, *get_args(hint)) else value


def _block(kind: type[_T], table: Mapping[str, Any], where: str, path: str) -> _T:
    """A dataclass from a TOML table; ``path`` are the keys before it, each followed by a dot."""
    hints = get_type_hints(kind)
    for key in table:
        if key not in hints:
            raise InputDataError(
                f"{where}: {path}{shown(key).strip(chr(39))} is not an option, but one of"
                f" {', '.join(hints)} was expected; correct or remove it"
            )
    values = {key: _value(hints[key], value, where, f"{path}{key}") for key, value in table.items()}
    try:
        return kind(**values)
    except ValueError as error:  # the block's own checks
        raise InputDataError(
            f"{where}: {path.rstrip('.') or 'options'}: {reason(error)}"
        ) from error


def _value(hint: Any, value: Any, where: str, key: str) -> Any:
    """The value of one option, checked against its annotation."""
    origin = get_origin(hint)
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        if not isinstance(value, dict):
            raise _refused(value, where, key, "a table")
        return _block(hint, value, where, f"{key}.")
    if origin in (Union, types.UnionType):  # optional: TOML has no null, so leave out means None
        parts = [part for part in get_args(hint) if part is not types.NoneType]
        chosen = parts[0] if len(parts) == 1 else _of_kind(parts, value, where, key)
        return _value(chosen, value, where, key)
    if origin is Literal:
        allowed = get_args(hint)
        if not any(value == choice and type(value) is type(choice) for choice in allowed):
            raise _refused(value, where, key, f"one of {', '.join(map(repr, allowed))}")
        return value
    if origin is tuple:
        if not isinstance(value, list):
            raise _refused(value, where, key, "an array")
        return tuple(
            _value(get_args(hint)[0], item, where, f"{key}[{i}]") for i, item in enumerate(value)
        )
    return _scalar(hint, value, where, key)


def _of_kind(parts: list[Any], value: Any, where: str, key: str) -> Any:
    """The one of several dataclasses that the table's ``kind`` names."""
    kinds = {get_args(get_type_hints(part)["kind"])[0]: part for part in parts}
    if not isinstance(value, dict) or value.get("kind") not in kinds:
        raise _refused(value, where, key, f"a table with a kind: one of {', '.join(kinds)}")
    return kinds[value["kind"]]


def _scalar(kind: Any, value: Any, where: str, key: str) -> Any:
    if kind not in _NAMES:
        raise TypeError(f"option {key}: the annotation {kind} cannot be read from a file")
    if kind is float and type(value) is int and abs(value) <= 2**53:
        return float(value)
    if type(value) is not kind or (kind is float and not math.isfinite(value)):
        raise _refused(value, where, key, _NAMES[kind])
    return value


def _refused(value: object, where: str, key: str, wanted: str) -> InputDataError:
    return InputDataError(
        f"{where}: {key} is {shown(value)}, but must be {wanted}; correct or remove it"
    )
