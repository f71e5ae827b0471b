"""The result outside of the page: figures as files, Markdown."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from handeye_fg.io.results import Result
from handeye_fg.report import markdown_text, write_figures


def test_figures_are_files_in_colours_of_their_own(result: Result, tmp_path: Path) -> None:
    files = write_figures(result, tmp_path / "figures")
    names = {file.stem for file in files}
    assert {"distance", "residuals", "histograms", "influence", "correlation"} <= names
    for file in files:
        if file.suffix == ".svg":
            text = file.read_text(encoding="utf-8")
            ET.fromstring(text)
            assert "var(--" not in text
            assert "#010101" not in text
            continue
        with Image.open(file) as image:
            pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
        assert (pixels[0] == 255).all()  # paper
        coloured = np.ptp(pixels, axis=1) > 60
        assert coloured.mean() > 1e-3, file.name  # no stand-in, all of which are black, is left


def test_markdown_says_what_a_person_needs(result: Result) -> None:
    text = markdown_text(result)
    for words in (
        "# Hand-eye calibration: gripper\\_T\\_camera",
        "Usable for 2 mm tasks",
        "All six components of X are determined.",
        "| translation, std, mm |",
        "| distance, mm |",
        "robot pose rejected",
        "too few matches with other images",
    ):
        assert words in text, words
    assert text.count("```") == 2


@pytest.mark.parametrize("name", ["<img src=x onerror=alert(1)>.jpg", "a|b`c`.jpg", "![x](y).jpg"])
def test_markdown_shows_names_as_text(name: str, renamed: Callable[[str], Result]) -> None:
    rows = [line for line in markdown_text(renamed(name)).splitlines() if " | not used | " in line]
    (row,) = rows
    shown = row.split(" | ")[0].removeprefix("| ")
    assert shown.replace("\\", "") == name
    for char in "<>|`![]":
        assert shown.count(char) == shown.count(f"\\{char}")
