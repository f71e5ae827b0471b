"""What people see of a run: text on stderr, progress, the libraries' logs."""

import logging
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter

from rich.console import Console
from rich.logging import RichHandler
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
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


# A log file is read later: a line in so many seconds says that it goes on.
_INTERVAL_S = 10.0


class _Bars:
    """A bar for each stage, for a terminal."""

    def __init__(self, bars: ProgressBars) -> None:
        self._bars = bars
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        """Move the stage's bar."""
        if stage not in self._tasks:
            self.close()
            name = _STAGES.get(stage, stage)
            # What an earlier run has done tells nothing of the speed.
            self._tasks[stage] = self._bars.add_task(name, total=total, completed=done)
        self._bars.update(self._tasks[stage], completed=done, total=total)

    def close(self) -> None:
        """A stage whose end was not known beforehand ends where the next begins."""
        for task in self._bars.tasks:
            if task.total is None:
                self._bars.update(task.id, total=task.completed)


class Lines:
    """A line at each stage's start and end, and now and then with the time left, for a log file."""

    def __init__(self, console: Console, clock: Callable[[], float] = perf_counter) -> None:
        self._console = console
        self._clock = clock
        self._stage: str | None = None
        self._count = ""
        self._first, self._since, self._last = 0, 0.0, 0.0

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        """Note the count; a new stage ends the one before."""
        now = self._clock()
        if stage != self._stage:
            self.close()
            self._stage = stage
            self._first, self._since, self._last = done, now, now
            say(self._console, f"{_STAGES.get(stage, stage)} ...")
        self._count = f"{done}" if total is None else f"{done} of {total}"
        if now - self._last >= _INTERVAL_S and total is not None and self._first < done < total:
            self._last = now
            left = (now - self._since) * (total - done) / (done - self._first)
            say(
                self._console, f"{_STAGES.get(stage, stage)}: {self._count}, {_duration(left)} left"
            )

    def close(self) -> None:
        """End the current stage."""
        if self._stage is not None:
            say(self._console, f"{_STAGES.get(self._stage, self._stage)}: {self._count}")
        self._stage = None


def _duration(seconds: float) -> str:
    """About so long."""
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"


@contextmanager
def progress_view(console: Console) -> Iterator[Progress]:
    """Bars in a terminal, lines elsewhere."""
    if console.is_terminal:
        columns = (
            TextColumn("{task.description:<20}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with ProgressBars(*columns, console=console) as bars:
            view = _Bars(bars)
            yield view
            view.close()
    else:
        lines = Lines(console)
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
