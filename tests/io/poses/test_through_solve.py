"""The same X from pose pairs in files of every format, from Python and from the command line."""

import html
import json

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import cli
from handeye_fg.errors import InputDataError
from handeye_fg.frames import exp
from handeye_fg.io.poses import FORMATS, write_poses
from handeye_fg.options import PoseFileOptions
from handeye_fg.simulate import simulate_poses
from handeye_fg.types import RobotPoses

NAMES = tuple(f"{1700000000 + i}.250000000" for i in range(12))
SUFFIX = {"ros": ".yaml", "moveit": ".yaml", "robot-cal-tools": ".yaml"}


@pytest.fixture(scope="module")
def pairs():
    robot, camera, truth = simulate_poses(np.random.default_rng(5), n_poses=12)
    return RobotPoses(names=NAMES, base_T_gripper=robot), camera, truth.gripper_T_camera


def camera_csv(folder, camera):
    poses = RobotPoses(names=NAMES, base_T_gripper=camera)
    return write_poses(poses, folder / "camera.csv")


@pytest.mark.parametrize("name", FORMATS)
def test_x_is_the_same_from_every_format(tmp_path, pairs, name):
    robot, camera, expected = pairs
    path = tmp_path / f"robot{SUFFIX.get(name, '.txt')}"
    write_poses(robot, path, PoseFileOptions(format=name))
    how = "order" if FORMATS[name].key == "none" and FORMATS[name].container != "folder" else "auto"
    how = "auto" if name == "robot-cal-tools" else how
    options = PoseFileOptions(format=name, pair_by=how)
    result = hf.solve(path, camera_csv(tmp_path, camera), robot_file=options)
    np.testing.assert_allclose(result.matrix, expected, atol=1e-8)
    robot_as, camera_as = (result.poses_read_as[whose] for whose in ("robot", "camera"))
    assert (robot_as.format, robot_as.recognised) == (name, False)
    assert (camera_as.format, camera_as.recognised) == ("csv", True)


def test_people_are_told_how_files_were_read(tmp_path, pairs):
    robot, camera, _ = pairs
    path = write_poses(robot, tmp_path / "robot.txt", PoseFileOptions(format="fanuc"))
    result = hf.solve(path, camera_csv(tmp_path, camera))
    how = f"read as fanuc ({FORMATS['fanuc'].convention}), recognised"
    text = hf.summary_text(result)
    assert f"robot poses      {how}" in text
    assert "camera poses     read as csv (quaternion x,y,z,w, m), recognised" in text
    assert f"The robot's poses were {how}." in html.unescape(hf.render_report(result))


def test_flags_of_the_command(tmp_path, pairs, capsys):
    robot, camera, expected = pairs
    write_poses(
        robot,
        tmp_path / "robot.txt",
        PoseFileOptions(format="kitti", units="mm", inverted=True),
    )
    write_poses(
        RobotPoses(names=NAMES, base_T_gripper=camera),
        tmp_path / "camera.tum",
        PoseFileOptions(format="tum"),
    )
    command = [
        "solve",
        str(tmp_path / "robot.txt"),
        str(tmp_path / "camera.tum"),
        *("--output", str(tmp_path / "out"), "--json", "--quiet"),
        *("--pose-format", "kitti", "--units", "mm", "--inverted"),
        *("--camera-file.pose-format", "tum"),
    ]
    assert cli.main(command) == 2
    assert "--pair-by number" in capsys.readouterr().err
    assert cli.main([*command, "--pair-by", "order"]) == 0
    result = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(result["calibration"]["matrix"], expected, atol=1e-8)


def test_robot_poses_between_those_of_a_slower_camera(tmp_path):
    """A robot that logs ten times as often as the camera, which is half a step late."""
    times = np.arange(0.0, 3.0, 0.01)
    angle = np.column_stack([0.5 * np.sin(times), 0.4 * np.sin(1.3 * times + 1), 0.3 * times])
    twists = np.hstack([angle, 0.2 * np.cos(angle)])
    robot = exp(twists)
    expected = exp(np.array([0.1, 0.2, -0.3, 0.05, 0.0, 0.1]))
    moments = np.arange(0.105, 2.9, 0.2)
    late = np.column_stack([0.5 * np.sin(moments), 0.4 * np.sin(1.3 * moments + 1), 0.3 * moments])
    camera = exp(np.hstack([late, 0.2 * np.cos(late)])) @ expected

    def written(name, poses, at):
        ns = [round((1700000000 + t) * 1000) * 10**6 for t in at]
        names = tuple(str(time) for time in ns)
        rows = RobotPoses(names=names, base_T_gripper=poses)
        return write_poses(rows, tmp_path / name, PoseFileOptions(format="tum"), times_ns=ns)

    result = hf.solve(written("robot.tum", robot, times), written("camera.tum", camera, moments))
    assert len(result.images) == len(moments)
    # Straight and about one axis instead of along the curve: about a (0.005 s)^2 / 2, a < 1 m/s^2.
    np.testing.assert_allclose(result.matrix, expected, atol=2e-4)


def test_a_mapping_and_a_file(tmp_path, pairs):
    robot, camera, expected = pairs
    path = write_poses(robot, tmp_path / "robot.csv")
    mapping = dict(zip(NAMES, camera, strict=True))
    np.testing.assert_allclose(hf.solve(path, mapping).matrix, expected, atol=1e-8)
    with pytest.raises(InputDataError, match="one list of poses has names"):
        hf.solve(path, camera)
