"""Presets of the search for features."""

import pytest

from handeye_fg.options import Preset, SfmOptions
from handeye_fg.sfm.presets import EFFORTS, effort_of


@pytest.mark.parametrize(("n", "preset"), [(3, "thorough"), (17, "normal"), (500, "normal")])
def test_automatic(n: int, preset: str) -> None:
    assert effort_of(SfmOptions(), n) == EFFORTS[preset]


@pytest.mark.parametrize("preset", ["fast", "normal", "thorough"])
def test_named(preset: Preset) -> None:
    effort = effort_of(SfmOptions(preset=preset, max_features=77), 40)
    assert effort.max_features == 77
    assert effort.first_octave == EFFORTS[preset].first_octave
    assert effort_of(SfmOptions(preset=preset), 40) == EFFORTS[preset]
