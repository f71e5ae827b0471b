"""Every solver that takes metres: exact without noise, for all angles, lengths and units."""

import math

import numpy as np
import pytest

from handeye_fg.frames import Array, exp, inverse, pose
from handeye_fg.motions import PosePairs
from handeye_fg.solvers import (
    Solution,
    andreff,
    andreff_scale,
    daniilidis,
    horaud_dornaika,
    li,
    park_martin,
    shah,
    tsai_lenz,
)

SOLVERS = [andreff, daniilidis, horaud_dornaika, li, park_martin, shah, tsai_lenz, andreff_scale]
ROTATION_BOUND = math.radians(1e-6)
TRANSLATION_BOUND = 1e-9


def turns(rng: np.random.Generator, angles: Array) -> Array:
    """Rotations (n, 3, 3) by given angles about random axes."""
    axes = rng.standard_normal((len(angles), 3))
    vectors = axes / np.linalg.norm(axes, axis=1, keepdims=True) * angles[:, None]
    return exp(np.hstack([vectors, np.zeros_like(vectors)]))[:, :3, :3]


def draw(seed: int) -> tuple[PosePairs, Array, Array]:
    """Poses without noise, X and Z: 4 to 12 poses, 1 mm to 100 m, rotations up to 179.9 degrees."""
    rng = np.random.default_rng(seed)
    length = 10.0 ** rng.uniform(-3.0, 2.0)
    largest = math.radians(rng.choice([20.0, 60.0, 179.9]))
    n = int(rng.integers(4, 13))
    angle_X = math.radians(179.9) * (1.0 if seed % 3 == 0 else rng.uniform())
    X = pose(turns(rng, np.array([angle_X]))[0], rng.uniform(-0.1, 0.1, 3))
    Z = pose(turns(rng, rng.uniform(0.0, math.pi, 1))[0], rng.uniform(-length, length, 3))
    robot = pose(
        turns(rng, rng.uniform(0.1 * largest, largest, n)), rng.uniform(-length, length, (n, 3))
    )
    return PosePairs(base_T_gripper=robot, world_T_camera=inverse(Z) @ robot @ X), X, Z


def errors(found: Solution, X: Array) -> tuple[float, float]:
    """Radians (the chord: exact near zero) and metres."""
    difference = found.gripper_T_camera - X
    return (
        float(np.linalg.norm(difference[:3, :3]) / math.sqrt(2.0)),
        float(np.linalg.norm(difference[:3, 3])),
    )


@pytest.mark.parametrize("solve", SOLVERS)
def test_exact_without_noise(solve) -> None:
    for seed in range(1000):
        data, X, Z = draw(seed)
        found = solve(data)
        rotation, translation = errors(found, X)
        assert rotation < ROTATION_BOUND, seed
        assert translation < TRANSLATION_BOUND, seed
        assert found.metres_per_world_unit == pytest.approx(1.0, abs=1e-9)
        if found.base_T_world is not None:
            np.testing.assert_allclose(found.base_T_world, Z, rtol=1e-9, atol=1e-9)
