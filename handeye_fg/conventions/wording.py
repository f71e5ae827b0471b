"""A verdict in words: one sentence for an error or a note, and a table for ``check``."""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np

from handeye_fg.conventions.evidence import Evidence
from handeye_fg.conventions.sizes import UNIT_WORDS
from handeye_fg.conventions.verdict import Judged, Verdict
from handeye_fg.conventions.whole_poses import UNITS

_OTHER = {"eye-in-hand": "eye-to-hand", "eye-to-hand": "eye-in-hand"}
_MOST_ALIKE = 4


def sentence(
    verdict: Verdict, names: Sequence[str], of: Literal["robot", "camera"] = "robot"
) -> str:
    """What the poses are, and what to do.

    Args:
        verdict: the verdict.
        names: images of the rows that were judged, in their order.
        of: whose poses were judged; those of the camera have flags of their own in ``solve``.
    """
    match verdict.kind:
        case "right":
            return f"The poses are as they are said to be: {_agreement(verdict.given.evidence)}."
        case "undecided":
            return _undecided(verdict)
        case "contradiction":
            return (
                f"robot and camera move differently ({_residual(verdict.given.evidence)}), and none of "
                f"{verdict.n_readings} other readings of the poses (inverted, transposed, other quaternion or "
                "Euler order, mirrored, rows shifted) makes them agree; check that the poses belong to "
                "these images and their format; where things in the images look alike, give the camera "
                "file, masks and more images"
            )
        case "wrong":
            if of == "robot":
                return _wrong(verdict, names)
            words = verdict.best.reading.words.replace("gripper_T_base", "camera_T_world")
            # Held against the robot's poses, they have so many of their units in a metre.
            unit = 1.0 / verdict.best.evidence.metres_per_world_unit
            return (
                f"the camera's poses look {words} ({_instead(verdict, unit, unit)}); "
                f"{_flags(verdict).replace('--', '--camera-file.')}"
            )


def remedy(verdict: Verdict) -> str:
    """What to do about poses that are not as they are said to be."""
    both = _flags(verdict)
    if verdict.best.reading.name == "inverted":
        setup = f"--setup {_OTHER[verdict.setup]}"
        if verdict.unit:
            setup += f" and {_unit_flag(verdict.unit).removeprefix('run again with ')}"
        what = "the camera stands still" if verdict.setup == "eye-in-hand" else "the camera moves"
        both = _ordered(verdict, both, f"run again with {setup} if {what}")
    return f"{both}, or with --auto-convention" if verdict.fixable else both


def _flags(verdict: Verdict) -> str:
    """What reads the poses right."""
    flags, reading = [], verdict.best.reading
    if verdict.best is not verdict.given:
        flags.append(reading.flags or f"run again with --convention {reading.name}")
    if verdict.unit:
        flags.append(_unit_flag(verdict.unit))
    return " and ".join(flags).replace(" and run again with", " and")


def _wrong(verdict: Verdict, names: Sequence[str]) -> str:
    """Why the poses are refused."""
    if verdict.parts is not None:
        parts = verdict.parts
        offset = f"{1e3 * parts.translation:.3g} mm"
        if parts.rotation > math.radians(1.0):
            offset += f" and {np.rad2deg(parts.rotation):.3g} deg"
        cause = {
            "tool": "the tool (TCP) was changed there, or the flange reported instead of it",
            "base": "the base or its frame was moved there",
            "tool and base": "tool and base were changed there",
        }[parts.change]
        return (
            f"your poses look as if they were of two parts: from {names[parts.row]} on they differ by "
            f"{offset} from those before, as if {cause}; calibrate the parts apart, or "
            "export all poses with the same tool and base"
        )
    found = []
    if verdict.best is not verdict.given:
        found.append(_looks(verdict))
    if verdict.unit:
        found.append(UNIT_WORDS[verdict.unit])
    what = ", and ".join(found)
    alike = [one.reading for one in verdict.alike[:_MOST_ALIKE]]
    also = f"; just as well they may look {_listed([one.words for one in alike])}" if alike else ""
    return f"your poses look {what} ({_instead(verdict, UNITS.get(verdict.unit, 1.0))}){also}; {remedy(verdict)}"


def _instead(verdict: Verdict, unit: float, given_unit: float = 1.0) -> str:
    """How well the poses agree then; units of the positions, metres."""
    residual = _residual(verdict.best.evidence, unit)
    if verdict.best is not verdict.given:
        return f"{residual} instead of {_numbers(verdict.given.evidence, given_unit)}"
    length = np.linalg.norm(verdict.best.evidence.gripper_T_camera[:3, 3])
    return f"{residual}, but X is then {length:.3g} m long"


def _looks(verdict: Verdict) -> str:
    """What the poses look like; of the inverse and the other setup the likelier one first."""
    reading = verdict.best.reading
    if reading.name != "inverted":
        return reading.words
    return _ordered(verdict, reading.words, f"like those of setup {_OTHER[verdict.setup]}")


def _ordered(verdict: Verdict, inverse: str, setup: str) -> str:
    """An inverse and the other setup are the same to every equation; the length of X tells likelier ones."""
    on_gripper = verdict.mounted_on_gripper
    said = verdict.setup == "eye-in-hand"
    both = [inverse, setup] if on_gripper in (None, said) else [setup, inverse]
    return ", or ".join(both)


def _undecided(verdict: Verdict) -> str:
    """What is not told apart."""
    agreement = _agreement(verdict.given.evidence)
    if not verdict.alike:
        return "The poses cannot be checked: robot or camera did not move; take images from different poses"
    alike = _listed([one.reading.words for one in verdict.alike[:_MOST_ALIKE]])
    more = len(verdict.alike) - _MOST_ALIKE
    return (
        f"The poses may be as they are said to be ({agreement}), but the motions cannot tell: they may also "
        f"look {alike}{f', or {more} more' if more > 0 else ''}; add poses that turn the camera by 20 degrees "
        "and more about two axes or more"
    )


def _unit_flag(unit: str) -> str:
    return {"mm": "run again with --units mm", "metres": "run again with --units m"}.get(
        unit, f"run again with --convention {unit}"
    )


def _agreement(evidence: Evidence) -> str:
    right = int(np.count_nonzero(evidence.right))
    n = len(evidence.right)
    rows = f"{n} rows" if right == n else f"{right} of {n} rows"
    return f"{rows} agree with the images within {_numbers(evidence)}"


def _residual(evidence: Evidence, unit: float = 1.0) -> str:
    return f"residual {_numbers(evidence, unit)}"


def _numbers(evidence: Evidence, unit: float = 1.0) -> str:
    """Typical angle and distance; ``unit``: of the positions, metres."""
    degrees, metres = np.rad2deg(evidence.typical[0]), unit * evidence.typical[1]
    if not math.isfinite(degrees):
        return "no agreement at all"
    millimetres = f"{1e3 * metres:.2g} mm" if metres < 0.1 else f"{1e3 * metres:.0f} mm"
    return f"{degrees:.2g} deg / {millimetres}"


def _listed(parts: Sequence[str]) -> str:
    return ", or ".join(parts)


def table(verdict: Verdict, most: int = 12) -> str:
    """The readings that were tried, best first: name, residuals, rows, words."""
    lines = [f"{'reading':<24}{'rotation':>12}{'translation':>14}{'rows':>10}   the poses look"]
    shown = list(verdict.tried[:most])
    if verdict.given not in shown:
        shown.append(verdict.given)
    lines += [_line(one) for one in shown]
    hidden = len(verdict.tried) - len(shown)
    if hidden > 0:
        lines.append(f"... {hidden} more fit worse")
    return "\n".join(lines)


def _line(one: Judged) -> str:
    evidence = one.evidence
    degrees, metres = evidence.typical
    if not math.isfinite(degrees):
        return f"{one.reading.name:<24}{'-':>12}{'-':>14}{'-':>10}   {one.reading.words}"
    rows = f"{np.count_nonzero(evidence.right)} of {len(evidence.right)}"
    return (
        f"{one.reading.name:<24}{np.rad2deg(degrees):>8.3f} deg{1e3 * metres:>11.2f} mm{rows:>10}   "
        f"{one.reading.words}"
    )
