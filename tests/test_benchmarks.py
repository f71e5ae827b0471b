"""The benchmarks run; their figures are in benchmarks/README.md."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import numpy as np
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


@pytest.mark.slow
@pytest.mark.simulation
def test_planned_poses_and_their_predictions() -> None:
    """Half as many planned poses serve as well as random ones, and as predicted."""
    planning = runpy.run_path(str(BENCHMARKS / "planning.py"))
    case = planning["Case"](start=10, planned=6, rotation=0.1, translation=1.0, points=50)
    found = [planning["draw"](case, seed) for seed in range(6)]
    # Beside twice as many added to the first ones, and beside twice as many as all together.
    rotation, position, distance = np.median([one.added for one in found], axis=0)
    assert min(position, distance) > 1.1
    assert rotation > 0.95
    assert np.median([one.twice[2] for one in found]) > 0.95
    ratios = np.median([one.reached / one.predicted for one in found], axis=0)
    assert np.abs(np.log(ratios)).max() < np.log(1.15)
    # All six components of X in predicted standard deviations.
    assert 0.7 < np.sqrt(np.mean([one.error for one in found])) < 1.3


@pytest.mark.slow
@pytest.mark.simulation
def test_no_plan_is_better_than_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the limit is not far off: a plan comes within a quarter of it."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    limits = runpy.run_path(str(BENCHMARKS / "planning_limits.py"))
    case = limits["Case"](start=10, planned=6, rotation=0.1, translation=1.0, points=50)
    for position, rotation, *best in limits["ratios"](case, 0):
        assert 0.75 * best[0] < position < best[0]
        assert 0.75 * best[1] < rotation < best[1]
        assert 0.8 * best[2] < min(position, rotation) < best[2]
        assert best[2] < 1.005 * min(best[:2])


@pytest.mark.slow
@pytest.mark.simulation
def test_first_sets() -> None:
    """Ten planned poses serve as well as twenty random ones, but for chance, and X is no farther off than predicted."""
    planning = runpy.run_path(str(BENCHMARKS / "planning.py"))
    case = planning["Case"](start=0, planned=10, rotation=0.1, translation=1.0, points=50)
    found = [planning["draw"](case, seed) for seed in range(3)]
    assert np.median([one.twice[2] for one in found]) > 0.95
    assert np.sqrt(np.mean([one.error for one in found])) < 1.5
