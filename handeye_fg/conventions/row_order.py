"""Rows that belong to other images: ``of_rows``."""

import re
from collections.abc import Sequence
from itertools import product

import numpy as np

from handeye_fg.conventions.reading import Conversion, Reading
from handeye_fg.types import RobotPoses

# Of long lists not every shift, and not every row after which one may have been lost, is tried.
_FARTHEST_SHIFT, _MOST_LOSSES = 150, 300


def of_rows(poses: RobotPoses) -> list[Reading]:
    """Rows that belong to other images."""
    n = len(poses.names)

    def taken(rows: Sequence[int]) -> Conversion:
        return lambda poses: np.asarray(poses.base_T_gripper[list(rows)])

    found = [
        Reading(
            name="reversed",
            words="to stand in the reverse order of the images",
            rank=1.0,
            convert=taken(range(n)[::-1]),
        )
    ]
    numeric = sorted(range(n), key=lambda k: _by_number(poses.names[k]))
    plain = sorted(range(n), key=lambda k: poses.names[k])
    if numeric != plain:
        # The k-th name in one order has the pose of the k-th name in the other.
        for name, one, other in (("as-text", plain, numeric), ("as-numbers", numeric, plain)):
            rows = [0] * n
            for a, b in zip(one, other, strict=True):
                rows[b] = a
            found.append(
                Reading(
                    name=f"sorted-{name}",
                    words="to be sorted otherwise than the images (1, 10, 2 against 1, 2, 10)",
                    rank=1.0,
                    convert=taken(rows),
                )
            )
    farthest = min(n // 2, _FARTHEST_SHIFT)
    for k in range(-farthest, farthest + 1):
        if k:
            rows = [(i + k) % n for i in range(n)]
            by = f"{abs(k)} row{'' if abs(k) == 1 else 's'}"
            where = "below" if k > 0 else "above"
            found.append(
                Reading(
                    name=f"shifted{k:+d}",
                    words=f"shifted against the images: each image's pose stands {by} {where} its own",
                    rank=1.0 if abs(k) <= 2 else 1.5,
                    convert=taken(rows),
                )
            )
    for k, first in product((-1, 1), range(2, n - 2, 1 + n // _MOST_LOSSES)):
        rows = [i + k * (i >= first) for i in range(n)]
        found.append(
            Reading(
                name=f"shifted{k:+d}-from-{first}",
                words=f"shifted by one row from {poses.names[first]} on (an image or a pose was lost there)",
                rank=1.5,
                convert=taken([min(row, n - 1) for row in rows]),
            )
        )
    return found


def _by_number(name: str) -> tuple[tuple[int, int, str], ...]:
    """A name with its numbers as numbers, for sorting."""
    parts = re.findall(r"\d+|\D+", name)
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)
