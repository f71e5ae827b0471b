from dataclasses import replace

import cv2
import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.patterns import Charuco, Detections, Grid, Target, corners_target
from handeye_fg.targets import board_poses, place_on_board
from handeye_fg.targets.numbering import agreeing
from handeye_fg.types import CameraModel


def detections(pixels, numbers=None):
    """The given pixels (n, k, 2) as those of n images."""
    n, k, _ = pixels.shape
    numbers = np.arange(k) if numbers is None else numbers
    return Detections(
        names=tuple(f"{i}.png" for i in range(n)),
        image_index=np.repeat(np.arange(n), k),
        corner=np.tile(numbers, n) if np.ndim(numbers) == 1 else np.concatenate(numbers),
        pixels=pixels.reshape(-1, 2),
    )


def robot(target_T_camera, rng, noise=0.0):
    """Poses of an arm whose camera is at the given poses."""
    base_T_target, camera_T_gripper = frames.exp(rng.normal(size=6)), frames.exp(rng.normal(size=6))
    poses = base_T_target @ target_T_camera @ camera_T_gripper
    return poses @ frames.exp(noise * rng.standard_normal((len(poses), 6)))


def apart(poses, others):
    """Largest rotation (rad) and translation (m) between poses (n, 4, 4)."""
    difference = frames.log(frames.inverse(poses) @ others)
    return np.linalg.norm(difference[:, :3], axis=1).max(), np.linalg.norm(
        difference[:, 3:], axis=1
    ).max()


def test_golden_poses(tmp_path, pattern, camera, render, around):
    """0.05 px over a board of 200 px: 0.05 deg and 0.2 mm at 0.4 m; half a pixel would be 0.3 mm."""
    rng = np.random.default_rng(11)
    truth = around(pattern, 5, rng)
    names = [f"{i}.png" for i in range(5)]
    for name, pose in zip(names, truth, strict=True):
        cv2.imwrite(str(tmp_path / name), render(pattern, camera, pose))
    found = board_poses(tmp_path, names, camera, Target(pattern=pattern), robot(truth, rng))
    assert found.names == tuple(names)
    assert found.left_out == ()
    assert found.rms_px.max() < 0.3
    # A pattern that looks the same from several sides may be turned as a whole.
    turn = truth[0] @ frames.inverse(found.target_T_camera[0])
    turned = turn if frames.rotation_angle(turn[:3, :3]) > 0.1 else np.eye(4)
    angle, length = apart(turned @ found.target_T_camera, truth)
    assert np.rad2deg(angle) < 0.2
    assert length < 1e-3


@pytest.mark.parametrize(("columns", "rows"), [(7, 5), (6, 6)])
def test_a_symmetric_grid_is_numbered_by_the_motion(columns, rows, camera, around, true_pixels):
    """Each image numbers the corners from another side; the robot tells from which."""
    rng = np.random.default_rng(12)
    pattern = Grid(kind="circles", columns=columns, rows=rows, spacing_m=0.025)
    truth = around(pattern, 10, rng)
    grid = np.arange(columns * rows).reshape(rows, columns)
    turns = [np.rot90(grid, quarter) for quarter in range(0, 4, 1 if columns == rows else 2)]
    numbers = [turns[rng.integers(len(turns))].ravel() for _ in truth]
    pixels = np.array([true_pixels(pattern, camera, pose) for pose in truth])
    pixels += 0.1 * rng.standard_normal(pixels.shape)
    given = detections(pixels, numbers)
    found = place_on_board(given, camera, Target(pattern=pattern), robot(truth, rng, 1e-3))
    assert found.names == given.names
    whole = truth[0] @ frames.inverse(found.target_T_camera[0])
    angle, _ = apart(whole @ found.target_T_camera, truth)
    assert np.rad2deg(angle) < 1.0
    assert len({tuple(found.detections.of(i)[0]) for i in range(10)}) == 1


def test_a_symmetric_grid_needs_the_robot(camera, around, true_pixels, patterns):
    pattern = patterns["circles"]
    pixels = np.array(
        [
            true_pixels(pattern, camera, pose)
            for pose in around(pattern, 3, np.random.default_rng(13))
        ]
    )
    with pytest.raises(InputDataError, match="looks the same when it is turned"):
        place_on_board(detections(pixels), camera, Target(pattern=pattern), None)


def test_images_that_the_motion_does_not_decide_are_left_out():
    """Two images half a turn apart are as likely as two that are not, for a robot that did a quarter."""
    quarter = frames.exp(np.array([0, 0, np.pi / 2, 0, 0, 0]))
    half = frames.exp(np.array([0, 0, np.pi, 0, 0, 0]))
    candidates = [np.array([np.eye(4), half]), np.array([quarter, half @ quarter])]
    chosen, decided = agreeing(np.array([np.eye(4), quarter]), candidates)
    assert not decided.any()
    assert chosen.shape == (2,)

    pattern = Grid(kind="circles", columns=7, rows=5, spacing_m=0.025)
    camera = CameraModel(
        model="PINHOLE", width=640, height=480, params=np.array([700.0, 700.0, 320.0, 240.0])
    )
    corners = corners_target(pattern)
    middle = corners.mean(axis=0)
    above = frames.pose(np.eye(3), middle - [0, 0, 0.4])
    poses = np.array([above, above @ quarter])
    pixels = []
    for pose in poses:
        local = (corners - pose[:3, 3]) @ pose[:3, :3]
        pixels.append(local[:, :2] / local[:, 2:] * 700.0 + [320.0, 240.0])
    found = place_on_board(detections(np.array(pixels)), camera, Target(pattern=pattern), poses)
    assert found.names == ()
    assert [reason for _, reason in found.left_out] == [found.left_out[0][1]] * 2
    assert "does not tell" in found.left_out[0][1]
    assert found.target_T_camera.shape == (0, 4, 4)


def test_strays_do_not_move_the_pose(camera, around, true_pixels, patterns):
    pattern = patterns["charuco"]
    rng = np.random.default_rng(14)
    truth = around(pattern, 3, rng)
    pixels = np.array([true_pixels(pattern, camera, pose) for pose in truth])
    pixels += 0.03 * rng.standard_normal(pixels.shape)
    pixels[:, 5] += 6.0
    found = place_on_board(detections(pixels), camera, Target(pattern=pattern), None)
    angle, length = apart(found.target_T_camera, truth)
    assert np.rad2deg(angle) < 0.1
    assert length < 1e-3
    assert found.rms_px.max() < 0.1


def test_a_target_of_another_size_is_refused(camera, around, true_pixels, patterns):
    pattern = patterns["charuco"]
    pixels = np.array(
        [
            true_pixels(pattern, camera, pose)
            for pose in around(pattern, 3, np.random.default_rng(15))
        ]
    )
    other = Charuco(**{**_fields(pattern), "squares_x": 5, "squares_y": 7})
    with pytest.raises(ReconstructionError, match="not that of the target file") as caught:
        place_on_board(detections(pixels), camera, Target(pattern=other), None)
    assert "check the counts" in str(caught.value)


def _fields(pattern):
    return {name: getattr(pattern, name) for name in pattern.__slots__}


def test_images_whose_corners_lie_on_a_line_or_fit_nothing(camera, around, true_pixels, patterns):
    pattern = patterns["charuco"]
    truth = around(pattern, 4, np.random.default_rng(16))
    pixels = np.array([true_pixels(pattern, camera, pose) for pose in truth])
    pixels[1] = np.random.default_rng(0).uniform(100, 400, pixels[1].shape)
    whole = detections(pixels)
    kept = ~((whole.image_index == 2) & (whole.corner >= 6))  # image 2 keeps the first row
    found = place_on_board(
        replace(
            whole,
            image_index=whole.image_index[kept],
            corner=whole.corner[kept],
            pixels=whole.pixels[kept],
        ),
        camera,
        Target(pattern=pattern),
        None,
    )
    assert found.names == ("0.png", "3.png")
    assert [name for name, _ in found.left_out] == ["1.png", "2.png"]
    angle, _ = apart(found.target_T_camera, truth[[0, 3]])
    assert angle < 1e-6


def test_a_distortion_that_folds_over_is_replaced_by_the_nearest(
    camera, around, true_pixels, patterns
):
    pattern = patterns["charuco"]
    truth = around(pattern, 2, np.random.default_rng(17))
    pixels = np.array([true_pixels(pattern, camera, pose) for pose in truth])
    folding = CameraModel(
        model="FULL_OPENCV",
        width=640,
        height=480,
        params=np.array([*camera.params, -20.0, 0, 0, 0]),
    )
    found = place_on_board(detections(pixels), folding, Target(pattern=pattern), None)
    angle, _ = apart(found.target_T_camera, truth)
    assert np.rad2deg(angle) < 3.0
