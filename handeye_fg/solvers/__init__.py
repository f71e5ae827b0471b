"""Closed forms of hand-eye calibration: one paper, one module; numpy and scipy only.

A solver takes ``PosePairs`` or ``MotionPairs`` and returns a ``Solution``. ``linear_start`` is the entry point:
it makes the pairs, solves them, and adds base_T_world and the residuals.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array, inverse, orthonormalised, pose, rotation_angle, scaled
from handeye_fg.motions import MotionPairs, motion_pairs
from handeye_fg.solvers.andreff import andreff
from handeye_fg.solvers.andreff_scale import andreff_scale
from handeye_fg.solvers.daniilidis import daniilidis
from handeye_fg.solvers.horaud_dornaika import horaud_dornaika
from handeye_fg.solvers.li import li
from handeye_fg.solvers.park_martin import park_martin
from handeye_fg.solvers.shah import shah
from handeye_fg.solvers.solution import Solution, Solver
from handeye_fg.solvers.tsai_lenz import tsai_lenz
from handeye_fg.types import LinearStart

__all__ = [
    "METHODS",
    "Solution",
    "andreff",
    "andreff_scale",
    "average_base_T_world",
    "daniilidis",
    "horaud_dornaika",
    "li",
    "linear_start",
    "motion_residuals",
    "park_martin",
    "shah",
    "tsai_lenz",
]

METHODS: Mapping[str, Solver] = MappingProxyType(
    {
        "andreff_scale": andreff_scale,
        "andreff": andreff,
        "daniilidis": daniilidis,
        "horaud_dornaika": horaud_dornaika,
        "li": li,
        "park_martin": park_martin,
        "shah": shah,
        "tsai_lenz": tsai_lenz,
    }
)


def linear_start(
    base_T_gripper: Array, world_T_camera: Array, *, method: str = "andreff_scale"
) -> LinearStart:
    """X, Z and the scale in closed form over wide-baseline motion pairs.

    Args:
        base_T_gripper: robot poses (n, 4, 4), metres.
        world_T_camera: camera poses (n, 4, 4) of the same instants, up to a similarity.
        method: one of ``METHODS``.

    Raises:
        InputDataError: an unknown method, fewer than three poses, matrices that are not poses, or
            a negative scale (another convention).
        UnobservableError: the motions determine no rotation or no scale.
    """
    if method not in METHODS:
        raise InputDataError(f"unknown method {method!r}: choose one of {', '.join(METHODS)}")
    base_T_gripper = np.asarray(base_T_gripper, dtype=np.float64)
    world_T_camera = np.asarray(world_T_camera, dtype=np.float64)
    pairs = motion_pairs(base_T_gripper, world_T_camera)
    solution = METHODS[method](pairs)
    X, scale = solution.gripper_T_camera, solution.metres_per_world_unit
    angles, lengths = motion_residuals(pairs, X, scale)
    return LinearStart(
        method=method,
        gripper_T_camera=X,
        base_T_world=average_base_T_world(base_T_gripper @ X, scaled(world_T_camera, scale)),
        metres_per_world_unit=scale,
        residual_rotation=float(np.sqrt(np.mean(angles**2))),
        residual_translation=float(np.sqrt(np.mean(lengths**2))),
    )


def average_base_T_world(base_T_camera: Array, world_T_camera: Array) -> Array:
    """Z (4, 4) that best takes camera poses in world to those in base, both (n, 4, 4) in metres.

    The rotation is the chordal mean; with it the translation matches the centroids, so that the
    result follows any change of the world frame exactly.
    """
    products = base_T_camera[:, :3, :3] @ np.swapaxes(world_T_camera[:, :3, :3], 1, 2)
    rotation = orthonormalised(products.mean(axis=0))
    centre_base, centre_world = base_T_camera[:, :3, 3].mean(0), world_T_camera[:, :3, 3].mean(0)
    return pose(rotation, centre_base - rotation @ centre_world)


def motion_residuals(
    pairs: MotionPairs, gripper_T_camera: Array, metres_per_world_unit: float
) -> tuple[Array, Array]:
    """A X against X B: angles (k,) in radians and lengths (k,) in metres of their difference."""
    left = pairs.gi_T_gj @ gripper_T_camera
    right = gripper_T_camera @ scaled(pairs.ci_T_cj, metres_per_world_unit)
    difference = inverse(left) @ right
    return (
        rotation_angle(difference[:, :3, :3]),
        np.asarray(np.linalg.norm(difference[:, :3, 3], axis=1)),
    )
