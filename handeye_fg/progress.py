"""How long stages tell a caller where they are; the terminal's view of it lives in the CLI."""

from collections.abc import Callable
from time import perf_counter

Progress = Callable[[str, int, int | None], None]
"""Called as ``progress(stage, done, total)``; ``total`` is None where it is not known beforehand.

Stages: "data sets", "images", "target", "features", "pairs", "registered", "iterations".
"""


def silent(_stage: str, _done: int, _total: int | None) -> None:
    """Report nothing."""


class Stopwatch:
    """Seconds by stage, in the order in which the stages ended."""

    def __init__(self) -> None:
        self._since = perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """End a stage."""
        now = perf_counter()
        self._laps[stage] = now - self._since
        self._since = now

    @property
    def timing_s(self) -> dict[str, float]:
        """Seconds by stage, and their total."""
        return {**self._laps, "total": sum(self._laps.values())}
