"""Checked reading of parsed documents (JSON, YAML): errors name file, key, value found and wanted."""

import math
import reprlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array


class _Short(reprlib.Repr):
    """Representations of bounded length."""

    def repr_int(self, x: int, level: int) -> str:
        """An integer; Python refuses to print those of thousands of digits."""
        bits = x.bit_length()
        return f"an integer of {bits} bits" if bits > 200 else super().repr_int(x, level)


_SHORT = _Short()
_SHORT.maxlevel = 2
_SHORT.maxlist = _SHORT.maxdict = 10
_SHORT.maxstring = _SHORT.maxother = 80


def shown(value: object) -> str:
    """A value as an error message shows it: bounded in length, control characters escaped."""
    return _SHORT.repr(value)


def reason(error: Exception) -> str:
    """What a library says about a failure, in one line of bounded length."""
    # Without number and path: the message has the path.
    said = error.strerror if isinstance(error, OSError) else None
    text = " ".join(str(said or error).split()) or type(error).__name__
    return text if len(text) <= 200 else f"{text[:200]}..."


@dataclass(frozen=True, slots=True, kw_only=True)
class Fields:
    """A mapping of a parsed document.

    Attributes:
        where: the document, as the start of an error message: "camera file a.yaml".
        remedy: what to do about an error, as the end of the message.
        values: the mapping.
        path: keys from the document's root to this mapping, each followed by a dot.
    """

    where: str
    remedy: str
    values: Mapping[str, object]
    path: str = ""

    def error(self, key: str, wanted: str) -> InputDataError:
        """The error for the value at a key, or for the lack of one."""
        found = f"is {shown(self.values[key])}" if key in self.values else "is missing"
        return InputDataError(
            f"{self.where}: {self.path}{key} {found}, but must be {wanted}; {self.remedy}"
        )

    def number(self, key: str) -> float:
        """A finite number.

        Raises:
            InputDataError: there is none.
        """
        number = finite(self.values.get(key))
        if number is None:
            raise self.error(key, "a finite number")
        return number

    def optional_number(self, key: str) -> float | None:
        """A finite number, or None where the document has null.

        Raises:
            InputDataError: the key is missing or has another value.
        """
        return None if self._is_null(key) else self.number(key)

    def integer(self, key: str, *, least: int = 0, most: int = 2**53) -> int:
        """An integer within bounds.

        Raises:
            InputDataError: there is none.
        """
        value = self.values.get(key)
        if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
            raise self.error(key, f"an integer from {least} to {most}")
        return value

    def text(self, key: str, allowed: Collection[str] = ()) -> str:
        """A string, of the allowed ones if any are given.

        Raises:
            InputDataError: there is none.
        """
        value = self.values.get(key)
        if not isinstance(value, str) or (allowed and value not in allowed):
            raise self.error(
                key, f"one of {', '.join(map(repr, allowed))}" if allowed else "a string"
            )
        return value

    def flag(self, key: str) -> bool:
        """A boolean.

        Raises:
            InputDataError: there is none.
        """
        value = self.values.get(key)
        if not isinstance(value, bool):
            raise self.error(key, "true or false")
        return value

    def array(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """An array of finite numbers from nested lists; None in ``shape``: any length.

        Raises:
            InputDataError: there is none of this shape.
        """
        numbers: list[float] = []
        if not _collect(self.values.get(key), shape, numbers):
            size = " x ".join("n" if n is None else str(n) for n in shape)
            raise self.error(key, f"{size} finite numbers in nested lists")
        return np.array(numbers).reshape([-1 if n is None else n for n in shape])

    def optional_array(self, key: str, shape: tuple[int | None, ...]) -> Array | None:
        """An array of finite numbers, or None where the document has null.

        Raises:
            InputDataError: the key is missing or has another value.
        """
        return None if self._is_null(key) else self.array(key, shape)

    def mapping(self, key: str) -> "Fields":
        """A mapping at a key.

        Raises:
            InputDataError: there is none.
        """
        value = self.values.get(key)
        if not isinstance(value, dict) or not all(isinstance(name, str) for name in value):
            raise self.error(key, "a mapping with names as keys")
        return Fields(where=self.where, remedy=self.remedy, values=value, path=f"{self.path}{key}.")

    def optional_mapping(self, key: str) -> "Fields | None":
        """A mapping at a key, or None where the document has null.

        Raises:
            InputDataError: the key is missing or has another value.
        """
        return None if self._is_null(key) else self.mapping(key)

    def mappings(self, key: str) -> "tuple[Fields, ...]":
        """A list of mappings at a key.

        Raises:
            InputDataError: there is none.
        """
        value = self.values.get(key)
        if not isinstance(value, list):
            raise self.error(key, "a list of mappings")
        items = Fields(
            where=self.where,
            remedy=self.remedy,
            values={f"{key}[{i}]": item for i, item in enumerate(value)},
            path=self.path,
        )
        return tuple(items.mapping(name) for name in items.values)

    def _is_null(self, key: str) -> bool:
        return key in self.values and self.values[key] is None


def finite(value: object) -> float | None:
    """The value as a float, if it is a finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:  # an integer of more than 308 digits
        return None
    return number if math.isfinite(number) else None


def _collect(value: object, shape: tuple[int | None, ...], numbers: list[float]) -> bool:
    """Append the numbers of nested lists; False where they do not have the shape."""
    if not shape:
        number = finite(value)
        if number is None:
            return False
        numbers.append(number)
        return True
    if not isinstance(value, list) or shape[0] not in (None, len(value)):
        return False
    return all(_collect(item, shape[1:], numbers) for item in value)
