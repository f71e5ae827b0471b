"""YAML files of other programs and of users, read as plain data; entry point ``read_yaml``."""

import re
from collections.abc import Hashable
from pathlib import Path

import yaml

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import Fields, reason, shown
from handeye_fg.io.files import read_text

_LARGEST_FILE = 100_000  # characters; a camera or target file has some hundred
_YAML = "tag:yaml.org,2002:"

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


class _Loader(yaml.SafeLoader):
    """Plain data only: no aliases, which could grow without bound, and no double keys."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node that is no alias."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.constructor.ConstructorError(None, None, "aliases are not supported")
        return super().compose_node(parent, index)

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


def read_yaml(path: Path, what: str, wanted: str, remedy: str) -> Fields:
    """Read the mapping that is a file's only document.

    Args:
        path: the file.
        what: the kind of file, as the start of an error message: "camera file".
        wanted: what to give instead of a file of another kind.
        remedy: what to do about an error, as the end of a message.

    Raises:
        InputDataError: the file is missing, empty, too long, not YAML, or no mapping.
    """
    text = read_text(path, what)
    if len(text) > _LARGEST_FILE:
        raise InputDataError(
            f"{what} {path}: {len(text)} characters are too many for a {what}, at most"
            f" {_LARGEST_FILE} were expected; give {wanted}"
        )
    if text.startswith("%YAML"):  # OpenCV's header is not always valid YAML
        text = text[text.find("\n") :] if "\n" in text else ""
    try:
        documents = [d for d in yaml.load_all(text, Loader=_Loader) if d is not None]
    except _MALFORMED as error:
        raise InputDataError(
            f"{what} {path}: not valid YAML ({reason(error)}); {remedy}"
        ) from error
    if len(documents) != 1 or not isinstance(documents[0], dict):
        found = shown(documents[0]) if len(documents) == 1 else f"{len(documents)} documents"
        raise InputDataError(
            f"{what} {path}: found {found}, but wanted one mapping of keys to values; give {wanted}"
        )
    values = {str(key): value for key, value in documents[0].items()}
    return Fields(where=f"{what} {path}", remedy=remedy, values=values)
