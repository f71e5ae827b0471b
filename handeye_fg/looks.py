"""How images look beside the others of their set: copies, blur and darkness; ``copies`` and ``flaws``.

Images of one scene by one camera are alike in sharpness, brightness and contrast, so that each set says
itself what is usual. Nothing here decides that an image is of no use.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from handeye_fg.frames import Array

# Squares of so many pixels by whose means images are compared, and so many of these for a first look.
_CELL, _BLOCK = 8, 8
# Mean levels of all squares of two files of one image are this near, after another compression too.
_SAME_LEVELS = 3.0
# A blank image, lens cap on, is not a copy of another one.
_BLANK = 3.0
# Of the usual: sets of sharp images go down to 0.8, a blur of 2 px (standard deviation) or a motion of 10
# px comes to 0.6, and more blur to 0.45.
_BLURRED = 0.7
# Of the usual; sets in steady light keep above 0.6.
_DARK = 0.4
_FLAT = 0.3
_BRIGHT = 1.3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """What tells images apart at a glance.

    Attributes:
        content: SHA-256 of the grey levels.
        level: their mean, of 255.
        contrast: their standard deviation.
        sharpness: gradient at 2 px over that at 8 px, of the direction in which it is least; 0.25 for a
            smooth image, whatever it shows.
        cells: mean levels (h, w) of squares of 8 px.
    """

    content: str
    level: float
    contrast: float
    sharpness: float
    cells: NDArray[np.float32]


def look_at(grey: NDArray[np.uint8]) -> Look:
    """The look of an image (h, w)."""
    fine, cells = _means(grey, 2), _means(grey, _CELL)
    gradients = [np.sqrt(_energy(cells, axis)) for axis in (0, 1)]
    ratios = [
        np.sqrt(_energy(fine, axis)) / gradient if gradient > 0.0 else 0.0
        for axis, gradient in enumerate(gradients)
    ]
    return Look(
        content=hashlib.sha256(repr(grey.shape).encode() + grey.tobytes()).hexdigest(),
        level=float(np.mean(grey)),
        contrast=float(np.std(grey)),
        sharpness=float(min(ratios)),
        cells=cells,
    )


def _means(grey: NDArray[np.uint8], size: int) -> NDArray[np.float32]:
    """Means over squares; a rest at the right and bottom border is left out."""
    size = min(size, *grey.shape)
    height, width = (n // size * size for n in grey.shape)
    squares = grey[:height, :width].reshape(height // size, size, width // size, size)
    return np.asarray(squares.mean(axis=(1, 3), dtype=np.float32))


def _energy(levels: NDArray[np.float32], axis: int) -> float:
    """Mean square of the differences between neighbours."""
    return float(np.mean(np.diff(levels, axis=axis) ** 2)) if levels.shape[axis] > 1 else 0.0


def copies(looks: Mapping[str, Look]) -> dict[str, tuple[str, bool]]:
    """Images that show what an earlier one shows.

    Args:
        looks: of images of one size.

    Returns:
        For each such image the first that looks so, and whether their grey levels are the same to the
        last; otherwise they differ by no more than another compression makes.
    """
    names = [name for name, look in looks.items() if look.contrast > _BLANK]
    if not names:
        return {}
    coarse = np.array([_blocks(looks[name].cells).ravel() for name in names])
    found: dict[str, tuple[str, bool]] = {}
    # Where squares are near, so are means of squares: a quick test that misses none.
    for i, j in sorted(KDTree(coarse).query_pairs(_SAME_LEVELS, p=np.inf)):
        first, second = looks[names[i]], looks[names[j]]
        same = first.content == second.content
        near = float(np.max(np.abs(first.cells - second.cells))) < _SAME_LEVELS
        if (same or near) and names[i] not in found and names[j] not in found:
            found[names[j]] = (names[i], same)
    return found


def _blocks(cells: NDArray[np.float32]) -> Array:
    """Means (k, l) over blocks of squares."""
    size = min(_BLOCK, *cells.shape)
    height, width = (n // size * size for n in cells.shape)
    blocks = cells[:height, :width].reshape(height // size, size, width // size, size)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float64)


def flaws(looks: Mapping[str, Look]) -> dict[str, str]:
    """What is wrong with those images that look far worse than is usual in their set, in words."""
    if not looks:
        return {}
    figures = np.array([(look.level, look.contrast, look.sharpness) for look in looks.values()])
    usual = np.median(figures, axis=0)
    found = {}
    for name, (level, contrast, sharpness) in zip(looks, figures.tolist(), strict=True):
        levels = f"(mean grey level {level:.0f} of 255, usual in this set {usual[0]:.0f})"
        if level < _DARK * usual[0]:
            found[name] = f"dark {levels}"
        elif contrast < _FLAT * usual[1]:
            lit = "overexposed" if level > _BRIGHT * usual[0] else "without contrast"
            found[name] = f"{lit} {levels}"
        elif sharpness < _BLURRED * usual[2]:
            found[name] = (
                f"blurred (fine gradients {100.0 * sharpness / usual[2]:.0f} % of what is usual in this set)"
            )
    return found
