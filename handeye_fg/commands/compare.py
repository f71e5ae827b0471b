"""``compare``: whether two calibrations differ by more than their uncertainties explain."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for SciPy

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from handeye_fg.commands.exit_codes import EXIT_DIFFERENT, EXIT_OK, EXIT_PARTIAL
from handeye_fg.console import say, stderr_console

if TYPE_CHECKING:
    from handeye_fg.comparison import Comparison, Difference


@dataclass(frozen=True, slots=True, kw_only=True)
class Compare:
    """Hold two calibrations of a camera against each other, with the significance of their difference.

    Exit codes: 0 they agree within their uncertainties; 4 they differ; 3 they agree as far as they can be
    compared: directions are free in one of them, or it has no covariance.
    """

    first: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT1")]
    """Folder of the earlier calibration, or its result.json."""
    second: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT2")]
    """Folder of the later one, from other images."""
    significance: float = 0.01
    """The probability below which a difference counts as one, and not as chance."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the comparison as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""

    def run(self) -> int:
        """Compare, and say what came out."""
        from handeye_fg.comparison import compare
        from handeye_fg.errors import InputDataError
        from handeye_fg.io.result_reader import load_result
        from handeye_fg.io.results import to_json

        if not 0.0 < self.significance < 1.0:
            raise InputDataError(
                f"--significance is {self.significance:g}, but must be between 0 and 1"
            )
        found = compare(
            load_result(self.first), load_result(self.second), significance=self.significance
        )
        if not self.quiet:
            say(stderr_console(), _text(found))
        if self.json:
            sys.stdout.write(to_json(_document(found)))
            sys.stdout.flush()
        if found.verdict == "differ":
            return EXIT_DIFFERENT
        return EXIT_OK if found.complete else EXIT_PARTIAL


def _text(comparison: "Comparison") -> str:
    """The comparison as a person reads it."""
    from handeye_fg.report import wording

    lines = [wording.printable(comparison.message)]
    for item in comparison.differences:
        of = f" of {wording.printable(item.camera)}" if item.camera else ""
        lines += ["", f"second against first{of}, along the camera's x, y, z axes"]
        for name, part, unit, factor in (
            ("rotation", slice(0, 3), "deg", math.degrees(1.0)),
            ("translation", slice(3, 6), "mm", 1e3),
        ):
            row = f"{name:<12} {'  '.join(wording.numbers(factor * item.xi[part], 4))}"
            if item.covariance is not None:
                stds = factor * item.covariance.diagonal()[part].clip(0.0) ** 0.5
                row += f"  ± {'  '.join(wording.numbers(stds, 4))}"
            lines.append(f"{row}  {unit}")
    return "\n".join(lines)


def _document(comparison: "Comparison") -> dict[str, object]:
    """The comparison for programs."""
    return {
        "verdict": comparison.verdict,
        "probability": comparison.probability,
        "significance": comparison.significance,
        "message": comparison.message,
        "differences": [_difference(item) for item in comparison.differences],
    }


def _difference(item: "Difference") -> dict[str, object]:
    return {
        "camera": item.camera,
        "first_T_second": item.first_T_second.tolist(),
        "rotation_deg": item.rotation_deg,
        "translation_mm": item.translation_mm,
        "expected_rotation_deg": item.expected_rotation_deg,
        "expected_translation_mm": item.expected_translation_mm,
        "xi": item.xi.tolist(),
        "covariance": None if item.covariance is None else item.covariance.tolist(),
        "directions": item.directions,
        "distance": item.distance,
        "probability": item.probability,
        "probability_rotation": item.probability_rotation,
        "probability_translation": item.probability_translation,
    }
