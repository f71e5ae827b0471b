"""Random motions and noise of the simulations in Andreff, Horaud and Espiau (IJRR 20(3), 2001).

Each draw is another X and another sequence of motions A = gi_T_gj, B = ci_T_cj with A X = X B. The
robot's motions are exact; the camera's have noise in proportion to their size:

    angle~ = (1 + sigma r) angle      each of roll, pitch and yaw, r standard normal
    t~ = t + sigma |t| n              n three-dimensional standard normal

Our reading, where the paper's text was not at hand: r is normal; the translation's noise has three
dimensions; axes and directions are uniform, angles uniform up to the amplitude, translations uniform in
a ball of that radius; X is drawn like the large motions. The noise of ``scenes`` is additive instead.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg.errors import HandEyeError
from handeye_fg.frames import Array, inverse, pose, scaled

Solve = Callable[[Array, Array], Array]
"""X (4, 4) from motions A and B (k, 4, 4)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Amplitude:
    """The largest motion.

    Attributes:
        translation: metres.
        rotation: radians.
    """

    translation: float
    rotation: float


LARGE = Amplitude(translation=1.0, rotation=float(np.pi))
SMALL = Amplitude(translation=0.02, rotation=float(np.deg2rad(10.0)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Draws:
    """Random calibrations, each with its truth.

    Attributes:
        gripper_T_camera: true X (d, 4, 4), metres.
        gi_T_gj: exact robot motions A (d, k, 4, 4), metres.
        ci_T_cj: camera motions B (d, k, 4, 4) with noise, metres.
        metres_per_world_unit: scale (d,) of a structure from motion with the same camera motions.
    """

    gripper_T_camera: Array
    gi_T_gj: Array
    ci_T_cj: Array
    metres_per_world_unit: Array

    def __len__(self) -> int:
        return len(self.gripper_T_camera)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """How far a method is from the truth in each draw; infinite where it refused to answer.

    Attributes:
        rotation: Frobenius norm (d,) of the difference of the rotation matrices; small ones are
            sqrt(2) times the angle between them.
        translation: length (d,) of the difference of the translations over that of the true one.
    """

    rotation: Array
    translation: Array


def simulate_draws(
    rng: np.random.Generator,
    *,
    n_draws: int,
    n_motions: int,
    amplitude: Amplitude,
    sigma: float,
    translation_sigma: float | None = None,
) -> Draws:
    """Draw calibrations.

    Args:
        rng: the source of all randomness.
        n_draws: number of calibrations d.
        n_motions: number of motions k of each.
        amplitude: of the robot's motions; X has the amplitude ``LARGE``.
        sigma: relative noise of the camera's motions.
        translation_sigma: that of their translations, where it is another one; None: ``sigma``.
    """
    X = _random_poses(rng, (n_draws, 1), LARGE)
    A = _random_poses(rng, (n_draws, n_motions), amplitude)
    B = inverse(X) @ A @ X
    return Draws(
        gripper_T_camera=X[:, 0],
        gi_T_gj=A,
        ci_T_cj=with_proportional_noise(
            rng, B, sigma, sigma if translation_sigma is None else translation_sigma
        ),
        metres_per_world_unit=np.exp(rng.uniform(np.log(0.05), np.log(5.0), n_draws)),
    )


def with_proportional_noise(
    rng: np.random.Generator, ci_T_cj: Array, rotation_sigma: float, translation_sigma: float
) -> Array:
    """Motions (..., 4, 4) with noise in proportion to their angles and lengths."""
    shape = ci_T_cj.shape[:-2]
    roll_pitch_yaw = Rotation.from_matrix(ci_T_cj[..., :3, :3].reshape(-1, 3, 3)).as_euler("xyz")
    roll_pitch_yaw *= 1.0 + rotation_sigma * rng.standard_normal(roll_pitch_yaw.shape)
    rotation = Rotation.from_euler("xyz", roll_pitch_yaw).as_matrix().reshape(*shape, 3, 3)
    t = ci_T_cj[..., :3, 3]
    length = np.linalg.norm(t, axis=-1, keepdims=True)
    return pose(rotation, t + translation_sigma * length * rng.standard_normal(t.shape))


def errors(draws: Draws, solve: Solve, *, scale_known: bool = True) -> Errors:
    """The errors of a method.

    Args:
        draws: the calibrations.
        solve: the method.
        scale_known: whether it gets the camera's translations in metres; else in world units.
    """
    rotation, translation = np.full(len(draws), np.inf), np.full(len(draws), np.inf)
    for d, (truth, A, B, scale) in enumerate(
        zip(
            draws.gripper_T_camera,
            draws.gi_T_gj,
            draws.ci_T_cj,
            draws.metres_per_world_unit,
            strict=True,
        )
    ):
        try:
            X = solve(A, B if scale_known else scaled(B, 1.0 / scale))
        except HandEyeError:
            continue
        rotation[d] = np.linalg.norm(X[:3, :3] - truth[:3, :3])
        translation[d] = np.linalg.norm(X[:3, 3] - truth[:3, 3]) / np.linalg.norm(truth[:3, 3])
    return Errors(rotation=rotation, translation=translation)


def _random_poses(rng: np.random.Generator, shape: tuple[int, ...], amplitude: Amplitude) -> Array:
    """Poses (*shape, 4, 4) up to an amplitude."""
    angle = amplitude.rotation * rng.uniform(size=(*shape, 1))
    rotation_vectors = (angle * _directions(rng, shape)).reshape(-1, 3)
    rotation = Rotation.from_rotvec(rotation_vectors).as_matrix().reshape(*shape, 3, 3)
    # The cube root makes points of a ball uniform.
    length = amplitude.translation * np.cbrt(rng.uniform(size=(*shape, 1)))
    return pose(rotation, length * _directions(rng, shape))


def _directions(rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
    """Uniform unit vectors (*shape, 3)."""
    vectors = rng.standard_normal((*shape, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
