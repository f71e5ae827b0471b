"""A static camera: robot poses come in inverted, their noise stays that of base_T_gripper."""

import gtsam
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from factors.testing import assert_jacobians_match
from handeye_fg import frames
from handeye_fg.graph import measurements as m
from handeye_fg.graph.summary import robot_residuals
from handeye_fg.graph.variables import State, to_values
from handeye_fg.types import Rig

SIGMAS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])

twists = st.lists(st.floats(-1.2, 1.2), min_size=6, max_size=6).map(np.array)


@given(camera=twists, base_T_camera=twists, gripper_T_world=twists, off=twists)
def test_the_residual_is_that_of_the_pose_as_reported(camera, base_T_camera, gripper_T_world, off):
    state = State(
        world_T_camera=frames.exp(camera)[None],
        points_world=np.zeros((0, 3)),
        gripper_T_cameras=frames.exp(base_T_camera)[None],
        base_T_world=frames.exp(gripper_T_world),
        log_scale=0.4,
        cameras=(),
        rig=Rig.of_one_camera(1),
    )
    metric = frames.scaled(state.world_T_camera[0], np.exp(0.4))
    base_T_gripper = state.gripper_T_camera @ frames.inverse(state.base_T_world @ metric)
    reported = base_T_gripper @ frames.inverse(
        frames.exp(0.5 * off)
    )  # so that the residual is off / 2
    gripper_T_base = frames.inverse(reported)[None]
    residual = robot_residuals(state, gripper_T_base, inverted=True)[0]
    np.testing.assert_allclose(residual, 0.5 * off, atol=1e-9)

    factor = m.robot_graph(gripper_T_base, SIGMAS, inverted=True).at(0)
    values = to_values(state)
    # With the sign reversed, which no cost and no covariance depends on.
    np.testing.assert_allclose(factor.whitenedError(values), -residual / SIGMAS, atol=1e-8)
    assert isinstance(factor, gtsam.CustomFactor)
    assert_jacobians_match(factor, values, (6, 6, 6, 1))
