"""The linear start of several cameras."""

import numpy as np
import pytest

from handeye_fg.simulate import simulate_rig
from handeye_fg.solvers import linear_start
from handeye_fg.solvers.rig import rig_start
from handeye_fg.types import Rig


def exact(**arguments):
    return simulate_rig(
        np.random.default_rng(0),
        n_points=40,
        pixel_sigma=0.0,
        robot_rotation_sigma=0.0,
        robot_translation_sigma=0.0,
        start_sigma=0.0,
        **arguments,
    )


def start_of(scene, world_T_camera=None, reported=None):
    poses = scene.scene.model.world_T_camera if world_T_camera is None else world_T_camera
    robot = scene.robot_poses.base_T_gripper if reported is None else reported
    return rig_start(robot, poses, scene.rig)


# The first camera misses most; the second took no image with the third, but with the first.
CHAIN = frozenset(
    {(0, i) for i in range(4, 10)} | {(1, i) for i in range(3)} | {(2, i) for i in range(3, 10)}
)
APART = frozenset((i % 2, i) for i in range(10))


@pytest.mark.parametrize(
    ("n_cameras", "missing"), [(1, ()), (3, ()), (3, CHAIN), (2, APART)], ids=str
)
def test_exact_data_give_the_truth(n_cameras, missing):
    scene = exact(n_cameras=n_cameras, n_poses=10, missing=frozenset(missing))
    found = start_of(scene)
    np.testing.assert_allclose(
        found.gripper_T_camera @ found.first_T_cameras, scene.gripper_T_cameras, atol=1e-6
    )
    np.testing.assert_allclose(found.first_T_cameras[0], np.eye(4), atol=1e-12)
    truth = scene.scene
    assert found.metres_per_world_unit == pytest.approx(truth.metres_per_world_unit, rel=1e-6)
    np.testing.assert_allclose(found.base_T_world, truth.base_T_world, atol=1e-5)


def test_one_camera_is_the_linear_start():
    scene = simulate_rig(np.random.default_rng(1), n_cameras=1, n_poses=8, n_points=40)
    found = start_of(scene)
    alone = linear_start(scene.robot_poses.base_T_gripper, scene.scene.model.world_T_camera)
    np.testing.assert_array_equal(found.gripper_T_camera, alone.gripper_T_camera)
    assert found.metres_per_world_unit == alone.metres_per_world_unit


def test_images_that_were_placed_falsely_do_not_move_the_other_camera():
    scene = exact(n_cameras=2, n_poses=12)
    poses = np.array(scene.scene.model.world_T_camera)
    wrong = np.flatnonzero(scene.rig.camera == 1)[[2, 7, 8]]
    poses[wrong] = poses[wrong[::-1]] @ np.diag([-1.0, -1.0, 1.0, 1.0])
    found = start_of(scene, poses)
    np.testing.assert_allclose(found.first_T_cameras, scene.first_T_cameras, atol=1e-6)


def test_swapped_robot_poses_are_not_trusted():
    scene = simulate_rig(np.random.default_rng(2), n_cameras=2, n_poses=14, n_points=40)
    reported = np.array(scene.robot_poses.base_T_gripper)
    reported[[4, 11]] = reported[[11, 4]]
    found = start_of(scene, reported=reported)
    np.testing.assert_array_equal(np.flatnonzero(~found.trusted), [4, 11])


def test_the_other_camera_tells_which_of_its_own_robot_poses_are_wrong():
    scene = simulate_rig(
        np.random.default_rng(2),
        n_cameras=2,
        n_poses=20,
        n_points=40,
        missing=frozenset((i % 2, i) for i in range(20)),
    )
    reported = np.array(scene.robot_poses.base_T_gripper)
    lead, other = (np.flatnonzero(scene.rig.camera == k) for k in range(2))
    wrong = scene.rig.pose[[lead[4], lead[7], other[2], other[6]]]
    reported[wrong] = reported[np.roll(wrong, 1)]
    found = start_of(scene, reported=reported)
    np.testing.assert_array_equal(np.flatnonzero(~found.trusted), np.sort(wrong))


def test_the_order_of_images_does_not_matter():
    scene = simulate_rig(np.random.default_rng(3), n_cameras=2, n_poses=8, n_points=40)
    order = np.random.default_rng(4).permutation(16)
    rig = Rig(n_cameras=2, camera=scene.rig.camera[order], pose=scene.rig.pose[order])
    one = start_of(scene)
    other = rig_start(
        scene.robot_poses.base_T_gripper, scene.scene.model.world_T_camera[order], rig
    )
    np.testing.assert_allclose(other.gripper_T_camera, one.gripper_T_camera, atol=1e-12)
    np.testing.assert_allclose(other.first_T_cameras, one.first_T_cameras, atol=1e-12)
