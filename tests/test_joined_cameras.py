"""Cameras on one arm whose images share nothing: joined through the robot, from matches to X of each."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy import stats

import handeye_fg as hf
from handeye_fg import frames, sfm
from handeye_fg.frames import Array
from handeye_fg.inputs import Inputs
from handeye_fg.parts import only
from handeye_fg.pipeline import solve_scene
from handeye_fg.progress import Stopwatch, silent
from handeye_fg.scene import Scene, find_scene
from handeye_fg.scene.joining import joined
from handeye_fg.simulate import RigScene, simulate_rig
from handeye_fg.types import CameraModel

N_POSES = 9
# The second camera sees finer, so that each must be taken with its own intrinsics.
LENS = CameraModel(
    model="OPENCV",
    width=1280,
    height=960,
    params=np.array([1400.0, 1390.0, 630.0, 482.0, 0.05, -0.02, -3e-4, 4e-4]),
)


@pytest.fixture(scope="module")
def rig() -> RigScene:
    """The second camera took no image at two of the poses."""
    return simulate_rig(
        np.random.default_rng(3),
        n_poses=N_POSES,
        n_points=160,
        start_sigma=0.0,
        missing=frozenset({(1, 2), (1, 5)}),
    )


def through(lens: CameraModel, rig: RigScene) -> Array:
    """The observations, those of the second camera as its lens shows them."""
    tracks = rig.scene.model.tracks
    first = pycolmap.Camera(model="OPENCV", width=1280, height=960, params=rig.scene.camera.params)
    second = pycolmap.Camera(model="OPENCV", width=1280, height=960, params=lens.params)
    mine = rig.rig.camera[tracks.image_index] == 1
    rays = np.insert(first.cam_from_img(tracks.pixels[mine]), 2, 1.0, axis=1)
    pixels = np.array(tracks.pixels)
    pixels[mine] = second.img_from_cam(rays)
    return pixels


Given = Callable[[RigScene, np.ndarray], Inputs]


@pytest.fixture
def inputs_of(from_matches: Callable[..., Inputs]) -> Given:
    """Matches of a rig's images; a number for each, those with different ones share no point."""

    def given(rig: RigScene, apart: np.ndarray) -> Inputs:
        tracks = rig.scene.model.tracks
        return from_matches(
            rig.robot_poses,
            rig.scene.model.names,
            tracks.image_index,
            tracks.point_index + apart[tracks.image_index] * len(tracks.points_world),
            through(LENS, rig),
            {"cam0": rig.scene.camera, "cam1": LENS},
        )

    return given


def off(found: Array, true: Array) -> tuple[float, float]:
    """Largest angle (degrees) and distance of poses, relative to the first of them, in its unit."""
    found, true = frames.inverse(found[0]) @ found, frames.inverse(true[0]) @ true
    unit = np.linalg.norm(true[1, :3, 3]) / np.linalg.norm(found[1, :3, 3])
    error = frames.log(frames.inverse(true) @ frames.scaled(found, unit))
    return (
        float(np.rad2deg(np.linalg.norm(error[:, :3], axis=1)).max()),
        float(np.linalg.norm(error[:, 3:], axis=1).max()),
    )


def test_cameras_that_share_nothing(rig: RigScene, tmp_path: Path, inputs_of: Given) -> None:
    """The second camera's images come in two parts, none of them with anything of the first camera."""
    camera, late = rig.rig.camera, np.arange(len(rig.rig.pose)) >= len(rig.rig.pose) - 3
    inputs = inputs_of(rig, camera + late)
    options = hf.Options()
    scene, inputs = find_scene(inputs, tmp_path / "out" / "sfm", options, silent)
    model = scene.model
    assert model.names == rig.scene.model.names
    assert model.unregistered == ()
    assert model.by_robot == int(np.sum(camera == 1))
    assert [one.params[0] for one in model.cameras] == [1100.0, 1400.0]
    degrees, metres = off(model.world_T_camera, rig.scene.world_T_camera)
    assert degrees < 0.3
    assert metres * rig.scene.metres_per_world_unit < 3e-3
    # The parts are kept: a second run joins them as the first did.
    again, _ = find_scene(inputs, tmp_path / "out" / "sfm", options, silent)
    np.testing.assert_array_equal(again.model.world_T_camera, model.world_T_camera)
    result = solve_scene(scene, inputs, options, Stopwatch(), silent)
    assert result.status == "ok"
    assert "were placed with the" in result.message
    for k, one in enumerate(result.cameras):
        error = frames.log(frames.inverse(one.matrix) @ rig.gripper_T_cameras[k])
        assert error @ np.linalg.solve(one.covariance, error) < 6 * stats.f.isf(1e-3, 6, 15)
        assert np.rad2deg(np.linalg.norm(error[:3])) < 0.05
        assert np.linalg.norm(error[3:]) < 1e-3


def test_a_camera_whose_images_do_not_move_as_the_robot_stays_out(
    rig: RigScene, tmp_path: Path, inputs_of: Given
) -> None:
    inputs = inputs_of(rig, rig.rig.camera)
    second = rig.rig.camera == 1
    poses = np.array(rig.scene.robot_poses.base_T_gripper)
    noise = np.random.default_rng(0).normal(0.0, 0.3, (int(second.sum()), 6))
    poses[second] = poses[second] @ frames.exp(noise)
    wrong = replace(rig.scene.robot_poses, base_T_gripper=poses)
    scene, _ = find_scene(
        replace(inputs, poses=wrong), tmp_path / "out" / "sfm", hf.Options(), silent
    )
    assert {name.partition("/")[0] for name in scene.model.names} == {"cam0"}
    assert len(scene.model.cameras) == 1
    assert len(scene.model.unregistered) == int(second.sum())


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Array]]:
    """Where images are asked for, each time; none is placed."""
    calls: list[dict[str, Array]] = []

    def complete(_folder, model, expected, _cameras):
        calls.append(dict(expected))
        return model

    monkeypatch.setattr(sfm, "complete", complete)
    return calls


def given(rig: RigScene, folder: Path) -> Inputs:
    return Inputs(
        images=folder,
        names=rig.scene.model.names,
        left_out=(),
        poses=rig.robot_poses,
        cameras=None,
        masks=None,
        digest="",
    )


def wrongly(asked: dict[str, Array], rig: RigScene) -> tuple[Array, Array]:
    """How far images are asked for from where they are: degrees, metres."""
    rows = [rig.scene.model.names.index(name) for name in asked]
    true = rig.scene.world_T_camera[rows]
    error = frames.log(frames.inverse(true) @ np.array(list(asked.values())))
    lengths = np.linalg.norm(error[:, 3:], axis=1) * rig.scene.metres_per_world_unit
    return np.rad2deg(np.linalg.norm(error[:, :3], axis=1)), lengths


ELSEWHERE = frames.exp(np.array([0.3, -0.2, 2.5, 1.0, 2.0, 0.0]))


def test_false_matches_do_not_link_a_camera_elsewhere(
    rig: RigScene, tmp_path: Path, asked: list[dict[str, Array]]
) -> None:
    """Look-alikes put all of the second camera's images at another side of the scene, in one model."""
    model, second = rig.scene.model, rig.rig.camera == 1
    inputs = given(rig, tmp_path)
    assert joined(model, inputs, tmp_path) is model
    assert asked == []
    wrong = np.array(model.world_T_camera)
    wrong[second] = ELSEWHERE @ wrong[second]
    found = joined(replace(model, world_T_camera=wrong), inputs, tmp_path)
    assert {why for _, why in found.unregistered} == {
        "its matches put it elsewhere than the robot does"
    }
    [places] = asked
    assert list(places) == [
        name for name, is_second in zip(model.names, second, strict=True) if is_second
    ]
    degrees, metres = wrongly(places, rig)
    assert degrees.max() < 0.3
    assert metres.max() < 5e-3


def test_a_camera_that_false_matches_bend_is_told_to_be_elsewhere(
    tmp_path: Path, asked: list[dict[str, Array]]
) -> None:
    """They hold some images more than others: the last is off by degrees, one by tens of them."""
    n = 14
    rig = simulate_rig(np.random.default_rng(7), n_poses=n, n_points=160, start_sigma=0.0)
    model, second = rig.scene.model, np.flatnonzero(rig.rig.camera == 1)
    wrong = np.array(model.world_T_camera)
    extent = np.sqrt(np.sum(np.var(wrong[second, :3, 3], axis=0)))
    off = np.random.default_rng(1).normal(size=(n, 6)) * np.linspace(0.05, 1.0, n)[:, None] ** 2
    off *= np.repeat([np.deg2rad(1.2), 0.02 * extent], 3)
    off[3] = 0.6
    wrong[second] = ELSEWHERE @ wrong[second] @ frames.exp(off)
    found = joined(replace(model, world_T_camera=wrong), given(rig, tmp_path), tmp_path)
    assert {name.partition("/")[0] for name in found.names} == {"cam0"}
    [places] = asked
    degrees, metres = wrongly(places, rig)
    held_little = np.delete(np.arange(9), 3)
    assert degrees[held_little].max() < 1.0
    assert metres[held_little].max() < 0.03
    assert degrees[3] > 20.0


def test_what_is_bent_is_asked_for_again_where_the_robot_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three images of the second camera come in wrong or not at all at first, and two of them stay out then."""
    rig = simulate_rig(np.random.default_rng(7), n_poses=12, n_points=160, start_sigma=0.0)
    names = [name for name in rig.scene.model.names if name.startswith("cam1/")]
    bent, again, out = names[0], names[3], names[5]
    asked: list[dict[str, Array]] = []

    def complete(_folder, model, expected, _cameras):
        asked.append(dict(expected))
        here = [name for name in rig.scene.model.names if name not in {again, out}]
        if len(asked) == 2:
            here = [name for name in rig.scene.model.names if name not in {bent, out}]
        full = only(rig.scene.model, here)
        poses, tracks = np.array(full.world_T_camera), full.tracks
        if len(asked) == 1:
            row = here.index(bent)
            poses[row] = poses[row] @ frames.exp(np.full(6, 0.05))
            few = (tracks.image_index != row) | (np.cumsum(tracks.image_index == row) < 12)
            tracks = replace(
                tracks,
                image_index=tracks.image_index[few],
                point_index=tracks.point_index[few],
                pixels=tracks.pixels[few],
            )
        missing = tuple((name, "why") for name in rig.scene.model.names if name not in here)
        return replace(full, world_T_camera=poses, tracks=tracks, unregistered=missing)

    monkeypatch.setattr(sfm, "complete", complete)
    wrong = np.array(rig.scene.model.world_T_camera)
    second = rig.rig.camera == 1
    wrong[second] = ELSEWHERE @ wrong[second]
    start = replace(rig.scene.model, world_T_camera=wrong)
    found = joined(start, given(rig, tmp_path), tmp_path)
    assert [sorted(places) for places in asked] == [names, sorted({bent, again, out})]
    degrees, metres = wrongly(asked[1], rig)
    assert degrees.max() < 0.3
    assert metres.max() < 5e-3
    assert dict(found.unregistered) == {bent: "why", out: "why"}
    assert found.by_robot == len(names) - 2


def test_cameras_that_nothing_brings_together_are_refused(rig: RigScene, tmp_path: Path) -> None:
    model, second = rig.scene.model, rig.rig.camera == 1
    wrong = np.array(model.world_T_camera)
    wrong[second] = ELSEWHERE @ wrong[second]
    scene = Scene(model=replace(model, world_T_camera=wrong))
    message = r"camera cam1: the images put it \d+ deg and \d+ mm from where .* one by one"
    with pytest.raises(hf.HandEyeError, match=message):
        solve_scene(scene, given(rig, tmp_path), hf.Options(), Stopwatch(), silent)
