"""A run continues where an earlier one ended; a change costs what depends on it and no more."""

import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

import tabletop
from handeye_fg.options import SfmOptions
from handeye_fg.sfm import reconstruct
from handeye_fg.turns import RobotTurns
from handeye_fg.types import SfmModel
from tabletop import HALF_CAMERA as CAMERA

pytestmark = pytest.mark.e2e

ROOT = Path(__file__).parents[2]
N_IMAGES = 5
NAMES = tabletop.NAMES[:N_IMAGES]
base_R_gripper = tabletop.TRUTH["base_T_gripper"][:N_IMAGES, :3, :3]
TURNS = RobotTurns(rotations=base_R_gripper, setup="eye-in-hand")
N_PAIRS = 10


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("images")
    tabletop.save_halves(folder, N_IMAGES)
    return folder


class Run:
    """One reconstruction, and how much of each stage was there before it began."""

    def __init__(self, images: Path, out: Path, **changes: object) -> None:
        self.found: dict[str, int] = {}
        settings = {
            "names": NAMES,
            "cameras": {".": CAMERA},
            "masks": None,
            "options": SfmOptions(max_features=1000, threads=1),
            "seed": 0,
            "turns": TURNS,
        } | changes
        names, cameras = settings.pop("names"), settings.pop("cameras")
        self.model: SfmModel = reconstruct(
            images, names, cameras, folder=out / "sfm", progress=self._tell, **settings
        )  # type: ignore[arg-type]  # mixed values

    def _tell(self, stage: str, done: int, _total: int | None) -> None:
        self.found.setdefault(stage, done)


@pytest.fixture(scope="module")
def fresh(images: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Path]:
    out = tmp_path_factory.mktemp("fresh")
    return Run(images, out), out


@pytest.fixture
def out(fresh: tuple[Run, Path], tmp_path: Path) -> Path:
    """A copy of a finished run's folder."""
    return Path(shutil.copytree(fresh[1], tmp_path / "out"))


def same(one: SfmModel, other: SfmModel) -> bool:
    return (
        np.array_equal(one.world_T_camera, other.world_T_camera)
        and np.array_equal(one.tracks.pixels, other.tracks.pixels)
        and np.array_equal(one.tracks.points_world, other.tracks.points_world)
    )


def test_the_first_run_does_everything(fresh: tuple[Run, Path]) -> None:
    run, out = fresh
    assert (run.found["features"], run.found["pairs"]) == (0, 0)
    assert run.model.names == NAMES
    assert {path.name for path in out.iterdir()} == {"sfm", "stages"}


def test_without_its_model_a_run_is_the_same_from_its_stages(
    images: Path, fresh: tuple[Run, Path], out: Path
) -> None:
    shutil.rmtree(out / "sfm")
    run = Run(images, out)
    assert run.found == {"features": 5, "pairs": N_PAIRS, "registered": 5}
    assert same(run.model, fresh[0].model)


# What is found of features, pairs and models after a change, and whether the answer is another one.
CHANGES = {
    "seed": ({"seed": 1}, (5, N_PAIRS, 0), True),
    "camera": (
        {"cameras": {".": replace(CAMERA, params=CAMERA.params * 1.001)}},
        (5, N_PAIRS, 0),
        True,
    ),
    "poses": (
        {"turns": RobotTurns(rotations=base_R_gripper @ base_R_gripper[0], setup="eye-in-hand")},
        (5, N_PAIRS, 5),
        False,
    ),
    "threads": ({"options": SfmOptions(max_features=1000, threads=2)}, (None, None, 5), False),
    "features": ({"options": SfmOptions(max_features=500, threads=1)}, (0, 0, 0), True),
    "fewer images": ({"names": NAMES[:4], "turns": TURNS.only(np.arange(4))}, (4, 6, 0), True),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_costs_what_depends_on_it(
    images: Path, fresh: tuple[Run, Path], out: Path, change: str
) -> None:
    changes, expected, other = CHANGES[change]
    run = Run(images, out, **changes)
    features, pairs, registered = expected
    assert run.found.get("features") == features
    assert run.found.get("pairs") == pairs
    if registered == 5:  # a model that was there already has all images at once
        assert run.found["registered"] == 5
    assert same(run.model, fresh[0].model) != other


def test_one_image_or_mask_that_changed_is_done_again_with_its_pairs(
    images: Path, fresh: tuple[Run, Path], out: Path, tmp_path: Path
) -> None:
    changed = tmp_path / "images"
    shutil.copytree(images, changed)
    with Image.open(changed / NAMES[2]) as image:
        pixels = np.array(image)
    pixels[:40] = 0
    Image.fromarray(pixels).save(changed / NAMES[2], quality=95)
    run = Run(changed, out)
    assert (run.found["features"], run.found["pairs"]) == (4, 6)
    assert same(run.model, Run(changed, tmp_path / "anew").model)
    back = Run(images, out)
    assert (back.found["features"], back.found["pairs"]) == (4, 6)
    assert same(back.model, fresh[0].model)
    for name in NAMES:
        mask = np.full((480, 640), 255, np.uint8)
        mask[:, :320] = 0 if name == NAMES[1] else 255
        cv2.imwrite(str(tmp_path / f"{name}.png"), mask)
    masked = Run(images, out, masks=tmp_path)
    assert masked.found["features"] == 0  # masks for all of them are new
    cv2.imwrite(str(tmp_path / f"{NAMES[1]}.png"), np.full((480, 640), 255, np.uint8))
    again = Run(images, out, masks=tmp_path)
    assert (again.found["features"], again.found["pairs"]) == (4, 6)
    assert same(again.model, fresh[0].model)


def test_a_damaged_stage_is_made_again(images: Path, fresh: tuple[Run, Path], out: Path) -> None:
    shutil.rmtree(out / "sfm")
    for database in (out / "stages").glob("*/database.db"):
        database.write_bytes(b"" if "matches" in database.parent.name else b"no database" * 1000)
    (out / "stages" / ".part-of-a-killed-run").mkdir()
    run = Run(images, out)
    assert run.found["features"] == 0
    assert same(run.model, fresh[0].model)
    assert not list((out / "stages").glob(".*"))


_KILLED = """
import os, signal, sys
from pathlib import Path
import tests.sfm.test_resume as here

def kill(self, stage, done, total):
    if stage == sys.argv[3] and done >= int(sys.argv[4]):
        os.kill(os.getpid(), signal.SIGKILL)

here.Run._tell = kill
here.Run(Path(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.mark.parametrize(("stage", "done"), [("features", 2), ("pairs", 3), ("registered", 3)])
def test_a_killed_run_is_continued(
    images: Path, fresh: tuple[Run, Path], tmp_path: Path, stage: str, done: int
) -> None:
    out = tmp_path / "out"
    killed = subprocess.run(
        [sys.executable, "-c", _KILLED, str(images), str(out), stage, str(done)],
        env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'tests' / 'shared'}"},
        check=False,
        timeout=60,
    )
    assert killed.returncode == -signal.SIGKILL
    assert not (out / "sfm").exists()
    run = Run(images, out)
    assert run.found["features"] >= (done if stage == "features" else 5)
    if stage != "features":
        assert run.found["pairs"] >= (done if stage == "pairs" else N_PAIRS)
    assert same(run.model, fresh[0].model)
    assert not list((out / "stages").glob(".*"))
