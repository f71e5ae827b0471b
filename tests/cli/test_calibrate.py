"""Exit codes and files of ``calibrate``, and options by flag and file."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from handeye_fg.errors import (
    ConvergenceError,
    HandEyeError,
    InputDataError,
    ReconstructionError,
    UnobservableError,
)
from handeye_fg.io.config import read_config
from handeye_fg.io.results import Result
from handeye_fg.options import Options
from stand_in import Calibration


def test_calibrated(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run() == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    for words in (
        "X = gripper_T_camera",
        "p_gripper = gripper_T_camera p_camera",
        "noise estimated",
        "undetermined     nothing",
        f"Report: {tmp_path / 'out' / 'report.html'}",
    ):
        assert words in printed.err, words
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"result.json", "report.html", "config.toml"}


def test_arguments_reach_the_pipeline(
    run: Callable[..., int], calibration: Calibration, tmp_path: Path
) -> None:
    assert run("--camera", "c.yaml", "--masks", "m", "--setup", "eye-to-hand", "--seed", "5") == 0
    asked = calibration.asked
    assert (asked["images"], asked["poses"]) == (Path("images"), Path("poses.csv"))
    assert (asked["camera"], asked["masks"]) == (Path("c.yaml"), Path("m"))
    assert asked["output"] == tmp_path / "out"
    assert asked["options"] == Options(setup="eye-to-hand", seed=5)
    assert asked["holdout"] is None
    assert run("--holdout-images", "new", "--holdout-poses", "new.csv") == 0
    assert calibration.asked["holdout"] == (Path("new"), Path("new.csv"))


def test_new_images_need_their_poses(
    run: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("--holdout-images", "new") == 2
    assert "--holdout-images and --holdout-poses belong together" in capsys.readouterr().err
    assert run("--holdout-images", "new", "--holdout-poses", "new.csv", "--holdout", "0.2") == 2
    assert "use one of them" in capsys.readouterr().err


def test_partial_result_is_code_3_and_written(
    run: Callable[..., int],
    calibration: Calibration,
    partial: Result,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    calibration.answer = partial
    assert run() == 3
    assert "Height is free." in capsys.readouterr().err
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["status"] == "partial"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (HandEyeError, 1),
        (ReconstructionError, 1),
        (UnobservableError, 1),
        (ConvergenceError, 1),
        (InputDataError, 2),
    ],
)
def test_errors_are_one_line_and_leave_no_file(
    error: type[HandEyeError],
    code: int,
    run: Callable[..., int],
    calibration: Calibration,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    calibration.answer = error("images/\x1b[31m: nothing there;\n give a folder [bold]with[/bold]")
    assert run("--quiet") == code
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err == (
        "handeye-fg: error: images/\\x1b[31m: nothing there; give a folder [bold]with[/bold]\n"
    )
    assert not (tmp_path / "out").exists()


def test_an_earlier_result_survives_a_failure(
    run: Callable[..., int], calibration: Calibration, tmp_path: Path
) -> None:
    assert run() == 0
    before = {path: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    for answer in (ReconstructionError("too few images"), KeyboardInterrupt()):
        calibration.answer = answer
        assert run("--seed", "9") in {1, 130}
    assert {path: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


def test_failure_with_json_is_a_document_too(
    run: Callable[..., int], calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration.answer = ReconstructionError("2 of 18 images registered; take more")
    assert run("--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert document["status"] == "failed"
    assert document["message"] == "2 of 18 images registered; take more"


def test_interrupt(
    run: Callable[..., int],
    calibration: Calibration,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    calibration.answer = KeyboardInterrupt()
    assert run("--quiet") == 130
    assert capsys.readouterr().err == "Interrupted.\n"
    assert not (tmp_path / "out").exists()


def test_a_bug_is_not_hidden(run: Callable[..., int], calibration: Calibration) -> None:
    calibration.answer = ZeroDivisionError("bug")
    with pytest.raises(ZeroDivisionError):
        run()


def test_flags_win_over_the_file_which_wins_over_defaults(
    run: Callable[..., int], calibration: Calibration, tmp_path: Path
) -> None:
    config = tmp_path / "run.toml"
    config.write_text('seed = 3\n[sfm]\nmax_features = 100\n[graph]\nintrinsics = "fixed"\n')
    assert run("--config", str(config), "--sfm.max-features", "200", "--noise.pixel-px", "0.5") == 0
    options = calibration.asked["options"]
    assert options.seed == 3
    assert options.graph.intrinsics == "fixed"
    assert options.sfm.max_features == 200
    assert options.noise.pixel_px == 0.5
    assert options.sfm.threads == Options().sfm.threads
    assert read_config(tmp_path / "out" / "config.toml") == options


def test_wrong_config_is_an_option_error(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "run.toml"
    config.write_text("sead = 3\n")
    assert run("--config", str(config)) == 2
    assert "sead" in capsys.readouterr().err
    assert run("--config", str(tmp_path / "absent.toml")) == 2


def test_option_out_of_range_is_named(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("--sfm.max-features", "-5") == 2
    printed = capsys.readouterr().err
    assert "sfm.max_features is -5" in " ".join(printed.split())
    assert "tyro" not in printed
    config = tmp_path / "run.toml"
    config.write_text("[sfm]\nmax_features = -5\n")
    assert run("--config", str(config)) == 2
    assert "sfm.max_features is -5" in capsys.readouterr().err
