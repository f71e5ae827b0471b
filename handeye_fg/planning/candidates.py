"""Poses from which a camera still sees the scene, and which an arm reaches; entry point ``candidates``."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.planning.reach import Reach
from handeye_fg.planning.sight import Sight, gripper_pose
from handeye_fg.types import frozen_array

_MOST_DRAWS = 20_000
_BATCH = 500
# How far from the scene's middle the camera aims, in standard deviations of its points.
_AIM = 0.35


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidates:
    """Poses that may be taken.

    Attributes:
        base_T_gripper: the gripper (n, 4, 4), metres.
        scene_T_camera: the camera in the scene's frame (n, 4, 4), metres.
        visible: which points (n, p) it sees.
    """

    base_T_gripper: Array
    scene_T_camera: Array
    visible: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n = len(self.base_T_gripper)
        for name in ("base_T_gripper", "scene_T_camera"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n, 4, 4), name))


def candidates(
    rng: np.random.Generator,
    sight: Sight,
    X: Array,
    reach: Reach,
    fewest_points: int,
    count: int,
    *,
    static: bool,
) -> Candidates:
    """Random poses: from about where points were seen, at about that distance, turned anyhow about the view.

    Args:
        rng: the source of randomness.
        sight: the scene and the camera.
        X: the camera on the gripper (4, 4), or for a static camera in the base, metres.
        reach: what the arm reaches.
        fewest_points: that must be seen.
        count: how many poses are wanted; fewer come back where few are found.
        static: the camera stands still, and the scene moves with the gripper.

    Raises:
        InputDataError: no pose within reach sees enough of the scene.
    """
    found: list[tuple[Array, Array, NDArray[np.bool_]]] = []
    drawn = 0
    while drawn < _MOST_DRAWS and sum(len(part[0]) for part in found) < count:
        cameras = _drawn(rng, sight, _BATCH)
        drawn += _BATCH
        grippers = gripper_pose(cameras, X, static=static)
        within = reach.reachable(grippers)
        cameras, grippers = cameras[within], grippers[within]
        visible = sight.visible(cameras)
        enough = np.count_nonzero(visible, axis=1) >= fewest_points
        found.append((grippers[enough], cameras[enough], visible[enough]))
    grippers, cameras, visible = (np.concatenate(part)[:count] for part in zip(*found, strict=True))
    if len(grippers) == 0:
        raise InputDataError(
            f"none of {drawn} poses of the gripper within reach has the camera look at the scene as it was "
            "seen before; give a larger workspace, one that the earlier poses are in"
        )
    return Candidates(base_T_gripper=grippers, scene_T_camera=cameras, visible=visible)


def _drawn(rng: np.random.Generator, sight: Sight, count: int) -> Array:
    """Camera poses (n, 4, 4) that look at the scene, whether they see it or not."""
    spread = np.std(sight.points, axis=0)
    aim = sight.centre + _AIM * spread * rng.standard_normal((count, 3))
    seen = sight.rays[rng.integers(len(sight.rays), size=count)]
    direction = _turned(rng, seen, sight.widest_angle)
    nearest, farthest = np.quantile(sight.distances, [0.1, 0.9])
    distance = rng.uniform(0.9 * nearest, 1.1 * farthest, count)
    roll = rng.uniform(-np.pi, np.pi, count)
    across = np.cross(direction, rng.standard_normal((count, 3)))
    x = across / np.linalg.norm(across, axis=1, keepdims=True)
    y = np.cross(-direction, x)
    cos, sin = np.cos(roll)[:, None], np.sin(roll)[:, None]
    rotation = np.stack([cos * x + sin * y, cos * y - sin * x, -direction], axis=2)
    return frames.pose(rotation, aim + distance[:, None] * direction)


def _turned(rng: np.random.Generator, directions: Array, widest: float) -> Array:
    """Unit vectors (n, 3), each turned by up to an angle about an axis across it."""
    across = np.cross(directions, rng.standard_normal(directions.shape))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angle = rng.uniform(0.0, widest, len(directions))[:, None]
    return np.asarray(np.cos(angle) * directions + np.sin(angle) * across)
