"""Each format is read back by the reader of that format, and has the same numbers."""

import io
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from example_results import make_result
from export_readers import EXACT, READERS, matrix_of
from handeye_fg.findings import FreeDirection
from handeye_fg.frames import exp
from handeye_fg.io.exports import export_text
from handeye_fg.io.exports.placed import rpy

NAMES = hf.ExportOptions(
    gripper_frame="tool0", base_frame="base_link", camera_frame="camera_color_optical_frame"
)
LINK = replace(NAMES, camera_link="camera_link", link_to_optical=(0.001, 0.015, -0.002))
# Near a pitch of 90 degrees roll and yaw run together.
TURNS = (
    [0.3, -0.2, 1.4],
    [np.pi, 0.0, 0.0],
    [0.0, np.pi / 2, 0.0],
    [0.0, -np.pi / 2 + 1e-9, 0.0],
)


@pytest.mark.parametrize("form", READERS)
@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_the_numbers_and_frames_read_back(form: str, setup: Any) -> None:
    parent = "tool0" if setup == "eye-in-hand" else "base_link"
    for turn in TURNS:
        X = exp(np.array([*turn, 0.03, -0.05, 1 / 3]))
        result = make_result(matrix=X, setup=setup)
        matrix, *names = READERS[form](hf.export(result, form, options=NAMES))
        np.testing.assert_allclose(matrix, X, **EXACT)
        assert names == [parent, "camera_color_optical_frame"]


@pytest.mark.parametrize("form", READERS)
def test_the_body_of_the_camera(form: str) -> None:
    """With the driver's own transform from the body to the optical frame, X comes out."""
    result = make_result()
    matrix, *names = READERS[form](result.export(form, LINK))
    link_T_optical = matrix_of((0.001, 0.015, -0.002), (-0.5, 0.5, -0.5, 0.5))
    # Of ROS: the optical z is the body's x, the optical x its -y.
    np.testing.assert_allclose(link_T_optical[:3, :3] @ [0, 0, 1], [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(link_T_optical[:3, :3] @ [1, 0, 0], [0, -1, 0], atol=1e-15)
    np.testing.assert_allclose(matrix @ link_T_optical, result.matrix, **EXACT)
    assert names == ["tool0", "camera_link"]
    given = replace(LINK, link_to_optical=(0.001, 0.015, -0.002, -0.5, 0.5, -0.5, 0.5))
    assert result.export(form, given) == result.export(form, LINK)


def plain(text: str) -> str:
    """A file's comments on one line, as people read them."""
    return " ".join(text.replace("#", " ").split())


@pytest.mark.parametrize("form", [*READERS, "covariance"])
def test_each_says_what_the_transform_is(form: str) -> None:
    result = make_result()
    text = plain(export_text(result, form, NAMES))
    point = result.matrix[:3, 3] + 0.5 * result.matrix[:3, 2]
    numbers = ", ".join(f"{value:.6f}" for value in point)
    assert "Put a point given in camera coordinates into gripper coordinates" in text
    assert f"p_gripper = gripper_T_camera p_camera; the point 0.5 m in front of the camera, (0, 0, 0.5), is at ({numbers}) m" in text  # fmt: skip
    assert "gripper is the frame tool0, camera the frame camera_color_optical_frame" in text


@pytest.mark.parametrize("form", [*READERS, "covariance"])
def test_a_partial_result_says_so_and_stays_readable(form: str) -> None:
    """Even where the description holds what would end a comment of the format."""
    free = FreeDirection(
        kind="translation",
        vector=np.array([0.0, 0.0, 1.0]),
        frame="gripper",
        description="Height is free; --prior helps -->\n<evil/>\r\necho evil\u2028echo evil",
    )
    result = make_result(status="partial", free_directions=(free,))
    text = export_text(result, form, NAMES)
    assert "PARTIAL: a part of this transform was chosen, not measured." in plain(text)
    if form in READERS:
        np.testing.assert_allclose(READERS[form](text)[0], result.matrix, **EXACT)


def test_the_table_of_the_covariance() -> None:
    result = make_result()
    table = pd.read_csv(io.StringIO(export_text(result, "covariance")), comment="#")
    assert list(table.columns) == ["rx", "ry", "rz", "tx", "ty", "tz"]
    assert np.array_equal(table.to_numpy(), result.covariance)
    assert json.loads(export_text(result, "json"))["optical_covariance"] == table.values.tolist()
    with pytest.raises(hf.InputDataError, match="gives no covariance"):
        export_text(make_result(covariance=None, certainty=None), "covariance")


@settings(max_examples=200)
@given(
    st.tuples(*[st.floats(-np.pi, np.pi)] * 3),
    st.sampled_from([0.0, 1e-12, 1e-9, 1e-7, 1e-4]),
)
def test_angles_are_exact_at_every_rotation(
    angles: tuple[float, float, float], near: float
) -> None:
    for roll, pitch, yaw in (angles, (angles[0], np.pi / 2 - near, angles[2])):
        R = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
        again = Rotation.from_euler("xyz", rpy(R)).as_matrix()
        np.testing.assert_allclose(again, R, rtol=0.0, atol=1e-14)
