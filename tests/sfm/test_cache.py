"""The folder of a reconstruction: replaced as a whole, reused only for the same inputs."""

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.options import SfmOptions
from handeye_fg.sfm.cache import (
    check_replaceable,
    file_digests,
    inputs_digest,
    publish,
    staging,
    stored_model,
)
from handeye_fg.sfm.model import to_sfm_model
from handeye_fg.sfm.stages import open_stage, prepare
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, Fragment

NAMES = ("a.jpg", "b.jpg")
CAMERA = CameraModel(model="PINHOLE", width=64, height=48, params=np.array([50.0, 50, 32, 24]))
TURNS = RobotTurns(rotations=np.eye(3)[None], setup="eye-in-hand")
UNREGISTERED = (("z.jpg", "no features found"),)
FRAGMENT = Fragment(names=("z.jpg",), world_T_camera=np.eye(4)[None], cameras={".": CAMERA})


@pytest.fixture
def inputs(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    (folder / "masks").mkdir(parents=True)
    for name in NAMES:
        (folder / name).write_bytes(name.encode())
        (folder / "masks" / f"{name}.png").write_bytes(b"mask")
    return folder


def digest(images: Path, **changes: object) -> str:
    settings = {
        "names": NAMES,
        "cameras": {".": CAMERA},
        "masks": images / "masks",
        "options": SfmOptions(),
        "seed": 0,
        "refine_intrinsics": False,
    } | changes
    files = file_digests(images, settings.pop("names"), settings.pop("masks"))
    return inputs_digest(files, **settings)  # type: ignore[arg-type]  # mixed values


def reconstruction() -> pycolmap.Reconstruction:
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = options.num_cameras_per_rig = 1
    options.num_frames_per_rig, options.num_points3D = 4, 20
    return pycolmap.synthesize_dataset(options)


def store(folder: Path, key: str) -> None:
    stages = prepare(folder.parent / "stages")
    database = stages / "strict.db"
    database.write_bytes(b"database")
    made = reconstruction()
    model = to_sfm_model(made, UNREGISTERED)
    model = replace(model, static_share=0.25, fragments=(FRAGMENT,))
    publish(stages, folder, database, made, model, key)


def test_everything_that_matters_changes_the_digest(inputs: Path) -> None:
    changed = [
        digest(inputs, names=NAMES[:1]),
        digest(inputs, cameras=None),
        digest(inputs, cameras={".": replace(CAMERA, params=CAMERA.params + 1e-9)}),
        digest(inputs, masks=None),
        digest(inputs, options=SfmOptions(max_features=100)),
        digest(inputs, seed=1),
        digest(inputs, refine_intrinsics=True),
        digest(inputs, turns=TURNS),
        digest(inputs, turns=TURNS.inverted()),
    ]
    same = digest(inputs)
    assert digest(inputs) == same
    assert digest(inputs, options=SfmOptions(threads=1)) == same
    (inputs / "masks" / "b.jpg.png").write_bytes(b"other")
    changed.append(digest(inputs))
    (inputs / "b.jpg").write_bytes(b"other")
    changed.append(digest(inputs))
    assert len({same, *changed}) == len(changed) + 1
    (inputs / "b.jpg").unlink()
    with pytest.raises(InputDataError, match=r"b\.jpg: cannot be read"):
        digest(inputs)


def test_a_stored_model_comes_back_only_for_its_inputs(tmp_path: Path) -> None:
    folder = tmp_path / "out" / "sfm"
    assert stored_model(folder, "key") is None
    store(folder, "key")
    model = stored_model(folder, "key")
    assert model is not None
    assert (len(model.names), model.unregistered) == (4, UNREGISTERED)
    assert model.static_share == 0.25
    assert [fragment.names for fragment in model.fragments] == [("z.jpg",)]
    np.testing.assert_array_equal(model.fragments[0].world_T_camera, np.eye(4)[None])
    kept = model.fragments[0].cameras["."]
    assert (kept.model, kept.width, kept.height) == ("PINHOLE", 64, 48)
    np.testing.assert_array_equal(kept.params, CAMERA.params)
    assert stored_model(folder, "other") is None
    assert [path.name for path in (folder.parent / "stages").iterdir()] == ["strict.db"]
    assert (folder / "database.db").read_bytes() == b"database"


def test_a_model_is_replaced_as_a_whole(tmp_path: Path) -> None:
    folder = tmp_path / "sfm"
    store(folder, "old")
    (folder / "of the old model").touch()
    store(folder, "new")
    assert stored_model(folder, "new") is not None
    assert not (folder / "of the old model").exists()


@pytest.mark.parametrize("name", ["inputs.json", "images.bin"])
def test_a_damaged_model_is_made_again(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "sfm"
    store(folder, "key")
    (folder / name).write_bytes(b"{")
    assert stored_model(folder, "key") is None
    check_replaceable(folder)


def test_a_failure_leaves_the_old_model_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "sfm"
    store(folder, "key")

    def interrupted() -> None:
        with staging(folder) as work:
            (work / "half").touch()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert {path.name for path in tmp_path.iterdir()} == {"sfm", "stages"}
    assert stored_model(folder, "key") is not None


def test_what_is_not_ours_is_not_replaced(tmp_path: Path) -> None:
    check_replaceable(tmp_path / "missing")
    check_replaceable(tmp_path)
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputDataError, match="not written by handeye-fg"):
        check_replaceable(tmp_path)
    with (
        pytest.raises(InputDataError, match="cannot be written"),
        staging(tmp_path / "thesis.tex" / "sfm"),
    ):
        pass


def test_the_content_says_what_it_was_made_from(tmp_path: Path) -> None:
    store(tmp_path / "sfm", "key")
    content = json.loads((tmp_path / "sfm" / "inputs.json").read_text())
    assert content == {
        "digest": "key",
        "unregistered": [["z.jpg", "no features found"]],
        "static_share": 0.25,
        "fragments": [
            [["z.jpg"], [np.eye(4).tolist()], {".": ["PINHOLE", 64, 48, [50.0, 50.0, 32.0, 24.0]]}]
        ],
    }


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), RuntimeError("disk I/O error")]
)
def test_a_stage_on_a_full_disk_is_made_again_as_a_whole(tmp_path: Path, error: Exception) -> None:
    """COLMAP's own errors say no more than that something went wrong."""
    stages = prepare(tmp_path / "stages")

    def half(folder: Path, _older: object) -> dict[str, object]:
        (folder / "half").touch()
        raise error

    with pytest.raises(
        InputDataError, match=r"cannot be written \(.*check the free disk space.*continues"
    ):
        open_stage(stages, "matches", {"seed": 0}, half)
    assert list(stages.iterdir()) == []
    made = open_stage(stages, "matches", {"seed": 0}, lambda _folder, _older: {"pairs": 3})
    assert made.facts == {"pairs": 3}
    # It is there now: nothing is built.
    assert open_stage(stages, "matches", {"seed": 0}, half).folder == made.folder
