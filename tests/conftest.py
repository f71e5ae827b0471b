"""What tests in several folders need: a calibration of data/tabletop, made once for all processes."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from filelock import FileLock

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="session")
def calibrated_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """``calibrated_once(name, data, *options)``: the output folder of a calibration; do not write to it."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # that of all processes

    def calibrated(name: str, data: Path, *options: str) -> Path:
        output = folder / name
        with FileLock(f"{output}.lock"):
            if not (output / "report.html").exists():
                command = [
                    *(sys.executable, "-m", "handeye_fg", "calibrate", "--quiet", *options),
                    *("--camera", str(data / "camera.yaml"), "--output", str(output)),
                    *(str(data / "images"), str(data / "poses.csv")),
                ]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                assert done.returncode == 0, done.stderr
        return output

    return calibrated


@pytest.fixture(scope="session")
def tabletop_output(calibrated_once: Callable[..., Path]) -> Path:
    """Output of ``calibrate`` for data/tabletop; not to be written to."""
    return calibrated_once("tabletop", ROOT / "data" / "tabletop")
