"""What every calibrating command does with its result, or with its failure."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from handeye_fg.commands.exit_codes import EXIT_OK, EXIT_PARTIAL
from handeye_fg.console import say
from handeye_fg.errors import HandEyeError
from handeye_fg.options import Setup

if TYPE_CHECKING:
    from handeye_fg.io.results import Result


@contextmanager
def failure_as_json(setup: Setup, *, json: bool) -> Iterator[None]:
    """Print a failure as JSON too, where JSON is asked for."""
    from handeye_fg.io.results import failed_document, to_json

    try:
        yield
    except HandEyeError as error:
        if json:
            sys.stdout.write(to_json(failed_document(setup, str(error))))
        raise


def written(result: "Result", output: Path) -> Path:
    """Write what belongs together, each file whole, once there is a result; the page's path."""
    from handeye_fg.report import write_report

    result.save(output)
    return write_report(result, output)


def told(result: "Result", report: Path, console: Console, *, json: bool, quiet: bool) -> int:
    """Say what came out; the exit code."""
    if not quiet:
        from handeye_fg.report import summary_text

        say(console, summary_text(result, report))
    if json:
        from handeye_fg.io.results import to_document, to_json

        sys.stdout.write(to_json(to_document(result)))
        sys.stdout.flush()
    return EXIT_OK if result.status == "ok" else EXIT_PARTIAL
