"""The only place that makes a ``gtsam.CustomFactor``.

GTSAM reads past the end of a Jacobian block that has too few rows or was left unset, and accepts too
few columns in silence; here every shape is checked before GTSAM sees it. The error function is a
closure: a bound method of a subclass would never be freed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Residual = Callable[..., tuple[Array, tuple[Array, ...]]]
"""``residual(*unknowns, jacobian) -> (residual, blocks)``; ``blocks`` is empty without ``jacobian``."""


@dataclass(frozen=True, slots=True)
class Kind:
    """How a kind of variable is read from ``gtsam.Values``, and the size of its tangent."""

    read: Callable[[gtsam.Values, int], Any]
    tangent_dim: int


@dataclass(frozen=True, slots=True)
class Key:
    """A variable of a factor: its GTSAM key and its kind."""

    symbol: int
    kind: Kind


_POSE = Kind(lambda values, symbol: values.atPose3(symbol), 6)
_SCALAR = Kind(lambda values, symbol: values.atDouble(symbol), 1)


def pose_key(symbol: int) -> Key:
    """Key of a ``gtsam.Pose3``."""
    return Key(symbol, _POSE)


def scalar_key(symbol: int) -> Key:
    """Key of a double."""
    return Key(symbol, _SCALAR)


def checked_factor(
    keys: Sequence[Key], noise: gtsam.noiseModel.Base, residual: Residual
) -> gtsam.CustomFactor:
    """Bind a residual to keys and noise.

    Args:
        keys: the unknowns, in the order of the residual's arguments.
        noise: noise model of the residual; its dimension is the residual's.
        residual: ``residual(*unknowns, jacobian=bool) -> (vector, blocks)``.

    Raises:
        ValueError: while the factor is evaluated, where the residual or a block has a wrong shape.
    """
    keys = tuple(keys)
    dim = noise.dim()

    def error(
        _factor: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None
    ) -> Array:
        unknowns = [key.kind.read(values, key.symbol) for key in keys]
        vector, blocks = residual(*unknowns, jacobian=jacobians is not None)
        if vector.shape != (dim,):
            raise ValueError(f"residual: {vector.shape=} but expected ({dim},)")
        if jacobians is not None:
            if len(blocks) != len(keys):
                raise ValueError(f"Jacobian: {len(blocks)} blocks but expected {len(keys)}")
            for slot, (key, block) in enumerate(zip(keys, blocks, strict=True)):
                if block.shape != (dim, key.kind.tangent_dim):
                    raise ValueError(
                        f"Jacobian block {slot}: {block.shape=} "
                        f"but expected ({dim}, {key.kind.tangent_dim})"
                    )
                jacobians[slot] = np.asfortranarray(block)  # assign the slot: it has no size yet
        return vector

    return gtsam.CustomFactor(noise, [key.symbol for key in keys], error)
