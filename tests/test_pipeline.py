"""The main flow on a simulated reconstruction; images are there but are not looked at."""

import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import handeye_fg as hf
from example_cameras import SMALL
from handeye_fg import frames, sfm
from handeye_fg.simulate import disturbed, simulate_scene
from handeye_fg.types import CameraModel


@pytest.fixture(scope="module")
def scene():
    return simulate_scene(
        np.random.default_rng(0), n_images=8, n_points=80, camera=SMALL, pixel_sigma=0.01
    )


@pytest.fixture
def images(tmp_path, scene):
    folder = tmp_path / "images"
    folder.mkdir()
    for name in scene.model.names:
        Image.new("L", (64, 48), 128).save(folder / name)
    return folder


@pytest.fixture
def reconstruction(monkeypatch, scene):
    calls = []

    def reconstruct(images, names, cameras, **arguments):
        calls.append({"images": images, "names": names, "cameras": cameras, **arguments})
        return scene.model

    monkeypatch.setattr(sfm, "reconstruct", reconstruct)
    return calls


def poses_of(scene):
    return dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))


def error_of(matrix, truth):
    error = frames.log(frames.inverse(matrix) @ truth)
    return np.rad2deg(np.linalg.norm(error[:3])), 1e3 * np.linalg.norm(error[3:])


def test_calibrate(images, scene, reconstruction, tmp_path):
    seen = []
    result = hf.calibrate(
        images,
        poses_of(scene),
        camera=scene.camera,
        output=tmp_path / "out",
        progress=lambda *step: seen.append(step),
    )
    degrees, millimetres = error_of(result.matrix, scene.gripper_T_camera)
    assert degrees < 0.05
    assert millimetres < 0.5
    assert result.status == "ok"
    assert [image.name for image in result.images] == list(scene.model.names)
    assert all(image.registered and not image.outlier for image in result.images)
    assert ("images", 8, 8) in seen
    assert any(stage == "iterations" for stage, _, _ in seen)
    assert set(result.timing_s) == {"input", "sfm", "linear start", "refinement", "total"}
    assert result.provenance["seed"] == 0
    assert reconstruction[0]["folder"] == tmp_path / "out" / "sfm"
    assert hf.load_result(result.save(tmp_path / "out")).matrix.tolist() == result.matrix.tolist()


def test_names_without_a_partner_are_listed(images, scene, reconstruction):
    poses = {**poses_of(scene), "ghost.jpg": np.eye(4)}
    Image.new("L", (64, 48)).save(images / "extra.png")
    result = hf.calibrate(images, poses, camera=scene.camera)
    reasons = {image.name: image.reason for image in result.images if not image.registered}
    assert reasons == {
        "extra.png": "no pose has this name",
        "ghost.jpg": "no image has this name",
    }
    assert "2 names" in result.message
    assert "extra.png" not in reconstruction[0]["names"]


def test_eye_to_hand_inverts_the_robot_poses(images, scene, reconstruction):
    inverted = {name: np.linalg.inv(matrix) for name, matrix in poses_of(scene).items()}
    result = hf.calibrate(
        images, inverted, camera=scene.camera, options=hf.Options(setup="eye-to-hand")
    )
    degrees, millimetres = error_of(result.matrix, scene.gripper_T_camera)
    assert degrees < 0.05
    assert millimetres < 0.5
    assert result.setup == "eye-to-hand"
    assert all(np.array_equal(image.base_T_camera, result.matrix) for image in result.images)


def test_without_a_camera_the_intrinsics_are_refined(images, scene, reconstruction):
    result = hf.calibrate(images, poses_of(scene))
    assert result.intrinsics_refined
    assert (result.intrinsics_std > 0).all()
    assert reconstruction[0]["cameras"] is None


def test_the_limit_of_iterations_is_told(images, scene, monkeypatch):
    rng = np.random.default_rng(0)
    far = disturbed(rng, scene.model.world_T_camera, 0.15, 0.0)
    model = replace(scene.model, world_T_camera=far)
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: model)
    options = hf.Options(graph=hf.GraphOptions(max_iterations=1))
    result = hf.calibrate(images, poses_of(scene), camera=scene.camera, options=options)
    assert "before it converged" in result.message


def test_a_wrong_pose_is_named(images, scene, reconstruction):
    poses = {name: np.array(matrix) for name, matrix in poses_of(scene).items()}
    bad = scene.model.names[3]
    poses[bad][:3, 3] += 0.02
    result = hf.calibrate(images, poses, camera=scene.camera)
    assert [image.name for image in result.images if image.outlier] == [bad]
    assert re.search(rf"{bad} \(3[45][.\d]* mm, 0[.\d]* deg, w \d\d+", result.message)
    for image in result.images:
        if image.name == bad:
            assert image.w_test > 20.0
            assert image.residual_translation == pytest.approx(0.035, rel=0.1)
            assert image.influence_translation is None
        else:
            assert image.w_test < 6.0
            assert 0.0 < image.influence_translation < 1e-3


def test_poses_of_other_images_are_refused(images, scene, reconstruction):
    names = scene.robot_poses.names
    shifted = dict(zip(names, np.roll(scene.robot_poses.base_T_gripper, 3, axis=0), strict=True))
    with pytest.raises(hf.HandEyeError, match=r"contradict|convention"):
        hf.calibrate(images, shifted, camera=scene.camera)


def test_an_arm_worse_than_any_is_refused(images, scene, reconstruction):
    rng = np.random.default_rng(3)
    off = disturbed(rng, scene.robot_poses.base_T_gripper, np.deg2rad(5.0), 0.05)
    poses = dict(zip(scene.robot_poses.names, off, strict=True))
    with pytest.raises(hf.ConvergenceError, match="contradict each other"):
        hf.calibrate(images, poses, camera=scene.camera)


def test_too_few_images(images, scene):
    poses = dict(list(poses_of(scene).items())[:2])
    with pytest.raises(hf.InputDataError, match="only 2 images"):
        hf.calibrate(images, poses, camera=scene.camera)


def test_camera_of_another_size(images, scene):
    camera = CameraModel(model="PINHOLE", width=640, height=480, params=np.full(4, 500.0))
    with pytest.raises(hf.InputDataError, match=r"640x480 pixels.*64x48"):
        hf.calibrate(images, poses_of(scene), camera=camera)


def test_a_mask_is_missing(images, scene, tmp_path):
    with pytest.raises(hf.InputDataError, match="no such file"):
        hf.calibrate(images, poses_of(scene), camera=scene.camera, masks=tmp_path)


def test_masks_are_passed_on(images, scene, reconstruction, tmp_path):
    for name in scene.model.names:
        Image.new("L", (64, 48), 255).save(tmp_path / f"{name}.png")
    hf.calibrate(images, poses_of(scene), camera=scene.camera, masks=tmp_path)
    assert reconstruction[0]["masks"] == tmp_path


def test_refine_an_existing_model(scene, monkeypatch):
    monkeypatch.setattr(sfm, "read_model", lambda _model: scene.model)
    poses = poses_of(scene)
    del poses[scene.model.names[2]]
    result = hf.refine("model", {**poses, "ghost.jpg": np.eye(4)})
    degrees, millimetres = error_of(result.matrix, scene.gripper_T_camera)
    assert degrees < 0.05
    assert millimetres < 0.5
    reasons = {image.name: image.reason for image in result.images if not image.registered}
    assert reasons == {
        scene.model.names[2]: "no pose has this name",
        "ghost.jpg": "the model has no such image",
    }
    few = dict(list(poses.items())[:2])
    with pytest.raises(hf.InputDataError, match="only 2 images of the model"):
        hf.refine("model", few)


def test_unknown_names_of_the_package():
    with pytest.raises(AttributeError, match="no attribute 'solve_everything'"):
        hf.solve_everything  # noqa: B018  # the access itself raises


def test_static_features_are_told(images, scene, monkeypatch):
    model = replace(scene.model, static_share=0.37)
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: model)
    message = hf.calibrate(images, poses_of(scene), scene.camera).message
    assert "37 % of the features stayed at their pixel while the robot turned (text" in message
    model = replace(scene.model, static_share=0.004)
    assert "stayed" not in hf.calibrate(images, poses_of(scene), scene.camera).message


def test_the_other_setup_is_named(images, scene, reconstruction):
    with pytest.raises(
        hf.InputDataError, match="your poses look like those of setup eye-in-hand, or inverted"
    ):
        hf.calibrate(images, poses_of(scene), scene.camera, options=hf.Options(setup="eye-to-hand"))
    turns = reconstruction[0]["turns"]
    assert turns.setup == "eye-to-hand"
    inverses = np.swapaxes(scene.robot_poses.base_T_gripper[:, :3, :3], 1, 2)
    np.testing.assert_allclose(turns.rotations, inverses, atol=1e-12)


def test_images_left_out_are_asked_for_where_the_robot_says_they_were(images, scene, monkeypatch):
    tracks, n = scene.model.tracks, 6
    kept = tracks.image_index < n
    part = replace(
        scene.model,
        names=scene.model.names[:n],
        world_T_camera=scene.model.world_T_camera[:n],
        image_camera=scene.model.image_camera[:n],
        tracks=replace(
            tracks,
            image_index=tracks.image_index[kept],
            point_index=tracks.point_index[kept],
            pixels=tracks.pixels[kept],
        ),
        unregistered=tuple((name, "why") for name in scene.model.names[n:]),
    )
    asked = {}

    def complete(_folder, model, expected, _cameras):
        assert model is part
        asked.update(expected)
        return scene.model

    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: part)
    monkeypatch.setattr(sfm, "complete", complete)
    result = hf.calibrate(images, poses_of(scene), scene.camera)
    assert all(image.registered for image in result.images)
    assert list(asked) == list(scene.model.names[n:])
    for name, pose in zip(asked, scene.world_T_camera[n:], strict=True):
        off = frames.log(frames.inverse(pose) @ asked[name])
        distance = np.linalg.norm(pose[:3, 3] - scene.points_world.mean(axis=0))
        assert np.rad2deg(np.linalg.norm(off[:3])) < 0.3
        assert np.linalg.norm(off[3:]) < 0.01 * distance
