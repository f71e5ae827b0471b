"""One camera in several worlds: reconstructions that only the robot joins; ``common_start``, ``in_world``.

Each world has a base_T_world and a unit of its own; X is common. Of M5's two steps (``andreff_scale``)
the first has no world in it, and the second gets one unknown scale for each:

    (R_A - I) t_X - lambda_k R_X u_B = -t_A        for the motions of world k
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handeye_fg.errors import UnobservableError
from handeye_fg.frames import Array, pose, scaled
from handeye_fg.motions import MotionPairs, PosePairs, as_motions, with_weight
from handeye_fg.solvers.andreff_scale import (
    NO_ROTATION,
    SIGNIFICANT,
    least_squares,
    require_motion,
    require_two_axes,
    rotation_noise,
    rotations_from_kronecker,
)
from handeye_fg.solvers.residuals import average_base_T_world, motion_residuals
from handeye_fg.types import Indices


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InWorld:
    """How a world lies in the robot's base, given X.

    Attributes:
        base_T_world: (4, 4), metres.
        metres_per_world_unit: positive.
        residual_rotation, residual_translation: root mean square over the motion pairs of the angle
            (radians) and the length (metres) of A X against X B.
    """

    base_T_world: Array
    metres_per_world_unit: float
    residual_rotation: float
    residual_translation: float


def common_start(worlds: Sequence[PosePairs]) -> Array:
    """X (4, 4), metres, in closed form from the motions in all worlds together.

    Args:
        worlds: poses of the robot and of the camera in each world, two or more.

    Raises:
        UnobservableError: the motions, all together, do not determine X, or a scale is not told from
            zero.
    """
    each = [with_weight(as_motions(data)) for data in worlds]
    first = np.cumsum([0, *(len(data) for data in worlds[:-1])])
    pairs = MotionPairs(
        i=np.concatenate([one.i + k for one, k in zip(each, first, strict=True)]),
        j=np.concatenate([one.j + k for one, k in zip(each, first, strict=True)]),
        gi_T_gj=np.concatenate([one.gi_T_gj for one in each]),
        ci_T_cj=np.concatenate([one.ci_T_cj for one in each]),
        weights=np.concatenate([np.asarray(one.weights) for one in each]),
    )
    world = np.repeat(np.arange(len(each)), [len(one) for one in each])
    require_motion(pairs)
    noise = max(NO_ROTATION, SIGNIFICANT * rotation_noise(pairs))
    require_two_axes(pairs, noise)
    solved = [
        (R_X, *_second_step(pairs, world, R_X)) for R_X in rotations_from_kronecker(pairs, noise)
    ]
    R_X, found, covariance, _ = min(solved, key=lambda one: one[3])
    if not np.all(found[3:] > SIGNIFICANT * np.sqrt(np.diag(covariance)[3:])):
        raise UnobservableError(
            f"the scales of {len(each)} reconstructions are not determined; take images that overlap"
        )
    return pose(R_X, found[:3])


def _second_step(pairs: MotionPairs, world: Indices, R_X: Array) -> tuple[Array, Array, float]:
    """t_X and the scales (3 + g,), their covariance, and the sum of squares."""
    R_A, t_A = pairs.gi_T_gj[:, :3, :3], pairs.gi_T_gj[:, :3, 3]
    own = world[:, None] == np.arange(int(world.max()) + 1)
    turned = np.einsum("ki,kg->kig", pairs.ci_T_cj[:, :3, 3] @ R_X.T, own)
    columns = np.concatenate([R_A - np.eye(3), -turned], axis=2)
    return least_squares(columns.reshape(-1, columns.shape[2]), -t_A.reshape(-1), pairs)


def in_world(data: Sequence[PosePairs], gripper_T_cameras: Sequence[Array]) -> InWorld | None:
    """How a world lies, from X; None where the motions in it leave no positive scale.

    Args:
        data: poses of the robot and of the camera in this world, of each camera.
        gripper_T_cameras: X (4, 4) of each camera, metres.
    """
    pairs = [as_motions(one) for one in data]
    seen = [
        one.ci_T_cj[:, :3, 3] @ X[:3, :3].T for one, X in zip(pairs, gripper_T_cameras, strict=True)
    ]
    square = sum(float(np.sum(ways**2)) for ways in seen)
    if square == 0.0:
        return None
    # A X with the origin of the camera's start: what the camera moved, in metres.
    moved = [
        (one.gi_T_gj @ X)[:, :3, 3] - X[:3, 3]
        for one, X in zip(pairs, gripper_T_cameras, strict=True)
    ]
    scale = sum(float(np.sum(a * b)) for a, b in zip(seen, moved, strict=True)) / square
    if scale <= 0.0:
        return None
    residuals = [
        motion_residuals(one, X, scale) for one, X in zip(pairs, gripper_T_cameras, strict=True)
    ]
    angles, lengths = (np.concatenate(parts) for parts in zip(*residuals, strict=True))
    base_T_camera = [one.base_T_gripper @ X for one, X in zip(data, gripper_T_cameras, strict=True)]
    world_T_camera = np.concatenate([one.world_T_camera for one in data])
    return InWorld(
        base_T_world=average_base_T_world(
            np.concatenate(base_T_camera), scaled(world_T_camera, scale)
        ),
        metres_per_world_unit=scale,
        residual_rotation=float(np.sqrt(np.mean(angles**2))),
        residual_translation=float(np.sqrt(np.mean(lengths**2))),
    )
