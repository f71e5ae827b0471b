"""Calibration from pose pairs: every method, both setups, poses and motions; the command line."""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

import jsonschema
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from handeye_fg import cli
from handeye_fg.commands import exit_codes
from handeye_fg.frames import Array, inverse, rotation_angle, scaled
from handeye_fg.io.results import Result, result_schema, to_document
from handeye_fg.motions import PosePairs, as_motions
from handeye_fg.options import MethodName
from handeye_fg.priors import Prior
from handeye_fg.report import summary_text, write_report
from handeye_fg.simulate import Motion, Truth, disturbed, simulate_poses
from handeye_fg.solvers import METHODS

NOISE = {
    "robot_rotation_sigma": 3e-4,
    "robot_translation_sigma": 2e-4,
    "camera_rotation_sigma": 3e-4,
    "camera_translation_sigma": 2e-4,
}
ALL_METHODS = get_args(MethodName)


def poses(seed: int = 3, n: int = 20, motion: Motion = "general") -> tuple[Array, Array, Truth]:
    robot, camera, truth = simulate_poses(
        np.random.default_rng(seed), n_poses=n, motion=motion, **NOISE
    )
    return robot.copy(), camera.copy(), truth


def in_unit_of(method: str, camera: Array, truth: Truth) -> Array:
    """The camera poses as the method takes them."""
    takes_metres = method in METHODS and METHODS[method].scale_known
    return scaled(camera, truth.metres_per_world_unit) if takes_metres else camera


def assert_near(result: Result, truth: Truth) -> None:
    """Within what 18 poses of 0.02 degrees and 0.3 mm of noise leave."""
    turn = result.matrix[:3, :3].T @ truth.gripper_T_camera[:3, :3]
    assert np.degrees(float(rotation_angle(turn))) < 0.05
    assert np.linalg.norm(result.matrix[:3, 3] - truth.gripper_T_camera[:3, 3]) < 1.5e-3


def assert_saved(result: Result, folder: Path) -> None:
    """The file is valid, comes back the same, and can be shown."""
    path = result.save(folder)
    document = json.loads(path.read_text())
    jsonschema.Draft202012Validator(result_schema()).validate(document)
    loaded = hf.load_result(path)
    assert loaded.message == result.message
    np.testing.assert_array_equal(loaded.matrix, result.matrix)
    assert (loaded.base_T_world is None) == (result.base_T_world is None)
    assert [row.reason for row in loaded.images] == [row.reason for row in result.images]
    page = write_report(result, folder).read_text().split("<script")[0]
    assert result.initial.method in page or result.initial.method == "partial"
    assert "registered" not in page
    assert "nan" not in summary_text(result)


def test_methods_are_those_of_the_options() -> None:
    assert set(ALL_METHODS) == {*METHODS, "pose_graph"}


@pytest.mark.parametrize("method", ALL_METHODS)
def test_every_method_bears_wrong_rows_and_names_them(method: str, tmp_path: Path) -> None:
    robot, camera, truth = poses()
    robot[[3, 7]] = robot[[7, 3]]
    result = hf.solve(robot, in_unit_of(method, camera, truth), method)
    assert result.status == "ok"
    assert_near(result, truth)
    assert [row.name for row in result.images if row.outlier] == ["row 3", "row 7"]
    assert all(bool(row.reason) == row.outlier for row in result.images)
    assert "row 3, row 7" in result.message
    assert result.sfm is None
    assert result.camera is None
    assert (result.noise is None) == (method != "pose_graph")
    assert result.initial.residual_translation < 2e-3
    assert result.covariance is not None
    # The truth lies within the stated uncertainty, twice as wide as a 99.9 % interval.
    shift = result.matrix[:3, :3].T @ (result.matrix[:3, 3] - truth.gripper_T_camera[:3, 3])
    assert shift @ np.linalg.solve(result.covariance[3:, 3:], shift) < 4.0 * 16.3
    assert_saved(result, tmp_path)


def test_without_robust_wrong_rows_count() -> None:
    robot, camera, truth = poses(n=30)
    plain = hf.solve(robot, camera, robust=False)
    assert_near(plain, truth)
    robot[[3, 7]] = robot[[7, 3]]
    with pytest.raises(hf.HandEyeError):
        hf.solve(robot, scaled(camera, truth.metres_per_world_unit), "tsai_lenz", robust=False)


@pytest.mark.parametrize("method", ["andreff_scale", "shah", "pose_graph"])
def test_motions(method: str, tmp_path: Path) -> None:
    robot, camera, truth = poses()
    camera = in_unit_of(method, camera, truth)
    pairs = as_motions(PosePairs(base_T_gripper=robot, world_T_camera=camera))
    result = hf.solve(pairs.gi_T_gj[::5], pairs.ci_T_cj[::5], method, motions=True)
    assert result.status == "ok"
    assert_near(result, truth)
    assert result.base_T_world is None
    assert all(row.base_T_camera is None for row in result.images)
    assert_saved(result, tmp_path)


@pytest.mark.parametrize("method", ["andreff_scale", "park_martin", "pose_graph"])
def test_eye_to_hand_inverts_the_robot_poses_once(method: str) -> None:
    robot, camera, truth = poses()
    result = hf.solve(
        inverse(robot), in_unit_of(method, camera, truth), method, setup="eye-to-hand"
    )
    assert_near(result, truth)
    for row in result.images:
        np.testing.assert_array_equal(row.base_T_camera, result.matrix)


@pytest.mark.parametrize("method", ["andreff_scale", "tsai_lenz", "pose_graph"])
def test_one_axis_is_partial(method: str, tmp_path: Path) -> None:
    robot, camera, truth = poses(motion="one_axis")
    result = hf.solve(robot, in_unit_of(method, camera, truth), method)
    assert result.status == "partial"
    assert [direction.kind for direction in result.free_directions] == ["translation"]
    assert_saved(result, tmp_path)


def test_a_prior_completes_it() -> None:
    robot, camera, truth = poses(motion="one_axis")
    axis = hf.solve(robot, camera).free_directions[0].vector
    value = float(axis @ truth.gripper_T_camera[:3, 3])
    prior = Prior("translation-along", tuple(axis), value, 1e-4)
    result = hf.solve(robot, camera, priors=[prior])
    assert result.status == "ok"
    assert_near(result, truth)


def test_rows_of_weight_zero_are_not_used() -> None:
    robot, camera, _ = poses()
    weights = np.ones(20)
    weights[4] = 0.0
    weighted = hf.solve(robot, camera, weights=weights)
    without = hf.solve(np.delete(robot, 4, axis=0), np.delete(camera, 4, axis=0))
    np.testing.assert_allclose(weighted.matrix, without.matrix, atol=1e-9)
    assert weighted.images[4].reason == "its weight is zero"
    assert not weighted.images[4].outlier


def test_weights_move_the_answer() -> None:
    robot, camera, _ = poses()
    weights = np.where(np.arange(20) < 10, 1.0, 1e-6)
    weighted = hf.solve(robot, camera, weights=weights, robust=False)
    half = hf.solve(robot[:10], camera[:10], robust=False)
    plain = hf.solve(robot, camera, robust=False)
    np.testing.assert_allclose(weighted.matrix, half.matrix, atol=1e-4)
    assert (
        np.abs(weighted.matrix - half.matrix).max() < np.abs(weighted.matrix - plain.matrix).max()
    )


def test_the_pose_graph_is_told_what_is_known() -> None:
    robot, camera, truth = poses()
    metric = scaled(camera, truth.metres_per_world_unit)
    noise = hf.RobotNoise(robot_rotation_deg=0.05, robot_translation_mm=1.0)
    result = hf.solve(
        robot, metric, "pose_graph", metric=True, camera_noise="odometry", noise=noise
    )
    assert result.metres_per_world_unit == 1.0
    assert np.isnan(result.metres_per_world_unit_std)
    assert "accumulate along the rows" in result.message
    assert result.noise is not None
    assert not result.noise.estimated
    assert result.noise.robot_rotation == pytest.approx(np.deg2rad(0.05))
    assert result.noise.robot_translation == pytest.approx(1e-3)
    free = hf.solve(robot, metric, "pose_graph")
    assert free.metres_per_world_unit_std > 0.0
    assert "are independent" in free.message
    assert free.noise is not None
    assert free.noise.estimated


def test_a_drifting_unit_is_told() -> None:
    rng = np.random.default_rng(12)
    robot, camera, truth = simulate_poses(rng, n_poses=60)
    robot = disturbed(rng, robot, 1e-4, 1e-4)
    camera = inverse(camera[0]) @ camera
    drift = np.cumsum(rng.normal(0.0, 5e-3, len(camera)))
    camera[:, :3, 3] *= np.exp(drift - drift[0])[:, None]
    result = hf.solve(robot, camera, "pose_graph")
    assert "Their unit drifts" in result.message
    # The first pose's scale; the drift leaves it a few standard deviations of one step uncertain.
    assert result.metres_per_world_unit == pytest.approx(truth.metres_per_world_unit, rel=0.02)
    assert np.linalg.norm(result.matrix[:3, 3] - truth.gripper_T_camera[:3, 3]) < 2e-3


def test_names_pair_the_rows() -> None:
    robot, camera, truth = poses()
    names = [f"p{i}" for i in range(20)]
    by_name = hf.solve(
        dict(zip(names, robot, strict=True)),
        dict(reversed(list(zip(names[1:], camera[1:], strict=True)))) | {"other": np.eye(4)},
    )
    assert_near(by_name, truth)
    left_out = {row.name: row.reason for row in by_name.images if not row.registered}
    assert left_out == {
        "p0": "no camera pose has this name",
        "other": "no robot pose has this name",
    }
    assert [row.name for row in hf.solve(robot, camera, names=names).images] == names


def test_same_seed_same_result() -> None:
    robot, camera, _ = poses()
    first, second = (to_document(hf.solve(robot, camera, seed=5)) for _ in range(2))
    assert first | {"timing_s": None} == second | {"timing_s": None}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"method": "tsai"}, "unknown method 'tsai': choose one of andreff_scale"),
        ({"world_T_camera": np.zeros((20, 4, 4))}, "camera pose 0 does not hold a rotation"),
        ({"world_T_camera": np.zeros((3, 3))}, r"camera poses have the shape \(3, 3\)"),
        ({"base_T_gripper": [["a"]]}, "robot poses are no array of numbers"),
        ({"base_T_gripper": np.eye(4)[None]}, "1 robot poses but 20 camera poses"),
        ({"base_T_gripper": {"a": np.eye(4)}}, "one list of poses has names"),
        ({"weights": np.ones(3)}, r"weights have the shape \(3,\)"),
        ({"weights": -np.ones(20)}, "weights must be finite and not negative"),
        ({"names": ["a"]}, "1 names but 20 rows"),
    ],
)
def test_wrong_input_is_named(change: Mapping[str, Any], message: str) -> None:
    robot, camera, _ = poses()
    arguments: dict[str, Any] = {"base_T_gripper": robot, "world_T_camera": camera}
    with pytest.raises(hf.InputDataError, match=message) as raised:
        hf.solve(**(arguments | change))
    assert "\n" not in str(raised.value)


def test_names_that_do_not_meet() -> None:
    robot, camera, _ = poses(n=3)
    named_robot, named_camera = (
        {f"{who}{i}": matrix for i, matrix in enumerate(matrices)}
        for who, matrices in (("robot", robot), ("camera", camera))
    )
    with pytest.raises(hf.InputDataError, match="named like 'robot0', the camera's like 'camera0'"):
        hf.solve(named_robot, named_camera)


@pytest.mark.parametrize("method", [name for name in METHODS if METHODS[name].scale_known])
def test_another_unit_is_refused(method: str) -> None:
    robot, camera, truth = poses()
    with pytest.raises(hf.InputDataError, match=r"with 0\.00[01]\d* metres per unit"):
        hf.solve(robot, scaled(camera, 1e3 * truth.metres_per_world_unit), method)


@pytest.mark.parametrize("method", ["andreff_scale", "tsai_lenz"])
def test_another_convention_is_refused(method: str) -> None:
    for seed in range(10):
        robot, camera, truth = poses(seed, 8)
        camera = in_unit_of(method, camera, truth)
        with pytest.raises((hf.InputDataError, hf.ConvergenceError)):
            hf.solve(inverse(robot), camera, method)


# --- command line ---------------------------------------------------------------------------------


def write_csv(path: Path, matrices: Array, left_out: int) -> Path:
    rows = ["image,x,y,z,qx,qy,qz,qw"]
    for i, matrix in enumerate(matrices):
        values = [*matrix[:3, 3], *Rotation.from_matrix(matrix[:3, :3]).as_quat()]
        rows.append(f"p{i:02d}," + ",".join(f"{value:.9f}" for value in values))
    del rows[left_out + 1]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.fixture
def files(tmp_path: Path) -> list[str]:
    robot, camera, _ = poses()
    robot[[3, 7]] = robot[[7, 3]]
    return [
        str(write_csv(tmp_path / "robot.csv", robot, 5)),
        str(write_csv(tmp_path / "camera.csv", camera, 11)),
    ]


def test_command_writes_result_and_page(
    files: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main(["solve", *files, "--output", str(out), "--json"]) == exit_codes.EXIT_OK
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert document == json.loads((out / "result.json").read_text())
    assert [row["name"] for row in document["images"] if row["outlier"]] == ["p03", "p07"]
    assert {row["name"] for row in document["images"] if not row["registered"]} == {"p05", "p11"}
    assert document["intrinsics"] is document["sfm"] is document["noise"] is None
    assert "18 of 20 paired, 2 rows rejected" in captured.err
    assert (out / "report.html").is_file()
    assert {path.name for path in out.iterdir()} == {"result.json", "report.html"}
    assert cli.main(["report", str(out)]) == exit_codes.EXIT_OK


def test_command_as_a_process(files: list[str], tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "handeye_fg", "solve", *files, "--output", str(tmp_path), "-q"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert_saved(hf.load_result(tmp_path), tmp_path)


def test_command_exit_codes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot, camera, _ = poses(motion="one_axis")
    robot_csv = str(write_csv(tmp_path / "robot.csv", robot, 0))
    camera_csv = str(write_csv(tmp_path / "camera.csv", camera, 0))
    options = ["--output", str(tmp_path / "out")]
    assert cli.main(["solve", robot_csv, camera_csv, *options]) == exit_codes.EXIT_PARTIAL
    assert "is not determined" in capsys.readouterr().err
    same = str(write_csv(tmp_path / "same.csv", np.repeat(robot[:1], 20, axis=0), 0))
    assert cli.main(["solve", same, camera_csv, *options, "--json"]) == exit_codes.EXIT_FAILED
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1
    assert "did not move" in captured.err
    assert json.loads(captured.out)["status"] == "failed"
    assert cli.main(["solve", robot_csv, "nowhere.csv", *options]) == exit_codes.EXIT_USAGE
    assert "nowhere.csv: no such file" in capsys.readouterr().err
    assert cli.main(["solve", robot_csv, camera_csv, "--method", "foo"]) == exit_codes.EXIT_USAGE
    assert "andreff_scale" in capsys.readouterr().err


def test_command_flags(files: list[str], tmp_path: Path) -> None:
    options = ["--output", str(tmp_path), "-q", "--no-robust", "--setup", "eye-to-hand"]
    # Inverting the robot poses makes these another convention.
    assert cli.main(["solve", *files, *options]) in (exit_codes.EXIT_FAILED, exit_codes.EXIT_USAGE)
    assert (
        cli.main(["solve", *files, "--robust", "-q", "--output", str(tmp_path)])
        == exit_codes.EXIT_OK
    )


def test_start_up_loads_nothing_of_images(files: list[str], tmp_path: Path) -> None:
    code = (
        "import sys; from handeye_fg.cli import main\n"
        f"main(['solve', *{files!r}, '--output', {str(tmp_path)!r}, '-q'])\n"
        "heavy = {'gtsam', 'pycolmap', 'cv2'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
