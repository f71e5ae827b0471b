"""How a file of poses was read: ``ReadAs``, and its form in ``result.json``."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from handeye_fg.io.fields import Fields


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadAs:
    """How a file of poses was read.

    Attributes:
        format: its format, as for ``--pose-format``.
        recognised: whether the file told the format; else the user named it.
        numbers: what its numbers were taken to mean, in words.
    """

    format: str
    recognised: bool
    numbers: str

    def __str__(self) -> str:
        return f"{self.format} ({self.numbers}), {'recognised' if self.recognised else 'as told'}"


def read_as_document(of: Mapping[str, ReadAs]) -> dict[str, Any]:
    """The content of the key ``poses_read_as``."""
    return {whose: asdict(one) for whose, one in of.items()}


def read_read_as(fields: Fields) -> dict[str, ReadAs]:
    """How the files were read, from the content of the key ``poses_read_as``.

    Raises:
        InputDataError: it has not the form of it.
    """
    entries = {whose: fields.mapping(whose) for whose in fields.values}
    return {
        whose: ReadAs(
            format=one.text("format"),
            recognised=one.flag("recognised"),
            numbers=one.text("numbers"),
        )
        for whose, one in entries.items()
    }
