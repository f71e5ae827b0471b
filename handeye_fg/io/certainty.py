"""How certain a result's figures are, and its form in ``result.json``: the key ``certainty``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, cast, get_args

import numpy as np

from handeye_fg.findings import LevelCertainty, NoiseLevels, RobotErrors
from handeye_fg.frames import Array
from handeye_fg.io.fields import Fields, finite

Document = dict[str, object]
Source = Literal["data", "prior", "user"]
Multiples = tuple[float, float, float]

# Name in NoiseLevels, name in the file, and units of the file in one of ours.
_LEVELS = {
    "pixel": ("pixel_px", 1.0),
    "robot_rotation": ("robot_rotation_deg", math.degrees(1.0)),
    "robot_translation": ("robot_translation_mm", 1e3),
    "corner": ("corner_px", 1.0),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CertaintyReport:
    """Intervals of X, of the scale and of the noise levels, all of 95 %.

    Attributes:
        half_widths: (7,) of X's components in the order of the covariance, radians and metres, and of
            the logarithm of the scale: Student's t with the degrees of freedom. NaN where free.
        degrees_of_freedom: (7,) of the same; infinite where the noise levels are known.
        levels: of the noise levels, by their names in ``NoiseLevels``.
        robot: whether the robot's errors are white, and what was done if not.
    """

    half_widths: Array
    degrees_of_freedom: Array
    levels: Mapping[str, LevelCertainty]
    robot: RobotErrors

    def __post_init__(self) -> None:
        for name in ("half_widths", "degrees_of_freedom"):
            values = np.array(getattr(self, name), dtype=np.float64)
            if values.shape != (7,) or (values < 0.0).any():
                raise ValueError(f"{name} is {values} but expected seven numbers above zero")
            values.setflags(write=False)
            object.__setattr__(self, name, values)


def certainty_document(report: CertaintyReport, noise: NoiseLevels) -> Document:
    """The content of the key ``certainty``."""
    robot = report.robot
    return {
        "half_width_rotation_deg": [_finite(v) for v in np.rad2deg(report.half_widths[:3])],
        "half_width_translation_mm": [_finite(v) for v in 1e3 * report.half_widths[3:6]],
        "half_width_log_scale": _finite(report.half_widths[6]),
        "degrees_of_freedom": [_finite(value) for value in report.degrees_of_freedom],
        "noise": {
            _LEVELS[name][0]: {
                "degrees_of_freedom": _finite(level.degrees_of_freedom),
                "interval": [
                    _LEVELS[name][1] * getattr(noise, name) * end for end in (level.low, level.high)
                ],
                "source": level.source,
                "found": None
                if level.found is None
                else [_LEVELS[name][1] * getattr(noise, name) * part for part in level.found],
            }
            for name, level in report.levels.items()
        },
        "robot": {
            "white": bool(robot.white),
            "probability": float(robot.probability),
            "resampled_ratio": robot.resampled_ratio,
            "hidden_rotation_deg": _scaled(robot.hidden_rotation, math.degrees(1.0)),
            "hidden_translation_mm": _scaled(robot.hidden_translation, 1e3),
            "reason": robot.reason,
        },
    }


def read_certainty(fields: Fields, noise: NoiseLevels) -> CertaintyReport:
    """The report from the content of the key ``certainty``.

    Raises:
        InputDataError: it has not the form of one.
    """
    robot, levels = fields.mapping("robot"), fields.mapping("noise")
    log_scale = fields.optional_number("half_width_log_scale")
    names = {file: (name, unit) for name, (file, unit) in _LEVELS.items() if file in levels.values}
    return CertaintyReport(
        half_widths=np.concatenate(
            [
                np.deg2rad(_numbers(fields, "half_width_rotation_deg", 3, math.nan)),
                1e-3 * _numbers(fields, "half_width_translation_mm", 3, math.nan),
                [math.nan if log_scale is None else log_scale],
            ]
        ),
        degrees_of_freedom=_numbers(fields, "degrees_of_freedom", 7, math.inf),
        levels={
            name: _level(levels.mapping(file), unit * getattr(noise, name))
            for file, (name, unit) in names.items()
        },
        robot=RobotErrors(
            white=robot.flag("white"),
            probability=robot.number("probability"),
            resampled_ratio=robot.optional_number("resampled_ratio"),
            hidden_rotation=_scaled(
                robot.optional_number("hidden_rotation_deg"), math.radians(1.0)
            ),
            hidden_translation=_scaled(robot.optional_number("hidden_translation_mm"), 1e-3),
            reason=robot.text("reason"),
        ),
    )


def _numbers(fields: Fields, key: str, count: int, missing: float) -> Array:
    """Numbers, some of which may be null."""
    values = fields.values.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise fields.error(key, f"{count} numbers or nulls")
    numbers = [missing if value is None else finite(value) for value in values]
    if None in numbers:
        raise fields.error(key, f"{count} numbers or nulls")
    return np.array(numbers, dtype=np.float64)


def _level(fields: Fields, sigma: float) -> LevelCertainty:
    low, high = fields.array("interval", (2,)) / sigma
    freedom = fields.optional_number("degrees_of_freedom")
    found = fields.optional_array("found", (3,))
    return LevelCertainty(
        degrees_of_freedom=math.inf if freedom is None else freedom,
        low=float(low),
        high=float(high),
        source=cast("Source", fields.text("source", get_args(Source))),
        found=None if found is None else cast("Multiples", tuple((found / sigma).tolist())),
    )


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _scaled(value: float | None, unit: float) -> float | None:
    return None if value is None else unit * float(value)
