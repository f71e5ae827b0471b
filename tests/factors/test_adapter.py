import gtsam
import numpy as np
import pytest

from factors._adapter import checked_factor, pose_key, scalar_key

NOISE = gtsam.noiseModel.Isotropic.Sigma(2, 1.0)


def values():
    result = gtsam.Values()
    result.insert(0, gtsam.Pose3())
    result.insert(1, 2.0)
    return result


def factor(vector, blocks):
    def residual(_pose, _scalar, *, jacobian):
        return vector, blocks if jacobian else ()

    return checked_factor([pose_key(0), scalar_key(1)], NOISE, residual)


def test_right_shapes_pass():
    made = factor(np.array([3.0, 4.0]), (np.ones((2, 6)), np.ones((2, 1))))
    assert made.error(values()) == pytest.approx(12.5)
    assert made.linearize(values()).jacobian()[0].shape == (2, 7)


@pytest.mark.parametrize(
    ("vector", "blocks", "message"),
    [
        (np.zeros(3), (np.ones((2, 6)), np.ones((2, 1))), "expected \\(2,\\)"),
        (np.zeros(2), (np.ones((2, 6)),), "1 blocks but expected 2"),
        (np.zeros(2), (np.ones((1, 6)), np.ones((2, 1))), "block 0"),
        (np.zeros(2), (np.ones((2, 5)), np.ones((2, 1))), "block 0"),
        (np.zeros(2), (np.ones((2, 6)), np.ones((2, 6))), "block 1"),
    ],
)
def test_wrong_shapes_raise_instead_of_crashing(vector, blocks, message):
    with pytest.raises(ValueError, match=message):
        factor(vector, blocks).linearize(values())


def test_errors_of_a_residual_come_through():
    def residual(*_unknowns, jacobian):
        raise ArithmeticError("mine")

    with pytest.raises(ArithmeticError, match="mine"):
        checked_factor([pose_key(0)], NOISE, residual).error(values())
