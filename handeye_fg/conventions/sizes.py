"""In which unit the positions are, from the size of ordinary robots and scenes; entry point ``unit_of``.

The scale of a reconstruction is free, so that the residuals of a wrong unit are those of the right one: only
sizes tell. An arm that takes pictures moves them by decimetres, a camera on it is centimetres to
decimetres from its flange, and what it looks at is decimetres to metres away. Millimetres taken for metres make
all of them a thousand times larger.
"""

import math
from dataclasses import dataclass

# Usual sizes, metres; each holds within a factor of ten.
_EXTENT, _DEPTH, _OFFSET = 0.25, 0.5, 0.25
# Logarithms (base ten) of the mean ratio to usual sizes from which the unit is another: no cell is so
# large, or so small.
_LARGE, _SMALL = 1.3, -1.8
# A known length, such as that of a target, is right to a few per cent: logarithm.
_EXACT = 0.15
# Sizes are in these units for these logarithms, mm from the geometric mean of its neighbour on.
_MILLIMETRES_FROM = 2.2
UNIT_WORDS = {
    "mm": "to be in millimetres, not metres",
    "cm": "to be in centimetres, not metres",
    "inch": "to be in inches, not metres",
    "metres": "to be in metres, but were read as millimetres",
}
_LENGTHS = {"mm": 3.0, "cm": 2.0, "inch": math.log10(39.37), "metres": -3.0}


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Lengths in the unit in which the positions were read.

    Attributes:
        extent: of the gripper's positions; 0 where it only turned.
        offset: of the camera from the gripper, or from the base.
        depth: of the scene from the camera; None: not known.
        scale: of camera poses that are in metres; None: they have a unit of their own.
    """

    extent: float
    offset: float
    depth: float | None = None
    scale: float | None = None


def unit_of(sizes: Sizes) -> str:
    """The unit of the positions, as a name for ``--convention``; "" where metres are plausible."""
    if sizes.scale is not None:
        ratio = math.log10(sizes.scale)
        near = [unit for unit, length in _LENGTHS.items() if abs(ratio - length) < _EXACT]
        return near[0] if near else ""
    ratios = [
        math.log10(value / usual)
        for value, usual in (
            (sizes.extent, _EXTENT),
            (sizes.depth or 0.0, _DEPTH),
            (sizes.offset, _OFFSET),
        )
        if value > 0.0
    ]
    if not ratios:
        return ""
    mean = sum(ratios) / len(ratios)
    if mean > _LARGE:
        return "mm" if mean > _MILLIMETRES_FROM else "cm"
    return "metres" if mean < _SMALL else ""
