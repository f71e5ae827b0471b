"""``report``: the page of an earlier result once more."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

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

    def run(self) -> int:
        """Read the result and write its page."""
        from handeye_fg.io.result_reader import load_result
        from handeye_fg.report import write_report

        result = load_result(self.output)
        say(stderr_console(), f"Report: {write_report(result, self.output)}")
        return EXIT_OK
