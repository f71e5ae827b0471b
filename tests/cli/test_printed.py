"""What the command prints, and where: progress, bars, the result as text or JSON."""

import io
import logging
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

from handeye_fg.console import Lines
from stand_in import Calibration


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
