import gtsam
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from factors import robot_pose_factor, robot_pose_residual
from factors.testing import assert_jacobians_match, taylor_slope

SIGMAS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
DIMS = (6, 6, 6, 1)
KEYS = (7, 2, 5, 3)  # not in order: the blocks must follow the factor's keys

twists = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)


def values_of(camera, x, z, log_scale):
    values = gtsam.Values()
    for key, twist in zip(KEYS, (camera, x, z), strict=False):
        values.insert(key, gtsam.Pose3.Expmap(np.asarray(twist, dtype=float)))
    values.insert(KEYS[3], float(log_scale))
    return values


def factor_of(measured):
    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS)
    return robot_pose_factor(*KEYS, measured, noise)


def predicted(values):
    camera, x, z = (values.atPose3(key) for key in KEYS[:3])
    metric = gtsam.Pose3(camera.rotation(), np.exp(values.atDouble(KEYS[3])) * camera.translation())
    return z.compose(metric).compose(x.inverse())


@given(camera=twists, x=twists, z=twists, measured=twists, log_scale=st.floats(-3, 3))
def test_jacobians_match_central_differences(camera, x, z, measured, log_scale):
    values = values_of(camera, x, z, log_scale)
    # Away from residual rotations of 180 degrees, where the logarithm jumps.
    offset = gtsam.Pose3.Expmap(0.5 * measured)
    assert_jacobians_match(factor_of(predicted(values).compose(offset)), values, DIMS)


@pytest.mark.parametrize(
    ("camera", "offset"),
    [
        (np.zeros(6), np.zeros(6)),
        (np.full(6, 1e-7), np.full(6, 1e-7)),
        (np.array([3.1, 0, 0, 0, 0, 0]), np.array([0, 3.1, 0, 0.1, 0, 0])),
        (np.array([0, 0, 0, 500.0, 0, 0]), np.array([0.1, 0, 0, 1.0, 0, 0])),
    ],
    ids=["identity", "near identity", "near 180 degrees", "large translation"],
)
def test_jacobians_at_corners(camera, offset):
    values = values_of(camera, np.full(6, 0.2), np.full(6, -0.3), 0.4)
    measured = predicted(values).compose(gtsam.Pose3.Expmap(offset))
    assert_jacobians_match(factor_of(measured), values, DIMS, relative_tolerance=1e-5)


def test_linearisation_error_is_quadratic():
    rng = np.random.default_rng(1)
    values = values_of(*rng.normal(size=(3, 6)), 0.7)
    measured = predicted(values).compose(gtsam.Pose3.Expmap(0.3 * rng.normal(size=6)))
    slope = taylor_slope(factor_of(measured), values, DIMS, rng.normal(size=19) / 5)
    assert slope == pytest.approx(2.0, abs=0.1)


@given(camera=twists, x=twists, z=twists, log_scale=st.floats(-3, 3))
def test_residual_is_zero_at_truth(camera, x, z, log_scale):
    values = values_of(camera, x, z, log_scale)
    residual, blocks = robot_pose_residual(
        *(values.atPose3(key) for key in KEYS[:3]), log_scale, base_T_gripper=predicted(values)
    )
    assert np.abs(residual).max() < 1e-9
    assert blocks == ()


@given(camera=twists, x=twists, z=twists, log_scale=st.floats(-2, 2), by=st.floats(-2, 2))
def test_scaling_the_world_only_shifts_the_log_scale(camera, x, z, log_scale, by):
    values = values_of(camera, x, z, log_scale)
    pose = values.atPose3(KEYS[0])
    values.update(KEYS[0], gtsam.Pose3(pose.rotation(), np.exp(by) * pose.translation()))
    values.update(KEYS[3], log_scale - by)
    assert predicted(values).equals(predicted(values_of(camera, x, z, log_scale)), 1e-9)


def test_the_checks_find_a_wrong_jacobian():
    """One entry off by one per cent must not pass."""
    values = values_of(np.full(6, 0.1), np.full(6, 0.2), np.full(6, 0.3), 0.4)
    right = factor_of(predicted(values).compose(gtsam.Pose3.Expmap(np.full(6, 0.2))))

    def error(_this, at, jacobians):
        if jacobians is not None:
            full = np.asarray(right.linearize(at).jacobian()[0]) * SIGMAS[:, None]
            full[0, 0] *= 1.01
            for slot, block in enumerate(np.split(full, np.cumsum(DIMS)[:-1], axis=1)):
                jacobians[slot] = np.asfortranarray(block)
        return right.unwhitenedError(at)

    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMAS)
    wrong = gtsam.CustomFactor(noise, list(KEYS), error)
    with pytest.raises(AssertionError, match="column 0"):
        assert_jacobians_match(wrong, values, DIMS)
    assert taylor_slope(wrong, values, DIMS, np.full(19, 0.2)) < 1.9
    with pytest.raises(AssertionError, match="columns"):
        assert_jacobians_match(right, values, (6, 6, 6))
