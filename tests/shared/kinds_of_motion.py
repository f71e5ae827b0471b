"""Motions of every kind, what each leaves free, and what the solver of such motions says of them."""

import numpy as np

from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.observability import Observability, analyse
from handeye_fg.priors import Prior
from handeye_fg.simulate import disturbed
from handeye_fg.solvers import Solution, first_order_covariance, partial

SCALE = 0.37
Z_AXIS, X_AXIS, Y_AXIS = np.eye(3)[[2, 0, 1]]
FIRST, SECOND = np.array([0.2, 0.1, -0.15]), np.array([-0.1, 0.25, 0.1])
TILTED = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])
OTHER = np.array([1.0, 0.3, 0.2]) / np.linalg.norm([1.0, 0.3, 0.2])

# An ordinary arm and a good reconstruction: radians and metres per axis.
ROTATION_NOISE, TRANSLATION_NOISE = 1.75e-4, 1e-4


def turn(axis: Array, angle: float) -> Array:
    return exp(np.concatenate([angle * axis, np.zeros(3)]))[:3, :3]


def T(translation: Array) -> Array:
    return pose(np.eye(3), translation)


def R(axis: Array, angle: float) -> Array:
    return pose(turn(axis, angle), np.zeros(3))


def P(axis: Array, angle: float, translation: Array) -> Array:
    return pose(turn(axis, angle), translation - axis * (axis @ translation))


def S(axis: Array, angle: float, translation: Array) -> Array:
    return pose(turn(axis, angle), translation)


# Motions of the gripper, and the free directions in order: t translation, r rotation, s scale; a
# scale takes a direction of the position with it wherever the gripper turns.
TABLE = {
    "one T": ([T(FIRST)], "tttr"),
    "one R": ([R(TILTED, 1.0)], "tsr"),
    "one P": ([P(TILTED, 1.0, FIRST)], "tsr"),
    "one S": ([S(TILTED, 1.0, FIRST)], "tr"),
    "T + T": ([T(FIRST), T(SECOND)], "ttt"),
    "T + R": ([T(FIRST), R(TILTED, 1.0)], "t"),
    "T + P": ([T(FIRST), P(TILTED, 1.0, SECOND)], "t"),
    "T + S": ([T(FIRST), S(TILTED, 1.0, SECOND)], "t"),
    "R + R": ([R(TILTED, 1.0), R(OTHER, 0.8)], "s"),
    "R + R + R": ([R(TILTED, 1.0), R(OTHER, 0.8), R(Y_AXIS, -0.7)], "s"),
    "R + P": ([R(TILTED, 1.0), P(OTHER, 0.8, FIRST)], ""),
    "R + S": ([R(TILTED, 1.0), S(OTHER, 0.8, FIRST)], ""),
    "P + P": ([P(TILTED, 1.0, FIRST), P(OTHER, 0.8, SECOND)], ""),
    "P + S": ([P(TILTED, 1.0, FIRST), S(OTHER, 0.8, SECOND)], ""),
    "S + S": ([S(TILTED, 1.0, FIRST), S(OTHER, 0.8, SECOND)], ""),
    "P + P, one axis": ([P(TILTED, 1.0, FIRST), P(TILTED, -0.8, SECOND)], "t"),
    "S + R, one axis": ([S(TILTED, 1.0, FIRST), R(TILTED, -0.8)], "t"),
    "S + S, one axis": ([S(TILTED, 1.0, FIRST), S(TILTED, 0.6, SECOND)], "t"),
    "R + R, one axis": ([R(TILTED, 1.0), R(TILTED, -0.6)], "tsr"),
    "T + T + R + R": ([T(FIRST), T(SECOND), R(TILTED, 1.0), R(OTHER, 0.8)], ""),
}
LETTERS = {"translation": "t", "rotation": "r", "scale": "s"}


def as_poses(
    motions: list[Array], X: Array, scale: float, rng: np.random.Generator, noise: float = 0.0
) -> PosePairs:
    """Poses that the motions lead through, as robot and camera report them."""
    gripper = [exp(np.array([0.3, 0.2, -0.5, 0.4, 0.1, 0.6]))]
    for motion in motions:
        gripper.append(gripper[-1] @ motion)
    return seen(np.array(gripper), X, scale, rng, noise)


def seen(
    gripper: Array, X: Array, scale: float, rng: np.random.Generator, noise: float
) -> PosePairs:
    """Robot and camera poses; the camera's have a fifth of the robot's noise."""
    camera = scaled(exp(np.array([0.4, -1.1, 0.7, 0.3, 0.2, -0.5])) @ gripper @ X, 1.0 / scale)
    rotation, translation = noise * ROTATION_NOISE, noise * TRANSLATION_NOISE
    return PosePairs(
        base_T_gripper=disturbed(rng, gripper, rotation, translation),
        world_T_camera=disturbed(rng, camera, 0.2 * rotation, 0.2 * translation / scale),
    )


def separate(motions: list[Array], X: Array, scale: float) -> MotionPairs:
    """Motions that share no pose."""
    A, k = np.array(motions), len(motions)
    return MotionPairs(
        i=2 * np.arange(k),
        j=2 * np.arange(k) + 1,
        gi_T_gj=A,
        ci_T_cj=scaled(inverse(X) @ A @ X, 1.0 / scale),
    )


def many_poses(kind: str, rng: np.random.Generator, n: int = 12) -> Array:
    vectors, positions = np.zeros((n, 6)), rng.uniform(-0.2, 0.2, (n, 3))
    if kind in ("general", "rotations"):
        vectors[:, :3] = rng.uniform(-0.6, 0.6, (n, 3))
    if kind in ("scara", "planar", "one rotation axis"):
        vectors[:, 2] = rng.uniform(-2.0, 2.0, n)
    if kind in ("rotations", "one rotation axis"):
        positions[:] = 0.0
    if kind == "planar":
        positions[:, 2] = 0.0
    tool = exp(np.concatenate([rng.uniform(-1.0, 1.0, 3), np.zeros(3)]))
    gripper: Array = pose(exp(vectors)[:, :3, :3], positions)
    return np.asarray(exp(rng.uniform(-1.0, 1.0, 6)) @ gripper @ tool)


def random_mount(rng: np.random.Generator) -> Array:
    direction = rng.standard_normal(3)
    return pose(
        turn(np.eye(3)[0], 0.0) @ exp(rng.uniform(-1.7, 1.7, 6))[:3, :3],
        rng.uniform(0.03, 0.12) * direction / np.linalg.norm(direction),
    )


def answer(
    data: PosePairs | MotionPairs, *, scale_known: bool = False, priors: tuple[Prior, ...] = ()
) -> tuple[Solution, Array, Observability]:
    found = partial(data, scale_known=scale_known, priors=priors)
    covariance = first_order_covariance(data, found, scale_known=scale_known, priors=priors)
    return found, covariance, analyse(covariance, np.asarray(found.gripper_T_camera), "gripper")


def kinds(found: Observability) -> str:
    return "".join(LETTERS[direction.kind] for direction in found.free_directions)


def misfit(data: PosePairs | MotionPairs, found: Solution) -> float:
    pairs, X = as_motions(data), np.asarray(found.gripper_T_camera)
    right = X @ scaled(pairs.ci_T_cj, found.metres_per_world_unit)
    return float(np.abs(pairs.gi_T_gj @ X - right).max())
