"""The command line. Text for people goes to stderr, the result for programs to stdout.

Exit codes: 0 calibrated; 1 failed; 2 usage, option or input-format error; 3 partial result;
130 interrupted. Heavy packages are imported where they are used, so that help is quick.
"""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

import logging
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as ProgressBars

from handeye_fg.errors import HandEyeError, InputDataError
from handeye_fg.options import Options
from handeye_fg.progress import Progress, silent

if TYPE_CHECKING:
    from handeye_fg.io.results import Result

EXIT_OK = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_PARTIAL = 3
EXIT_INTERRUPTED = 130

_PROGRAM = "handeye-fg"
_DESCRIPTION = """Hand-eye calibration from ordinary images: the pose of a camera on a robot arm,
with its uncertainty, from a folder of images and the poses that the controller reported.

handeye-fg --version prints the version. Exit codes: 0 calibrated; 1 failed; 2 wrong usage, option
or input format; 3 partial: a result was written, but the motion left directions undetermined."""
_STAGES = {
    "images": "reading images",
    "target": "finding the target",
    "features": "finding features",
    "pairs": "matching pairs",
    "registered": "registering images",
    "iterations": "refining",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrate:
    """Calibrate from a folder of images and the robot's poses.

    Flags win over the file given with --config, which wins over the defaults. Writes result.json,
    report.html, config.toml (the options as used) and sfm/ (the reconstruction) to --output.
    """

    images: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMAGES")]
    """Folder of the images."""
    poses: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POSES")]
    """CSV file with the header image,x,y,z,qx,qy,qz,qw: for each image name the pose of the gripper
    in the robot's base (metres, Hamilton quaternion)."""
    camera: Path | None = None
    """Camera file (YAML of OpenCV or ROS). Without it the intrinsics are estimated."""
    masks: Path | None = None
    """Folder with a mask NAME.png for each image NAME (frame_0000.jpg.png): white is used."""
    target: Path | None = None
    """Target file (YAML): a board of known size that images show, with or without a scene around it."""
    config: Path | None = None
    """Options as a TOML file, such as the config.toml of an earlier run."""
    output: Path = Path("handeye-fg-out")
    """Folder for the results."""
    json: bool = False
    """Print the result as JSON on stdout."""
    quiet: Annotated[bool, tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""
    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"])] = False
    """Let the logs of the libraries through."""
    options: Annotated[Options, tyro.conf.arg(name="")] = field(default_factory=Options)
    """Options of the calibration."""

    def run(self) -> int:
        """Calibrate, write the results and say what came out."""
        from handeye_fg.io.results import failed_document, to_document, to_json

        console = _console()
        try:
            result = self._calibrate(console)
        except HandEyeError as error:
            if self.json:
                sys.stdout.write(to_json(failed_document(self.options.setup, str(error))))
            raise
        report = self._write(result)
        if not self.quiet:
            from handeye_fg.report import summary_text

            _say(console, summary_text(result, report))
        if self.json:
            sys.stdout.write(to_json(to_document(result)))
            sys.stdout.flush()
        return EXIT_OK if result.status == "ok" else EXIT_PARTIAL

    def _calibrate(self, console: Console) -> "Result":
        from handeye_fg.pipeline import calibrate
        from handeye_fg.sfm import set_verbosity

        set_verbosity(self.verbose)
        with ExitStack() as stack:
            stack.enter_context(_logging(console, self._log_level()))
            stack.enter_context(_native_stdout_moved(None if self.verbose else os.devnull))
            view = silent if self.quiet else stack.enter_context(_progress_view(console))
            return calibrate(
                self.images,
                self.poses,
                camera=self.camera,
                masks=self.masks,
                options=self.options,
                target=self.target,
                output=self.output,
                progress=view,
            )

    def _log_level(self) -> int:
        if self.quiet:
            return logging.ERROR
        return logging.DEBUG if self.verbose else logging.WARNING

    def _write(self, result: "Result") -> Path:
        """Write what belongs together, each file whole, once there is a result."""
        from handeye_fg.io.config import write_config
        from handeye_fg.report import write_report

        result.save(self.output)
        write_config(self.options, self.output / "config.toml")
        return write_report(result, self.output)


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
        _say(_console(), f"Report: {write_report(result, self.output)}")
        return EXIT_OK


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the arguments without the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        print(f"{_PROGRAM} {metadata.version(_PROGRAM)}")
        return EXIT_OK
    try:
        return _parse(arguments).run()
    except SystemExit as stop:  # the option parser: help was asked for, or the usage was wrong
        return stop.code if isinstance(stop.code, int) else EXIT_USAGE
    except InputDataError as error:
        _say_error(error)
        return EXIT_USAGE
    except HandEyeError as error:
        _say_error(error)
        return EXIT_FAILED
    except KeyboardInterrupt:
        _say(_console(), "Interrupted.")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Who read stdout has gone (``| head``); Python's own flush at exit must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED


def _parse(arguments: Sequence[str]) -> Calibrate | Report:
    """The command; the options of a --config file are the defaults of the flags."""
    command = _parse_over(Options(), arguments)
    if isinstance(command, Calibrate) and command.config is not None:
        from handeye_fg.io.config import read_config

        command = _parse_over(read_config(command.config), arguments)
    return command


def _parse_over(options: Options, arguments: Sequence[str]) -> Calibrate | Report:
    defaults = Calibrate(images=tyro.MISSING, poses=tyro.MISSING, options=options)
    calibrate = tyro.conf.subcommand("calibrate", default=defaults, prefix_name=False)
    report = tyro.conf.subcommand("report", prefix_name=False)

    # A function, not the union alone: its argument's name stands in the parser's error messages.
    def choose(
        command: Annotated[
            Annotated[Calibrate, calibrate] | Annotated[Report, report], tyro.conf.arg(name="")
        ],
    ) -> Calibrate | Report:
        return command

    return tyro.cli(
        choose,
        prog=_PROGRAM,
        description=_DESCRIPTION,
        args=list(arguments),
        config=(tyro.conf.FlagCreatePairsOff, tyro.conf.HelptextFromCommentsOff),
    )


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
            _say(self._console, f"{_STAGES.get(stage, stage)} ...")
        self._count = f"{done}" if total is None else f"{done} of {total}"

    def close(self) -> None:
        """End the current stage."""
        if self._stage is not None:
            _say(self._console, f"{_STAGES.get(self._stage, self._stage)}: {self._count}")
        self._stage = None


@contextmanager
def _progress_view(console: Console) -> Iterator[Progress]:
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
def _native_stdout_moved(target: str | None) -> Iterator[None]:
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
def _logging(console: Console, level: int) -> Iterator[None]:
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


def _console() -> Console:
    return Console(stderr=True, highlight=False, markup=False, emoji=False, soft_wrap=True)


def _say(console: Console, text: str) -> None:
    console.print(_printable(text))


def _say_error(error: HandEyeError) -> None:
    sentence = " ".join(str(error).split())
    _say(_console(), f"{_PROGRAM}: error: {sentence}")


def _printable(text: str) -> str:
    """Text that cannot steer the terminal: control characters become escapes."""
    return "".join(
        char if char.isprintable() or char == "\n" else ascii(char)[1:-1] for char in text
    )
