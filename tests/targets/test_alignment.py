from dataclasses import replace

import numpy as np
import pytest

from handeye_fg import frames
from handeye_fg.patterns import Detections, Target, corners_target
from handeye_fg.targets import BoardPoses, on_target
from handeye_fg.types import SfmModel, Tracks

N = 8


@pytest.fixture
def scene(camera, around, patterns, true_pixels):
    """Eight images; the target gives poses to all but the last, the reconstruction to all but the first."""
    rng = np.random.default_rng(21)
    pattern = patterns["charuco"]
    truth = around(pattern, N, rng)
    k = len(corners_target(pattern))
    pixels = np.array([true_pixels(pattern, camera, pose) for pose in truth])
    board = BoardPoses(
        detections=Detections(
            names=tuple(f"{i}.png" for i in range(N - 1)),
            image_index=np.repeat(np.arange(N - 1), k),
            corner=np.tile(np.arange(k), N - 1),
            pixels=pixels[:-1].reshape(-1, 2),
        ),
        target_T_camera=truth[:-1],
        rms_px=np.full(N - 1, 0.1),
        left_out=(("7.png", "no target"),),
    )
    # The reconstruction's world: another frame, and units of 0.2 m.
    world_T_target = frames.exp(rng.normal(size=6))
    points = corners_target(pattern).mean(axis=0) + rng.uniform(-0.1, 0.1, (20, 3))

    def in_world(poses):
        moved = world_T_target @ poses
        moved[..., :3, 3] *= 5.0
        return moved

    homogeneous = np.column_stack([points, np.ones(len(points))])
    model = SfmModel(
        names=tuple(f"{i}.png" for i in range(1, N)),
        world_T_camera=in_world(truth[1:]),
        cameras=(camera,),
        image_camera=np.zeros(N - 1, dtype=int),
        tracks=Tracks(
            points_world=5.0 * (homogeneous @ world_T_target.T)[:, :3],
            image_index=np.repeat(np.arange(N - 1), 20),
            point_index=np.tile(np.arange(20), N - 1),
            pixels=np.ones((20 * (N - 1), 2)),
        ),
        mean_reprojection_px=0.3,
        unregistered=(("0.png", "too few matches"), ("8.png", "no features found")),
    )
    return Target(pattern=pattern, accuracy_m=2e-4), board, model, truth, points


def test_reconstruction_and_target_come_into_one_frame(scene, camera):
    target, board, model, truth, points = scene
    joined, known = on_target(model, board, target, camera)
    assert joined.names == tuple(f"{i}.png" for i in range(N))
    np.testing.assert_allclose(joined.world_T_camera, truth, atol=1e-9)
    k = len(known.points_world)
    np.testing.assert_allclose(joined.tracks.points_world[:k], known.points_world)
    np.testing.assert_allclose(joined.tracks.points_world[k:], points, atol=1e-9)
    assert joined.unregistered == (("8.png", "no features found"),)
    assert len(joined.tracks.pixels) == len(board.detections.pixels) + len(model.tracks.pixels)
    first = joined.tracks.image_index == 0  # placed by the target alone
    assert (joined.tracks.point_index[first] < k).all()
    assert known.sigma == 2e-4
    assert known.log_scale_sigma == pytest.approx(2e-4 / np.hypot(5 * 0.03, 3 * 0.03))


def test_an_image_that_the_reconstruction_placed_wrongly_keeps_the_targets_pose(scene, camera):
    target, board, model, truth, _ = scene
    wrong = np.array(model.world_T_camera)
    wrong[2] = wrong[2] @ frames.exp(np.array([0, 0, 0.5, 0, 0, 0]))
    joined, known = on_target(replace(model, world_T_camera=wrong), board, target, camera)
    np.testing.assert_allclose(joined.world_T_camera, truth, atol=1e-6)
    its = joined.tracks.point_index[joined.tracks.image_index == 3]
    assert (its < len(known.points_world)).all()


def test_without_a_reconstruction_the_target_suffices(scene, camera):
    target, board, _, truth, _ = scene
    alone, known = on_target(None, board, target, camera)
    np.testing.assert_allclose(alone.world_T_camera, truth[:-1])
    assert len(alone.tracks.points_world) == len(known.points_world)
    assert alone.unregistered == (("7.png", "no target"),)
    assert alone.mean_reprojection_px == pytest.approx(0.1)


@pytest.mark.parametrize("how", ["turned", "mirrored", "stretched", "few"])
def test_a_false_reconstruction_is_left_out(scene, camera, how):
    target, board, model, truth, _ = scene
    poses = np.array(model.world_T_camera)
    rng = np.random.default_rng(3)
    if how == "turned":
        poses = poses @ frames.exp(
            np.column_stack([rng.normal(size=(N - 1, 3)), np.zeros((N - 1, 3))])
        )
    elif how == "mirrored":
        poses[:, :3, 3] *= -1.0
    elif how == "stretched":
        poses[:, :3, 3] += rng.normal(size=(N - 1, 3))
    else:
        board = replace(
            board,
            detections=replace(board.detections, names=("0.png", "1.png", "2.png", *"abcd")),
        )
    joined, known = on_target(replace(model, world_T_camera=poses), board, target, camera)
    assert joined.names == board.names
    assert len(joined.tracks.points_world) == len(known.points_world)
    reasons = dict(joined.unregistered)
    assert "disagrees with the target" in reasons["7.png"] or reasons["7.png"] == "no target"
    np.testing.assert_allclose(joined.world_T_camera, truth[:-1])
