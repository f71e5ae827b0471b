"""What tests in several folders need: a calibration made once for all processes, and matches without images."""

import importlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest
from filelock import FileLock
from hypothesis import settings

from handeye_fg.frames import Array
from handeye_fg.inputs import Inputs
from handeye_fg.types import CameraModel, Indices, RobotPoses
from tabletop import TABLETOP

# A busy machine is no failure.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")
# What they assert tells the values, as in a module of tests.
pytest.register_assert_rewrite("exact_poses", "export_readers", "pose_files", "pose_graphs")


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
    return calibrated_once("tabletop", TABLETOP)


@pytest.fixture
def from_matches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Inputs]:
    """``from_matches(poses, names, image_index, point_index, pixels, cameras)``: inputs whose images match so.

    Two observations of one point match.
    """
    import pycolmap  # noqa: PLC0415  # for few tests

    from handeye_fg.sfm.ladder import Matches  # noqa: PLC0415  # likewise
    from handeye_fg.sfm.stages import open_stage  # noqa: PLC0415  # likewise
    from handeye_fg.sfm.tracks import _fill  # noqa: PLC0415  # likewise

    def inputs(
        poses: RobotPoses,
        names: tuple[str, ...],
        image_index: Indices,
        point_index: Indices,
        pixels: Array,
        cameras: Mapping[str, CameraModel],
    ) -> Inputs:
        database = tmp_path / "tracks.db"
        _fill(database, names, image_index, point_index, pixels, cameras)
        options = pycolmap.TwoViewGeometryOptions()
        options.ransac.random_seed = 0
        pycolmap.geometric_verification(database, two_view_geometry_options=options)
        for name in names:
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(name.encode())

        def matched(task, _sensitivity) -> Matches:
            def build(stage: Path, _older) -> dict[str, object]:
                shutil.copyfile(database, stage / "database.db")
                return {"static_share": 0.0, "images": dict.fromkeys(names, "digest")}

            key = {"matching": 0, "geometry": 0}
            return Matches(stage=open_stage(task.stages, "matches", key, build))

        module = importlib.import_module("handeye_fg.sfm.ladder")
        monkeypatch.setattr(module, "_matched", matched)
        return Inputs(
            images=tmp_path,
            names=names,
            left_out=(),
            poses=poses,
            cameras=dict(cameras),
            masks=None,
            digest="",
        )

    return inputs
