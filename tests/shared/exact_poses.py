"""Poses of robot and camera without noise, and how far an answer is from their truth."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.motions import MAX_PAIRS, MotionPairs, PosePairs, as_motions

ROTATION_BOUND = math.radians(1e-6)
TRANSLATION_BOUND = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    base_T_gripper: Array
    world_T_camera: Array
    gripper_T_camera: Array
    metres_per_world_unit: float


def case(base_T_gripper: Array, X: Array, scale: float, Z: Array | None = None) -> Case:
    """Exact camera poses of given robot poses."""
    Z = exp(np.array([0.4, -1.1, 0.7, 0.3, 0.2, -0.5])) if Z is None else Z
    world_T_camera = inverse(Z) @ base_T_gripper @ X
    return Case(base_T_gripper, scaled(world_T_camera, 1.0 / scale), X, scale)


def motions_between(
    base_T_gripper: Array, world_T_camera: Array, max_pairs: int = MAX_PAIRS
) -> MotionPairs:
    """The motions between poses, as the solvers see them."""
    poses = PosePairs(base_T_gripper=base_T_gripper, world_T_camera=world_T_camera)
    return as_motions(poses, max_pairs)


def rotation_error(found: Array, wanted: Array) -> float:
    # The chord, not the angle by arccos: exact near zero.
    return float(np.linalg.norm(found[:3, :3] - wanted[:3, :3]) / math.sqrt(2.0))


def translation_error(found: Array, wanted: Array) -> float:
    return float(np.linalg.norm(found[:3, 3] - wanted[:3, 3]))


def assert_exact(start, wanted: Case, bound: float = TRANSLATION_BOUND) -> None:
    assert rotation_error(start.gripper_T_camera, wanted.gripper_T_camera) < ROTATION_BOUND
    assert translation_error(start.gripper_T_camera, wanted.gripper_T_camera) < bound
    assert start.metres_per_world_unit == pytest.approx(wanted.metres_per_world_unit, rel=1e-8)


def random_poses(rng: np.random.Generator, n: int, angle: float, length: float) -> Array:
    """Poses with rotations up to an angle about any axis and positions up to a length."""
    axes = rng.standard_normal((n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotation = exp(np.hstack([axes * rng.uniform(0.1 * angle, angle, (n, 1)), np.zeros((n, 3))]))
    return pose(rotation[:, :3, :3], rng.uniform(-length, length, (n, 3)))


X_RANDOM = exp(np.array([0.9, -0.3, 1.4, 0.05, -0.02, 0.11]))


# Rotation vectors below 3 radians, translations below a metre.
twists = arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)).map(
    lambda xi: xi * [1.7, 1.7, 1.7, 1.0, 1.0, 1.0]
)
pose_lists = arrays(np.float64, (5, 6), elements=st.floats(-1.0, 1.0)).map(
    lambda xi: exp(xi * [1.7, 1.7, 1.7, 1.0, 1.0, 1.0])
)
