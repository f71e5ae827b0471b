"""Readings that cannot be: a turn keeps its angle whatever X is; entry point ``likely``."""

from collections.abc import Sequence

import numpy as np

from handeye_fg.frames import Array, rotation_angle
from handeye_fg.types import Indices

_PAIRS = 300
# With a fifth of the rows wrong two thirds of the pairs are right; this part of them tells.
_SHARE = 0.35
# Angles that agree within this (radians), or within twice the best, may be right.
_ALIKE = np.deg2rad(3.0)
# More than this (radians) is as bad as any more.
_APART = np.deg2rad(10.0)
# Readings up to this rank are tried whenever they are possible, of the others so many.
_PLAIN, _MOST = 1.0, 80
_EQUAL = np.deg2rad(0.5)


def likely(rotations: Sequence[Array], ranks: Sequence[float], world_R_camera: Array) -> list[int]:
    """The readings whose turns have the camera's angles.

    Args:
        rotations: of each reading (n, 3, 3).
        ranks: how far-fetched each is.
        world_R_camera: (n, 3, 3).
    """
    i, j = _pairs(len(world_R_camera))
    camera = _angles(world_R_camera, i, j)
    apart = np.array([np.abs(_angles(R, i, j) - camera) for R in rotations])
    typical = np.quantile(apart, _SHARE, axis=1)
    possible = typical <= max(_ALIKE, 2.0 * typical.min())
    plain = np.asarray(ranks) <= _PLAIN
    # Of the others those with the fewest contradictions, of equals the least far-fetched.
    contradictions = np.minimum(apart, _APART).mean(axis=1) // _EQUAL
    order = np.lexsort((np.asarray(ranks), contradictions))
    others = [k for k in order.tolist() if possible[k] and not plain[k]]
    return [*np.flatnonzero(possible & plain).tolist(), *others[:_MOST]]


def _angles(rotation: Array, i: Indices, j: Indices) -> Array:
    return rotation_angle(np.swapaxes(rotation[i], 1, 2) @ rotation[j])


def _pairs(n: int) -> tuple[Indices, Indices]:
    """All pairs of n poses, or a sample."""
    i, j = np.triu_indices(n, k=1)
    if len(i) > _PAIRS:
        chosen = np.random.default_rng(0).choice(len(i), _PAIRS, replace=False)
        i, j = i[chosen], j[chosen]
    return i, j
