import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors import (
    camera_distance_factor,
    camera_distance_residual,
    camera_spread_factor,
    camera_spread_residual,
)
from factors.testing import assert_jacobians_match

twists = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)
NOISE = gtsam.noiseModel.Isotropic.Sigma(1, 0.1)


def values_of(poses, log_scale):
    values = gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, pose)
    values.insert(100, float(log_scale))
    return values


@given(one=twists, offset=twists, log_scale=st.floats(-3.0, 3.0))
def test_the_distance_s_jacobian(one, offset, log_scale):
    first = gtsam.Pose3.Expmap(one)
    # Apart: at a distance of zero there is no derivative.
    away = np.array([2.5, 0.0, 0.0]) + offset[3:]
    values = values_of([first, first.compose(gtsam.Pose3(first.rotation(), away))], log_scale)
    factor = camera_distance_factor(0, 1, 100, 0.4, NOISE)
    assert_jacobians_match(factor, values, (6, 6, 1))


@given(seed=st.integers(0, 1000), n=st.integers(2, 6), log_scale=st.floats(-3.0, 3.0))
def test_the_spread_s_jacobian(seed, n, log_scale):
    rng = np.random.default_rng(seed)
    poses = [gtsam.Pose3.Expmap(rng.uniform(-1.2, 1.2, 6)) for _ in range(n)]
    factor = camera_spread_factor(range(n), 100, 0.4, NOISE)
    assert_jacobians_match(factor, values_of(poses, log_scale), (*(6,) * n, 1))


def test_residuals_are_zero_where_the_length_is_right():
    turn = gtsam.Rot3.Expmap(np.array([0.3, -0.2, 0.5]))
    one, other = gtsam.Pose3(turn, [1.0, 2.0, 3.0]), gtsam.Pose3(gtsam.Rot3(), [1.0, 2.0, 5.0])
    log_scale = np.log(0.25)
    assert camera_distance_residual(one, other, log_scale, metres=0.5)[0] == pytest.approx([0.0])
    assert camera_distance_residual(one, other, log_scale, metres=0.4)[0] == pytest.approx([0.1])
    # Both are at 1 unit from their mean.
    assert camera_spread_residual([one, other], log_scale, metres=0.25)[0] == pytest.approx([0.0])
    found, _ = camera_spread_residual([one, other], log_scale, metres=0.2)
    assert found == pytest.approx([np.log(1.25)])
