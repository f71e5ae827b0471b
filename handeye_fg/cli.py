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

from handeye_fg.console import logged, native_stdout_moved, progress_view, say, stderr_console
from handeye_fg.errors import HandEyeError, InputDataError
from handeye_fg.options import CameraNoise, MethodName, Options, Priors, RobotNoise, Setup
from handeye_fg.progress import silent

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrate:
    """Calibrate from a folder of images and the robot's poses.

    Flags win over the file given with --config, which wins over the defaults. Writes result.json,
    report.html, config.toml (the options as used) and sfm/ (the reconstruction) to --output.
    """

    images: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMAGES")]
    """Folder of the images; of several cameras on one arm with a sub-folder for each, in which images of
    one robot pose have the same name."""
    poses: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POSES")]
    """CSV file with the header image,x,y,z,qx,qy,qz,qw: for each image name the pose of the gripper
    in the robot's base (metres, Hamilton quaternion)."""
    camera: Path | None = None
    """Camera file (YAML of OpenCV or ROS), or for several cameras a folder with a file for each, named like
    the sub-folders (cam0.yaml). Without it the intrinsics are estimated."""
    masks: Path | None = None
    """Folder with a mask NAME.png for each image NAME (frame_0000.jpg.png, of several cameras
    cam0/frame_0000.jpg.png): white is used."""
    target: Path | None = None
    """Target file (YAML): a board of known size that images show, with or without a scene around it."""
    config: Path | None = None
    """Options as a TOML file, such as the config.toml of an earlier run."""
    output: Path = Path("handeye-fg-out")
    """Folder for the results."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""
    verbose: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-v"])] = False
    """Let the logs of the libraries through."""
    options: Annotated[Options, tyro.conf.arg(name="")] = field(default_factory=Options)
    """Options of the calibration."""

    def run(self) -> int:
        """Calibrate, write the results and say what came out."""
        from handeye_fg.io.config import write_config

        console = stderr_console()
        with _failure_as_json(self.options.setup, json=self.json):
            result = self._calibrate(console)
        report = _written(result, self.output)
        write_config(self.options, self.output / "config.toml")
        return _told(result, report, console, json=self.json, quiet=self.quiet)

    def _calibrate(self, console: Console) -> "Result":
        from handeye_fg.pipeline import calibrate
        from handeye_fg.sfm import set_verbosity

        set_verbosity(self.verbose)
        with ExitStack() as stack:
            stack.enter_context(logged(console, self._log_level()))
            stack.enter_context(native_stdout_moved(None if self.verbose else os.devnull))
            view = silent if self.quiet else stack.enter_context(progress_view(console))
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Solve:
    """Calibrate from pose pairs alone, without images.

    Rows are paired by name. Writes result.json and report.html to --output.
    """

    robot: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROBOT.csv")]
    """CSV file with the header image,x,y,z,qx,qy,qz,qw: the pose of the gripper in the robot's base
    (metres, Hamilton quaternion); the column image holds any name of the row."""
    camera: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAMERA.csv")]
    """CSV file with the same columns: the pose of the camera in the world, or, for eye-to-hand, in what
    moves with the gripper. In any unit of length for andreff_scale and pose_graph, in
    metres for the others."""
    method: MethodName = "andreff_scale"
    """Closed form to use, or pose_graph: least squares with the noise of both lists modelled."""
    setup: Setup = "eye-in-hand"
    """Camera on the gripper, or static camera that looks at an object on the gripper."""
    robust: bool = True
    """Leave out, and name, rows that disagree with the majority."""
    metric: tyro.conf.FlagCreatePairsOff[bool] = False
    """For pose_graph: the camera's translations are in metres; else it finds their unit."""
    camera_noise: CameraNoise = "auto"
    """For pose_graph: each camera pose has an error of its own (independent), or each motion to the
    next pose has, so that errors accumulate (odometry); auto: the data tell."""
    noise: RobotNoise = field(default_factory=RobotNoise)
    priors: Priors = ()
    """What is known beforehand, as for calibrate; scale is the unit of CAMERA.csv."""
    seed: int = 0
    """Seed of everything random."""
    output: Path = Path("handeye-fg-out")
    """Folder for the results."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""

    def run(self) -> int:
        """Solve, write the results and say what came out."""
        with _failure_as_json(self.setup, json=self.json):
            from handeye_fg.from_poses import solve

            result = solve(
                self.robot,
                self.camera,
                self.method,
                setup=self.setup,
                robust=self.robust,
                metric=self.metric,
                camera_noise=self.camera_noise,
                noise=self.noise,
                priors=self.priors,
                seed=self.seed,
            )
        report = _written(result, self.output)
        return _told(result, report, stderr_console(), json=self.json, quiet=self.quiet)


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


@contextmanager
def _failure_as_json(setup: Setup, *, json: bool) -> Iterator[None]:
    """Print a failure as JSON too, where JSON is asked for."""
    from handeye_fg.io.results import failed_document, to_json

    try:
        yield
    except HandEyeError as error:
        if json:
            sys.stdout.write(to_json(failed_document(setup, str(error))))
        raise


def _written(result: "Result", output: Path) -> Path:
    """Write what belongs together, each file whole, once there is a result; the page's path."""
    from handeye_fg.report import write_report

    result.save(output)
    return write_report(result, output)


def _told(result: "Result", report: Path, console: Console, *, json: bool, quiet: bool) -> int:
    """Say what came out; the exit code."""
    if not quiet:
        from handeye_fg.report import summary_text

        say(console, summary_text(result, report))
    if json:
        from handeye_fg.io.results import to_document, to_json

        sys.stdout.write(to_json(to_document(result)))
        sys.stdout.flush()
    return EXIT_OK if result.status == "ok" else EXIT_PARTIAL


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
        say(stderr_console(), "Interrupted.")
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Who read stdout has gone (``| head``); Python's own flush at exit must not fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILED


def _parse(arguments: Sequence[str]) -> Calibrate | Solve | Report:
    """The command; the options of a --config file are the defaults of the flags."""
    command = _parse_over(Options(), arguments)
    if isinstance(command, Calibrate) and command.config is not None:
        from handeye_fg.io.config import read_config

        command = _parse_over(read_config(command.config), arguments)
    return command


def _parse_over(options: Options, arguments: Sequence[str]) -> Calibrate | Solve | Report:
    defaults = Calibrate(images=tyro.MISSING, poses=tyro.MISSING, options=options)
    calibrate = tyro.conf.subcommand("calibrate", default=defaults, prefix_name=False)
    solve = tyro.conf.subcommand("solve", prefix_name=False)
    report = tyro.conf.subcommand("report", prefix_name=False)

    # A function, not the union alone: its argument's name stands in the parser's error messages.
    def choose(
        command: Annotated[
            Annotated[Calibrate, calibrate] | Annotated[Solve, solve] | Annotated[Report, report],
            tyro.conf.arg(name=""),
        ],
    ) -> Calibrate | Solve | Report:
        return command

    return tyro.cli(
        choose,
        prog=_PROGRAM,
        description=_DESCRIPTION,
        args=list(arguments),
        config=(tyro.conf.HelptextFromCommentsOff,),
    )


def _say_error(error: HandEyeError) -> None:
    sentence = " ".join(str(error).split())
    say(stderr_console(), f"{_PROGRAM}: error: {sentence}")
