import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.observability import analyse

SURE = np.diag([1e-8] * 3 + [1e-8] * 3 + [1e-8])


@pytest.mark.parametrize(
    ("kind", "index", "words"),
    [("rotation", 1, "do not turn enough"), ("translation", 4, "share this axis")],
)
def test_a_direction_without_information_is_named(kind, index, words):
    covariance = SURE.copy()
    covariance[index, index] = 100.0
    gripper_T_camera = frames.exp(np.array([0.3, -0.2, 0.5, 0.1, 0.2, 0.3]))
    found = analyse(covariance, gripper_T_camera, "gripper")
    (free,) = found.free_directions
    assert free.kind == kind
    assert words in free.description
    axis = gripper_T_camera[:3, 1]
    np.testing.assert_allclose(np.abs(free.vector @ axis), 1.0)
    expected = SURE[:6, :6].copy()
    expected[index, index] = 0.0
    np.testing.assert_allclose(found.covariance, expected, atol=1e-15)
    assert found.weakest_std > 1.0


def test_a_free_scale_is_named():
    covariance = SURE.copy()
    covariance[6, 6] = 1.0
    (free,) = analyse(covariance, np.eye(4), "gripper").free_directions
    assert free.kind == "scale"
    assert "100 mm" in free.description


def test_all_determined():
    found = analyse(SURE, np.eye(4), "gripper")
    assert found.free_directions == ()
    np.testing.assert_allclose(found.covariance, SURE[:6, :6])
