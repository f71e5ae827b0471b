"""One X from several reconstructions that only the robot joins."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from handeye_fg import frames
from handeye_fg.errors import UnobservableError
from handeye_fg.motions import PosePairs
from handeye_fg.simulate import simulate_poses
from handeye_fg.solvers import andreff_scale
from handeye_fg.solvers.worlds import common_start, in_world


def moved(rng, world_T_camera, scale):
    """The same cameras in another world, of another unit."""
    other = frames.pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3))
    return frames.scaled(other @ world_T_camera, scale)


def in_worlds(seed, sizes, noise=0.0):
    rng = np.random.default_rng(seed)
    reported, world_T_camera, truth = simulate_poses(rng, n_poses=sum(sizes))
    reported = reported @ frames.exp(noise * rng.normal(size=(len(reported), 6)))
    ends = np.cumsum(sizes)
    scales = rng.uniform(0.1, 10.0, len(sizes))
    worlds = [
        PosePairs(
            base_T_gripper=reported[end - n : end],
            world_T_camera=moved(rng, world_T_camera[end - n : end], scale),
        )
        for n, end, scale in zip(sizes, ends, scales, strict=True)
    ]
    return worlds, truth.gripper_T_camera, scales


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(3, 6), min_size=1, max_size=4))
def test_exact_poses_give_x_whatever_the_worlds_are(seed, sizes):
    worlds, X, scales = in_worlds(seed, sizes)
    found = common_start(worlds)
    np.testing.assert_allclose(found, X, atol=1e-6)
    units = [in_world([data], [found]).metres_per_world_unit for data in worlds]
    np.testing.assert_allclose(np.array(units) * scales, units[0] * scales[0], rtol=1e-6)
    for data in worlds:
        world = in_world([data], [found])
        camera = frames.scaled(data.world_T_camera, world.metres_per_world_unit)
        np.testing.assert_allclose(
            data.base_T_gripper @ found, world.base_T_world @ camera, atol=1e-6
        )


def test_of_one_world_it_is_the_self_calibration():
    [data], _, _ = in_worlds(3, [12], noise=1e-3)
    np.testing.assert_allclose(
        common_start([data]), andreff_scale(data).gripper_T_camera, atol=1e-9
    )


def test_worlds_together_know_more_than_each():
    worlds, X, _ = in_worlds(4, [4, 4, 4, 4], noise=1e-3)

    def error(found):
        return np.linalg.norm(frames.log(frames.inverse(found) @ X)[3:])

    assert error(common_start(worlds)) < np.mean([error(common_start([one])) for one in worlds])


def about(axis, n, rng):
    return [rng.uniform(0.3, 1.0) * k * np.array(axis) for k in range(n)]


def test_two_axes_may_be_in_two_worlds():
    rng = np.random.default_rng(5)
    X = frames.exp(np.array([0.1, -0.2, 0.3, 0.05, -0.02, 0.1]))
    worlds = []
    for axis in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]):
        turns = Rotation.from_rotvec(about(axis, 4, rng)).as_matrix()
        reported = frames.pose(turns, rng.normal(size=(4, 3)))
        worlds.append(
            PosePairs(base_T_gripper=reported, world_T_camera=moved(rng, reported @ X, 2.0))
        )
    np.testing.assert_allclose(common_start(worlds), X, atol=1e-6)
    for world in worlds:
        with pytest.raises(UnobservableError, match="share one axis"):
            common_start([world])


def test_a_world_that_moves_backwards_has_no_place():
    [data], X, _ = in_worlds(6, [6])
    mirrored = np.array(data.world_T_camera)
    mirrored[:, :3, 3] *= -1.0
    assert (
        in_world([PosePairs(base_T_gripper=data.base_T_gripper, world_T_camera=mirrored)], [X])
        is None
    )
