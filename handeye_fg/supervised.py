"""The program, with its long work in a process of its own, so that it ends when it is to end, and says why.

Compiled libraries cannot be interrupted at every moment, and end the process where memory or disk run out.
The state in the output folder is sound at every moment, so that their process can be ended at once; this one
stays to say what happened. The child ends with its parent, since its stdin is then closed. What takes long to
import is imported late, so that interrupts are heard from the start.
"""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

# What takes long; the rest is run in this process.
_LONG = ("calibrate",)
# What an interrupted child may take to end by itself.
_GRACE_S = 0.5
_ORPHANED = 143
_CONTINUE = "The same command continues where this run ended."


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the arguments without the program's name; those of the process by default.

    Returns:
        The exit code.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if not arguments or arguments[0] not in _LONG or {"-h", "--help"} & {*arguments}:
        _hear_interrupts()
        from handeye_fg.cli import main as run

        return run(arguments)
    _hear_interrupts()
    # One that comes now is heard as soon as there is a child, and by that as soon as it can handle it.
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    child = subprocess.Popen(
        [sys.executable, "-P", "-m", __name__, *arguments],
        stdin=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        code = child.wait()
    except KeyboardInterrupt:
        return _interrupted(child)
    if code >= 0:
        return code
    from handeye_fg.cli import PROGRAM
    from handeye_fg.commands.exit_codes import EXIT_FAILED
    from handeye_fg.console import say, stderr_console

    say(stderr_console(), f"{PROGRAM}: error: {_why(-code)}")
    return EXIT_FAILED


def _hear_interrupts() -> None:
    """Shells start what they put in the background with interrupts ignored; one that comes was meant."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupted(child: "subprocess.Popen[bytes]") -> int:
    """End the child, gently at first."""
    gently = True
    try:
        child.send_signal(signal.SIGINT)  # where only this process got it
        child.wait(_GRACE_S)
    except (subprocess.TimeoutExpired, KeyboardInterrupt):
        gently = False
        child.kill()
        child.wait()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    from handeye_fg.commands.exit_codes import EXIT_INTERRUPTED
    from handeye_fg.console import say, stderr_console

    console = stderr_console()
    if not gently:
        console.show_cursor()
        say(console, "\nInterrupted.")
    say(console, _CONTINUE)
    return EXIT_INTERRUPTED


def _why(number: int) -> str:
    """The sentence for a child that a signal ended."""
    if number == signal.SIGKILL:
        why = "most likely since memory ran out; close other programs, or use fewer threads (--sfm.threads 1)"
    elif number in {signal.SIGABRT, signal.SIGBUS, signal.SIGXFSZ}:
        why = "most often since the disk is full; free some space, or choose another output folder (--output)"
    else:
        why = "inside a library; run it with --verbose to see its log"
    return f"the calibration was ended by {signal.Signals(number).name}, {why}. {_CONTINUE}"


def _child() -> NoReturn:
    """The child's part."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from handeye_fg.cli import main as run
    from handeye_fg.commands.exit_codes import EXIT_INTERRUPTED
    from handeye_fg.console import say, stderr_console

    signal.signal(signal.SIGINT, _interrupt_once)
    arguments = sys.argv[1:]
    if not {"-v", "--verbose"} & {*arguments}:
        # Libraries that break print a trace of their own there.
        sys.stderr = os.fdopen(os.dup(2), "w", 1, sys.stderr.encoding, "backslashreplace")
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    try:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
        code = run(arguments)
    except KeyboardInterrupt:  # one that came before
        say(stderr_console(), "Interrupted.")
        code = EXIT_INTERRUPTED
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # without waiting for threads that libraries have left


def _interrupt_once(_number: int, _frame: FrameType | None) -> None:
    """An interrupt reaches the child from the terminal and from its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise KeyboardInterrupt


def _end_with_parent() -> None:
    while os.read(0, 1):
        pass
    os._exit(_ORPHANED)


if __name__ == "__main__":
    _child()
