"""Several cameras on one arm: image poses as a function of the shared unknowns."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.graph import start_state
from handeye_fg.graph.reduced import Layout
from handeye_fg.graph.reprojection import derivatives
from handeye_fg.graph.rig import first_camera_poses, image_poses, is_plain, to_images
from handeye_fg.graph.variables import State, moved
from handeye_fg.lens import lens_of
from handeye_fg.simulate import simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import CameraModel, Rig
from refinements import refined_from

CAMERA = np.array([0, 0, 1, 2, 1, 2, 2])
POSE = np.array([0, 1, 1, 1, 2, 2, 0])


CAMERAS = tuple(
    CameraModel(model=model, width=1280, height=960, params=np.array(params))
    for model, params in (
        ("SIMPLE_PINHOLE", [1100.0, 645.0, 475.0]),
        ("OPENCV", [1100.0, 1050.0, 645.0, 475.0, -0.2, 0.1, 0.004, -0.003]),
        ("OPENCV_FISHEYE", [700.0, 705.0, 645.0, 475.0, 0.02, -0.01, 0.004, -0.003]),
    )
)


@pytest.fixture
def state():
    rng = np.random.default_rng(0)
    return State(
        world_T_camera=frames.exp(rng.uniform(-1.0, 1.0, (3, 6))),
        points_world=rng.uniform(-1.0, 1.0, (2, 3)),
        gripper_T_cameras=frames.exp(rng.uniform(-1.0, 1.0, (3, 6))),
        base_T_world=frames.exp(rng.uniform(-1.0, 1.0, 6)),
        log_scale=0.7,
        cameras=CAMERAS,
        rig=Rig(n_cameras=3, camera=CAMERA, pose=POSE),
    )


def test_images_of_one_robot_pose_share_the_gripper(state):
    """base_T_gripper from each image, by its own camera's X, is one."""
    metric = frames.scaled(image_poses(state), np.exp(state.log_scale))
    X = state.gripper_T_cameras[state.rig.camera]
    gripper = state.base_T_world @ metric @ frames.inverse(X)
    for pose in range(3):
        at = gripper[pose == POSE]
        np.testing.assert_allclose(at, np.broadcast_to(at[0], at.shape), atol=1e-12)


@pytest.mark.parametrize("intrinsics", [(), ((0, 1, 2), (), (0, 3))])
def test_the_map_to_image_poses_by_central_differences(state, intrinsics):
    layout = Layout(n_poses=3, n_cameras=3, intrinsics=intrinsics, n_known=2)
    to = to_images(state, layout).toarray()
    n_images, h = len(CAMERA), 1e-5
    found = np.zeros((6 * n_images, layout.dim))
    before = frames.inverse(image_poses(state))

    def images_after(step):
        steps = gtsam.VectorValues()
        for key in layout.keys:
            steps.insert(key, step[layout.columns(key)])
        return frames.log(
            before @ image_poses(moved(state, steps, np.zeros((0, 3)), intrinsics))
        ).ravel()

    for column, step in enumerate(h * np.eye(layout.dim)):
        found[:, column] = (images_after(step) - images_after(-step)) / (2.0 * h)
    np.testing.assert_allclose(to[: 6 * n_images], found, atol=1e-8)
    # All that is no pose stays what it is.
    others = to[6 * n_images :]
    np.testing.assert_array_equal(others[:, 18:], np.eye(layout.dim - 18))
    np.testing.assert_array_equal(others[:, :18], 0.0)


def test_the_first_camera_is_where_the_first_image_puts_it(state):
    poses = image_poses(state)
    again = first_camera_poses(replace(state, world_T_camera=np.zeros((3, 4, 4))), poses)
    np.testing.assert_allclose(again.world_T_camera, state.world_T_camera, atol=1e-12)
    # At pose 1 there are images of all cameras: the first camera's counts.
    poses = np.array(poses)
    poses[2:4, :3, 3] += 1.0
    again = first_camera_poses(state, poses)
    np.testing.assert_allclose(again.world_T_camera[1], state.world_T_camera[1], atol=1e-12)


def test_one_camera_is_the_same_with_and_without_the_map():
    """Images in another order than robot poses take the general way."""
    scene = simulate_scene(np.random.default_rng(1), n_images=8, n_points=60, start_sigma=1e-4)
    reported, model = scene.robot_poses.base_T_gripper, scene.model
    linear = linear_start(reported, model.world_T_camera)
    order = np.random.default_rng(2).permutation(8)
    rig = Rig(n_cameras=1, camera=np.zeros(8, dtype=int), pose=np.argsort(order))

    def refined(reported, rig):
        start = start_state(model, [model.camera], linear, rig)
        return refined_from(start, model, reported)

    plain, general = refined(reported, None), refined(reported[order], rig)
    assert not is_plain(general.state.rig)
    for name in ("metres_per_world_unit", "metres_per_world_unit_std", "degrees_of_freedom"):
        assert getattr(general, name) == pytest.approx(getattr(plain, name), rel=1e-6)
    np.testing.assert_allclose(
        general.state.gripper_T_camera, plain.state.gripper_T_camera, atol=1e-9
    )
    np.testing.assert_allclose(general.base_T_camera, plain.base_T_camera, atol=1e-8)
    np.testing.assert_allclose(
        general.observability.covariance, plain.observability.covariance, rtol=1e-5, atol=1e-15
    )
    np.testing.assert_allclose(general.residuals[np.argsort(order)], plain.residuals, atol=1e-9)
    np.testing.assert_allclose(general.first_T_cameras, np.eye(4)[None], atol=1e-12)


def test_every_camera_sees_through_its_own_lens(state):
    """Errors and derivatives of images of several cameras are those of one camera after the other."""
    rng = np.random.default_rng(4)
    image = rng.integers(0, len(CAMERA), 40)
    poses = image_poses(state)
    rays = np.column_stack([rng.uniform(-0.4, 0.4, (40, 2)), np.ones(40)])
    points = np.einsum("nij,nj->ni", poses[image, :3, :3], 3.0 * rays) + poses[image, :3, 3]
    state, every = replace(state, points_world=points), np.arange(40)
    unknown = ((0, 1, 2), (), (0, 3))
    found = derivatives(state, image, every, np.zeros((40, 2)), unknown)
    assert found.by_intrinsics.shape == (40, 2, 5)
    for k in range(3):
        mine = np.flatnonzero(CAMERA[image] == k)
        alone = replace(
            state,
            world_T_camera=poses,
            cameras=(CAMERAS[k],),
            rig=Rig.of_one_camera(len(CAMERA)),
        )
        one = derivatives(
            alone, image[mine], every[mine], np.zeros((len(mine), 2)), unknown[k : k + 1]
        )
        expected = lens_of(CAMERAS[k]).pixels(*rays[mine, :2].T)
        np.testing.assert_allclose(found.errors[mine], expected, atol=1e-9)
        for name in ("errors", "by_pose", "by_point"):
            np.testing.assert_allclose(getattr(found, name)[mine], getattr(one, name), atol=1e-9)
        own = {0: [0, 1, 2], 1: [], 2: [3, 4]}[k]
        np.testing.assert_allclose(found.by_intrinsics[mine][:, :, own], one.by_intrinsics)
        assert not np.delete(found.by_intrinsics[mine], own, axis=2).any()
