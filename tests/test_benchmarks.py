"""The benchmarks run; their figures are in benchmarks/README.md."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.slow
def test_kinhec(tmp_path: Path) -> None:
    """The smallest tier has two monocular sequences of each of two arms."""
    options = ["--tier", "smoke", "--tracks", "monocular", "--output", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, str(BENCHMARKS / "kinhec.py"), *options],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    rows = re.findall(r"\| ([\w +]+) \| (\d+)/(\d+) \| ([\d.]+) \| ([\d.]+) \|", done.stdout)
    millimetres = {solver: float(distance) for solver, *_, distance in rows}
    assert all(answered == total == "4" for _, answered, total, _, _ in rows)
    assert millimetres["pose_graph"] < millimetres["andreff_scale"]
    assert millimetres["andreff_scale"] < millimetres["kinhec andreff_scale"]
