import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.io.result_reader import load_result
from handeye_fg.io.results import Result
from handeye_fg.io.scene_file import SCENE_NAME, RefinedScene, read_scene, write_scene


@pytest.fixture
def scene() -> RefinedScene:
    rng = np.random.default_rng(2)
    return RefinedScene(
        points=rng.normal(size=(50, 3)),
        n_points=70,
        image=rng.integers(0, 2, 30),
        pixels=rng.uniform(0, 600, (30, 2)),
        errors=rng.normal(size=(30, 2)),
        sigmas=rng.uniform(0.1, 0.5, 30),
        n_observations=44,
        names=("a.png", "frame_\u2603.png"),
        thumbnails={"a.png": b"one picture", "frame_\u2603.png": b"another"},
        path=np.tile(np.eye(4), (3, 1, 1)),
    )


def test_round_trip(scene: RefinedScene, tmp_path: Path) -> None:
    write_scene(scene, tmp_path)
    found = read_scene(tmp_path)
    assert found is not None
    assert found.names == scene.names
    assert dict(found.thumbnails) == dict(scene.thumbnails)
    assert (found.n_points, found.n_observations) == (70, 44)
    np.testing.assert_array_equal(found.image, scene.image)
    for name in ("points", "pixels", "errors", "sigmas", "path"):
        np.testing.assert_allclose(getattr(found, name), getattr(scene, name), rtol=1e-6)


def test_a_scene_goes_and_comes_with_its_result(
    scene: RefinedScene, changed: Callable[..., Result], tmp_path: Path
) -> None:
    changed(scene=scene).save(tmp_path)
    found = load_result(tmp_path).scene
    assert found is not None
    assert found.names == scene.names
    changed().save(tmp_path)
    assert not (tmp_path / SCENE_NAME).exists()
    assert load_result(tmp_path / "result.json").scene is None


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 damaged"])
def test_what_is_no_scene_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / SCENE_NAME).write_bytes(content)
    with pytest.raises(InputDataError, match="not a scene"):
        read_scene(tmp_path)


class Trap:
    """What runs as soon as it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.marker),)


def test_pickles_are_not_opened(scene: RefinedScene, tmp_path: Path) -> None:
    path = write_scene(scene, tmp_path)
    with np.load(path) as found:
        arrays = dict(found)
    trap = np.array([Trap(tmp_path / "sprung")] * 2, dtype=object)
    np.savez(path, **(arrays | {"names": trap}))
    with pytest.raises(InputDataError, match=r"not a scene \(Object arrays cannot be loaded"):
        read_scene(tmp_path)
    assert not (tmp_path / "sprung").exists()


def test_archives_that_unpack_to_too_much_are_not_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / SCENE_NAME, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", bytes(65 * 2**20))
    with pytest.raises(InputDataError, match="larger than any scene"):
        read_scene(tmp_path)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"names": ("a.png",)}, "not those of names"),
        ({"image": np.full(30, -1)}, "not those of names"),
        ({"points": np.zeros((50, 2))}, "points: array"),
        ({"pixels": np.zeros((29, 2))}, "pixels: array"),
        ({"errors": np.zeros((30, 3))}, "errors: array"),
        ({"sigmas": np.full(30, np.nan)}, "sigmas: array"),
        ({"path": np.zeros((3, 3, 4))}, "path: array"),
    ],
)
def test_scenes_that_cannot_be_are_refused(
    scene: RefinedScene, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        replace(scene, **changes)
