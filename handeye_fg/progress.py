"""How long stages tell a caller where they are; the terminal's view of it lives in the CLI."""

from collections.abc import Callable

Progress = Callable[[str, int, int | None], None]
"""Called as ``progress(stage, done, total)``; ``total`` is None where it is not known beforehand.

Stages: "images", "features", "pairs", "registered", "iterations".
"""


def silent(_stage: str, _done: int, _total: int | None) -> None:
    """Report nothing."""
