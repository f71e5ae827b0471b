"""Results of earlier versions, which lack what has been added since: they are read, and every command works on them."""

import copy
import json

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import cli, sfm
from handeye_fg.errors import InputDataError
from handeye_fg.io.result_reader import from_document
from handeye_fg.simulate import simulate_rig

LEVEL = "certainty.noise.robot_rotation_deg"
LATER = [
    *("noise.image_inflation", "noise.corner_px"),
    *(f"images[].{key}" for key in ("w_test", "influence_rotation_deg")),
    *(f"images[].{key}" for key in ("influence_translation_mm", "std_growth")),
    *(f"intrinsics.{key}" for key in ("other", "focal_offset", "correlation")),
    *(f"cameras[].intrinsics.{key}" for key in ("other", "focal_offset", "correlation")),
    *(f"holdout.{key}" for key in ("expected_reprojection_px", "within_95", "new_images")),
    "holdout.images[].expected_reprojection_px",
    *(f"certainty.noise.{name}.found" for name in ("pixel_px", "robot_rotation_deg")),
    "certainty.noise.robot_translation_mm.found",
]
# Whole parts that were added, too.
PARTS = ["second_start", "holdout", "certainty", "accuracy"]


def places(document, path):
    """The mappings of a document that have the last key of a path, and that key."""
    *parents, key = path.split(".")
    found = [document]
    for parent in parents:
        name = parent.removesuffix("[]")
        found = [one[name] for one in found]
        if parent.endswith("[]"):
            found = [item for one in found for item in one]
    return found, key


def without(document, paths):
    """A copy of a document that lacks some keys."""
    document = copy.deepcopy(document)
    for path in paths:
        found, key = places(document, path)
        assert found
        for one in found:
            del one[key]
    return document


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder as ``calibrate`` leaves it: two cameras, poses held out."""
    folder = tmp_path_factory.mktemp("later")
    rig = simulate_rig(np.random.default_rng(2), n_poses=9, n_points=60, start_sigma=1e-4)
    sfm.write_model(rig.scene.model, folder / "sfm")
    options = hf.Options(graph=hf.GraphOptions(intrinsics="free"), holdout=0.2)
    hf.refine(rig.scene.model, rig.robot_poses, options).save(folder)
    return folder


@pytest.fixture(scope="module")
def document(folder):
    return json.loads((folder / "result.json").read_text("utf-8"))


@pytest.mark.parametrize("path", [*LATER, *PARTS])
def test_keys_that_were_added_may_be_missing(document, path):
    # What derives from a key was added with it.
    paths = [p for p in LATER if p.endswith(".expected_reprojection_px")]
    old = from_document(without(document, paths if path in paths else [path]))
    new = from_document(document)
    np.testing.assert_array_equal(old.matrix, new.matrix)
    np.testing.assert_array_equal(old.covariance, new.covariance)


@pytest.mark.parametrize("path", LATER)
def test_they_must_not_be_malformed(document, path):
    broken = copy.deepcopy(document)
    found, key = places(broken, path)
    found[-1][key] = "much"
    with pytest.raises(InputDataError, match=rf"{key}(: it)? is 'much', but must be"):
        from_document(broken)


def test_what_is_missing_is_unknown(document):
    old = from_document(without(document, LATER))
    assert {image.std_growth for image in old.images} == {None}
    assert {camera.intrinsics_correlation for camera in old.cameras} == {None}
    assert {level.found for level in old.certainty.levels.values()} == {None}
    assert old.holdout.within is None
    assert old.holdout.expected_reprojection is None
    assert not old.holdout.new_images
    with pytest.raises(InputDataError, match="expected_rotation_deg is missing, but must be"):
        from_document(without(document, [*LATER, "holdout.expected_rotation_deg"]))
    with pytest.raises(InputDataError, match="'surplus' is an unknown key"):
        from_document(without(document, LATER) | {"surplus": 1})


@pytest.mark.parametrize("paths", [LATER, PARTS], ids=["keys", "parts"])
def test_every_command_works_on_them(folder, document, tmp_path, capsys, paths):
    (tmp_path / "sfm").symlink_to(folder / "sfm")
    old = json.dumps(without(document, paths))
    (tmp_path / "result.json").write_text(old, encoding="utf-8")
    assert cli.main(["report", str(tmp_path), "--summary"]) == 0
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "nan" not in page.split()
    assert ("std grows, %" in page) == (paths is PARTS)
    assert cli.main(["compare", str(folder), str(tmp_path)]) == 0
    exported = tmp_path / "x.json"
    flags = ["--format", "json", "--camera", "cam1", "--output", str(exported)]
    assert cli.main(["export", str(tmp_path), *flags]) == 0
    assert exported.exists()
    assert cli.main(["plan", str(tmp_path), "--count", "1"]) == 0
    assert "with next_001" in capsys.readouterr().err
