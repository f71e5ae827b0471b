"""The command line. Text for people goes to stderr, the result for programs to stdout.

Exit codes: 0 calibrated; 1 failed; 2 usage, option or input-format error; 3 partial result;
4 results differ; 130 interrupted.
"""

import os
import sys
from collections.abc import Sequence
from functools import reduce
from importlib import metadata
from operator import or_
from typing import Annotated, Any

import tyro

from handeye_fg.commands import COMMANDS, Calibrate, Check, Command
from handeye_fg.commands.exit_codes import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE
from handeye_fg.console import say, stderr_console
from handeye_fg.errors import HandEyeError, InputDataError
from handeye_fg.options import Options

PROGRAM = "handeye-fg"
_DESCRIPTION = """Hand-eye calibration from ordinary images: the pose of a camera on a robot arm,
with its uncertainty, from a folder of images and the poses that the controller reported.

handeye-fg --version prints the version. Exit codes: 0 calibrated; 1 failed; 2 wrong usage, option
or input format; 3 partial: a result was written, but the motion left directions undetermined; 4 compare,
batch: results differ from earlier ones."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the arguments without the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["--version"]:
        print(f"{PROGRAM} {metadata.version(PROGRAM)}")
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


def _parse(arguments: Sequence[str]) -> Command:
    """The command; the options of a --config file are the defaults of the flags."""
    command = _parse_over(Options(), arguments)
    if isinstance(command, Calibrate | Check) and command.config is not None:
        from handeye_fg.io.config import read_config  # noqa: PLC0415  # help does without it

        command = _parse_over(read_config(command.config), arguments)
    return command


def _parse_over(options: Options, arguments: Sequence[str]) -> Command:
    def of_name(name: str, kind: type[Command]) -> Any:  # a type made at run time
        if kind in (Calibrate, Check):
            given = kind(images=tyro.MISSING, poses=tyro.MISSING, options=options)
            return Annotated[kind, tyro.conf.subcommand(name, default=given, prefix_name=False)]
        return Annotated[kind, tyro.conf.subcommand(name, prefix_name=False)]

    def choose(command: Command) -> Command:
        return command

    # A function, not the union alone: its argument's name stands in the parser's error messages.
    union = reduce(or_, (of_name(*item) for item in COMMANDS.items()))
    choose.__annotations__["command"] = Annotated[union, tyro.conf.arg(name="")]
    return tyro.cli(
        choose,
        prog=PROGRAM,
        description=_DESCRIPTION,
        args=list(arguments),
        config=(tyro.conf.HelptextFromCommentsOff,),
    )


def _say_error(error: HandEyeError) -> None:
    sentence = " ".join(str(error).split())
    say(stderr_console(), f"{PROGRAM}: error: {sentence}")
