"""The noise levels against what was said of them, as a table and in words."""

import math
from dataclasses import dataclass

from handeye_fg.findings import LevelCertainty
from handeye_fg.io.results import Result
from handeye_fg.report.wording import significant

# By ISO 9283 the repeatability is the mean distance plus three of its standard deviations; of normal errors
# of one size on all axes that is so many times the standard deviation of an axis.
_REPEATABILITY = 3.62


@dataclass(frozen=True, slots=True)
class Level:
    """A noise level, as text.

    Attributes:
        what: whose noise it is.
        value, unit: standard deviation per axis.
        interval: of 95 %; "" where there is none.
        basis: what it rests on; "" where that is not known.
        found: whether it was found in the data alone.
    """

    what: str
    value: str
    unit: str
    interval: str
    basis: str
    found: bool


def levels(result: Result) -> tuple[Level, ...]:
    """Noise levels, and what each rests on."""
    found = result.noise
    if found is None:
        return ()
    certainties = {} if result.certainty is None else result.certainty.levels
    kinds = [
        ("image observation", "pixel", 1.0, "px"),
        ("corner of the target", "corner", 1.0, "px"),
        ("reported robot orientation", "robot_rotation", math.degrees(1.0), "deg"),
        ("reported robot position", "robot_translation", 1000.0, "mm"),
    ]
    return tuple(
        _level(what, unit * sigma, name, certainties.get(key))
        for what, key, unit, name in kinds
        if (sigma := getattr(found, key)) is not None and math.isfinite(sigma)
    )


def _level(what: str, sigma: float, unit: str, level: LevelCertainty | None) -> Level:
    interval = basis = ""
    if level is not None and level.source != "user":
        interval = f"{significant(level.low * sigma)} to {significant(level.high * sigma)}"
    if level is not None:
        basis = {
            "user": f"given{_held_against(level, sigma)}",
            "prior": "the data say next to nothing: a prior for usual arms decided",
            "data": f"{level.degrees_of_freedom:.0f} degrees of freedom",
        }[level.source]
    found = level is None or level.source == "data"
    return Level(what, significant(sigma), unit, interval, basis, found)


def _held_against(level: LevelCertainty, sigma: float) -> str:
    """What the residuals say of a given level."""
    if level.found is None:
        return ""
    value, low, high = (significant(part * sigma, 2) for part in level.found)
    agrees = level.found[1] <= 1.0 <= level.found[2]
    judged = (
        "which agrees" if agrees else "which is less" if level.found[2] < 1.0 else "which is more"
    )
    return f"; the residuals say {value} ({low} to {high}), {judged}"


def doubtful(result: Result) -> tuple[str, ...]:
    """The levels that were not found in the data alone, each in a sentence."""
    return tuple(
        f"{level.what.capitalize()}: {level.value} {level.unit}, {level.basis}."
        for level in levels(result)
        if not level.found
    )


def remarks(result: Result) -> tuple[str, ...]:
    """What else there is to say of the noise, each in a sentence."""
    said = (_data_sheet(result), _alike(result))
    return tuple(sentence for sentence in said if sentence)


def _data_sheet(result: Result) -> str:
    """The noise of the reported positions against the arm's data sheet; "" where nobody stated that."""
    if result.repeatability is None or result.noise is None:
        return ""
    stated = 1e3 * result.repeatability
    times = 1e3 * result.noise.robot_translation / (stated / _REPEATABILITY)
    return (
        f"The data sheet states a repeatability of {significant(stated)} mm, which is {significant(stated / _REPEATABILITY, 2)} mm "
        f"per axis. The reported positions are off by {significant(times, 2)} times as much: to return to a place is easier "
        "than to know where it is, so several times are usual, and dozens mean a wrong tool, time or calibration of the arm."
    )


def _alike(result: Result) -> str:
    """By how much errors of neighbouring features agree."""
    if result.noise is None or result.noise.image_inflation <= 1.0:
        return ""
    return (
        "Neighbouring features err alike: what the images say together has "
        f"{significant(result.noise.image_inflation)} times the variance that independent errors would give it. "
        "This is part of all standard deviations here."
    )
