"""Poses from which a camera still sees the scene, and which an arm reaches.

Entry points: ``candidates`` and ``nearby``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.planning.reach import Reach
from handeye_fg.planning.sight import Sight, gripper_pose, scene_camera
from handeye_fg.types import Indices, frozen_array

_MOST_DRAWS = 20_000
_BATCH = 500
# How far from the scene's middle the camera aims, in standard deviations of its points.
_AIM = 0.35
# At one distance the size of the scene and the camera's place along its axis are hardly told apart: distances
# vary as those seen, and at least from and to these parts of the standoff.
_NEARER, _FARTHER = 0.65, 1.5
# How far poses near a pose are: round the scene's middle, radians, and in the logarithm of the distance.
_NEAR_ANGLE, _NEAR_DISTANCE = 0.1, 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Cameras:
    """The cameras of an arm, and the scene.

    Attributes:
        sights: the scene and each of the k cameras.
        gripper_T_cameras: X of each (k, 4, 4), of static cameras in the base, metres.
        static: the cameras stand still, and the scene moves with the gripper.
    """

    sights: tuple[Sight, ...]
    gripper_T_cameras: Array
    static: bool

    def in_scene(self, base_T_gripper: Array) -> Array:
        """The cameras in the scene's frame (n, k, 4, 4) at poses of the gripper (n, 4, 4)."""
        return scene_camera(
            base_T_gripper[:, None], self.gripper_T_cameras[None], static=self.static
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidates:
    """Poses that may be taken.

    Attributes:
        base_T_gripper: the gripper (n, 4, 4), metres.
        scene_T_cameras: the cameras in the scene's frame (n, k, 4, 4), metres.
        visible: which points (n, k, p) each sees; none where it sees too few.
    """

    base_T_gripper: Array
    scene_T_cameras: Array
    visible: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n, k = self.visible.shape[:2]
        for name, shape in (
            ("base_T_gripper", (n, 4, 4)),
            ("scene_T_cameras", (n, k, 4, 4)),
        ):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))

    def only(self, which: Indices) -> "Candidates":
        """Some of them."""
        return Candidates(
            base_T_gripper=self.base_T_gripper[which],
            scene_T_cameras=self.scene_T_cameras[which],
            visible=self.visible[which],
        )


def candidates(
    rng: np.random.Generator,
    cameras: Cameras,
    reach: Reach,
    fewest_points: int,
    count: int,
) -> Candidates:
    """Random poses: from about where points were seen, at about that distance, turned anyhow about the view.

    Args:
        rng: the source of randomness.
        cameras: what looks at the scene.
        reach: what the arm reaches.
        fewest_points: that a camera must see, one of several at least.
        count: how many poses are wanted; fewer come back where few are found.

    Raises:
        InputDataError: no pose within reach sees enough of the scene.
    """
    found: list[Candidates] = []
    drawn = 0
    while drawn < _MOST_DRAWS and sum(len(part.base_T_gripper) for part in found) < count:
        looking = rng.integers(len(cameras.sights), size=_BATCH)
        placed = np.empty((_BATCH, 4, 4))
        for i, (sight, X) in enumerate(zip(cameras.sights, cameras.gripper_T_cameras, strict=True)):
            own = np.flatnonzero(looking == i)
            placed[own] = gripper_pose(_drawn(rng, sight, len(own)), X, static=cameras.static)
        drawn += _BATCH
        found.append(_usable(placed, cameras, reach, fewest_points))
    result = joined(found)
    if len(result.base_T_gripper) == 0:
        raise InputDataError(
            f"none of {drawn} poses of the gripper within reach has the camera look at the scene as it was "
            "seen before; give a larger workspace, one that the earlier poses are in"
        )
    return result.only(np.arange(min(count, len(result.base_T_gripper))))


def nearby(
    rng: np.random.Generator,
    some: Candidates,
    cameras: Cameras,
    reach: Reach,
    fewest_points: int,
    count: int,
) -> Candidates:
    """Random poses near certain ones.

    Args:
        rng: the source of randomness.
        some: the poses.
        cameras: what looks at the scene.
        reach: what the arm reaches.
        fewest_points: that a camera must see.
        count: how many are drawn near each; those that see too little or are out of reach do not come back.
    """
    first = np.repeat(some.scene_T_cameras[:, 0], count, axis=0)
    turn = frames.exp(_NEAR_ANGLE * np.pad(rng.standard_normal((len(first), 3)), ((0, 0), (0, 3))))
    # Round the scene's middle, and nearer or farther.
    centre, rotations = cameras.sights[0].centre, turn[:, :3, :3]
    offset = np.exp(_NEAR_DISTANCE * rng.standard_normal((len(first), 1)))
    offset = offset * (first[:, :3, 3] - centre)
    moved = frames.pose(
        frames.orthonormalised(rotations @ first[:, :3, :3]),
        centre + np.einsum("nij,nj->ni", rotations, offset),
    )
    placed = gripper_pose(moved, cameras.gripper_T_cameras[0], static=cameras.static)
    return _usable(placed, cameras, reach, fewest_points)


def joined(parts: Sequence[Candidates]) -> Candidates:
    """All of several parts."""
    return Candidates(
        base_T_gripper=np.concatenate([part.base_T_gripper for part in parts]),
        scene_T_cameras=np.concatenate([part.scene_T_cameras for part in parts]),
        visible=np.concatenate([part.visible for part in parts]),
    )


def _usable(
    base_T_gripper: Array, cameras: Cameras, reach: Reach, fewest_points: int
) -> Candidates:
    """Those of the poses (n, 4, 4) that are within reach and from which a camera sees enough."""
    base_T_gripper = base_T_gripper[reach.reachable(base_T_gripper)]
    placed = cameras.in_scene(base_T_gripper)
    visible = np.stack(
        [sight.visible(placed[:, i]) for i, sight in enumerate(cameras.sights)], axis=1
    )
    visible &= np.count_nonzero(visible, axis=2, keepdims=True) >= fewest_points
    visible &= np.stack(
        [_at_distance(sight, placed[:, i]) for i, sight in enumerate(cameras.sights)], axis=1
    )[:, :, None]
    enough = visible.any(axis=(1, 2))
    return Candidates(
        base_T_gripper=base_T_gripper[enough],
        scene_T_cameras=placed[enough],
        visible=visible[enough],
    )


def _distances(sight: Sight) -> tuple[float, float]:
    """The shortest and the longest distance of a camera from what it aims at."""
    nearest, farthest = np.quantile(sight.distances, [0.1, 0.9]).tolist()
    return min(0.9 * nearest, _NEARER * sight.standoff), max(
        1.1 * farthest, _FARTHER * sight.standoff
    )


def _at_distance(sight: Sight, cameras: Array) -> NDArray[np.bool_]:
    """Which cameras (n, 4, 4) have the scene's middle as far before them as they may."""
    depth = np.einsum("ni,ni->n", sight.centre - cameras[:, :3, 3], cameras[:, :3, 2])
    shortest, longest = _distances(sight)
    return np.asarray((depth >= shortest) & (depth <= longest))


def _drawn(rng: np.random.Generator, sight: Sight, count: int) -> Array:
    """Camera poses (n, 4, 4) that look at the scene, whether they see it or not."""
    spread = np.std(sight.points, axis=0)
    aim = sight.centre + _AIM * spread * rng.standard_normal((count, 3))
    seen = sight.rays[rng.integers(len(sight.rays), size=count)]
    direction = _turned(rng, seen, sight.widest_angle)
    distance = rng.uniform(*_distances(sight), count)
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
