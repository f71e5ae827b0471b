"""Which poses are chosen, and the information on which that rests."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.findings import NoiseLevels
from handeye_fg.graph.forecast import forecast
from handeye_fg.options import NoiseOptions
from handeye_fg.planning.candidates import candidates, nearby
from handeye_fg.planning.design import best, pose_information, prior_information, uncertainty
from handeye_fg.planning.reach import Both, Workspace
from handeye_fg.planning.sight import gripper_pose, scene_camera
from handeye_fg.planning.situation import assumed_situation
from handeye_fg.priors import PosePrior, Prior
from handeye_fg.simulate import simulate_scene
from handeye_fg.simulate.scenes import SCENE_CENTRE, default_camera
from handeye_fg.types import Rig

KNOWN = NoiseOptions(pixel_px=0.3, robot_rotation_deg=0.1, robot_translation_mm=1.0)
NOISE = NoiseLevels(
    pixel=0.3, robot_rotation=np.deg2rad(0.1), robot_translation=1e-3, estimated=False
)
X = frames.exp(np.array([0.3, -0.2, 1.4, 0.03, -0.05, 0.09]))
STANDOFF = 0.45


@pytest.fixture
def there():
    rng = np.random.default_rng(2)
    return assumed_situation(rng, SCENE_CENTRE, STANDOFF, default_camera(), X, NOISE)


def informations(there, cameras, *, static=False):
    visible = there.sight.visible(cameras)
    images = np.array(
        [
            there.sight.pose_information(camera, which, 0.3)
            for camera, which in zip(cameras, visible, strict=True)
        ]
    )
    gains = pose_information(
        cameras[:, None], images[:, None], X[None], there.sight.centre, NOISE, static=static
    )
    return visible, gains


@pytest.mark.parametrize("static", [False, True])
def test_the_closed_form_is_that_of_the_graph(there, static):
    """But for the points, which it takes as known: that makes 5 % here, with a robot of 0.1 degrees."""
    rng = np.random.default_rng(1)
    cameras = candidates(rng, there.cameras, Both(()), 30, 12).scene_T_cameras[:, 0]
    visible, gains = informations(there, cameras, static=static)
    information = prior_information((), X[None], STANDOFF) + gains.sum(axis=0)
    closed = np.sqrt(np.diag(np.linalg.inv(information))[:6])
    image, point = np.nonzero(visible)
    (found,) = forecast(
        cameras,
        Rig.of_one_camera(len(cameras)),
        there.sight.points,
        image,
        point,
        np.ones(len(image)),
        X[None],
        [default_camera()],
        NOISE,
        KNOWN,
        inverted=static,
    )
    np.testing.assert_allclose(closed, np.sqrt(np.diag(found.covariance)), rtol=0.06)


def test_the_closed_form_with_two_cameras_is_that_of_the_graph(there):
    """The robot's noise at a pose is common to both, and a pose may have an image of one of them only."""
    rng = np.random.default_rng(1)
    both = np.array([X, X @ frames.exp([0.4, -0.3, 0.3, 0.05, 0.02, -0.03])])
    cameras = replace(there.cameras, sights=there.cameras.sights * 2, gripper_T_cameras=both)
    found = candidates(rng, cameras, Both(()), 30, 12)
    seen = found.visible.any(axis=2)
    assert not seen.all()
    images = np.zeros((12, 2, 6, 6))
    for i, k in np.argwhere(seen):
        images[i, k] = there.sight.pose_information(
            found.scene_T_cameras[i, k], found.visible[i, k], 0.3
        )
    gains = pose_information(
        found.scene_T_cameras, images, both, there.sight.centre, NOISE, static=False
    )
    information = prior_information((), both, STANDOFF) + gains.sum(axis=0)
    closed = np.sqrt(np.diag(np.linalg.inv(information)))
    pose, camera = np.nonzero(seen)
    image, point = np.nonzero(found.visible[pose, camera])
    expected = forecast(
        found.scene_T_cameras[pose, camera],
        Rig(n_cameras=2, camera=camera, pose=pose),
        there.sight.points,
        image,
        point,
        np.ones(len(image)),
        both,
        [default_camera()] * 2,
        NOISE,
        KNOWN,
    )
    for k, one in enumerate(expected):
        own = closed[6 * k : 6 * k + 6]
        np.testing.assert_allclose(own, np.sqrt(np.diag(one.covariance)), rtol=0.08)


def test_the_forecast_is_what_a_refinement_reports():
    scene = simulate_scene(np.random.default_rng(5), n_images=12, n_points=80, start_sigma=0.0)
    tracks = scene.model.tracks
    metric = scene.base_T_world @ frames.scaled(scene.world_T_camera, scene.metres_per_world_unit)
    points = scene.metres_per_world_unit * scene.points_world @ scene.base_T_world[:3, :3].T
    (found,) = forecast(
        metric,
        Rig.of_one_camera(12),
        points + scene.base_T_world[:3, 3],
        tracks.image_index,
        tracks.point_index,
        np.ones(len(tracks.pixels)),
        scene.gripper_T_camera[None],
        [scene.camera],
        scene.noise,
        NoiseOptions(pixel_px=0.3, robot_rotation_deg=0.1, robot_translation_mm=1.0),
    )
    gone = np.arange(12) < 6
    (half,) = forecast(
        metric,
        Rig.of_one_camera(12),
        points + scene.base_T_world[:3, 3],
        tracks.image_index,
        tracks.point_index,
        np.ones(len(tracks.pixels)),
        scene.gripper_T_camera[None],
        [scene.camera],
        scene.noise,
        NoiseOptions(),
        trusted=gone,
        refine_intrinsics=[True],
    )
    assert not found.free_directions
    # Half of the robot's poses, unknown noise levels and intrinsics: far less certain.
    assert (np.diag(half.covariance) > 1.5 * np.diag(found.covariance)).all()


def test_candidates_are_within_reach_and_see_the_scene(there):
    box = Workspace((0.2, -0.3, 0.2), (0.8, 0.3, 0.6))
    for static in (False, True):
        reach = Both(()) if static else Both((box,))
        cameras = replace(there.cameras, static=static)
        found = candidates(np.random.default_rng(0), cameras, reach, 20, 50)
        assert len(found.base_T_gripper) == 50
        assert reach.reachable(found.base_T_gripper).all()
        assert (found.visible.sum(axis=2) >= 20).all()
        np.testing.assert_allclose(
            scene_camera(found.base_T_gripper, X, static=static),
            found.scene_T_cameras[:, 0],
            atol=1e-12,
        )
        near = nearby(np.random.default_rng(0), found.only([0, 1]), cameras, reach, 20, 9)
        assert reach.reachable(near.base_T_gripper).all()
        assert 4 < len(near.base_T_gripper) <= 18
        moved = frames.inverse(found.scene_T_cameras[0, 0]) @ near.scene_T_cameras[0, 0]
        assert 0.0 < frames.rotation_angle(moved[:3, :3]) < 0.5


def drawn(there, count, seed=0):
    found = candidates(np.random.default_rng(seed), there.cameras, Both(()), 30, count)
    return found.base_T_gripper, informations(there, found.scene_T_cameras[:, 0])[1]


def test_few_poses_are_nearly_the_best_of_all_choices(there):
    poses, gains = drawn(there, 14)
    known = prior_information((), X[None], STANDOFF) + gains[:3].sum(axis=0)
    chosen = best(known, gains, poses, poses[:3], 3, STANDOFF)
    assert not set(chosen) & {0, 1, 2}
    found = uncertainty(known + gains[chosen].sum(axis=0))
    every = [
        uncertainty(known + gains[list(three)].sum(axis=0))
        for three in itertools.combinations(range(3, 14), 3)
    ]
    assert found < 1.02 * min(every)
    # The one that helps most comes first.
    first = [uncertainty(known + gains[one]) for one in chosen]
    assert np.argmin(first) == 0


def test_planned_poses_serve_as_well_as_twice_as_many_random_ones(there):
    poses, gains = drawn(there, 300)
    known = prior_information((), X[None], STANDOFF) + gains[:5].sum(axis=0)
    chosen = best(known, gains, poses, poses[:5], 6, STANDOFF)

    planned = uncertainty(known + gains[chosen].sum(axis=0))
    rng = np.random.default_rng(0)
    random = [
        uncertainty(known + gains[rng.choice(300, 12, replace=False)].sum(axis=0))
        for _ in range(50)
    ]
    assert planned < 0.97 * np.median(random)


def test_rotation_and_position_count_alike():
    """Whatever their units, and of several axes and cameras nearly the worst alone."""

    def of(rotation, position):
        stds = np.concatenate([rotation, position], axis=-1).reshape(-1)
        return uncertainty(np.diag(np.append(stds, np.ones(7)) ** -2.0))

    one = of([1.0, 1.0, 1.0], [1.0, 1.0, 1.0])
    assert of([2.0, 2.0, 2.0], [1.0, 1.0, 1.0]) == pytest.approx(np.sqrt(2.0) * one)
    assert of([1.0, 1.0, 1.0], [8.0, 8.0, 8.0]) == pytest.approx(np.sqrt(8.0) * one)
    assert of([1.0, 1.0, 1.0], [8.0, 0.1, 0.1]) == pytest.approx(np.sqrt(8.0) * one, rel=0.05)
    two = of([[1.0, 1.0, 1.0], [1.0, 4.0, 1.0]], [[1.0, 1.0, 3.0], [1.0, 1.0, 1.0]])
    assert two == pytest.approx(np.sqrt(12.0), rel=0.15)


def test_no_pose_is_taken_twice(there):
    poses, gains = drawn(there, 6)
    known = prior_information((), X[None], STANDOFF)
    again = np.concatenate([poses, poses @ frames.exp([0.02, 0.0, 0.0, 0.002, 0.0, 0.0])])
    twice = np.concatenate([gains, gains])
    assert len(best(known, twice, again, poses[:2], 12, STANDOFF)) == 4


def test_what_is_known_of_x_counts():
    free = uncertainty(prior_information((), X[None], STANDOFF))
    rough = PosePrior.of(X, 0.5, 2.0)
    found = uncertainty(prior_information((rough,), X[None], STANDOFF))
    # Half a degree and two millimetres about and along each axis.
    assert found == pytest.approx(np.sqrt(np.deg2rad(0.5) * 2e-3), rel=1e-3)
    height = Prior("translation-along", (0, 0, 1), 0.08, 0.001)
    assert found < free
    information = prior_information((height,), X[None], STANDOFF)[3:6, 3:6]
    axis = X[:3, :3].T @ [0.0, 0.0, 1.0]
    assert axis @ information @ axis == pytest.approx(1e6, rel=1e-3)


def test_gripper_poses_of_a_static_camera():
    scene_T_camera = frames.exp(np.array([[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]]))
    gripper = gripper_pose(scene_T_camera, X, static=True)
    np.testing.assert_allclose(frames.inverse(gripper) @ X, scene_T_camera, atol=1e-12)
