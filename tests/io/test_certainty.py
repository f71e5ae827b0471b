"""The key ``certainty`` of ``result.json``: there and back, nulls, and what is refused."""

import copy
import math
from collections.abc import Callable
from typing import Any

import jsonschema
import numpy as np
import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.findings import LevelCertainty, RobotErrors
from handeye_fg.io.certainty import CertaintyReport
from handeye_fg.io.result_reader import from_document
from handeye_fg.io.results import Result, result_schema, to_document


def report(**changes: Any) -> CertaintyReport:
    fields: dict[str, Any] = {
        "half_widths": np.array([1e-3, 2e-3, np.nan, 7e-4, 6e-4, 9e-4, 1e-3]),
        "degrees_of_freedom": np.array([12.0, 12.5, 13.0, 14.0, 15.0, 16.0, np.inf]),
        "levels": {
            "pixel": LevelCertainty(degrees_of_freedom=900.0, low=0.95, high=1.05, source="data"),
            "robot_rotation": LevelCertainty(
                degrees_of_freedom=math.inf, low=1.0, high=1.0, source="user", found=(1.8, 1.5, 2.2)
            ),
        },
        "robot": RobotErrors(
            white=False,
            probability=0.002,
            resampled_ratio=1.4,
            hidden_rotation=5e-4,
            hidden_translation=3e-4,
            reason="The robot's errors are not independent noise.",
        ),
    }
    return CertaintyReport(**(fields | changes))


def test_there_and_back(changed: Callable[..., Result]) -> None:
    result = changed(certainty=report())
    document: Any = to_document(result)
    jsonschema.Draft202012Validator(result_schema()).validate(document)
    found = document["certainty"]
    np.testing.assert_allclose(found["half_width_rotation_deg"][:2], np.rad2deg([1e-3, 2e-3]))
    assert found["half_width_rotation_deg"][2] is None
    np.testing.assert_allclose(found["half_width_translation_mm"], [0.7, 0.6, 0.9])
    assert found["degrees_of_freedom"][6] is None
    assert result.noise is not None
    ends = [0.95 * result.noise.pixel, 1.05 * result.noise.pixel]
    np.testing.assert_allclose(found["noise"]["pixel_px"]["interval"], ends)
    assert found["noise"]["robot_rotation_deg"]["degrees_of_freedom"] is None
    assert found["robot"]["hidden_translation_mm"] == pytest.approx(0.3)
    again = from_document(document)
    assert again.certainty is not None
    np.testing.assert_allclose(again.certainty.half_widths, report().half_widths)
    assert again.certainty.levels["robot_rotation"].source == "user"
    held = found["noise"]["robot_rotation_deg"]["found"]
    assert held[0] == pytest.approx(1.8 * np.rad2deg(result.noise.robot_rotation))
    assert again.certainty.levels["robot_rotation"].found == pytest.approx((1.8, 1.5, 2.2))
    assert again.certainty.levels["pixel"].found is None
    assert again.certainty.robot.hidden_rotation == pytest.approx(5e-4)
    assert again.certainty.robot.reason == report().robot.reason


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("degrees_of_freedom",), [1.0, 2.0], "must be 7 numbers or nulls"),
        (("half_width_rotation_deg",), [1.0, "a", 2.0], "must be 3 numbers or nulls"),
        (("noise", "pixel_px", "source"), "nobody", "must be one of"),
        (("robot", "white"), 1, "must be true or false"),
    ],
)
def test_what_is_none_is_refused(
    path: tuple[str, ...], value: object, message: str, changed: Callable[..., Result]
) -> None:
    document: Any = copy.deepcopy(to_document(changed(certainty=report())))
    place = document["certainty"]
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(InputDataError, match=f"{path[-1]} is .*, but {message}"):
        from_document(document)


def test_reports_that_cannot_be_are_refused(changed: Callable[..., Result]) -> None:
    with pytest.raises(ValueError, match="half_widths"):
        report(half_widths=-np.ones(7))
    with pytest.raises(ValueError, match="degrees_of_freedom"):
        report(degrees_of_freedom=np.ones(6))
    with pytest.raises(ValueError, match="noise"):
        changed(certainty=report(), noise=None)
