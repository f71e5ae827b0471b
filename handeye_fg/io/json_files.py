"""JSON files of other programs, read as plain data; entry point ``read_json``."""

import json
from pathlib import Path

from handeye_fg.errors import InputDataError
from handeye_fg.io.fields import Fields, reason, shown
from handeye_fg.io.files import read_text


def read_json(path: Path, what: str, wanted: str, remedy: str) -> Fields:
    """Read the object that is a file's content.

    Args:
        path: the file.
        what: the kind of file, as the start of an error message: "camera file".
        wanted: what to give instead of a file of another kind.
        remedy: what to do about an error, as the end of a message.

    Raises:
        InputDataError: the file is missing, empty, too large, not JSON, or no object.
    """
    try:
        content = json.loads(read_text(path, what))
    except (ValueError, RecursionError) as error:
        raise InputDataError(
            f"{what} {path}: not valid JSON ({reason(error)}); {remedy}"
        ) from error
    if not isinstance(content, dict):
        raise InputDataError(
            f"{what} {path}: found {shown(content)}, but wanted an object with keys; give {wanted}"
        )
    return Fields(where=f"{what} {path}", remedy=remedy, values=content)
