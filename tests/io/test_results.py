import copy
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
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from handeye_fg.errors import InputDataError
from handeye_fg.findings import (
    FocalOffset,
    FreeDirection,
    LinearStart,
    NoiseLevels,
    OtherIntrinsics,
    SecondStart,
)
from handeye_fg.frames import exp
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.io.read_as import ReadAs
from handeye_fg.io.result_reader import from_document, load_result
from handeye_fg.io.results import (
    ImageReport,
    Result,
    SfmSummary,
    failed_document,
    result_schema,
    to_document,
    to_json,
)
from handeye_fg.types import CameraModel

quick = settings(
    max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
# Keys that results of earlier versions do not have.
LATER = (
    *(
        "image_inflation",
        "corner_px",
        "other",
        "focal_offset",
        "correlation",
        "std_growth",
        "w_test",
    ),
    *("influence_rotation_deg", "influence_translation_mm"),
)
VALIDATOR = jsonschema.Draft202012Validator(result_schema())


def assert_same(a: Any, b: Any) -> None:
    """Equal by value: arrays exactly, other floats to the rounding of a change of unit."""
    if dataclasses.is_dataclass(a):
        assert type(a) is type(b)
        for field in dataclasses.fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_same(one, other)
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b)
        assert not b.flags.writeable
    elif isinstance(a, float):
        assert b == pytest.approx(a, rel=1e-15, abs=0.0)
    else:
        assert a == b


finite = st.floats(-1e9, 1e9)
positive = st.floats(1e-9, 1e9)
counts = st.integers(0, 10**9)
twists = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6)
poses = twists.map(lambda twist: exp(np.array(twist)))
units = st.sampled_from([*np.eye(3), np.ones(3) / np.sqrt(3.0)])
words = st.text(max_size=12)
figures = st.dictionaries(words, finite, max_size=3)
images = st.builds(
    ImageReport,
    name=words,
    registered=st.booleans(),
    base_T_camera=st.none() | poses,
    residual_rotation=st.none() | positive,
    residual_translation=st.none() | positive,
    reprojection_rms=st.none() | positive,
    outlier=st.booleans(),
    w_test=st.none() | positive,
    influence_rotation=st.none() | positive,
    influence_translation=st.none() | positive,
    reason=words,
)


second_starts = st.builds(
    SecondStart,
    agrees=st.booleans(),
    restarted=st.booleans(),
    rotation=positive,
    translation=positive,
)
other_intrinsics = st.builds(
    OtherIntrinsics,
    kind=st.sampled_from(["free", "fixed"]),
    gripper_T_camera=poses,
    covariance=st.builds(lambda size: size * np.eye(6), positive),
    shift_rotation=positive,
    shift_translation=positive,
    shift_sigma=positive,
)
focal_offsets = st.builds(
    FocalOffset,
    correlation=st.floats(-1.0, 1.0),
    std_factor=st.floats(1.0, 1e6),
    metres_per_percent=st.floats(-1.0, -1e-9),
    confounded=st.booleans(),
)

read_as = st.builds(ReadAs, format=words, recognised=st.booleans(), numbers=words)


@st.composite
def camera_reports(draw: st.DrawFn) -> CameraReport:
    root = np.array(draw(st.lists(st.floats(-1.0, 1.0), min_size=36, max_size=36))).reshape(6, 6)
    params = np.array(draw(st.lists(finite, min_size=3, max_size=12)))
    return CameraReport(
        name=draw(words),
        matrix=draw(poses),
        covariance=root @ root.T,
        free_directions=(),
        camera=CameraModel(model="RADIAL", width=640, height=480, params=params),
        intrinsics_refined=draw(st.booleans()),
        intrinsics_std=np.abs(params),
        intrinsics_note=draw(words),
        pixel=draw(positive),
        other_intrinsics=draw(st.none() | other_intrinsics),
        focal_offset=draw(st.none() | focal_offsets),
        first_T_camera=draw(poses),
        first_T_camera_covariance=root.T @ root,
    )


@st.composite
def results(draw: st.DrawFn) -> Result:
    setup = draw(st.sampled_from(["eye-in-hand", "eye-to-hand"]))
    frame = "gripper" if setup == "eye-in-hand" else "base"
    directions = draw(
        st.lists(
            st.builds(
                FreeDirection,
                kind=st.sampled_from(["rotation", "translation"]),
                vector=units,
                frame=st.just(frame),
                description=words,
            ),
            max_size=3,
        )
    )
    root = np.array(draw(st.lists(st.floats(-1.0, 1.0), min_size=36, max_size=36))).reshape(6, 6)
    params = np.array(draw(st.lists(finite, min_size=3, max_size=12)))
    return Result(
        status="partial" if directions else "ok",
        setup=setup,
        message=draw(words),
        matrix=draw(poses),
        covariance=root @ root.T,
        free_directions=tuple(directions),
        metres_per_world_unit=draw(positive),
        metres_per_world_unit_std=draw(positive),
        base_T_world=draw(poses),
        noise=NoiseLevels(
            pixel=draw(positive),
            robot_rotation=draw(positive),
            robot_translation=draw(positive),
            estimated=draw(st.booleans()),
        ),
        initial=LinearStart(
            method=draw(words),
            gripper_T_camera=draw(poses),
            base_T_world=draw(poses),
            metres_per_world_unit=draw(positive),
            residual_rotation=draw(positive),
            residual_translation=draw(positive),
        ),
        images=tuple(draw(st.lists(images, max_size=3))),
        camera=CameraModel(model="RADIAL", width=640, height=480, params=params),
        intrinsics_refined=draw(st.booleans()),
        intrinsics_std=np.abs(params),
        intrinsics_note=draw(words),
        other_intrinsics=draw(st.none() | other_intrinsics),
        focal_offset=draw(st.none() | focal_offsets),
        sfm=SfmSummary(
            n_images=draw(counts),
            n_registered=draw(counts),
            n_points=draw(counts),
            n_observations=draw(counts),
            mean_reprojection_px=draw(positive),
        ),
        second_start=draw(st.none() | second_starts),
        cameras=tuple(draw(st.just([]) | st.lists(camera_reports(), min_size=2, max_size=3))),
        poses_read_as=draw(st.dictionaries(st.sampled_from(["robot", "camera"]), read_as)),
        observability=draw(figures),
        timing_s=draw(figures),
        provenance=draw(st.dictionaries(words, words | st.integers(-(2**63), 2**63), max_size=3)),
    )


@quick
@given(results())
def test_round_trip_and_schema(tmp_path: Path, result: Result) -> None:
    path = result.save(tmp_path)
    assert path == tmp_path / "result.json"
    assert_same(result, load_result(path))
    VALIDATOR.validate(json.loads(path.read_text()))


def test_what_the_data_sheet_says_is_kept(changed: Callable[..., Result]) -> None:
    document = to_document(changed(repeatability=3e-5))
    VALIDATOR.validate(document)
    assert document["data_sheet"] == {"repeatability_mm": pytest.approx(0.03)}
    assert from_document(document).repeatability == pytest.approx(3e-5)
    assert "data_sheet" not in to_document(changed())


def test_the_schema_is_strict(result: Result, partial: Result) -> None:
    jsonschema.Draft202012Validator.check_schema(result_schema())

    def is_strict(node: Any) -> bool:
        if isinstance(node, list):
            return all(map(is_strict, node))
        if not isinstance(node, dict):
            return True
        closed = node.get("type") != "object" or "additionalProperties" in node
        return closed and all(map(is_strict, node.values()))

    assert is_strict(result_schema())
    for document in (to_document(result), to_document(partial)):
        VALIDATOR.validate(document)
        for place in (document, document["calibration"], document["images"][0]):  # type: ignore[index]  # JSON
            place["surplus"] = 1  # type: ignore[index]  # JSON
            assert not VALIDATOR.is_valid(document)
            del place["surplus"]  # type: ignore[attr-defined]  # JSON
        for key in list(document):
            assert not VALIDATOR.is_valid({k: v for k, v in document.items() if k != key})


def test_a_failure_has_no_numbers() -> None:
    document = failed_document("eye-in-hand", "Nothing could be reconstructed.")
    VALIDATOR.validate(document)
    assert not VALIDATOR.is_valid(document | {"noise": {}})
    with pytest.raises(InputDataError, match=r"calibration failed \(Nothing could be reconst"):
        from_document(document)


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


@pytest.mark.parametrize("text", ["{", "[" * 100_000, '{"a": ' + "9" * 5000 + "}"])
def test_what_is_no_json_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(InputDataError, match=r"^result file .*json: not valid JSON \("):
        load_result(tmp_path)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("schema_version", "2", "schema_version is '2', but must be one of '1'"),
        ("status", "fine", "status is 'fine', but must be one of 'ok'"),
        ("status", "partial", "self.status='partial' with 0 free directions"),
        ("setup", None, "setup is None, but must be one of 'eye-in-hand', 'eye-to-hand'"),
        ("setup", "eye-to-hand", "calibration.parent is 'gripper', but must be one of 'base'"),
        ("message", 3, "message is 3, but must be a string"),
        ("calibration", [], r"calibration is \[\], but must be a mapping"),
        ("calibration.matrix", [[1.0]], "calibration.matrix is .* must be 4 x 4 finite numbers"),
        ("calibration.matrix.0.0", 9.0, "matrix: not a rigid transform"),
        ("calibration.matrix.1.2", "NaN", "calibration.matrix is .* must be 4 x 4 finite"),
        ("calibration.covariance.5.5", True, "calibration.covariance is .* 6 x 6 finite numbers"),
        ("calibration.free_directions", {}, "free_directions is {}, but must be a list"),
        ("calibration.free_directions", [1], r"free_directions\[0\] is 1, but must be a mapping"),
        ("calibration.translation_m.1", 7.0, r"calibration.translation_m\[1\]: it is 7.0, but m"),
        ("calibration.translation_m.1", 10**400, r"translation_m\[1\]: it is an integer of 1329"),
        ("calibration.std_rotation_deg.0", None, r"std_rotation_deg\[0\]: it is None, but must"),
        ("calibration.surplus", 1, "calibration: 'surplus' is an unknown key"),
        ("calibration.translation_m", [1.0], "translation_m: it has 1 items, but must have 3"),
        ("calibration.sentence", 1, "calibration.sentence: it is 1, but must be like 'Put a po"),
        ("surplus", 1, "root: 'surplus' is an unknown key"),
        ("metres_per_world_unit.std", "x", "unit.std is 'x', but must be a finite number"),
        ("noise.estimated", 1, "noise.estimated is 1, but must be true or false"),
        ("noise.pixel_px", 10**400, "noise.pixel_px is an integer of 1329 bits, but must be a fi"),
        ("images.0.name", 5, r"images\[0\].name is 5, but must be a string"),
        ("images.1.reprojection_rms_px", "low", r"images\[1\].reprojection_rms_px is 'low', but"),
        ("intrinsics.first_pixel_centre", 0, "first_pixel_centre is 0, but must be 0.5"),
        ("intrinsics.std", [1.0], "intrinsics.std is .* must be 4 finite numbers"),
        ("intrinsics.width", 0, "intrinsics.width is 0, but must be an integer from 1"),
        ("sfm.n_points", 1.5, "sfm.n_points is 1.5, but must be an integer from 0"),
        ("timing_s.sfm", "long", "timing_s.sfm is 'long', but must be a finite number"),
        ("provenance.seed", 0.5, "provenance.seed is 0.5, but must be an integer"),
    ],
)
def test_malformed_documents_are_refused(
    result: Result, path: str, value: object, message: str
) -> None:
    document: Any = to_document(result)
    place = document
    *keys, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    for key in keys:
        place = place[key]
    place[last] = value
    with pytest.raises(InputDataError, match=f"^result document: .*{message}"):
        from_document(document)


def test_every_missing_key_is_an_input_data_error(partial: Result) -> None:
    document: Any = json.loads(to_json(to_document(partial)))

    def check(path: list[Any]) -> None:
        node = document
        for key in path:
            node = node[key]
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            if isinstance(node[key], dict | list):
                check([*path, key])
            if isinstance(node, dict) and path[:1] not in (
                ["observability"],
                ["timing_s"],
                ["provenance"],
            ):
                broken = copy.deepcopy(document)
                place = broken
                for step in path:
                    place = place[step]
                del place[key]
                if key in LATER:
                    continue  # tests/test_earlier_results.py
                with pytest.raises(InputDataError, match=str(key)):
                    from_document(broken)

    check([])


@pytest.mark.parametrize("document", [None, [], 3, "text"])
def test_what_is_no_object_is_refused(document: object) -> None:
    with pytest.raises(InputDataError, match="but wanted an object"):
        from_document(document)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"matrix": np.eye(3)}, "matrix: array.shape"),
        ({"matrix": 1e200 * np.eye(4)}, "matrix: not a rigid"),
        ({"matrix": np.diag([1.0, 1.0, -1.0, 1.0])}, "matrix: not a rigid"),
        ({"matrix": np.diag([1.0, 1.0, 1.0, 2.0])}, "matrix: not a rigid"),
        ({"base_T_world": np.full((4, 4), np.nan)}, "base_T_world: .* finite numbers"),
        ({"covariance": np.eye(3)}, "covariance: array.shape"),
        ({"intrinsics_std": np.ones(3)}, "intrinsics_std: array.shape"),
        ({"metres_per_world_unit": np.nan}, "metres_per_world_unit is nan"),
        ({"status": "partial"}, "'partial' with 0 free directions"),
        (
            {
                "noise": NoiseLevels(
                    pixel=np.inf, robot_rotation=1.0, robot_translation=1.0, estimated=True
                )
            },
            "pixel is inf",
        ),
        (
            {
                "status": "partial",
                "free_directions": (
                    FreeDirection(
                        kind="rotation", vector=np.eye(3)[0], frame="camera", description=""
                    ),
                ),
            },
            "direction.frame='camera' but expected 'gripper'",
        ),
    ],
)
def test_results_that_cannot_be_are_refused(
    changed: Callable[..., Result], changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        changed(**changes)


def test_image_reports_are_checked_and_read_only() -> None:
    with pytest.raises(ValueError, match="residual_rotation is nan"):
        ImageReport(name="a", registered=True, residual_rotation=np.nan)
    with pytest.raises(ValueError, match="base_T_camera: array"):
        ImageReport(name="a", registered=True, base_T_camera=np.eye(3))
    report = ImageReport(name="a", registered=True, base_T_camera=np.eye(4))
    assert report.base_T_camera is not None
    assert not report.base_T_camera.flags.writeable


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


def test_intrinsics_are_whole_or_missing(changed: Any) -> None:
    with pytest.raises(ValueError, match="camera and intrinsics_std"):
        changed(camera=None)
