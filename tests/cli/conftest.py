"""The command line with a stand-in for the pipeline."""

import dataclasses
import sys
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from example_results import make_result
from handeye_fg import cli
from handeye_fg.findings import FreeDirection
from handeye_fg.io.results import Result
from stand_in import Calibration


@pytest.fixture
def result() -> Result:
    return make_result()


@pytest.fixture
def calibration(result: Result, monkeypatch: pytest.MonkeyPatch) -> Calibration:
    stand_in = Calibration(result)
    pipeline, sfm = types.ModuleType("pipeline"), types.ModuleType("sfm")
    pipeline.calibrate = stand_in.calibrate  # type: ignore[attr-defined]  # a bare module
    sfm.set_verbosity = stand_in.verbose.append  # type: ignore[attr-defined]  # likewise
    monkeypatch.setitem(sys.modules, "handeye_fg.pipeline", pipeline)
    monkeypatch.setitem(sys.modules, "handeye_fg.sfm", sfm)
    return stand_in


@pytest.fixture
def run(tmp_path: Path, calibration: Calibration) -> Callable[..., int]:
    def run(*flags: str) -> int:
        return cli.main(
            ["calibrate", "images", "poses.csv", "--output", str(tmp_path / "out"), *flags]
        )

    return run


@pytest.fixture
def partial(result: Result) -> Result:
    free = FreeDirection(
        kind="translation",
        vector=np.array([0.0, 0.0, 1.0]),
        frame="gripper",
        description="Height is free.",
    )
    return dataclasses.replace(result, status="partial", free_directions=(free,))
