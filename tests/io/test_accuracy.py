import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from handeye_fg.errors import InputDataError
from handeye_fg.io.result_reader import from_document, load_result
from handeye_fg.io.results import Result, result_schema, to_document
from handeye_fg.point_errors import accuracy


@pytest.fixture
def accurate(changed: Callable[..., Result], result: Result) -> Result:
    assert result.covariance is not None
    return changed(accuracy=accuracy(result.matrix, result.covariance, 12.0, 0.4, 5e-4))


def test_round_trip_and_schema(accurate: Result, tmp_path: Path) -> None:
    jsonschema.validate(to_document(accurate), result_schema())
    accurate.save(tmp_path)
    before, after = accurate.accuracy, load_result(tmp_path).accuracy
    assert before is not None
    assert after is not None
    assert after.working_distance == pytest.approx(0.4)
    assert after.tolerance == pytest.approx(5e-4)
    pairs = zip((before.tool, *before.along_axis), (after.tool, *after.along_axis), strict=True)
    for a, b in pairs:
        np.testing.assert_array_equal(a.point_camera, b.point_camera)
        np.testing.assert_array_equal(a.covariance, b.covariance)
        assert a.within_95 == pytest.approx(b.within_95, rel=1e-12)


def test_figures_carry_the_units_of_their_names(accurate: Result) -> None:
    found = json.loads(json.dumps(to_document(accurate)["accuracy"]))
    assert found["working_distance_mm"] == pytest.approx(400.0)
    work = next(
        row for row in found["along_axis"] if row["point_camera_m"][2] == pytest.approx(0.4)
    )
    stds = 1e3 * np.sqrt(np.diag(work["covariance"]))
    np.testing.assert_allclose(work["std_mm"], stds)
    assert max(stds) < work["within_95_mm"] < 3.5 * np.linalg.norm(stds)


def test_what_contradicts_itself_is_refused(accurate: Result) -> None:
    document = json.loads(json.dumps(to_document(accurate)))
    document["accuracy"]["tool"]["std_mm"][1] *= 2.0
    with pytest.raises(InputDataError, match=r"accuracy\.tool\.std_mm\[1\]"):
        from_document(document)
    without = dataclasses.replace(accurate, accuracy=None)
    assert "accuracy" not in to_document(without)
