"""``batch``: many data sets at once."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for Dask

import logging
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from handeye_fg.commands.exit_codes import EXIT_DIFFERENT, EXIT_FAILED, EXIT_OK, EXIT_PARTIAL
from handeye_fg.console import logged, progress_view, say, stderr_console
from handeye_fg.progress import silent

if TYPE_CHECKING:
    from handeye_fg.batching.rows import Batch as Outcome


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """Calibrate many data sets, each in a process of its own; go on where an earlier run was ended.

    Writes to --output a folder for each data set (as calibrate does), summary.csv and summary.html. What is done
    already, with the same input and options, is kept. Exit codes: 0 all calibrated; 1 some failed; 4 none
    failed, but some have drifted from their earlier calibration; 3 neither, but some are partial; 2 wrong usage
    or manifest: nothing was calibrated.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MANIFEST|DIR")]
    """CSV file with a row for each data set (columns name, poses, images or model, and optionally camera, masks,
    target, config, reference: paths, from the manifest's folder, or fsspec URLs), YAML file with the same keys in
    a list data_sets, or a folder with a folder for each data set (images/ or model/, poses.csv, camera.yaml,
    masks/, target.yaml, config.toml)."""
    output: Annotated[str, tyro.conf.arg(metavar="OUT")]
    """Folder for the results, or fsspec URL; with --scheduler one that all machines share."""
    jobs: int | None = None
    """Data sets at a time; without it as many as there are cores and memory, or places in the cluster."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Address of a running Dask scheduler (tcp://HOST:PORT) whose workers have handeye-fg; without it the work is
    done on this machine."""
    config: Path | None = None
    """Options as a TOML file, for the data sets that name none."""
    reference: Annotated[str | None, tyro.conf.arg(metavar="OUT")] = None
    """Output of an earlier batch: each data set is held against that of the same name."""
    significance: float = 0.001
    """The probability below which a difference from an earlier calibration counts as drift, and not as chance."""
    timeout: float = 3600.0
    """Seconds after which a data set has failed."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the table of the data sets as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""

    def run(self) -> int:
        """Calibrate all, write the summary and say what came out."""
        from handeye_fg.io.results import to_json

        console = stderr_console()
        outcome = self._done(console)
        if not self.quiet:
            say(console, self._told(outcome))
        if self.json:
            from handeye_fg.batching.summary import records

            sys.stdout.write(to_json({"data_sets": records(outcome)}))
        return exit_code(outcome)

    def _done(self, console: Console) -> "Outcome":
        from handeye_fg.batching.run import batch
        from handeye_fg.io.config import read_config

        options = None if self.config is None else read_config(self.config)
        with ExitStack() as stack:
            level = logging.ERROR if self.quiet else logging.WARNING
            stack.enter_context(logged(console, level))
            return batch(
                self.source,
                self.output,
                jobs=self.jobs,
                scheduler=self.scheduler,
                options=options,
                reference=self.reference,
                significance=self.significance,
                timeout_s=self.timeout,
                progress=silent if self.quiet else stack.enter_context(progress_view(console)),
            )

    def _told(self, outcome: "Outcome") -> str:
        rows = outcome.rows
        counts = (
            f"{sum(row.status == 'ok' for row in rows)} of {len(rows)} data sets calibrated",
            f"{len(outcome.partial)} partial",
            f"{sum(row.status == 'failed' for row in rows)} failed",
            f"{len(outcome.drifted)} drifted",
            f"{sum(row.kept for row in rows)} kept from an earlier run",
        )
        return f"{', '.join(counts)}.\nSummary: {self.output.rstrip('/')}/summary.html"


def exit_code(outcome: "Outcome") -> int:
    """What the batch says to the program that started it: the worst that happened."""
    if outcome.failed:
        return EXIT_FAILED
    if outcome.drifted:
        return EXIT_DIFFERENT
    return EXIT_PARTIAL if outcome.partial else EXIT_OK
