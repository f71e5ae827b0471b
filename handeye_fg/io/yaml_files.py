"""YAML of other programs and of users, read as plain data; entry points ``read_yaml``, ``parse_yaml``."""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import Fields, reason, shown
from handeye_fg.io.files import read_text

_LARGEST_FILE = 100_000  # characters; a camera or target file has some hundred
_LONGEST_SCALAR = 4000  # characters
_DEEPEST = 50  # levels of nesting
_YAML = "tag:yaml.org,2002:"
_SafeLoader: Any = getattr(
    yaml, "CSafeLoader", yaml.SafeLoader
)  # ten times faster where there is libyaml

# What PyYAML raises on malformed text and on tags that do not suit their value.
_MALFORMED = (
    yaml.YAMLError,
    ValueError,
    TypeError,
    AttributeError,
    LookupError,
    ArithmeticError,
    RecursionError,
)


class _Loader(_SafeLoader):  # type: ignore[misc]  # one of two classes
    """Plain data only, without double keys."""

    def construct_plain(self, node: yaml.Node) -> dict[Hashable, object]:
        """A mapping, of whatever tag, without double keys."""
        if not isinstance(node, yaml.MappingNode):
            raise yaml.constructor.ConstructorError(None, None, f"{node.tag} must be a mapping")
        result: dict[Hashable, object] = self.construct_mapping(node, deep=True)
        if len(result) != len(node.value):
            raise yaml.constructor.ConstructorError(
                None, None, f"a key occurs twice in the mapping in line {node.start_mark.line + 1}"
            )
        return result

    def construct_text(self, node: yaml.ScalarNode) -> str:
        """A scalar as it is written."""
        return str(node.value)


for _tag in ("map", "opencv-matrix", "opencv-nd-matrix"):
    _Loader.add_constructor(_YAML + _tag, _Loader.construct_plain)
_Loader.add_constructor(_YAML + "timestamp", _Loader.construct_text)
_Loader.add_implicit_resolver(  # YAML 1.1 takes 1e-3 for text
    _YAML + "float", re.compile(r"[-+]?[0-9.]+[eE][-+]?[0-9]+$"), list("-+.0123456789")
)


def read_yaml(
    path: Path, what: str, wanted: str, remedy: str, longest: int = _LARGEST_FILE
) -> Fields:
    """Read the mapping that is a file's only document.

    Args:
        path: the file.
        what: the kind of file, as the start of an error message: "camera file".
        wanted: what to give instead of a file of another kind.
        remedy: what to do about an error, as the end of a message.
        longest: most characters that such a file has.

    Raises:
        InputDataError: the file is missing, empty, too long, not YAML, or no mapping.
    """
    text = read_text(path, what)
    if len(text) > longest:
        raise InputDataError(
            f"{what} {path}: {len(text)} characters are too many for a {what}, at most"
            f" {longest} were expected; give {wanted}"
        )
    if text.startswith("%YAML"):  # OpenCV's header is not always valid YAML
        text = text[text.find("\n") :] if "\n" in text else ""
    documents = parse_yaml(text, f"{what} {path}", remedy)
    if len(documents) != 1 or not isinstance(documents[0], dict):
        found = shown(documents[0]) if len(documents) == 1 else f"{len(documents)} documents"
        raise InputDataError(
            f"{what} {path}: found {found}, but wanted one mapping of keys to values; give {wanted}"
        )
    values = {str(key): value for key, value in documents[0].items()}
    return Fields(where=f"{what} {path}", remedy=remedy, values=values)


def parse_yaml(text: str, where: str, remedy: str) -> list[object]:
    """The documents of a YAML text that hold something.

    Args:
        text: the YAML; aliases, which could grow without bound, and deep nesting are refused.
        where: the start of an error message.
        remedy: what to do about an error, as the end of a message.

    Raises:
        InputDataError: it is not YAML, or not plain data.
    """
    try:
        _check_events(text)
        return [d for d in yaml.load_all(text, Loader=_Loader) if d is not None]
    except _MALFORMED as error:
        raise InputDataError(f"{where}: not valid YAML ({reason(error)}); {remedy}") from error


def _check_events(text: str) -> None:
    """Refuse aliases and deep nesting before anything is built."""
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.AliasEvent):
            raise yaml.constructor.ConstructorError(None, None, "aliases are not supported")
        if isinstance(event, yaml.ScalarEvent) and len(event.value) > _LONGEST_SCALAR:
            # Numbers to the base 60, 1:2:3..., take the square of their length.
            raise ValueError(f"a value of {len(event.value)} characters")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEEPEST:
            raise ValueError(f"nested deeper than {_DEEPEST} levels")
