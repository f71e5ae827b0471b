"""``report``: the page of an earlier result once more."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from handeye_fg.commands.exit_codes import EXIT_OK
from handeye_fg.console import say, stderr_console


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Write report.html again from the result.json of a calibration."""

    output: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """Folder of an earlier calibration."""
    figures: Path | None = None
    """Folder for the figures as SVG and PNG files."""
    summary: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the summary for the terminal on stdout."""
    markdown: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as Markdown, for an issue tracker, on stdout."""

    def run(self) -> int:
        """Read the result and write its page."""
        from handeye_fg.io.result_reader import load_result
        from handeye_fg.report import markdown_text, summary_text, write_figures, write_report

        result, console = load_result(self.output), stderr_console()
        say(console, f"Report: {write_report(result, self.output)}")
        if self.figures is not None:
            files = write_figures(result, self.figures)
            say(console, f"Figures: {len(files)} files in {self.figures}")
        if self.summary:
            sys.stdout.write(f"{summary_text(result)}\n")
        if self.markdown:
            sys.stdout.write(markdown_text(result))
        return EXIT_OK
