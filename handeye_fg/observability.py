"""What the data determine of X and of the scale, from their joint covariance in scaled units.

With noise no direction is ever exactly free, and none raises an exception: a direction counts as free
where its standard deviation is one that a user would call useless. The unknowns are ordered
(rotation, translation, ln metres_per_world_unit), X's part a right perturbation; entry ``analyse``.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg

from handeye_fg.frames import Array
from handeye_fg.types import FreeDirection

# A camera pose or a scale less certain than this serves no purpose.
USELESS_ROTATION = float(np.deg2rad(5.0))
USELESS_TRANSLATION = 0.05
USELESS_LOG_SCALE = 0.2
LIMITS = np.array([USELESS_ROTATION] * 3 + [USELESS_TRANSLATION] * 3 + [USELESS_LOG_SCALE])
LIMITS.setflags(write=False)
# Free directions whose squared length (in units of the limits) lies to this part in one kind of
# unknown are told as that kind alone; noise leans them towards the others by a few percent.
_PURE = 0.99
_PARTS = {"rotation": slice(0, 3), "translation": slice(3, 6), "scale": slice(6, 7)}

Kind = Literal["rotation", "translation", "scale"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observability:
    """Determined and free part of X and the scale.

    Attributes:
        covariance: of X (6, 6) on the determined subspace, zero along the free directions.
        free_directions: the rest, one entry for each free dimension of (X, scale).
        free_basis: the free subspace: orthonormal columns (7, d) in units of ``LIMITS``.
        free_scale: whether the scale is not determined, alone or together with X.
        weakest_std: standard deviation of the weakest direction, in units of ``LIMITS``.
    """

    covariance: Array
    free_directions: tuple[FreeDirection, ...]
    free_basis: Array
    free_scale: bool
    weakest_std: float


def analyse(covariance: Array, gripper_T_camera: Array, frame: str) -> Observability:
    """Split the joint covariance of (X, ln scale) into determined and free directions.

    Args:
        covariance: (7, 7), finite; radians, metres, 1.
        gripper_T_camera: X (4, 4), to give directions in its parent frame.
        frame: name of the parent frame.
    """
    basis = free_basis(covariance)
    scaled = covariance / np.outer(LIMITS, LIMITS)
    return Observability(
        covariance=_determined(covariance[:6, :6]),
        free_directions=_directions(basis, gripper_T_camera[:3, :3], frame),
        free_basis=basis,
        free_scale=bool(covariance[6, 6] > USELESS_LOG_SCALE**2),
        weakest_std=float(np.sqrt(np.linalg.eigvalsh(scaled)[-1])),
    )


def free_basis(covariance: Array) -> Array:
    """Orthonormal columns (d, k), in units of ``LIMITS``, of the free directions.

    Args:
        covariance: of the first d unknowns (d, d), 6 or 7.
    """
    limits = LIMITS[: len(covariance)]
    variances, vectors = np.linalg.eigh(covariance / np.outer(limits, limits))
    return np.asarray(vectors[:, variances > 1.0])


def _determined(covariance: Array) -> Array:
    """The covariance (6, 6) of X on the complement of its free directions.

    Errors along the free directions may have any size. The complement is orthogonal to them in
    radians and metres, so that such an error leaves no trace in it.
    """
    free = LIMITS[:6, None] * free_basis(covariance)
    if free.shape[1] == 0:
        return covariance
    kept = linalg.null_space(free.T)
    return np.asarray(kept @ (kept.T @ covariance @ kept) @ kept.T)


def _directions(basis: Array, R_X: Array, frame: str) -> tuple[FreeDirection, ...]:
    """The free subspace (7, d) in directions as simple as it has them.

    First those of one kind alone; what is left couples several kinds: at most one direction
    changes the scale, and the others turn the camera while its position changes.
    """
    found: list[FreeDirection] = []
    pure: dict[Kind, Array] = {}
    rest = basis
    for kind in ("translation", "rotation", "scale"):
        pure[kind], rest = _split(rest, _PARTS[kind], _PURE)
    shifts = _readable(R_X @ pure["translation"][_PARTS["translation"]])
    turns = _readable(R_X @ pure["rotation"][_PARTS["rotation"]])
    found += [
        _free("translation", axis, frame, _position(axis, shifts.shape[1], frame))
        for axis in shifts.T
    ]
    found += [_free("rotation", axis, frame, _rotation(axis, None, frame)) for axis in turns.T]
    if pure["scale"].shape[1]:
        found.append(_free("scale", np.zeros(3), frame, _SCALE))
    # The scale is one row: one direction of the rest has all of it.
    with_scale, rest = _split(rest, _PARTS["scale"], 1.0 - _PURE)
    for column in with_scale.T:
        vector = _unit(R_X @ column[_PARTS["translation"]])
        found.append(_free("scale", vector, frame, _coupled_scale(vector, frame)))
    for column in rest.T:
        axis, shift = _unit(R_X @ column[_PARTS["rotation"]]), R_X @ column[_PARTS["translation"]]
        found.append(_free("rotation", axis, frame, _rotation(axis, _unit(shift), frame)))
    return tuple(found)


def _split(basis: Array, part: slice, share: float) -> tuple[Array, Array]:
    """Directions of a subspace (7, d) that have this share of their square in a part; the others."""
    if basis.shape[1] == 0:
        return basis, basis
    _, singular, vt = np.linalg.svd(basis[part])
    squares = np.zeros(basis.shape[1])
    squares[: len(singular)] = singular**2
    inside = squares >= share
    return basis @ vt[inside].T, basis @ vt[~inside].T


def _readable(vectors: Array) -> Array:
    """A unit basis, in columns, of the span of columns (3, d); the axes if it is everything."""
    if vectors.shape[1] == 3:
        return np.eye(3)
    return np.array([_unit(vector) for vector in vectors.T]).reshape(-1, 3).T


def _unit(vector: Array) -> Array:
    """The direction of a vector (3,), its largest component positive."""
    length = float(np.linalg.norm(vector)) * (1.0 if vector[np.abs(vector).argmax()] > 0 else -1.0)
    return vector / length if length else np.zeros(3)


def _free(kind: Kind, vector: Array, frame: str, description: str) -> FreeDirection:
    return FreeDirection(kind=kind, vector=vector, frame=frame, description=description)


def _words(vector: Array) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in np.round(vector, 2) + 0.0) + ")"


_TURN = "Add poses that turn the gripper by 20 degrees or more about two different axes"
_SCALE = (
    "The scale of the scene is not determined: the gripper only turned about its own origin or "
    "hardly moved. Add poses that move it by 100 mm or more."
)


def _position(vector: Array, count: int, frame: str) -> str:
    place = f"The camera's position along {frame} axis {_words(vector)} is not determined"
    if count == 1:
        return (
            f"{place}: all rotations share one axis. Add two poses tilted 20 degrees or more about "
            "another axis, or give a prior for that distance."
        )
    return f"{place}: the gripper never turned. {_TURN}, or give a prior for that distance."


def _rotation(axis: Array, shift: Array | None, frame: str) -> str:
    place = f"The camera's rotation about {frame} axis {_words(axis)} is not determined"
    if shift is not None and shift.any():
        place += f", and its position along {_words(shift)} changes with it"
    return (
        f"{place}: the motions neither turn about a second axis nor move across this one. {_TURN}."
    )


def _coupled_scale(vector: Array, frame: str) -> str:
    return (
        "The scale of the scene is not determined, and the camera's position along "
        f"{frame} axis {_words(vector)} changes with it: the gripper only turned about its own "
        "origin or moved too little. Add poses that move it by 100 mm or more and turn it about "
        "two different axes, or give a prior for that distance."
    )
