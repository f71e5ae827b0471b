"""Any result, written and read back."""

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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
    result_schema,
    to_document,
)
from handeye_fg.types import CameraModel

quick = settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
