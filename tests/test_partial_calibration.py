"""``calibrate`` for motions that leave something free: exit code 3, and 0 with a prior."""

import json

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from example_cameras import SMALL
from handeye_fg import sfm
from handeye_fg.cli import main
from handeye_fg.commands.exit_codes import EXIT_FAILED, EXIT_OK, EXIT_PARTIAL
from handeye_fg.io.config import read_config, write_config
from handeye_fg.simulate import simulate_scene


@pytest.fixture
def calibrate(tmp_path, monkeypatch):
    """Run the command on a simulated scene; its exit code, result and scene."""

    def run(motion, *flags, poses=None):
        scene = simulate_scene(
            np.random.default_rng(0),
            n_images=8,
            n_points=80,
            camera=SMALL,
            pixel_sigma=0.01,
            motion=motion,
        )
        monkeypatch.setattr(sfm, "reconstruct", lambda *_args, **_kwargs: scene.model)
        images = tmp_path / "images"
        images.mkdir(exist_ok=True)
        rows = ["image,x,y,z,qx,qy,qz,qw"]
        reported = scene.robot_poses.base_T_gripper if poses is None else poses
        for name, pose in zip(scene.model.names, reported, strict=True):
            Image.new("L", (64, 48), 128).save(images / name)
            values = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
            rows.append(",".join([name, *(f"{value:.12f}" for value in values)]))
        table, out = tmp_path / "poses.csv", tmp_path / "out"
        table.write_text("\n".join(rows) + "\n", encoding="utf-8")
        code = main(["calibrate", str(images), str(table), "--output", str(out), "-q", *flags])
        path = out / "result.json"
        document = json.loads(path.read_text("utf-8")) if path.exists() else None
        return code, document, scene

    return run


@pytest.mark.parametrize(
    ("motion", "kinds"),
    [
        ("one_axis", ["translation"]),
        ("pure_translation", ["translation"] * 3),
        ("pure_rotation", ["scale"]),
    ],
)
def test_a_partial_result_is_code_3(calibrate, motion, kinds):
    code, document, scene = calibrate(motion)
    assert code == EXIT_PARTIAL
    calibration = document["calibration"]
    assert document["status"] == "partial"
    assert [free["kind"] for free in calibration["free_directions"]] == kinds
    assert (document["metres_per_world_unit"]["std"] is None) == (kinds == ["scale"])
    R_X = np.array(calibration["matrix"])[:3, :3]
    vectors = np.array([free["vector"] for free in calibration["free_directions"]])
    # A component has a standard deviation exactly where no free direction leans on it.
    leans = np.abs(vectors @ R_X).max(axis=0) > 0.1
    assert [std is None for std in calibration["std_translation_mm"]] == leans.tolist()
    assert None not in calibration["std_rotation_deg"]
    # Nothing ties a position along the optical axis that is free.
    assert (document["intrinsics"]["focal_offset"] is None) == leans[2]
    turn = np.degrees(Rotation.from_matrix(scene.gripper_T_camera[:3, :3].T @ R_X).magnitude())
    assert turn < 0.2
    assert all(
        free["description"] in document["message"] for free in calibration["free_directions"]
    )


def test_a_prior_makes_it_code_0(calibrate):
    _, document, scene = calibrate("one_axis")
    axis = np.array(document["calibration"]["free_directions"][0]["vector"])
    value = float(axis @ scene.gripper_T_camera[:3, 3])
    words = ["translation-along", ",".join(map(str, axis)), str(value), "0.001"]
    code, document, _ = calibrate("one_axis", "--prior", *words)
    assert code == EXIT_OK
    assert document["status"] == "ok"
    X = np.array(document["calibration"]["matrix"])
    np.testing.assert_allclose(X[:3, 3], scene.gripper_T_camera[:3, 3], atol=1e-3)
    covariance = np.array(document["calibration"]["covariance"])[3:, 3:]
    in_camera = X[:3, :3].T @ axis
    assert np.sqrt(in_camera @ covariance @ in_camera) == pytest.approx(1e-3, rel=0.1)


def test_a_robot_at_rest_is_an_error(calibrate, capsys):
    code, document, _ = calibrate("general", poses=np.stack([np.eye(4)] * 8))
    assert code == EXIT_FAILED
    assert document is None
    assert "the robot did not move" in capsys.readouterr().err


def test_options_refuse_priors_that_say_nothing():
    for arguments, words in (
        (("rotation", (0.0, 0.0, 1.0), 0.1, 0.1), "kind"),
        (("translation-along", (0.0, 0.0), 0.1, 0.1), "three numbers"),
        (("translation-along", (0.0, 0.0, 0.0), 0.1, 0.1), "not all zero"),
        (("translation-along", (0.0, 0.0, np.inf), 0.1, 0.1), "three numbers"),
        (("translation-along", (0.0, 0.0, 1.0), np.nan, 0.1), "value"),
        (("translation-along", (0.0, 0.0, 1.0), 0.1, 0.0), "positive"),
    ):
        with pytest.raises(ValueError, match=words):
            hf.Prior(*arguments)
    assert hf.Prior("translation-along", (0.0, 3.0, 4.0), 0.1, 0.1).axis == (0.0, 0.6, 0.8)


def test_priors_survive_the_options_file(tmp_path):
    options = hf.Options(priors=(hf.Prior("translation-along", (0.0, 0.6, 0.8), 0.08, 1e-3),))
    assert read_config(write_config(options, tmp_path / "config.toml")) == options
    (tmp_path / "bad.toml").write_text(
        '[[priors]]\nkind = "translation-along"\naxis = [0, 0, 0]\nvalue = 0.1\nstd = 0.1\n',
        encoding="utf-8",
    )
    with pytest.raises(hf.InputDataError, match="not all zero"):
        read_config(tmp_path / "bad.toml")
