"""How long an interrupted calibration takes to end, stage by stage.

    python benchmarks/interrupts.py SET [--output OUT]

The program is started as users start it and interrupted (SIGINT) at moments of each stage; it then continues in the
same output folder up to the next moment. Prints a Markdown table: seconds from the interrupt to the program's end,
the exit code, and what it said last.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

# Stage's line, and seconds after it.
MOMENTS = (
    ("", (0.1, 0.5)),
    ("reading images ...", (0.05,)),
    ("finding features ...", (0.1, 1.0, 5.0)),
    ("matching pairs ...", (0.1, 1.0, 5.0)),
    ("registering images ...", (0.1, 2.0, 10.0)),
    ("refining ...", (0.1, 0.5, 1.0, 2.0)),
    ("refining: ", (0.0, 0.1, 0.3)),
)


def interrupted(data, out, line, after):
    """Seconds to the end, exit code and last words; None for the seconds where the run was over before."""
    command = [sys.executable, "-m", "handeye_fg", "calibrate", data / "images", data / "poses.csv"]
    command += ["--camera", data / "camera.yaml", "--output", out]
    process = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    for printed in process.stderr if line else ():
        if printed.startswith(line):
            break
    said = []
    reader = threading.Thread(target=lambda: said.extend(process.stderr), daemon=True)
    reader.start()
    time.sleep(after)
    if process.poll() is not None:
        return None, process.returncode, ""
    since = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)  # all of them, as a terminal does
    process.wait()
    seconds = time.monotonic() - since
    reader.join()
    lines = [text.strip() for text in said if text.strip()]
    return seconds, process.returncode, " ".join(lines[-2:])


def main():
    """Interrupt one calibration again and again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    print("| after | s later | s to the end | exit code | last words |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        out = arguments.output or Path(folder) / "out"
        for line, delays in MOMENTS:
            for after in delays:
                seconds, code, words = interrupted(arguments.set, out, line, after)
                took = "over before" if seconds is None else f"{seconds:.2f}"
                print(
                    f"| {line or 'the start'} | {after} | {took} | {code} | {words} |", flush=True
                )


if __name__ == "__main__":
    main()
