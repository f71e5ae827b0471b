"""What people see of a run: text on stderr, progress, the libraries' logs."""

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBars

from handeye_fg.progress import Progress

_STAGES = {
    "data sets": "data sets",
    "images": "reading images",
    "target": "finding the target",
    "features": "finding features",
    "pairs": "matching pairs",
    "registered": "registering images",
    "iterations": "refining",
}


class _Bars:
    """A bar for each stage, for a terminal."""

    def __init__(self, bars: ProgressBars) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        """Move the stage's bar."""
        if stage not in self._tasks:
            self.close()
            self._tasks[stage] = self._bars.add_task(_STAGES.get(stage, stage), total=total)
        self._bars.update(self._tasks[stage], completed=done, total=total)

    def close(self) -> None:
        """A stage whose end was not known beforehand ends where the next begins."""
        for task in self._bars.tasks:
            if task.total is None:
                self._bars.update(task.id, total=task.completed)


class _Lines:
    """A line at each stage's start and end, for a log file."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._stage: str | None = None
        self._count = ""

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        """Note the count; a new stage ends the one before."""
        if stage != self._stage:
            self.close()
            self._stage = stage
            say(self._console, f"{_STAGES.get(stage, stage)} ...")
        self._count = f"{done}" if total is None else f"{done} of {total}"

    def close(self) -> None:
        """End the current stage."""
        if self._stage is not None:
            say(self._console, f"{_STAGES.get(self._stage, self._stage)}: {self._count}")
        self._stage = None


@contextmanager
def progress_view(console: Console) -> Iterator[Progress]:
    """Bars in a terminal, lines elsewhere."""
    if console.is_terminal:
        columns = (
            TextColumn("{task.description:<20}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
        )
        with ProgressBars(*columns, console=console) as bars:
            view = _Bars(bars)
            yield view
            view.close()
    else:
        lines = _Lines(console)
        yield lines
        lines.close()


@contextmanager
def native_stdout_moved(target: str | None) -> Iterator[None]:
    """Keep what C++ libraries print on stdout away from it: only the result belongs there.

    Args:
        target: file that gets the text instead; None: stderr.
    """
    sys.stdout.flush()
    saved = os.dup(1)
    try:
        if target is None:
            os.dup2(2, 1)
        else:
            with Path(target).open("wb") as sink:
                os.dup2(sink.fileno(), 1)
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)


@contextmanager
def logged(console: Console, level: int) -> Iterator[None]:
    """Show the package's log on the console."""
    logger = logging.getLogger("handeye_fg")
    handler = RichHandler(console=console, show_path=False, show_time=False, markup=False)
    before = logger.level
    logger.addHandler(handler)
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)


def stderr_console() -> Console:
    """The console for people."""
    return Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


def say(console: Console, text: str) -> None:
    """Print text that may hold anything."""
    console.print(_printable(text))


def _printable(text: str) -> str:
    """Text that cannot steer the terminal: control characters become escapes."""
    return "".join(
        char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in text
    )
