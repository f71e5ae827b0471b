"""Models that exist already: COLMAP of both generations, nerfstudio, trajectories; damaged ones too."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from handeye_fg import frames, sfm
from handeye_fg.cli import main
from handeye_fg.frames import Array
from handeye_fg.io.model_poses import read_camera_poses
from handeye_fg.simulate import Scene, default_camera, simulate_scene

OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return simulate_scene(np.random.default_rng(0), n_images=8, n_points=60, pixel_sigma=0.05)


def colmap_model(scene: Scene, *, per_rig: int = 1, points: bool = True) -> pycolmap.Reconstruction:
    """The scene as COLMAP has it; with rigs every second image is of a second camera, of its own folder."""
    model, camera = pycolmap.Reconstruction(), default_camera()
    tracks = scene.model.tracks
    rig = pycolmap.Rig(rig_id=1)
    for k in range(1, per_rig + 1):
        native = pycolmap.Camera(
            camera_id=k, model=camera.model, width=1280, height=960, params=camera.params
        )
        model.add_camera(native)
        if k == 1:
            rig.add_ref_sensor(native.sensor_id)
        else:
            rig.add_sensor(native.sensor_id, pycolmap.Rigid3d())
    model.add_rig(rig)
    place = np.zeros(len(tracks.pixels), dtype=int)
    for i, name in enumerate(scene.model.names):
        seen = np.flatnonzero(tracks.image_index == i)
        place[seen] = np.arange(len(seen))
        image = pycolmap.Image(name, tracks.pixels[seen], 1, i + 1)
        frame = pycolmap.Frame(frame_id=i + 1, rig_id=1)
        frame.add_data_id(image.data_id)
        frame.rig_from_world = pycolmap.Rigid3d(frames.inverse(scene.model.world_T_camera[i])[:3])
        model.add_frame(frame)
        image.frame_id = i + 1
        model.add_image(image)
        model.register_frame(i + 1)
    for p, xyz in enumerate(tracks.points_world if points else []):
        track = pycolmap.Track()
        for k in np.flatnonzero(tracks.point_index == p):
            track.add_element(int(tracks.image_index[k]) + 1, int(place[k]))
        model.add_point3D(xyz, track)
    return model


def poses_of(scene: Scene) -> dict[str, Array]:
    return dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))


def error_of(result: Any, scene: Scene) -> tuple[float, float]:
    error = frames.log(frames.inverse(result.matrix) @ scene.gripper_T_camera)
    return float(np.rad2deg(np.linalg.norm(error[:3]))), float(1e3 * np.linalg.norm(error[3:]))


def write_model(model: pycolmap.Reconstruction, folder: Path, suffix: str, generation: int) -> None:
    folder.mkdir(parents=True)
    (model.write_binary if suffix == "bin" else model.write_text)(folder)
    if generation == 3:  # as before rigs and frames
        for name in ("rigs", "frames"):
            (folder / f"{name}.{suffix}").unlink()


@pytest.mark.parametrize("suffix", ["bin", "txt"])
def test_a_colmap_model_of_either_generation(scene: Scene, tmp_path: Path, suffix: str) -> None:
    model, places = colmap_model(scene), (".", "sparse/0")
    results = []
    for generation, place in zip((3, 4), places, strict=True):
        root = tmp_path / str(generation)
        write_model(model, root / place, suffix, generation)
        results.append(hf.refine(root, poses_of(scene)))
    direct = hf.refine(model, poses_of(scene))
    for result in (*results, direct):
        assert result.sfm is not None
        assert result.sfm.n_registered == 8
        assert error_of(result, scene)[1] < 0.5
        np.testing.assert_allclose(result.matrix, direct.matrix, atol=1e-9)


def test_only_the_given_images_are_used(scene: Scene, tmp_path: Path) -> None:
    model = colmap_model(scene)
    for image in model.images.values():
        image.name = f"rgb/{image.name}"
    images = tmp_path / "images"
    images.mkdir()
    *kept, left = scene.model.names
    for name in (*kept, "extra.png"):
        Image.new("L", (4, 4)).save(images / name)
    result = hf.refine(model, poses_of(scene), images=images)
    registered = [image.name for image in result.images if image.registered]
    assert registered == [f"rgb/{name}" for name in kept]
    reasons = {image.name: image.reason for image in result.images if not image.registered}
    assert reasons["extra.png"] == reasons[left] == "the model has no such image"
    for name in kept:
        (images / name).unlink()
    with pytest.raises(hf.InputDataError, match="no image has the name of one in the model"):
        hf.refine(model, poses_of(scene), images=images)


def transforms(scene: Scene, folder: str = "./images/") -> dict[str, Any]:
    return {
        "camera_model": "OPENCV",
        "frames": [
            {"file_path": f"{folder}{name}", "transform_matrix": (matrix @ OPENGL).tolist()}
            for name, matrix in zip(scene.model.names, scene.world_T_camera, strict=True)
        ],
    }


def test_nerfstudio(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(transforms(scene)))
    expected = hf.solve(
        poses_of(scene),
        dict(zip(scene.model.names, scene.world_T_camera, strict=True)),
        "pose_graph",
    )
    for source in (tmp_path, str(path)):
        result = hf.refine(source, poses_of(scene))
        np.testing.assert_allclose(result.matrix, expected.matrix, atol=1e-9)
        assert result.sfm is None
        assert [image.name for image in result.images] == sorted(scene.model.names)
    bare = transforms(scene, "train/")
    for frame in bare["frames"]:
        frame["file_path"] = frame["file_path"].rsplit(".", 1)[0]
    path.write_text(json.dumps(bare))
    np.testing.assert_allclose(hf.refine(path, poses_of(scene)).matrix, expected.matrix, atol=1e-9)


def tum_lines(poses: Mapping[float, Array]) -> str:
    rows = [
        [time, *matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_quat()]
        for time, matrix in poses.items()
    ]
    return "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(
        " ".join(f"{number:.12f}" for number in row) for row in rows
    )


def test_a_trajectory_of_slam(scene: Scene, tmp_path: Path) -> None:
    """Times in the images' names, or robot poses with times as well."""
    times = [1.6e9 + 0.5 * i for i in range(8)]
    camera = tmp_path / "camera.txt"
    camera.write_text(tum_lines(dict(zip(times, scene.world_T_camera, strict=True))))
    robot = scene.robot_poses.base_T_gripper
    named = {f"{time:.6f}.png": matrix for time, matrix in zip(times, robot, strict=True)}
    timed = tmp_path / "robot.txt"
    timed.write_text(tum_lines(dict(zip(times, robot, strict=True))))
    expected = hf.solve(robot, scene.world_T_camera, "pose_graph")
    for poses in (named, timed):
        result = hf.refine(camera, poses)
        np.testing.assert_allclose(result.matrix, expected.matrix, atol=1e-7)
        assert sum(image.registered for image in result.images) == 8
    unnamed = {f"a{i}.png": matrix for i, matrix in enumerate(robot)}
    with pytest.raises(
        hf.InputDataError, match="its rows have times, but the images' names do not"
    ):
        hf.refine(camera, unnamed)
    counted = hf.Options(poses=hf.PoseFileOptions(pair_by="order"))
    np.testing.assert_allclose(
        hf.refine(camera, unnamed, counted).matrix, expected.matrix, atol=1e-7
    )


def test_camera_poses_as_a_mapping_and_as_a_model_without_points(scene: Scene) -> None:
    cameras = dict(zip(scene.model.names, scene.model.world_T_camera, strict=True))
    expected = hf.solve(poses_of(scene), cameras, "pose_graph")
    result = hf.refine(cameras, poses_of(scene))
    np.testing.assert_allclose(result.matrix, expected.matrix, atol=1e-9)
    bare = hf.refine(colmap_model(scene, points=False), poses_of(scene))
    np.testing.assert_allclose(bare.matrix, expected.matrix, atol=1e-9)
    assert bare.sfm is None


def test_eye_to_hand_and_what_is_known(scene: Scene) -> None:
    inverted = {name: frames.inverse(matrix) for name, matrix in poses_of(scene).items()}
    cameras = dict(zip(scene.model.names, scene.model.world_T_camera, strict=True))
    known = hf.NoiseOptions(robot_rotation_deg=0.01, robot_translation_mm=0.05)
    for model in (cameras, colmap_model(scene)):
        options = hf.Options(setup="eye-to-hand", noise=known)
        result = hf.refine(model, inverted, options)
        assert result.setup == "eye-to-hand"
        assert error_of(result, scene)[1] < 1.0
        assert result.noise is not None
        assert result.noise.robot_translation == pytest.approx(5e-5)
        # The scene stands still in the gripper: there each image has a pose of its own.
        for image in result.images:
            assert image.gripper_T_camera is not None
            there = scene.base_T_gripper[scene.model.names.index(image.name)]
            np.testing.assert_allclose(
                image.gripper_T_camera, there @ scene.gripper_T_camera, atol=0.01
            )


def test_the_command(scene: Scene, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m").mkdir()
    (tmp_path / "m" / "transforms.json").write_text(json.dumps(transforms(scene)))
    rows = ["image,x,y,z,qx,qy,qz,qw"]
    for name, matrix in poses_of(scene).items():
        numbers = [*matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_quat()]
        rows.append(",".join([name, *map(repr, map(float, numbers))]))
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(rows))
    out = tmp_path / "out"
    command = ["calibrate", "-", str(poses), "--model", str(tmp_path / "m"), "--output", str(out)]
    assert main(command) == 0
    assert error_of(hf.load_result(out), scene)[1] < 1.0
    assert {path.name for path in out.iterdir()} == {"result.json", "report.html", "config.toml"}
    capsys.readouterr()
    assert main([*command, "--camera", "c.yaml", "--masks", "m"]) == 2
    assert "--camera and --masks cannot be used with --model" in capsys.readouterr().err
    assert main([*command[:4], str(tmp_path / "nowhere"), "--output", str(out)]) == 2
    assert "nowhere: no such folder" in capsys.readouterr().err
    assert main([*command[:4], str(tmp_path), "--output", str(out)]) == 2
    assert "holds no COLMAP model" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"frames": []}, "frames is .*, but must be a list of one frame"),
        ({"frames": 5}, "frames is 5, but must be a list"),
        ({"frames": [{"file_path": "a"}]}, r"frames\[0\].transform_matrix is missing"),
        ({"frames": [{"file_path": 7, "transform_matrix": []}]}, "file_path is 7, but must be a str"),
        ({"frames": [{"file_path": "a", "transform_matrix": (2 * np.eye(4)).tolist()}]}, "a rotation and"),
        ({"frames": [{"file_path": "a", "transform_matrix": np.diag([1, 1, -1, 1]).tolist()}]}, "a rotation"),
        ({"frames": [{"file_path": "a", "transform_matrix": [[1e300] * 4] * 4}]}, "a rotation and"),
        ({"frames": 2 * [{"file_path": "a", "transform_matrix": np.eye(4).tolist()}]}, "another file in each"),
        (
            {"frames": [{"file_path": f"{k}/a.png", "transform_matrix": np.eye(4).tolist()} for k in "xy"]},
            "two frames are of images with the name 'a.png'",
        ),
    ],
)  # fmt: skip
def test_transforms_that_cannot_serve(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(change))
    with pytest.raises(hf.InputDataError, match=message):
        hf.refine(path, {"a.png": np.eye(4), "b.png": np.eye(4)})


values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=4)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=3), inner)
    ),
    max_leaves=5,
)


@settings(
    max_examples=300, deadline=20_000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_transforms_give_poses_or_a_clean_error(
    tmp_path: Path, scene: Scene, data: st.DataObject
) -> None:
    content = transforms(scene)
    frame = content["frames"][data.draw(st.integers(0, 7))]
    where = data.draw(st.sampled_from([content, frame]))
    where[data.draw(st.sampled_from(sorted(where)))] = data.draw(values)
    text = json.dumps(content)
    i = data.draw(st.one_of(st.just(len(text)), st.integers(0, len(text))))
    path = tmp_path / "transforms.json"
    path.write_bytes(text[:i].encode() + data.draw(st.binary(max_size=3)) + text[i + 1 :].encode())
    poses, message = {}, ""
    try:
        poses = read_camera_poses(path, scene.model.names)
    except hf.InputDataError as error:
        message = str(error)
    if not poses:
        assert "camera poses" in message
        assert "\n" not in message
    for matrix in poses.values():
        assert np.isfinite(matrix).all()
        np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-9)


@pytest.fixture(scope="module")
def intact(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("models")
    for suffix in ("bin", "txt"):
        write_model(colmap_model(scene), root / suffix, suffix, 4)
    return root


# COLMAP itself would read some of these without end.
@settings(
    max_examples=300, deadline=20_000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_any_damage_gives_a_model_or_a_clean_error(
    intact: Path, tmp_path: Path, data: st.DataObject
) -> None:
    suffix = data.draw(st.sampled_from(["bin", "txt"]))
    names = ["cameras", "frames", "images", "points3D", "rigs"]
    folder = tmp_path / "m"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(intact / suffix, folder)
    path = folder / f"{data.draw(st.sampled_from(names))}.{suffix}"
    content = path.read_bytes()
    i = data.draw(st.integers(0, min(len(content), 300)))
    j = data.draw(st.sampled_from([i, i + 1, i + 8, len(content)]))
    inserted = st.one_of(st.binary(max_size=9), st.just(b"\xff" * 8), st.just(b"nan"))
    path.write_bytes(content[:i] + data.draw(inserted) + content[j:])
    model = None
    try:
        model = sfm.read_model(folder)
    except hf.HandEyeError as error:
        message = str(error)
        assert "\n" not in message
    if model is not None:
        assert np.isfinite(model.world_T_camera).all()
        assert np.isfinite(model.tracks.points_world).all()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("frames.bin", b"", "frames.bin is damaged .it ends after 0 bytes"),
        ("points3D.bin", b"\xff" * 60, "points3D.bin is damaged .it ends after 60 bytes"),
        ("rigs.bin", bytes(12), "rigs.bin is damaged .4 bytes follow its last entry"),
        ("images.bin", b"\x01" + bytes(7 + 64) + b"\xff\0" + bytes(8), "a name is not UTF-8 text"),
        ("images.bin", b"\x01" + bytes(7 + 64) + b"abc", "a name has no end"),
    ],
)
def test_the_damage_is_named(
    intact: Path, tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    shutil.copytree(intact / "bin", tmp_path / "m")
    (tmp_path / "m" / name).write_bytes(content)
    with pytest.raises(hf.InputDataError, match=message):
        sfm.read_model(tmp_path / "m")


def test_a_model_that_lacks_points(intact: Path, tmp_path: Path) -> None:
    shutil.copytree(intact / "txt", tmp_path / "m")
    points = tmp_path / "m" / "points3D.txt"
    points.write_text("\n".join(points.read_text().splitlines()[:-3]))
    with pytest.raises(hf.InputDataError, match=r"lacks point .*, which image .* observes"):
        sfm.read_model(tmp_path / "m")


def test_camera_poses_alone_tell_the_convention_too() -> None:
    scene = simulate_scene(np.random.default_rng(2), n_images=10, n_points=60)
    camera = dict(zip(scene.model.names, scene.world_T_camera, strict=True))
    right = dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))
    wrong = {name: np.linalg.inv(pose) for name, pose in right.items()}
    with pytest.raises(hf.InputDataError, match=r"^your poses look inverted"):
        hf.refine(camera, wrong)

    def refined(**poses: Any) -> hf.Result:
        return hf.refine(camera, wrong, hf.Options(poses=hf.PoseFileOptions(**poses)))

    expected = hf.refine(camera, right)
    for options in ({"auto_convention": True}, {"convention": "inverted"}):
        result = refined(**options)
        np.testing.assert_allclose(result.matrix, expected.matrix, atol=1e-9)
        assert result.provenance["convention"] == "inverted"
    with pytest.raises(hf.HandEyeError, match=r"^(?!.*poses look)"):
        refined(convention="as-given")
