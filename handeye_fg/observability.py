"""What the data determine of X and of the scale, from their joint covariance in scaled units.

With noise no direction is ever exactly free, and none raises an exception: a direction counts as free
where its standard deviation is one that a user would call useless. The unknowns are ordered
(rotation, translation, ln metres_per_world_unit), X's part a right perturbation; entry ``analyse``.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg

from handeye_fg.findings import FreeDirection
from handeye_fg.frames import Array

# A camera pose or a scale less certain than this serves no purpose.
USELESS_ROTATION = float(np.deg2rad(5.0))
USELESS_TRANSLATION = 0.05
USELESS_LOG_SCALE = 0.2
LIMITS = np.array([USELESS_ROTATION] * 3 + [USELESS_TRANSLATION] * 3 + [USELESS_LOG_SCALE])
LIMITS.setflags(write=False)
# Wide priors (radians, metres, ln scale) keep free directions finite and change no determined one: a
# camera on an arm is within a metre of the gripper's origin or so.
WIDE = np.array([3.0] * 3 + [1.0] * 3 + [5.0])
WIDE.setflags(write=False)
# The information that noise feigns may exceed its mean by so many of its standard deviations.
_FEIGNED_SIGMAS = 3.0
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
        log_scale_std: standard deviation of ln scale; infinite where it is not determined, alone or
            together with X.
        weakest_std: standard deviation of the weakest direction, in units of ``LIMITS``.
    """

    covariance: Array
    free_directions: tuple[FreeDirection, ...]
    free_basis: Array
    log_scale_std: float
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
        covariance=on_determined(covariance[:6, :6]),
        free_directions=_directions(basis, gripper_T_camera[:3, :3], frame),
        free_basis=basis,
        log_scale_std=_log_scale_std(covariance),
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


def free_space(covariance: Array) -> Array:
    """The free directions of X, in columns (6, k), radians and metres.

    Args:
        covariance: of X (6, 6) on the determined subspace, as ``Observability`` has it.
    """
    variances, vectors = np.linalg.eigh(covariance)
    # Projected away, they have variances of rounding; others are within 1e-8 of the largest.
    return np.asarray(vectors[:, variances < 1e-12 * variances[-1]])


def free_lean(covariance: Array) -> Array:
    """How much the free directions of X lean on each of its components (6,): 0 not at all, 1 fully.

    Args:
        covariance: of X (6, 6) on the determined subspace, as ``Observability`` has it.
    """
    orthonormal, _ = np.linalg.qr(free_space(covariance) / LIMITS[:6, None])
    return np.asarray(np.linalg.norm(orthonormal, axis=1))


def feigned_information(
    gripper_T_camera: Array,
    independent: int,
    pose_std: Array,
    sigmas: Array,
    camera_from_grippers: Array | None = None,
) -> Array:
    """The information (7, 7) on (X, ln scale) that noisy poses add by their own apparent motion.

    Noise makes motions look richer than they are: rotations about one axis seem to turn about a
    second one, a gripper at rest seems to move. With dR_i and dt_i the noise of a pose in the base
    frame, a = R_X xi_r, b = R_X xi_t for the tangent xi of X, l = ln scale, and the camera at
    t_i + R_i t_X, the residual of a pose changes by ``-dR_i a`` in rotation and by
    ``dR_i (t_X l - t_X x a - b) + dt_i l`` in translation, and on average over the noise

        E |dR_i v|^2 = 2 std_r^2 |v|^2,   E |dt_i|^2 = 3 std_t^2.

    For a static camera, X = base_T_camera, the residual of base_T_gripper changes by ``dR_i' a`` and
    ``dR_i' (b + (t_X - t_i) x a - (t_X - t_i) l) - dt_i x a + dt_i l``, t_i the position of the gripper:
    the same with the camera as seen from the gripper in place of t_X, and one more term.

    The mean is enlarged by three of its standard deviations, that of a chi-square.

    Args:
        gripper_T_camera: X (4, 4), metres; base_T_camera of a static camera.
        independent: number of independent motions: poses less one, for each group of them.
        pose_std: standard deviations (2,) of the poses with which the residuals were linearised,
            radians and metres.
        sigmas: those by which the residuals are weighted.
        camera_from_grippers: of a static camera: t_X - t_i (n, 3); None: the camera is on the gripper.
    """
    R_X = gripper_T_camera[:3, :3]
    turned, shifted = np.zeros((3, 7)), np.zeros((3, 7))
    turned[:, :3] = R_X
    shifted[:, 3:6] = -R_X
    levers = gripper_T_camera[None, :3, 3] if camera_from_grippers is None else camera_from_grippers
    mean = 2.0 * (pose_std[0] / sigmas[0]) ** 2 * turned.T @ turned
    for lever in levers:
        shifted[:, :3] = -np.cross(lever, R_X.T).T
        shifted[:, 6] = lever
        mean += 2.0 * (pose_std[0] / sigmas[1]) ** 2 * shifted.T @ shifted / len(levers)
    if camera_from_grippers is not None:
        mean += 2.0 * (pose_std[1] / sigmas[1]) ** 2 * turned.T @ turned
    mean[6, 6] += 3.0 * (pose_std[1] / sigmas[1]) ** 2
    margin = 1.0 + _FEIGNED_SIGMAS * np.sqrt(2.0 / (3.0 * independent))
    return np.asarray(independent * margin * mean)


def without_feigned(values: Array, vectors: Array, feigned: Array) -> Array:
    """A covariance (d, d) from its information, less what noise feigns of it.

    It is taken off along the principal directions, for which it matters only where they are weak;
    what is left is no less than that of the wide prior.

    Args:
        values: eigenvalues (d,) of the information in units of ``LIMITS``, with that of the priors.
        vectors: its eigenvectors (d, d).
        feigned: from ``feigned_information``; its first d rows and columns are used.
    """
    d = len(values)
    limits = LIMITS[:d]
    taken = np.einsum("ik,ij,jk->k", vectors, feigned[:d, :d] * np.outer(limits, limits), vectors)
    least = ((limits / WIDE[:d]) ** 2) @ vectors**2
    covariance = (vectors / np.maximum(values - taken, least)) @ vectors.T
    return np.asarray(covariance * np.outer(limits, limits))


def on_determined(covariance: Array) -> Array:
    """A covariance on the complement of its free directions.

    Errors along the free directions may have any size. The complement is orthogonal to them in
    radians and metres, so that such an error leaves no trace in it.
    """
    free = LIMITS[: len(covariance), None] * free_basis(covariance)
    if free.shape[1] == 0:
        return covariance
    kept = linalg.null_space(free.T)
    inside = kept.T @ covariance @ kept
    # Free variances are huge, and so is their rounding: symmetric, it stays inside.
    result = kept @ (0.5 * (inside + inside.T)) @ kept.T
    return np.asarray(0.5 * (result + result.T))


def _log_scale_std(covariance: Array) -> float:
    """Standard deviation of ln scale where X's free directions stay as they are."""
    if covariance[6, 6] > USELESS_LOG_SCALE**2:
        return np.inf
    return float(np.sqrt(on_determined(covariance)[6, 6]))


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
