"""The program as a whole: wrong usage, help, closed pipes, and the command report."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from handeye_fg import cli
from stand_in import Calibration


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
