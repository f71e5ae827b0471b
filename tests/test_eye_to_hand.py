"""The rendered set of a static camera, against its exact truth."""

import json
from pathlib import Path

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import frames

DATA = Path(__file__).parents[1] / "data" / "eye_to_hand"
TRUTH = np.array(json.loads((DATA / "truth.json").read_text(encoding="utf-8"))["base_T_camera"])


@pytest.mark.e2e
@pytest.mark.slow
def test_without_masks_the_background_is_left_out_and_the_robot_joins_all_images() -> None:
    """Masked or not, the mapper alone takes sides of the object for one another."""
    result = hf.calibrate(
        DATA / "images",
        DATA / "poses.csv",
        camera=DATA / "camera.yaml",
        options=hf.Options(setup="eye-to-hand"),
    )
    assert result.status == "ok"
    assert all(image.registered and not image.outlier for image in result.images)
    assert "of the features stayed at their pixel" in result.message
    assert "the static background" in result.message
    error = frames.log(frames.inverse(result.matrix) @ TRUTH)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.03
    assert 1e3 * np.linalg.norm(error[3:]) < 0.5
    assert error @ np.linalg.solve(result.covariance, error) < 16.8
    assert 0.5 < np.rad2deg(result.noise.robot_rotation) / 0.01 < 2.0
    assert 0.5 < 1e3 * result.noise.robot_translation / 0.05 < 2.0
