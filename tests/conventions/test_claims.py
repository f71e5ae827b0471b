"""``calibrate`` stops at poses of another convention, or converts them if asked; ``check`` says why."""

import json

import numpy as np
import pytest
from PIL import Image

import handeye_fg as hf
from example_cameras import SMALL
from handeye_fg import cli, frames, sfm
from handeye_fg.io.poses import Convention
from handeye_fg.io.poses.convention import from_poses
from handeye_fg.simulate import simulate_scene


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(0)
    return simulate_scene(rng, n_images=9, n_points=80, camera=SMALL, pixel_sigma=0.01)


@pytest.fixture
def images(tmp_path, scene, monkeypatch):
    folder = tmp_path / "images"
    folder.mkdir()
    for name in scene.model.names:
        Image.new("L", (64, 48), 128).save(folder / name)
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: scene.model)
    return folder


def written(path, scene, convention, *, header, poses=None):
    """A poses file with rows of name, position and rotation under a convention."""
    poses = scene.robot_poses.base_T_gripper if poses is None else poses
    positions, rotations = from_poses(poses, convention)
    rows = [
        ",".join([name, *(f"{x:.12g}" for x in (*position, *rotation))])
        for name, position, rotation in zip(
            scene.robot_poses.names, positions, rotations, strict=True
        )
    ]
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


OURS = "image,x,y,z,qx,qy,qz,qw"
ANGLES = "image,X,Y,Z,A,B,C"


def options_of(**poses):
    return hf.Options(poses=hf.PoseFileOptions(**poses))


def calibrated(images, poses, scene, **options):
    return hf.calibrate(images, poses, camera=scene.camera, options=options_of(**options))


@pytest.mark.parametrize(
    ("convention", "header", "claimed", "flag"),
    [
        (Convention(rotation="wxyz"), OURS, {}, "--rotation wxyz"),
        (Convention(unit="mm"), OURS, {}, "--units mm"),
        (Convention(inverted=True), OURS, {}, "--inverted"),
        (Convention(), OURS, {"inverted": True}, "without --inverted"),
        (
            Convention(rotation="ZYX", angles="rad"),
            ANGLES,
            {"format": "kuka", "units": "m", "angles": "deg"},
            "--angles rad",
        ),
        (
            Convention(rotation="ZYX", angles="deg"),
            ANGLES,
            {"format": "kuka", "units": "m", "angles": "rad"},
            "--angles deg",
        ),
        (
            Convention(rotation="ZYX", angles="deg"),
            ANGLES,
            {"format": "mitsubishi", "units": "m"},
            "--rotation ZYX",
        ),
        (
            Convention(rotation="ZYZ", angles="deg"),
            ANGLES,
            {"format": "kuka", "units": "m"},
            "--rotation ZYZ",
        ),
        (
            Convention(rotation="rotation-vector", angles="deg"),
            ANGLES,
            {"format": "kuka", "units": "m"},
            "--rotation rotation-vector",
        ),
    ],
)
def test_the_flag_that_reads_the_file_right_is_named(
    images, scene, tmp_path, convention, header, claimed, flag
):
    """Numbers are read again: degrees taken as radians, too, which a rotation does not tell."""
    path = written(tmp_path / "poses.csv", scene, convention, header=header)
    with pytest.raises(hf.InputDataError, match=f"your poses look .* run again .*{flag}"):
        calibrated(images, path, scene, **claimed)


def test_auto_convention_converts_and_says_so(images, scene, tmp_path):
    right = calibrated(images, written(tmp_path / "a.csv", scene, Convention(), header=OURS), scene)
    assert right.provenance["convention"] == "as given"
    assert str(right.poses_read_as["robot"]) == "csv (quaternion x,y,z,w, m), recognised"
    path = written(tmp_path / "b.csv", scene, Convention(rotation="wxyz", unit="mm"), header=OURS)
    result = calibrated(images, path, scene, auto_convention=True)
    np.testing.assert_allclose(result.matrix, right.matrix, atol=1e-6)
    assert result.provenance["convention"] == "rotation-wxyz,mm"
    assert "were taken as such (--auto-convention: rotation-wxyz,mm)" in result.message


def test_a_named_convention_is_applied_and_checked(images, scene):
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    poses = dict(
        zip(scene.model.names, mirror @ scene.robot_poses.base_T_gripper @ mirror, strict=True)
    )
    # Which axis it is no image tells, so that it is not converted unasked.
    with pytest.raises(hf.InputDataError, match=r"look mirrored .* --convention mirrored-x"):
        calibrated(images, poses, scene, auto_convention=True)
    result = calibrated(images, poses, scene, convention="mirrored-y")
    error = frames.log(frames.inverse(result.matrix) @ scene.gripper_T_camera)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.05
    assert result.provenance["convention"] == "mirrored-y"
    with pytest.raises(hf.InputDataError, match="convention 'mirror' is not known; give one or mo"):
        calibrated(images, poses, scene, convention="mirror")
    with pytest.raises(hf.InputDataError, match="does not say which axis"):
        calibrated(images, poses, scene, convention="mirrored")


def test_a_setup_is_not_chosen_for_the_user(images, scene):
    """X is then of another frame: a decision that stays with the user."""
    poses = dict(zip(scene.model.names, scene.robot_poses.base_T_gripper, strict=True))
    options = hf.Options(setup="eye-to-hand", poses=hf.PoseFileOptions(auto_convention=True))
    with pytest.raises(hf.InputDataError, match="look like those of setup eye-in-hand, or inver"):
        hf.calibrate(images, poses, camera=scene.camera, options=options)


def test_unchecked_poses_are_used_as_they_are(images, scene):
    poses = dict(
        zip(scene.model.names, frames.scaled(scene.robot_poses.base_T_gripper, 1e3), strict=True)
    )
    with pytest.raises(
        hf.InputDataError, match=r"to be in millimetres.*but X is then [\d.]+ m long"
    ):
        calibrated(images, poses, scene)
    checked = options_of(convention="as-given")
    with pytest.raises(hf.ConvergenceError, match="contradict"):  # 50 mm of noise
        hf.calibrate(images, poses, camera=scene.camera, options=checked)


@pytest.mark.parametrize(
    ("convention", "code", "verdict"),
    [(Convention(), 0, "right"), (Convention(inverted=True), 1, "wrong")],
)
def test_check_tells_and_calibrates_nothing(
    images, scene, tmp_path, capfd, convention, code, verdict
):
    path = written(tmp_path / "poses.csv", scene, convention, header=OURS)
    assert cli.main(["check", str(images), str(path), "--json"]) == code
    out, err = capfd.readouterr()
    document = json.loads(out)
    assert document["verdict"] == verdict
    assert document["convention"] == ("" if code == 0 else "inverted")
    assert document["readings"][0]["residual_rotation_deg"] < 0.1
    assert document["motion"]["axes"] == 2
    assert (document["images"], document["placed"]) == (9, 9)
    assert "determine X and the scale" in err
    assert "as-given" in err
    assert document["message"] in " ".join(err.split())
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["images", "poses.csv"]


def test_check_of_motions_that_cannot_tell_is_partial(tmp_path, monkeypatch, capfd):
    scene = simulate_scene(np.random.default_rng(1), n_images=8, n_points=80, motion="one_axis")
    images = tmp_path / "images"
    images.mkdir()
    for name in scene.model.names:
        Image.new("L", (scene.camera.width, scene.camera.height), 128).save(images / name)
    monkeypatch.setattr(sfm, "reconstruct", lambda *_, **__: scene.model)
    path = written(tmp_path / "poses.csv", scene, Convention(), header=OURS)
    assert cli.main(["check", str(images), str(path)]) == 3
    err = capfd.readouterr().err
    assert "the motions cannot tell" in err
    assert "All rotations share one axis" in err
