"""Several cameras on one arm, from folders to the result; the reconstruction is simulated."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest
from PIL import Image
from scipy import stats

import handeye_fg as hf
from handeye_fg import frames, sfm
from handeye_fg.inputs import read_model_inputs
from handeye_fg.io.results import result_schema, to_document
from handeye_fg.patterns import Charuco, Target
from handeye_fg.report.page import render
from handeye_fg.report.terminal import summary_text
from handeye_fg.simulate import simulate_rig
from handeye_fg.types import Tracks

SIZE = (1280, 960)
CAMERA_FILE = """image_width: {width}
image_height: {height}
camera_matrix: {{rows: 3, cols: 3, data: [{fx}, 0, {cx}, 0, {fy}, {cy}, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [{k1}, {k2}, {p1}, {p2}, 0]}}
"""


@pytest.fixture(scope="module")
def scene():
    # The second camera took no image at the third robot pose.
    return simulate_rig(
        np.random.default_rng(0),
        n_poses=8,
        n_points=120,
        start_sigma=1e-4,
        missing=frozenset({(1, 2)}),
    )


def folders_of(scene, folder, size=SIZE):
    for name in scene.scene.model.names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", size, 128).save(folder / name)
    return folder


@pytest.fixture
def images(tmp_path, scene):
    return folders_of(scene, tmp_path / "images")


@pytest.fixture
def reconstruction(monkeypatch, scene):
    calls = []

    def reconstruct(images, names, cameras, **arguments):
        calls.append({"names": names, "cameras": cameras, **arguments})
        return scene.scene.model

    monkeypatch.setattr(sfm, "reconstruct", reconstruct)
    return calls


def poses_of(scene):
    return dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))


def camera_file(path, camera):
    fx, fy, cx, cy, k1, k2, p1, p2 = camera.params.tolist()
    size = {"width": camera.width, "height": camera.height}
    cx, cy = cx - 0.5, cy - 0.5
    values = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "k1": k1, "k2": k2, "p1": p1, "p2": p2}
    path.write_text(CAMERA_FILE.format(**size, **values))
    return path


def nees(matrix, truth, covariance):
    error = frames.log(frames.inverse(matrix) @ truth)
    return error @ np.linalg.solve(covariance, error)


def test_calibrate(images, scene, reconstruction, tmp_path):
    result = hf.calibrate(images, poses_of(scene), camera=scene.scene.camera)
    assert reconstruction[0]["names"] == scene.scene.model.names
    assert list(reconstruction[0]["cameras"]) == ["cam0", "cam1"]
    assert [camera.name for camera in result.cameras] == ["cam0", "cam1"]
    for camera in result.cameras:
        assert camera.pixel == pytest.approx(scene.scene.noise.pixel, rel=0.15)
    first, second = result.cameras
    # The first camera's figures are those of the whole.
    np.testing.assert_array_equal(first.matrix, result.matrix)
    np.testing.assert_array_equal(first.covariance, result.covariance)
    np.testing.assert_array_equal(first.first_T_camera, np.eye(4))
    limit = 6 * stats.f.isf(1e-3, 6, 15)
    for k, camera in enumerate(result.cameras):
        assert nees(camera.matrix, scene.gripper_T_cameras[k], camera.covariance) < limit
    relative = second.first_T_camera
    np.testing.assert_allclose(first.matrix @ relative, second.matrix, atol=1e-12)
    truth = scene.first_T_cameras[1]
    assert nees(relative, truth, second.first_T_camera_covariance) < limit
    names = [image.name for image in result.images]
    assert names == sorted(scene.scene.model.names)
    # One robot pose, one residual.
    by_name = {image.name: image for image in result.images}
    for i in (0, 1, 3):
        pair = [by_name[f"cam{k}/image_000{i}.jpg"] for k in range(2)]
        assert pair[0].residual_translation == pair[1].residual_translation

    document = json.loads(json.dumps(to_document(result)))
    jsonschema.validate(document, result_schema())
    assert document["cameras"][0]["calibration"] == document["calibration"]
    assert document["cameras"][0]["first_T_camera"]["std_rotation_deg"] == [0.0, 0.0, 0.0]
    loaded = hf.load_result(result.save(tmp_path / "out"))
    np.testing.assert_array_equal(
        loaded.cameras[1].first_T_camera_covariance, second.first_T_camera_covariance
    )
    page, text = render(result), summary_text(result)
    assert "Pose of each camera in cam0" in page
    assert f"{second.first_T_camera[0, 3]:.6f}" in page
    assert "cam0_T_cam1" in text
    assert f"{second.first_T_camera[0, 3]:.7f}" in text


def test_one_folder_is_one_camera(images, scene, reconstruction, monkeypatch):
    for path in (images / "cam1").iterdir():
        path.unlink()
    model = scene.scene.model
    kept = np.flatnonzero(model.image_camera == 0)
    tracks = model.tracks
    seen = np.isin(tracks.image_index, kept)
    alone = replace(
        model,
        names=tuple(model.names[i] for i in kept),
        world_T_camera=model.world_T_camera[kept],
        cameras=model.cameras[:1],
        image_camera=model.image_camera[kept],
        tracks=Tracks(
            points_world=tracks.points_world,
            image_index=tracks.image_index[seen],
            point_index=tracks.point_index[seen],
            pixels=tracks.pixels[seen],
        ),
    )
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: alone)
    result = hf.calibrate(images, poses_of(scene), camera=scene.scene.camera)
    assert result.cameras == ()
    assert "cameras" not in to_document(result)
    assert result.images[0].name == "cam0/image_0000.jpg"


def test_a_camera_without_placed_images_is_named(images, scene, reconstruction, monkeypatch):
    """What is left must not be taken for the first camera."""
    whole, tracks = scene.scene.model, scene.scene.model.tracks
    kept = np.flatnonzero(whole.image_camera == 1)
    seen = np.isin(tracks.image_index, kept)
    alone = replace(
        whole,
        names=tuple(whole.names[i] for i in kept),
        world_T_camera=whole.world_T_camera[kept],
        cameras=whole.cameras[1:],
        image_camera=np.zeros(len(kept), dtype=int),
        tracks=replace(
            tracks,
            image_index=tracks.image_index[seen] - kept[0],
            point_index=tracks.point_index[seen],
            pixels=tracks.pixels[seen],
        ),
        unregistered=tuple((name, "no features") for name in whole.names[: kept[0]]),
    )
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: alone)
    result = hf.calibrate(images, poses_of(scene), camera=scene.scene.camera)
    assert "No image of cam0 could be placed" in result.message
    (camera,) = result.cameras
    assert camera.name == "cam1"
    jsonschema.validate(json.loads(json.dumps(to_document(result))), result_schema())
    error = frames.log(frames.inverse(camera.matrix) @ scene.gripper_T_cameras[1])
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.05


def test_an_image_that_few_points_hold_elsewhere_is_left_out(
    images, scene, reconstruction, monkeypatch
):
    model, tracks = scene.scene.model, scene.scene.model.tracks
    last, poses = len(model.names) - 1, np.array(model.world_T_camera)
    seen = np.flatnonzero(tracks.image_index == last)
    kept = np.setdiff1d(np.arange(len(tracks.image_index)), seen[12:])
    thin = replace(
        tracks,
        image_index=tracks.image_index[kept],
        point_index=tracks.point_index[kept],
        pixels=tracks.pixels[kept],
    )

    def left_out(poses):
        found = replace(model, world_T_camera=poses, tracks=thin)
        monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: found)
        result = hf.calibrate(images, poses_of(scene), camera=scene.scene.camera)
        return {
            image.name: image.reason
            for image in result.images
            if not image.registered and "no image has this name" not in image.reason
        }

    assert left_out(poses) == {}  # few points are no reason
    poses[last] = poses[last] @ frames.exp(np.array([0.5, 0.3, -0.4, 2.0, 1.0, 0.5]))
    ((name, reason),) = left_out(poses).items()
    assert name == model.names[last]
    assert reason.startswith("its matches put it elsewhere than the robot does")
    assert reason.endswith("only 12 points hold it")


def test_poses_of_each_image_are_poses_of_their_own(images, scene, reconstruction):
    """Cameras that were triggered at different times."""
    poses = dict(
        zip(scene.scene.robot_poses.names, scene.scene.robot_poses.base_T_gripper, strict=True)
    )
    result = hf.calibrate(images, poses, camera=scene.scene.camera)
    assert len(result.cameras) == 2
    by_name = {image.name: image for image in result.images}
    assert (
        by_name["cam0/image_0000.jpg"].residual_translation
        != by_name["cam1/image_0000.jpg"].residual_translation
    )


def test_static_cameras(images, scene, reconstruction):
    inverted = {name: np.linalg.inv(matrix) for name, matrix in poses_of(scene).items()}
    options = hf.Options(setup="eye-to-hand")
    result = hf.calibrate(images, inverted, camera=scene.scene.camera, options=options)
    for k, camera in enumerate(result.cameras):
        error = frames.log(frames.inverse(camera.matrix) @ scene.gripper_T_cameras[k])
        assert np.rad2deg(np.linalg.norm(error[:3])) < 0.05
        assert np.linalg.norm(error[3:]) < 5e-4
    assert {str(image.base_T_camera) for image in result.images} == {
        str(camera.matrix) for camera in result.cameras
    }


def test_a_camera_file_for_each(images, scene, reconstruction, tmp_path):
    """The wrong file of the second camera is contradicted, the first one's is kept."""
    camera, files = scene.scene.camera, tmp_path / "files"
    files.mkdir()
    camera_file(files / "cam0.yaml", camera)
    wrong = replace(camera, params=camera.params * [1.02, 1.02, 1, 1, 1, 1, 1, 1])
    camera_file(files / "cam1.yaml", wrong)
    result = hf.calibrate(images, poses_of(scene), camera=files)
    first, second = result.cameras
    assert not first.intrinsics_refined
    assert (first.intrinsics_std == 0.0).all()
    assert second.intrinsics_refined
    assert "contradict" in second.intrinsics_note
    error = second.camera.params - camera.params
    assert (np.abs(error) < 4.5 * second.intrinsics_std).all()
    assert not result.intrinsics_refined


def test_without_camera_files_each_is_refined(images, scene, reconstruction):
    result = hf.calibrate(images, poses_of(scene))
    assert reconstruction[0]["cameras"] is None
    for camera in result.cameras:
        assert camera.intrinsics_refined
        assert (
            np.abs(camera.camera.params - scene.scene.camera.params) < 5 * camera.intrinsics_std
        ).all()


def test_what_does_not_fit_together_is_refused(images, scene, tmp_path):
    poses, camera = poses_of(scene), scene.scene.camera
    files = tmp_path / "files"
    files.mkdir()
    camera_file(files / "cam0.yaml", camera)
    with pytest.raises(hf.InputDataError, match=r"cam1\.yaml"):
        hf.calibrate(images, poses, camera=files)
    camera_file(files / "cam1.yaml", replace(camera, width=640))
    with pytest.raises(hf.InputDataError, match=r"640x960 pixels, but those in .*cam1 have"):
        hf.calibrate(images, poses, camera=files)
    with pytest.raises(hf.InputDataError, match=r"only 2 images .* have a pose"):
        hf.calibrate(images, dict(list(poses.items())[:2]), camera=camera)
    with pytest.raises(hf.InputDataError, match="no pose has the name of an image"):
        hf.calibrate(images, {"other.jpg": np.eye(4)}, camera=camera)
    for name in ("image_0001.jpg", "image_0002.jpg"):  # more than a fifth is no slip
        Image.new("L", (640, 480)).save(images / "cam1" / name)
    with pytest.raises(hf.InputDataError, match=r"cam1/image_0001\.jpg: 640 x 480 pixels"):
        hf.calibrate(images, poses, camera=camera)
    Image.new("L", SIZE).save(images / "alone.jpg")
    with pytest.raises(hf.InputDataError, match="1 images lie in it and others in its sub-folder"):
        hf.calibrate(images, poses, camera=camera)


def test_an_existing_model_of_several_cameras(scene):
    """Its cameras' intrinsics are those given; images of one robot pose share it."""
    model = scene.scene.model
    inputs, paired = read_model_inputs(model, scene.robot_poses, hf.Options())
    rig, reported = inputs.arm(paired)
    np.testing.assert_array_equal(rig.camera, scene.rig.camera)
    np.testing.assert_array_equal(rig.pose, scene.rig.pose)
    np.testing.assert_array_equal(reported, scene.robot_poses.base_T_gripper)
    given = inputs.given(paired)
    assert given is not None
    assert [camera.params.tolist() for camera in given] == [
        camera.params.tolist() for camera in model.cameras
    ]


def test_one_camera_takes_one_image_at_a_robot_pose(scene):
    model = replace(
        scene.scene.model,
        cameras=scene.scene.model.cameras[:1],
        image_camera=np.zeros(len(scene.scene.model.names), dtype=int),
    )
    inputs, paired = read_model_inputs(model, scene.robot_poses, hf.Options())
    with pytest.raises(
        hf.InputDataError, match=r"cam0/image_0000\.jpg and cam1/image_0000\.jpg are"
    ):
        inputs.arm(paired)


def test_masks_lie_in_folders_as_well(images, scene, reconstruction, tmp_path):
    masks = tmp_path / "masks"
    for name in scene.scene.model.names:
        (masks / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", SIZE, 255).save(masks / f"{name}.png")
    hf.calibrate(images, poses_of(scene), camera=scene.scene.camera, masks=masks)
    assert reconstruction[0]["masks"] == masks
    (masks / "cam1" / "image_0000.jpg.png").unlink()
    with pytest.raises(hf.InputDataError, match=r"cam1/image_0000\.jpg needs a mask"):
        hf.calibrate(images, poses_of(scene), camera=scene.scene.camera, masks=masks)


def test_a_target_serves_one_camera(images, scene):
    pattern = Charuco(
        squares_x=5, squares_y=4, square_m=0.03, marker_m=0.02, dictionary="DICT_5X5_100"
    )
    with pytest.raises(hf.InputDataError, match="folders cam0, cam1: a target serves one camera"):
        hf.calibrate(images, poses_of(scene), scene.scene.camera, target=Target(pattern=pattern))
