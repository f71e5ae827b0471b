import dataclasses
import io
import json
import logging
import re
import runpy
import subprocess
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from handeye_fg import cli
from handeye_fg.console import Lines
from handeye_fg.errors import (
    ConvergenceError,
    HandEyeError,
    InputDataError,
    ReconstructionError,
    UnobservableError,
)
from handeye_fg.findings import FreeDirection
from handeye_fg.io.config import read_config
from handeye_fg.io.results import Result
from handeye_fg.options import Options

# The tests are no package: the hand-made result of the report's tests is read from its file.
make_result: Callable[..., Result] = runpy.run_path(
    str(Path(__file__).parent / "report" / "conftest.py")
)["make_result"]


@dataclasses.dataclass
class Calibration:
    """A stand-in for the pipeline: answers at once, or raises, and keeps what it was asked."""

    answer: Result | BaseException
    asked: dict[str, Any] = dataclasses.field(default_factory=dict)
    verbose: list[bool] = dataclasses.field(default_factory=list)

    def calibrate(
        self,
        images: Path,
        poses: Path,
        camera: Path | None = None,
        masks: Path | None = None,
        options: Options | None = None,
        *,
        output: Path | None = None,
        target: Path | None = None,
        holdout: tuple[Path, Path] | None = None,
        progress: Callable[[str, int, int | None], None],
    ) -> Result:
        self.asked = {"images": images, "poses": poses, "camera": camera, "masks": masks}
        self.asked |= {"options": options, "output": output, "target": target, "holdout": holdout}
        for done in range(3):
            progress("images", done, 2)
        progress("iterations", 1, None)
        progress("iterations", 7, None)
        progress("registered", 2, 2)
        logging.getLogger("handeye_fg.sfm").info("a detail of the library")
        logging.getLogger("handeye_fg.sfm").warning("a warning of the library")
        if isinstance(self.answer, BaseException):
            raise self.answer
        return self.answer


@pytest.fixture
def result() -> Result:
    return make_result()


@pytest.fixture
def calibration(result: Result, monkeypatch: pytest.MonkeyPatch) -> Calibration:
    stand_in = Calibration(result)
    pipeline, sfm = types.ModuleType("pipeline"), types.ModuleType("sfm")
    pipeline.calibrate = stand_in.calibrate  # type: ignore[attr-defined]  # a bare module
    sfm.set_verbosity = stand_in.verbose.append  # type: ignore[attr-defined]  # likewise
    monkeypatch.setitem(sys.modules, "handeye_fg.pipeline", pipeline)
    monkeypatch.setitem(sys.modules, "handeye_fg.sfm", sfm)
    return stand_in


@pytest.fixture
def run(tmp_path: Path, calibration: Calibration) -> Callable[..., int]:
    def run(*flags: str) -> int:
        return cli.main(
            ["calibrate", "images", "poses.csv", "--output", str(tmp_path / "out"), *flags]
        )

    return run


@pytest.fixture
def partial(result: Result) -> Result:
    free = FreeDirection(
        kind="translation",
        vector=np.array([0.0, 0.0, 1.0]),
        frame="gripper",
        description="Height is free.",
    )
    return dataclasses.replace(result, status="partial", free_directions=(free,))


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


def test_json_alone_is_on_stdout(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("--json") == 0
    assert capsys.readouterr().out == (tmp_path / "out" / "result.json").read_text()


def test_quiet_is_silent(run: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    assert run("-q") == 0
    printed = capsys.readouterr()
    assert (printed.out, printed.err) == ("", "")


def test_log_file_has_a_line_at_each_start_and_end(
    run: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run() == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line for line in lines if re.match("reading|refining|registering", line)] == [
        "reading images ...",
        "reading images: 2 of 2",
        "refining ...",
        "refining: 7",
        "registering images ...",
        "registering images: 2 of 2",
    ]


def test_log_file_says_now_and_then_how_long_it_takes() -> None:
    text, now = io.StringIO(), 0.0
    lines = Lines(Console(file=text), lambda: now)
    for done in range(40, 101):  # 40 were there already
        lines("pairs", done, 100)
        now += 3.0
    lines.close()
    assert text.getvalue().splitlines()[:4] == [
        "matching pairs ...",
        "matching pairs: 44 of 100, 3 min left",
        "matching pairs: 48 of 100, 3 min left",
        "matching pairs: 52 of 100, 2 min left",
    ]
    assert "matching pairs: 72 of 100, 84 s left" in text.getvalue()


def test_terminal_has_bars(
    run: Callable[..., int], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    assert run() == 0
    printed = capsys.readouterr().err
    assert "reading images" in printed
    assert "2/2" in printed
    assert "7/7" in printed
    assert printed.rindex("2/2") > printed.rindex("/?")


def test_verbosity(
    run: Callable[..., int], calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run() == 0
    printed = capsys.readouterr().err
    assert "a warning of the library" in printed
    assert "a detail of the library" not in printed
    assert run("-v") == 0
    assert "a detail of the library" in capsys.readouterr().err
    assert calibration.verbose == [False, True]
    assert logging.getLogger("handeye_fg").handlers == []


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


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["calibrat"],
        ["calibrate"],
        ["calibrate", "images"],
        ["calibrate", "images", "poses.csv", "--sfm.max-feature", "3"],
        ["calibrate", "images", "poses.csv", "--sfm.max-features", "many"],
        ["calibrate", "images", "poses.csv", "--setup", "eye"],
        ["report"],
    ],
)
def test_wrong_usage_is_code_2(
    arguments: list[str], calibration: Calibration, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err != ""
    assert calibration.asked == {}


def test_report_again(
    run: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("--quiet") == 0
    page = tmp_path / "out" / "report.html"
    first = page.read_text(encoding="utf-8")
    page.unlink()
    assert cli.main(["report", str(tmp_path / "out")]) == 0
    assert f"Report: {page}" in capsys.readouterr().err
    assert page.read_text(encoding="utf-8") == first


def test_report_without_a_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", str(tmp_path)]) == 2
    assert "result.json" in capsys.readouterr().err


def test_help_explains_every_option(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["calibrate", "--help"]) == 0
    text = capsys.readouterr().out
    for words in ("IMAGES POSES", "--sfm.max-features", "--noise.pixel-px", "--graph.intrinsics"):
        assert words in text, words


@pytest.mark.parametrize("flag", ["--help", "--version"])
def test_as_a_program(flag: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "handeye_fg", flag], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("usage: handeye-fg" if flag == "--help" else "handeye-fg 0.")
    assert done.stderr == ""


def test_closed_pipe_is_no_traceback() -> None:
    command = [sys.executable, "-u", "-m", "handeye_fg", "calibrate", "--help"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 1
