"""From images of a target to a result, where structure from motion fails or is not asked."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import yaml

import handeye_fg as hf
from handeye_fg import cli, frames, sfm
from handeye_fg.errors import ReconstructionError
from handeye_fg.io.results import result_schema
from handeye_fg.patterns import Target
from handeye_fg.report import write_report

N = 8
X = frames.exp(np.array([0.1, -0.05, 2.0, 0.03, -0.02, 0.06]))


@pytest.fixture
def failing_sfm(monkeypatch):
    def fail(*_, **__):
        raise ReconstructionError("structure from motion placed 0 of 8 images, take more")

    monkeypatch.setattr(sfm, "reconstruct", fail)


@pytest.fixture
def folder(tmp_path, camera, render, around, patterns):
    """Eight images of a ChArUco board on a plain wall, and the poses of a good arm."""
    rng = np.random.default_rng(31)
    pattern = patterns["charuco"]
    truth = around(pattern, N, rng)
    base_T_target = frames.exp(np.array([0.2, 0.1, -1.0, 0.5, 0.1, 0.2]))
    robot = base_T_target @ truth @ frames.inverse(X)
    robot = robot @ frames.exp(rng.normal(size=(N, 6)) * np.repeat([2e-4, 5e-5], 3))
    (tmp_path / "images").mkdir()
    rows = ["image,x,y,z,qx,qy,qz,qw"]
    for i, pose in enumerate(truth):
        name = f"{i}.png"
        cv2.imwrite(str(tmp_path / "images" / name), render(pattern, camera, pose))
        figures = [*robot[i, :3, 3], *frames.quaternion_xyzw(robot[i, :3, :3])]
        rows.append(",".join([name, *(repr(float(figure)) for figure in figures)]))
    (tmp_path / "poses.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    fx, fy, cx, cy, *distortion = camera.params.tolist()
    (tmp_path / "camera.yaml").write_text(
        yaml.safe_dump(
            {
                "image_width": camera.width,
                "image_height": camera.height,
                "camera_matrix": [fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0],
                "distortion_coefficients": distortion,
            }
        ),
        encoding="utf-8",
    )
    (tmp_path / "board.yaml").write_text(
        "kind: charuco\nsquares_x: 7\nsquares_y: 5\nsquare_m: 0.03\nmarker_m: 0.022\n"
        "dictionary: DICT_4X4_50\n",
        encoding="utf-8",
    )
    return tmp_path


def arguments(folder: Path, *more: str) -> list[str]:
    return [
        *("calibrate", str(folder / "images"), str(folder / "poses.csv")),
        *("--target", str(folder / "board.yaml"), "--output", str(folder / "out"), "--quiet"),
        *more,
    ]


@pytest.mark.usefixtures("failing_sfm")
def test_a_target_on_a_plain_wall_suffices(folder, capsys):
    """0.05 px and a robot noise of 0.01 deg and 0.05 mm leave 0.05 deg and 0.5 mm at most."""
    code = cli.main(arguments(folder, "--camera", str(folder / "camera.yaml"), "--json"))
    assert code == 0
    document = json.loads(capsys.readouterr().out)
    jsonschema.validate(document, result_schema())
    error = frames.log(frames.inverse(np.array(document["calibration"]["matrix"])) @ X)
    assert np.rad2deg(np.linalg.norm(error[:3])) < 0.05
    assert np.linalg.norm(error[3:]) < 5e-4
    target = document["target"]
    assert target["kind"] == "charuco"
    assert target["n_images"] == N
    assert target["n_corners"] > 0.95 * 24 * N
    assert target["rms_px"] < 0.2
    assert document["metres_per_world_unit"]["value"] == pytest.approx(1.0, abs=2e-3)
    np.testing.assert_allclose(target["base_T_target"], document["base_T_world"], atol=1e-3)
    assert "The target was found in 8" in document["message"]

    again = hf.load_result(folder / "out")
    assert again.target is not None
    assert again.target.kind == "charuco"
    page = write_report(again, folder / "out").read_text(encoding="utf-8")
    assert "charuco in 8 images" in page


@pytest.mark.usefixtures("failing_sfm")
def test_without_intrinsics_the_target_alone_does_not_suffice(folder, capsys):
    assert cli.main(arguments(folder)) == 1
    said = capsys.readouterr().err
    assert "placed 0 of 8 images" in said
    assert "give the camera file" in said
    assert len(said.strip().splitlines()) == 1


@pytest.mark.usefixtures("failing_sfm")
def test_a_target_that_no_image_shows(folder, capsys):
    text = (folder / "board.yaml").read_text(encoding="utf-8")
    (folder / "board.yaml").write_text(text.replace("4X4_50", "APRILTAG_36h11"), encoding="utf-8")
    assert cli.main(arguments(folder)) == 1
    said = capsys.readouterr().err
    assert "found in none of the 8 images" in said
    assert len(said.strip().splitlines()) == 1


@pytest.mark.usefixtures("failing_sfm")
def test_a_target_file_that_is_wrong(folder, capsys):
    (folder / "board.yaml").write_text("kind: checkers\n", encoding="utf-8")
    assert cli.main(arguments(folder)) == 2
    assert "kind is 'checkers'" in capsys.readouterr().err


@pytest.mark.usefixtures("failing_sfm")
def test_too_few_images_show_the_target(folder, camera, patterns):
    for i in range(2, N):
        cv2.imwrite(str(folder / "images" / f"{i}.png"), np.full((480, 640), 100 + i, np.uint8))
    with pytest.raises(ReconstructionError, match="gives poses to only 2 of 8 images"):
        hf.calibrate(
            folder / "images",
            folder / "poses.csv",
            camera=camera,
            target=Target(pattern=patterns["charuco"]),
        )


@pytest.mark.usefixtures("failing_sfm")
def test_a_target_declared_at_a_wrong_size_is_noticed(folder, camera, patterns):
    pattern = replace(patterns["charuco"], square_m=0.033, marker_m=0.0242)
    result = hf.calibrate(
        folder / "images", folder / "poses.csv", camera=camera, target=Target(pattern=pattern)
    )
    assert "0.90" in result.message
    assert "check the lengths in the target file" in result.message
    error = frames.log(frames.inverse(result.matrix) @ X)
    assert np.linalg.norm(error[3:]) < 1e-3
    assert result.target is not None
    assert result.target.note in result.message


def test_the_digest_covers_the_target(folder, camera, patterns, failing_sfm):
    pattern = patterns["charuco"]
    digests = {
        hf.calibrate(
            folder / "images",
            folder / "poses.csv",
            camera=camera,
            target=Target(pattern=pattern, accuracy_m=accuracy),
        ).provenance["input_digest"]
        for accuracy in (1e-4, 2e-4)
    }
    assert len(digests) == 2
