"""What a result's document says: units, frames, and null for what is not known."""

import dataclasses
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.findings import (
    FreeDirection,
)
from handeye_fg.io.result_reader import from_document, load_result
from handeye_fg.io.results import (
    Result,
    result_schema,
    to_document,
    to_json,
)

VALIDATOR = jsonschema.Draft202012Validator(result_schema())


def test_figures_carry_the_units_of_their_names(result: Result) -> None:
    document: Any = to_document(result)
    np.testing.assert_allclose(
        document["calibration"]["std_rotation_deg"], np.degrees([1e-4, 2e-4, 3e-4])
    )
    np.testing.assert_allclose(document["calibration"]["std_translation_mm"], [1.0, 2.0, 3.0])
    assert document["calibration"]["translation_m"] == result.matrix[:3, 3].tolist()
    assert document["noise"]["robot_rotation_deg"] == pytest.approx(np.degrees(5e-4))
    assert document["noise"]["robot_translation_mm"] == pytest.approx(0.3)
    assert document["initial"]["residual_rotation_deg"] == pytest.approx(np.degrees(2e-3))
    assert document["initial"]["residual_translation_mm"] == pytest.approx(1.2)
    assert document["images"][0]["residual_rotation_deg"] == pytest.approx(np.degrees(1e-3))
    assert document["images"][0]["residual_translation_mm"] == pytest.approx(2.0)
    assert document["images"][1]["base_T_camera"] is None
    assert document["intrinsics"]["first_pixel_centre"] == 0.5
    assert document["observability"] == {"smallest_singular_value": 0.1, "condition": None}


def test_the_sentence_names_the_frames(result: Result, changed: Callable[..., Result]) -> None:
    calibration: Any = to_document(result)["calibration"]
    assert (calibration["parent"], calibration["child"]) == ("gripper", "camera")
    assert calibration["sentence"].startswith(
        "Put a point given in camera coordinates into gripper coordinates:"
        " p_gripper = gripper_T_camera p_camera; the point 0.5 m in front of the camera, (0, 0, 0.5), is at ("
    )
    numbers = re.search(r"is at \((.*)\) m in the gripper frame.$", calibration["sentence"])
    assert numbers is not None
    np.testing.assert_allclose(
        [float(number) for number in numbers[1].split(", ")],
        result.matrix[:3, 3] + 0.5 * result.matrix[:3, 2],
        atol=5e-7,
    )
    calibration = to_document(changed(setup="eye-to-hand"))["calibration"]
    assert calibration["parent"] == "base"
    assert "into base coordinates: p_base = base_T_camera p_camera;" in calibration["sentence"]
    assert calibration["sentence"].endswith("m in the base frame.")


def test_free_components_have_no_standard_deviation(partial: Result) -> None:
    document: Any = to_document(partial)
    rotation = document["calibration"]["std_rotation_deg"]
    assert rotation[2] is None
    np.testing.assert_allclose(rotation[:2], np.degrees([1e-4, 2e-4]))
    assert document["calibration"]["std_translation_mm"] == [None, None, pytest.approx(3.0)]
    assert document["metres_per_world_unit"] == {"value": 0.25, "std": None}
    again = from_document(document)
    assert np.isnan(again.metres_per_world_unit_std)
    assert to_document(again) == document


def test_a_direction_that_hardly_leans_on_an_axis_leaves_it_alone(
    changed: Callable[..., Result],
) -> None:
    def std(lean: float) -> Any:
        vector = np.array([lean, 0.0, np.sqrt(1.0 - lean**2)])
        direction = FreeDirection(
            kind="translation", vector=vector, frame="gripper", description=""
        )
        result = changed(status="partial", free_directions=(direction,), matrix=np.eye(4))
        calibration: Any = to_document(result)["calibration"]
        return calibration["std_translation_mm"]

    assert std(0.09) == [pytest.approx(1.0), pytest.approx(2.0), None]
    assert std(-0.11) == [None, pytest.approx(2.0), None]


def test_json_is_ascii_and_has_a_matrix_row_in_a_line(result: Result) -> None:
    text = to_json(to_document(result))
    assert text.isascii()
    assert "[0.0, 0.0, 0.0, 1.0]" in text
    assert json.loads(text) == to_document(result)
    assert not re.search("NaN|Infinity", text)
    assert json.loads(to_json({"a": "[\n 1\n ]", "b": [], "c": ["[\n", "]"]})) == {
        "a": "[\n 1\n ]",
        "b": [],
        "c": ["[\n", "]"],
    }
    with pytest.raises(ValueError, match="not JSON compliant"):
        to_json({"a": float("nan")})


def test_a_folder_stands_for_its_result(tmp_path: Path, result: Result) -> None:
    result.save(tmp_path / "new" / "folder")
    assert load_result(tmp_path / "new" / "folder").message == result.message
    with pytest.raises(InputDataError, match=r"^result file .*result\.json: no such file"):
        load_result(tmp_path)


def test_what_a_method_does_not_give_is_null(changed: Any, tmp_path: Path) -> None:
    whole = changed()
    result = changed(
        covariance=None,
        metres_per_world_unit_std=math.nan,
        base_T_world=None,
        noise=None,
        initial=dataclasses.replace(whole.initial, base_T_world=None),
        camera=None,
        intrinsics_refined=False,
        intrinsics_std=None,
        intrinsics_note="",
        sfm=None,
    )
    document = json.loads(result.save(tmp_path).read_text())
    VALIDATOR.validate(document)
    for key in ("base_T_world", "noise", "intrinsics", "sfm"):
        assert document[key] is None
    assert document["calibration"]["covariance"] is None
    assert document["calibration"]["std_rotation_deg"] == [None, None, None]
    assert document["metres_per_world_unit"]["std"] is None
    assert to_document(load_result(tmp_path)) == document


def test_noise_without_images_has_no_pixels(changed: Any, tmp_path: Path) -> None:
    without_images = {"camera": None, "intrinsics_std": None, "intrinsics_refined": False}
    noise = dataclasses.replace(changed().noise, pixel=math.nan)
    result = changed(noise=noise, sfm=None, intrinsics_note="", **without_images)
    document = json.loads(result.save(tmp_path).read_text())
    VALIDATOR.validate(document)
    assert document["noise"]["pixel_px"] is None
    assert load_result(tmp_path).noise is not None
    with pytest.raises(ValueError, match="pixel is nan"):
        changed(noise=noise)
