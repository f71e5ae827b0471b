"""Pose pairs that contradict each other: what is likely wrong is named, on either side, and nothing else is."""

import json

import numpy as np
import pytest

import handeye_fg as hf
from handeye_fg import cli, frames
from handeye_fg.frames import Array
from handeye_fg.io.poses import Convention
from handeye_fg.io.poses.convention import from_poses
from handeye_fg.simulate import Truth, simulate_poses
from handeye_fg.simulate.careless import WAYS

NAMES = tuple(f"image_{i:02d}.jpg" for i in range(40))


def pairs(seed: int = 0, n: int = 10, noise: float = 1.0, **more) -> tuple[Array, Array, Truth]:
    robot, camera, truth = simulate_poses(
        np.random.default_rng(seed),
        n_poses=n,
        robot_rotation_sigma=noise * 5e-4,
        robot_translation_sigma=noise * 2e-4,
        camera_rotation_sigma=noise * 5e-4,
        camera_translation_sigma=noise * 2e-4,
        **more,
    )
    return robot.copy(), camera.copy(), truth


def distance(result: hf.Result, truth: Truth) -> tuple[float, float]:
    """Degrees and metres from the truth."""
    error = frames.log(frames.inverse(result.matrix) @ truth.gripper_T_camera)
    return float(np.rad2deg(np.linalg.norm(error[:3]))), float(np.linalg.norm(error[3:]))


@pytest.mark.parametrize(
    ("way", "flag"),
    [
        ("millimetres", "--units mm, or with --auto-convention"),
        ("metres as millimetres", "--units m, or"),
        ("w first", "--convention wxyz, or"),
        ("conjugate", "--convention transposed, or"),
        ("mirrored y", "--convention mirrored-x, mirrored-y or mirrored-z"),
        ("y negated", "--convention negated-y, or"),
        ("shifted", "--convention shifted\\+1, or"),
        ("reversed", "--convention reversed, or"),
        ("inverse", "--convention inverted, or run again with --setup eye-to-hand if"),
        ("inverse in mm", "--convention inverted and --units mm, or run again with --setup"),
    ],
)
def test_what_is_wrong_with_the_robots_poses_is_named_first(way, flag):
    robot, camera, _ = pairs()
    with pytest.raises(hf.InputDataError, match=f"^your poses look .*?; run again with {flag}"):
        hf.solve(WAYS[way][0](robot), camera)


@pytest.mark.parametrize(
    ("way", "flag"),
    [
        ("w first", "wxyz"),
        ("conjugate", "transposed"),
        ("z negated", "negated-z"),
        ("inverse", "inverted"),
    ],
)
def test_what_is_wrong_with_the_cameras_poses_is_named_first(way, flag):
    robot, camera, _ = pairs()
    words = f"^the camera's poses look [^;]*; run again with --camera-file.convention {flag}"
    with pytest.raises(hf.InputDataError, match=words) as caught:
        hf.solve(robot, WAYS[way][0](camera))
    # One equation: an inverse of the one is an inverse of the other, and the other setup.
    assert (
        "or just as well your poses look like those of setup eye-to-hand" in str(caught.value)
    ) is (way == "inverse")


def test_of_a_static_camera_both_explanations_are_named():
    robot, camera, _ = pairs()
    with pytest.raises(hf.InputDataError) as caught:
        hf.solve(robot, camera, setup="eye-to-hand")
    first, second = str(caught.value).split("; or just as well ")
    assert first.startswith("the camera's poses look inverted (camera_T_world)")
    assert second.startswith("your poses look like those of setup eye-in-hand, or inverted")


def test_a_named_convention_of_either_side_is_applied():
    robot, camera, truth = pairs()
    result = hf.solve(
        frames.inverse(robot),
        WAYS["conjugate"][0](camera),
        robot_file=hf.PoseFileOptions(convention="inverted"),
        camera_file=hf.PoseFileOptions(convention="transposed"),
    )
    assert distance(result, truth) < (0.2, 0.003)
    assert result.provenance["convention"] == "inverted"
    motions = np.linalg.inv(robot[:-1]) @ robot[1:]
    with pytest.raises(hf.InputDataError, match="the rows are motions; convert the poses before"):
        hf.solve(
            motions, motions, motions=True, robot_file=hf.PoseFileOptions(convention="inverted")
        )


@pytest.mark.parametrize("way", ["w first", "inverse in mm"])
def test_auto_convention_converts_and_says_so(way):
    robot, camera, _ = pairs()
    options = hf.PoseFileOptions(auto_convention=True)
    result = hf.solve(WAYS[way][0](robot), camera, robot_file=options)
    right = hf.solve(robot, camera)
    np.testing.assert_allclose(result.matrix, right.matrix, atol=1e-9)
    assert f"taken as such (--auto-convention: {WAYS[way][1]})" in result.message
    assert result.provenance["convention"] == WAYS[way][1]
    assert right.provenance["convention"] == "as given"
    # The camera's poses are not converted in the place of the robot's.
    with pytest.raises(hf.InputDataError, match="the camera's poses look"):
        hf.solve(robot, WAYS[way][0](camera), robot_file=options)


def test_as_given_switches_the_diagnosis_off():
    robot, camera, _ = pairs()
    options = hf.PoseFileOptions(convention="as-given")
    large = hf.solve(frames.scaled(robot, 1e3), camera, robot_file=options)
    assert np.linalg.norm(large.matrix[:3, 3]) > 5.0
    with pytest.raises(hf.HandEyeError, match=r"^(?!.*poses look)"):
        hf.solve(frames.inverse(robot), camera, robot_file=options)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_noisy_poses_with_wrong_rows_raise_no_alarm(seed, setup):
    """A bad arm of 0.6 degrees and 4 mm, a fifth of whose rows are swapped."""
    robot, camera, truth = pairs(seed, n=20, noise=20.0)
    wrong = np.random.default_rng(seed).choice(20, 4, replace=False)
    robot[wrong] = robot[np.roll(wrong, 1)]
    robot = robot if setup == "eye-in-hand" else frames.inverse(robot)
    assert distance(hf.solve(robot, camera, setup=setup), truth) < (2.0, 0.04)


def test_a_vehicle_is_no_arm_in_centimetres():
    """Hundreds of metres on the way, and a camera two metres from the reference: large, and right."""
    robot, _, _ = pairs()
    robot[:, :3, 3] *= 400.0
    X = frames.pose(np.eye(3), np.array([1.5, 0.2, 1.0]))
    camera = frames.inverse(frames.exp(np.array([0.1, 0.2, 0.3, 40.0, 0.0, 20.0]))) @ robot @ X
    result = hf.solve(robot, camera)
    np.testing.assert_allclose(result.matrix, X, atol=1e-6)
    # Nor is it one where something else is wrong.
    with pytest.raises(hf.InputDataError, match=r"^your poses look .*inverted") as caught:
        hf.solve(frames.inverse(robot), camera)
    assert "metres, not" not in str(caught.value)


def test_what_has_nothing_in_common_stays_a_contradiction():
    robot, camera, _ = pairs(3)
    robot[:, :3, 3] = np.random.default_rng(0).normal(size=(10, 3))
    with pytest.raises(hf.ConvergenceError, match="robot and camera contradict each other"):
        hf.solve(robot, camera)


def test_the_flags_of_both_files(tmp_path, capsys):
    robot, camera, truth = pairs()

    def written(file, poses, convention):
        numbers = from_poses(poses, convention)
        rows = [
            ",".join([name, *(f"{x:.12g}" for x in (*position, *rotation))])
            for name, position, rotation in zip(NAMES[: len(poses)], *numbers, strict=True)
        ]
        (tmp_path / file).write_text("\n".join(["image,x,y,z,qx,qy,qz,qw", *rows]))
        return str(tmp_path / file)

    right, wrong = Convention(), Convention(rotation="wxyz")
    ways = {"--rotation wxyz": (wrong, right), "--camera-file.rotation wxyz": (right, wrong)}
    for flags, (of_robot, of_camera) in ways.items():
        command = ["solve", written("a.csv", robot, of_robot), written("b.csv", camera, of_camera)]
        command += ["--output", str(tmp_path / "out"), "--json", "--quiet"]
        assert cli.main(command) == 2
        message = json.loads(capsys.readouterr().out)["message"]
        assert f"; run again with {flags}" in message
        assert cli.main([*command, *flags.split()]) == 0
        matrix = np.array(json.loads(capsys.readouterr().out)["calibration"]["matrix"])
        assert np.linalg.norm(matrix[:3, 3] - truth.gripper_T_camera[:3, 3]) < 0.003
