"""Images that are damaged, repeated, blurred, dark or of something else."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

import handeye_fg as hf
from example_cameras import SMALL
from handeye_fg import frames, sfm
from handeye_fg.parts import only
from handeye_fg.simulate import simulate_scene


@pytest.fixture
def scene():
    return simulate_scene(
        np.random.default_rng(0), n_images=9, n_points=80, camera=SMALL, pixel_sigma=0.01
    )


@pytest.fixture
def names(scene):
    return scene.model.names


def write(folder, name, change=lambda levels: levels):
    levels = np.random.default_rng(list(name.encode())).integers(0, 256, (48, 64)).astype(np.uint8)
    Image.fromarray(change(levels)).save(folder / name, format="PNG")


@pytest.fixture
def images(tmp_path, names):
    folder = tmp_path / "images"
    folder.mkdir()
    for name in names:
        write(folder, name)
    return folder


@pytest.fixture(autouse=True)
def reconstruction(monkeypatch, scene):
    """All images that are asked for are placed, but those named in what is returned."""
    without = {}

    def reconstruct(_images, asked, *_, **__):
        model = only(scene.model, [name for name in asked if name not in without])
        return replace(model, unregistered=tuple(without.items()))

    monkeypatch.setattr(sfm, "reconstruct", reconstruct)
    monkeypatch.setattr(sfm, "complete", lambda _folder, model, _expected, _cameras: model)
    return without


def calibrate(images, scene, **changed):
    poses = dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))
    return hf.calibrate(images, poses | changed, camera=scene.camera)


def left_out(result):
    """Names and reasons, which the message tells as well."""
    assert result.sfm.n_images == len(result.images)
    assert f"Calibrated from {result.sfm.n_registered} of {len(result.images)}" in result.message
    reasons = {image.name: image.reason for image in result.images if not image.registered}
    for name, reason in reasons.items():
        assert f"{name} ({reason})" in result.message
    return reasons


def test_a_clean_set_is_used_whole(images, scene):
    result = calibrate(images, scene)
    assert left_out(result) == {}
    assert "Not used" not in result.message


def test_a_truncated_image_does_not_end_the_calibration(images, scene, names):
    content = (images / names[2]).read_bytes()
    (images / names[2]).write_bytes(content[: len(content) // 2])
    (name, reason), *others = left_out(calibrate(images, scene)).items()
    assert (name, others) == (names[2], [])
    assert "cannot be decoded (image file is truncated" in reason


def test_an_image_of_another_size_is_named(images, scene, names):
    write(images, names[0], lambda levels: levels.T)
    reasons = left_out(calibrate(images, scene))
    assert reasons == {names[0]: "48 x 64 pixels, but the others have 64 x 48"}


def test_an_image_that_is_repeated_under_another_pose_is_named(images, scene, names):
    (images / names[5]).write_bytes((images / names[1]).read_bytes())
    (name, reason), *others = left_out(calibrate(images, scene)).items()
    assert (name, others) == (names[5], [])
    assert f"shows the same as {names[1]} although the robot had moved by" in reason


def test_an_image_that_is_there_twice_counts_once(images, scene, names):
    (images / "twice.png").write_bytes((images / names[1]).read_bytes())
    pose = scene.robot_poses.base_T_gripper[scene.robot_poses.names.index(names[1])]
    result = calibrate(images, scene, **{"twice.png": pose})
    assert left_out(result) == {"twice.png": f"it is the same image as {names[1]}"}


def test_two_images_of_one_view_are_two_measurements(images, scene, names):
    def noisy(levels):
        noise = np.random.default_rng(1).integers(-1, 2, levels.shape)
        return np.clip(levels + noise, 0, 255).astype(np.uint8)

    first = np.asarray(Image.open(images / names[1]))
    Image.fromarray(noisy(first)).save(images / names[2], format="PNG")
    at = scene.robot_poses.base_T_gripper[list(scene.robot_poses.names).index(names[1])]
    assert names[2] in left_out(calibrate(images, scene))
    # The scene's points contradict this pose; whether the image is read is what counts.
    inputs = hf.inputs.read_inputs(
        images, dict.fromkeys(names, at), scene.camera, None, hf.Options(), lambda *_: None
    )
    assert inputs.unusable == ()


def test_too_few_usable_images_are_refused_with_the_reasons(images, scene, names):
    for name in names[2:]:
        (images / name).write_bytes(b"")
    with pytest.raises(
        hf.InputDataError, match=rf"only 2 usable images .*{names[4]}: cannot be decoded"
    ):
        calibrate(images, scene)


def blurred(levels):
    return cv2.GaussianBlur(levels, (0, 0), 1)


def test_a_blurred_image_with_few_points_is_left_out(images, scene, names, monkeypatch):
    write(images, names[3], blurred)
    # As long as it has its points, it is used.
    assert left_out(calibrate(images, scene)) == {}
    tracks = scene.model.tracks
    seen = np.flatnonzero(tracks.image_index == 3)
    kept = np.setdiff1d(np.arange(len(tracks.image_index)), seen[12:])
    thin = replace(
        scene.model,
        tracks=replace(
            tracks,
            image_index=tracks.image_index[kept],
            point_index=tracks.point_index[kept],
            pixels=tracks.pixels[kept],
        ),
    )
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: thin)
    (name, reason), *others = left_out(calibrate(images, scene)).items()
    assert (name, others) == (names[3], [])
    assert reason.startswith("blurred (fine gradients")
    assert reason.endswith("; only 12 points hold it")
    # A sharp one with few points is used, where the robot was there.
    write(images, names[3])
    assert left_out(calibrate(images, scene)) == {}
    poses = np.array(thin.world_T_camera)
    poses[3] = poses[3] @ frames.exp(np.array([0.5, 0.3, -0.4, 2.0, 1.0, 0.5]))
    elsewhere = replace(thin, world_T_camera=poses)
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: elsewhere)
    (name, reason), *others = left_out(calibrate(images, scene)).items()
    assert (name, others) == (names[3], [])
    assert reason.startswith("its matches put it elsewhere than the robot does: it shows something")
    # Few points place an image badly; that is no reason.
    poses[3] = thin.world_T_camera[3] @ frames.exp(np.array([0.02, -0.02, 0.03, 0.0, 0.1, 0.0]))
    badly = replace(thin, world_T_camera=poses)
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: badly)
    assert left_out(calibrate(images, scene)) == {}


def test_the_look_of_an_image_without_pose_is_its_reason(images, scene, names, reconstruction):
    write(images, names[3], lambda levels: levels // 20)
    reconstruction |= {names[3]: "no features found", names[4]: "something else"}
    reasons = left_out(calibrate(images, scene))
    assert reasons[names[3]].startswith("dark (mean grey level 6 of 255, usual in this set 12")
    assert reasons[names[3]].endswith("; no features found")
    assert reasons[names[4]] == "something else"


def test_of_many_images_the_message_names_some(images, scene, names, reconstruction):
    reconstruction |= dict.fromkeys(names[:6], "why")
    result = hf.calibrate(
        images,
        dict(zip(names, scene.robot_poses.base_T_gripper, strict=True)),
        camera=scene.camera,
    )
    assert f"{names[4]} (why), 1 more, see the list of images." in result.message
