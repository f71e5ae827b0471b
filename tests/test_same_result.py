"""What makes a result another one, and what does not: runs, formats of image files, options of later stages."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from PIL import Image

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.options import GraphOptions, NoiseOptions, SfmOptions, TaskOptions
from handeye_fg.priors import Prior
from tabletop import HALF_CAMERA as CAMERA
from tabletop import TABLETOP

pytestmark = pytest.mark.e2e

N_IMAGES = 6
OPTIONS = hf.Options(sfm=SfmOptions(preset="fast", threads=1))
Pixels = NDArray[np.uint8]


@pytest.fixture(scope="module")
def pixels() -> dict[str, Pixels]:
    """Blue, green and red by the name without its suffix."""
    names = [path.stem for path in sorted((TABLETOP / "images").iterdir())[: N_IMAGES + 1]]
    found = {}
    for name in names:
        whole = cv2.imread(str(TABLETOP / "images" / f"{name}.jpg"))
        assert whole is not None
        found[name] = cv2.resize(whole, (640, 480), interpolation=cv2.INTER_AREA)
    return found


def poses(suffix: str) -> dict[str, NDArray[np.float64]]:
    reported = hf.read_poses(TABLETOP / "poses.csv")
    names = [name.replace(".jpg", suffix) for name in reported.names[:N_IMAGES]]
    return dict(zip(names, reported.base_T_gripper, strict=False))


@pytest.fixture(scope="module")
def images(pixels: dict[str, Pixels], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "images"
    folder.mkdir()
    for name in list(pixels)[:N_IMAGES]:
        cv2.imwrite(str(folder / f"{name}.png"), pixels[name])
    return folder


# 1. Formats.


def deep(levels: Pixels) -> NDArray[np.generic]:
    return levels.astype(np.uint16) * 257


def grey(levels: Pixels) -> Pixels:
    return np.asarray(cv2.cvtColor(levels, cv2.COLOR_BGR2GRAY), dtype=np.uint8)


def stored(change: Callable[[Pixels], NDArray[np.generic]]) -> Callable[[Path, Pixels], object]:
    return lambda path, levels: cv2.imwrite(str(path), change(levels))


def as_jpeg(path: Path, levels: Pixels) -> None:
    """With a tag that tells viewers to turn it."""
    tags = Image.Exif()
    tags[0x0112] = 6
    Image.fromarray(levels[..., ::-1]).save(path, quality=95, exif=tags)


COLOUR: dict[str, Callable[[Path, Pixels], object]] = {
    ".tif": stored(deep),
    ".bmp": stored(lambda levels: levels),
}
GREY: dict[str, Callable[[Path, Pixels], object]] = {
    ".png": stored(grey),
    ".tif": stored(lambda levels: grey(levels).astype(np.uint16) * 16),  # 12 bits
}


def calibrated(
    folder: Path,
    pixels: dict[str, Pixels],
    suffix: str,
    write: Callable[[Path, Pixels], object],
) -> hf.Result:
    folder.mkdir()
    for name in list(pixels)[:N_IMAGES]:
        write(folder / f"{name}{suffix}", pixels[name])
    return hf.calibrate(folder, poses(suffix), CAMERA, options=OPTIONS)


@pytest.fixture(scope="module")
def reference(images: Path) -> hf.Result:
    result = hf.calibrate(images, poses(".png"), CAMERA, options=OPTIONS)
    assert result.sfm is not None
    assert (result.status, result.sfm.n_registered) == ("ok", N_IMAGES)
    return result


def in_sigma(found: hf.Result, reference: hf.Result) -> float:
    """How far X is from the reference's, in units of its standard deviations."""
    error = frames.log(frames.inverse(reference.matrix) @ found.matrix)
    return float(np.sqrt(error @ np.linalg.solve(reference.covariance, error) / 6.0))


@pytest.mark.parametrize("suffix", COLOUR)
def test_x_is_the_same_from_all_formats_without_loss(
    suffix: str, pixels: dict[str, Pixels], reference: hf.Result, tmp_path: Path
) -> None:
    found = calibrated(tmp_path / "images", pixels, suffix, COLOUR[suffix])
    np.testing.assert_array_equal(found.matrix, reference.matrix)
    np.testing.assert_array_equal(found.covariance, reference.covariance)


def test_x_is_nearly_the_same_without_colours_and_from_jpeg(
    pixels: dict[str, Pixels], reference: hf.Result, tmp_path: Path
) -> None:
    """Rounding and losses are other noise of the images, not more than what X's uncertainty tells."""
    png, tif = (
        calibrated(tmp_path / suffix, pixels, suffix, write) for suffix, write in GREY.items()
    )
    np.testing.assert_array_equal(tif.matrix, png.matrix)
    assert in_sigma(png, reference) < 1.0
    assert in_sigma(calibrated(tmp_path / "jpeg", pixels, ".jpg", as_jpeg), reference) < 1.0


# 2. Runs.


@pytest.fixture(scope="module")
def camera_file(images: Path) -> Path:
    fx, fy, cx, cy, *distortion = CAMERA.params.tolist()
    K = [fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0]
    content = {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [*distortion, 0.0]},
    }
    path = images.parent / "camera.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def program(images: Path, camera: Path, out: Path, threads: int) -> dict[str, object]:
    """The result of a process of its own, without what tells the time."""
    csv = images.parent / "poses.csv"
    csv.write_text((TABLETOP / "poses.csv").read_text().replace(".jpg", ".png"))
    command = [sys.executable, "-m", "handeye_fg", "calibrate", str(images), str(csv), "--quiet"]
    command += ["--camera", str(camera), "--output", str(out)]
    command += ["--sfm.preset", "fast", "--sfm.threads", str(threads)]
    # Two orders of sets, so that nothing depends on it.
    env = {**os.environ, "PYTHONHASHSEED": out.name}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    assert done.returncode == 0, done.stderr
    document = json.loads((out / "result.json").read_text())
    del document["timing_s"]
    return dict(document)


def test_the_same_input_and_seed_give_the_same_result(
    images: Path, camera_file: Path, tmp_path: Path
) -> None:
    """On one thread to the last bit; on more, X to a tenth of its standard deviations."""
    one, two = (program(images, camera_file, tmp_path / seed, 1) for seed in "12")
    assert json.dumps(one) == json.dumps(two)
    scenes = [(tmp_path / seed / "scene.npz").read_bytes() for seed in "12"]
    assert scenes[0] == scenes[1]
    more = hf.load_result(tmp_path / "1" / "result.json")
    program(images, camera_file, tmp_path / "3", 2)
    assert in_sigma(hf.load_result(tmp_path / "3" / "result.json"), more) < 0.1


# 3. Options and inputs.


def state(out: Path) -> dict[str, tuple[int, int]]:
    """Every file below, with size and time."""
    return {
        str(path.relative_to(out)): (path.stat().st_size, path.stat().st_mtime_ns)
        for path in sorted(out.rglob("*"))
        if path.is_file()
    }


LATER = {
    "intrinsics": {"graph": GraphOptions(intrinsics="prior")},
    "iterations": {"graph": GraphOptions(max_iterations=99)},
    "noise": {"noise": NoiseOptions(pixel_px=0.5)},
    "holdout": {"holdout": 0.2},
    "prior": {"priors": (Prior("translation-along", (0.0, 0.0, 1.0), 0.044, 0.01),)},
    "task": {"task": TaskOptions(tolerance_mm=1.0)},
}


@pytest.fixture(scope="module")
def finished(images: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("finished")
    hf.calibrate(images, poses(".png"), CAMERA, options=OPTIONS, output=out)
    return out


@pytest.mark.parametrize("change", LATER)
def test_options_of_later_stages_leave_the_reconstruction_as_it_is(
    change: str, images: Path, finished: Path
) -> None:
    before = state(finished)
    told: dict[str, int] = {}
    options = replace(OPTIONS, **LATER[change])
    hf.calibrate(
        images,
        poses(".png"),
        CAMERA,
        options=options,
        output=finished,
        progress=lambda stage, done, _total: told.setdefault(stage, done) and None,
    )
    assert state(finished) == before
    assert set(told) == {"images", "registered", "iterations"}
    assert told["registered"] == N_IMAGES


def test_positions_of_the_robot_leave_the_reconstruction_as_it_is(
    images: Path, finished: Path
) -> None:
    """Only its turns tell what is static in the images."""
    before = state(finished)
    moved = {name: frames.scaled(pose, 1.001) for name, pose in poses(".png").items()}
    result = hf.calibrate(images, moved, CAMERA, options=OPTIONS, output=finished)
    assert state(finished) == before
    assert result.metres_per_world_unit > 0.0


def test_one_more_image_costs_itself_and_its_pairs(
    images: Path, finished: Path, pixels: dict[str, Pixels], tmp_path: Path
) -> None:
    more = tmp_path / "images"
    shutil.copytree(images, more)
    name = list(pixels)[N_IMAGES]
    cv2.imwrite(str(more / f"{name}.png"), pixels[name])
    reported = hf.read_poses(TABLETOP / "poses.csv")
    posed = poses(".png") | {f"{name}.png": reported.base_T_gripper[N_IMAGES]}
    out = Path(shutil.copytree(finished, tmp_path / "out"))
    told: dict[str, int] = {}
    result = hf.calibrate(
        more,
        posed,
        CAMERA,
        options=OPTIONS,
        output=out,
        progress=lambda stage, done, _total: told.setdefault(stage, done) and None,
    )
    assert told["features"] == N_IMAGES
    assert told["pairs"] == N_IMAGES * (N_IMAGES - 1) // 2
    anew = hf.calibrate(more, posed, CAMERA, options=OPTIONS)
    np.testing.assert_array_equal(result.matrix, anew.matrix)
