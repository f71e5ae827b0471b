"""What a planned image sees, and what it says of its pose."""

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.planning.sight import Sight, gripper_pose, in_image, pixels_by_pose, scene_camera
from handeye_fg.simulate import project
from handeye_fg.simulate.scenes import default_camera
from handeye_fg.types import CameraModel

FISHEYE = CameraModel(
    model="OPENCV_FISHEYE",
    width=1280,
    height=960,
    params=np.array([500.0, 505.0, 640.0, 480.0, 0.02, -0.01, 0.003, -0.001]),
)
POINTS = np.random.default_rng(0).uniform([-0.2, -0.15, 0.5], [0.2, 0.15, 0.9], (20, 3))


@pytest.mark.parametrize("camera", [default_camera(), FISHEYE], ids=["perspective", "fisheye"])
def test_derivatives_by_the_pose(camera):
    found = pixels_by_pose(camera, POINTS)
    step = 1e-6
    for k in range(6):
        there, back = (
            project(camera, POINTS @ moved[:3, :3].T + moved[:3, 3])
            for moved in (frames.inverse(frames.exp(s * np.eye(6)[k])) for s in (step, -step))
        )
        np.testing.assert_allclose(found[..., k], (there - back) / (2.0 * step), atol=1e-4)


def test_what_is_behind_beside_or_folded_back_is_not_in_the_image():
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [2.0, 0.0, 1.0], [40.0, 0.0, 1.0]])
    assert in_image(default_camera(), points).tolist() == [True, False, False, False]


def sight(**changes):
    given = {
        "points": np.zeros((1, 3)),
        "rays": np.array([[0.0, 0.0, 1.0], [0.0, 0.6, 0.8]]),
        "distances": np.array([0.4, 0.6]),
        "point_index": np.array([0, 0]),
        "camera": default_camera(),
    }
    return Sight(**(given | changes))


def camera_at(direction, distance):
    z = -np.array(direction) / np.linalg.norm(direction)
    x = np.cross(z, [0.3, 0.5, 0.1])
    x /= np.linalg.norm(x)
    return frames.pose(np.stack([x, np.cross(z, x), z], axis=1), -distance * z)


@pytest.mark.parametrize(
    ("direction", "distance", "seen"),
    [
        ((0.0, 0.0, 1.0), 0.5, True),
        ((0.0, 1.0, 0.5), 0.5, True),  # 27 degrees from the second ray
        ((0.0, -1.0, 1.0), 0.5, False),  # 45 degrees from the first
        ((0.0, 0.0, 1.0), 1.2, False),  # twice as far as ever
        ((0.0, 0.0, 1.0), 0.2, False),
    ],
)
def test_points_are_found_again_from_about_where_they_were_seen(direction, distance, seen):
    assert sight().visible(camera_at(direction, distance)[None]).tolist() == [[seen]]
    assert sight(widest_angle=np.pi).visible(camera_at((0.0, -1.0, 1.0), 0.5)[None]).all()


@pytest.mark.parametrize("static", [False, True])
def test_gripper_and_camera_belong_together(static):
    X, pose = (frames.exp(np.random.default_rng(seed).standard_normal((2, 6))) for seed in range(2))
    there = scene_camera(pose, X, static=static)
    np.testing.assert_allclose(gripper_pose(there, X, static=static), pose, atol=1e-12)
