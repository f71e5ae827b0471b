"""What is no result: documents that break the schema, and values that no result can have."""

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.findings import (
    FreeDirection,
    NoiseLevels,
)
from handeye_fg.io.result_reader import from_document, load_result
from handeye_fg.io.results import (
    ImageReport,
    Result,
    failed_document,
    result_schema,
    to_document,
    to_json,
)

# Keys that results of earlier versions do not have; of them see tests/test_earlier_results.py.
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
            free = path[:1] in (["observability"], ["timing_s"], ["provenance"])
            if isinstance(node, dict) and not free and key not in LATER:
                broken = copy.deepcopy(document)
                place = broken
                for step in path:
                    place = place[step]
                del place[key]
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
        ({"matrix": np.diag([1.1, 1.1, 1.1, 1.0])}, "matrix: not a rigid"),
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


def test_intrinsics_are_whole_or_missing(changed: Any) -> None:
    with pytest.raises(ValueError, match="camera and intrinsics_std"):
        changed(camera=None)
