import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from handeye_fg import write_scene
from handeye_fg.simulate import simulate_scene


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data sets that are quick to calibrate: three complete ones, and one that turns about one axis."""
    folder = tmp_path_factory.mktemp("made")
    for seed, name in enumerate(("first", "second", "third")):
        rng = np.random.default_rng(seed)
        write_scene(simulate_scene(rng, n_images=8, n_points=80), folder / name)
    rng = np.random.default_rng(9)
    write_scene(simulate_scene(rng, n_images=8, n_points=80, motion="one_axis"), folder / "flat")
    return folder


@pytest.fixture
def sets(made: Path, tmp_path: Path) -> Callable[..., Path]:
    """A folder with copies of some of the data sets: ``sets(name="first")``."""

    def copied(**names: str) -> Path:
        for name, source in names.items():
            shutil.copytree(made / source, tmp_path / "sets" / name)
        return tmp_path / "sets"

    return copied
