"""Where images stand in pictures of the scene."""

from dataclasses import replace

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.io.results import Result
from handeye_fg.report.placed import placed
from handeye_fg.types import CameraModel

WIDTH, HEIGHT = 640, 480
IMAGE_CORNERS = np.array([[0, 0], [WIDTH, 0], [WIDTH, HEIGHT], [0, HEIGHT]], dtype=float)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("PINHOLE", [500.0, 510.0, 300.0, 250.0]),
        ("SIMPLE_RADIAL", [500.0, 310.0, 230.0, -0.2]),
        ("OPENCV_FISHEYE", [180.0, 181.0, 322.0, 239.0, 0.1, 0.0, 0.0, 0.0]),
    ],
)
def test_corners_are_where_the_camera_sees_them(
    result: Result, model: str, params: list[float]
) -> None:
    """The first pixel top left, x to the right, y down, before the camera."""
    camera = CameraModel(model=model, width=WIDTH, height=HEIGHT, params=np.array(params))
    focal = np.array([params[0], params[0] if model == "SIMPLE_RADIAL" else params[1]])
    centre = np.array(params[1:3] if model == "SIMPLE_RADIAL" else params[2:4])
    one = placed(
        replace(
            result, camera=camera, intrinsics_std=np.zeros(len(params)), intrinsics_correlation=None
        )
    )[3]
    seen = (one.corners(0.1) - one.pose[:3, 3]) @ one.pose[:3, :3]
    assert (seen[:, 2] > 0.0).all()
    np.testing.assert_allclose(seen[:, :2] / seen[:, 2:] * focal + centre, IMAGE_CORNERS, atol=1e-9)
    assert np.ptp(seen, axis=0)[:2].max() < 0.2


def test_an_unknown_lens_has_corners_too(result: Result) -> None:
    unknown = replace(result.camera, model="THIN_PRISM")
    for changes in ({"camera": unknown}, {"camera": None, "intrinsics_std": None}):
        one = placed(replace(result, **changes))[0]
        seen = (one.corners(0.1) - one.pose[:3, 3]) @ one.pose[:3, :3]
        assert (np.sign(seen) == [[-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]]).all()


def test_the_gripper_is_found_through_the_own_camera(two_cameras: Result) -> None:
    """Two cameras that took an image at the same robot pose have the gripper at one place."""
    grippers = {one.image.name: one.gripper for one in placed(two_cameras)}
    assert len(grippers) == 34
    for name, gripper in grippers.items():
        if name.startswith("left/"):
            np.testing.assert_allclose(gripper, grippers[f"right/{name[5:]}"], atol=1e-12)


def test_the_pose_is_that_in_the_moving_frame(result: Result) -> None:
    """Where the camera stands still, images differ by where it was in the gripper."""
    moved = frames.exp(np.full(6, 0.1))
    images = tuple(
        replace(image, gripper_T_camera=None if image.base_T_camera is None else moved)
        for image in result.images
    )
    shown = placed(replace(result, setup="eye-to-hand", images=images))
    assert len(shown) == 17
    assert all((one.pose == moved).all() for one in shown)
