"""Which points of a scene a camera would find again, and what its image says of its pose."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.lens import lens_of
from handeye_fg.types import CameraModel, Indices, frozen_array, frozen_indices

# Features are found again from directions and distances that differ by no more than this.
WIDEST_ANGLE = float(np.deg2rad(35.0))
_DISTANCE_RATIO = 1.8
# Part of the image's width that stays free at its border.
_BORDER = 0.02
# Directions beyond this multiple of the image's corner are never seen: a polynomial distortion folds far
# directions back into the image.
_FOLD_GUARD = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sight:
    """A scene, from where its points were seen, and the camera.

    Attributes:
        points: positions (p, 3) in the frame in which the scene stands still: the base, for a static
            camera the gripper; metres.
        rays: (m, 3) unit vectors from a point to a camera that saw it.
        distances: (m,) along them, metres.
        point_index: (m,) their points, ascending; each point has one at least.
        camera: the intrinsics.
        widest_angle: from a ray, from which the point is still found again, radians.
    """

    points: Array
    rays: Array
    distances: Array
    point_index: Indices
    camera: CameraModel
    widest_angle: float = WIDEST_ANGLE

    def __post_init__(self) -> None:
        m = len(self.point_index)
        for name, shape in (("points", (None, 3)), ("rays", (m, 3)), ("distances", (m,))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))
        object.__setattr__(self, "point_index", frozen_indices(self.point_index, m, "point_index"))

    @property
    def centre(self) -> Array:
        """The middle (3,) of the points."""
        return np.asarray(np.median(self.points, axis=0))

    @property
    def standoff(self) -> float:
        """Usual distance of the camera from the points, metres."""
        return float(np.median(self.distances))

    def visible(self, cameras: Array) -> NDArray[np.bool_]:
        """Which points (n, p) cameras at poses (n, 4, 4) in the scene's frame would find again."""
        seen = [self._visible(one) for one in cameras]
        return np.array(seen, dtype=bool).reshape(-1, len(self.points))

    def _visible(self, scene_T_camera: Array) -> NDArray[np.bool_]:
        offsets = scene_T_camera[:3, 3] - self.points
        distance = np.linalg.norm(offsets, axis=1)
        inside = in_image(self.camera, -offsets @ scene_T_camera[:3, :3])
        first = np.searchsorted(self.point_index, np.arange(len(self.points)))
        cosine = np.einsum("mi,mi->m", self.rays, (offsets / distance[:, None])[self.point_index])
        near = np.maximum.reduceat(cosine, first) > np.cos(self.widest_angle)
        closest = np.minimum.reduceat(self.distances, first) / _DISTANCE_RATIO
        farthest = np.maximum.reduceat(self.distances, first) * _DISTANCE_RATIO
        return np.asarray(inside & near & (distance > closest) & (distance < farthest))

    def pose_information(
        self, scene_T_camera: Array, which: NDArray[np.bool_], sigma: float
    ) -> Array:
        """What images say of the pose of a camera (6, 6) if the points are known; right perturbation.

        Args:
            scene_T_camera: the camera (4, 4).
            which: (p,) the points that it sees.
            sigma: standard deviation of an observation, pixels.
        """
        in_camera = (self.points[which] - scene_T_camera[:3, 3]) @ scene_T_camera[:3, :3]
        jacobian = pixels_by_pose(self.camera, in_camera).reshape(-1, 6)
        return np.asarray(jacobian.T @ jacobian / sigma**2)


def in_image(camera: CameraModel, points_camera: Array) -> NDArray[np.bool_]:
    """Whether points (p, 3) in the camera's frame are in its image, away from the border."""
    lens = lens_of(camera)
    x, y, z = points_camera.T
    front = z > 0.0
    x, y = (np.divide(part, z, out=np.zeros(len(z)), where=front) for part in (x, y))
    size = np.array([camera.width, camera.height])
    corner = float(np.hypot(*(size / lens.focal))) / 2.0
    front &= np.hypot(x, y) < _FOLD_GUARD * corner
    pixels = lens.pixels(np.where(front, x, 0.0), np.where(front, y, 0.0))
    border = _BORDER * camera.width
    return np.asarray(front & ((pixels > border) & (pixels < size - border)).all(axis=1))


def pixels_by_pose(camera: CameraModel, points_camera: Array) -> Array:
    """Derivatives (p, 2, 6) of pixels by the camera's pose (right perturbation: rotation, translation)."""
    lens = lens_of(camera)
    x, y, z = points_camera.T
    by_point = np.zeros((len(z), 2, 3))
    by_point[:, 0, 0] = by_point[:, 1, 1] = 1.0 / z
    by_point[:, 0, 2], by_point[:, 1, 2] = -x / z**2, -y / z**2
    by_point = (lens.focal[:, None] * lens.by_ray(x / z, y / z)) @ by_point
    # p' = Exp(-xi) p = p + p x rotation - translation
    by_rotation = np.cross(by_point, points_camera[:, None, :])
    return np.concatenate([by_rotation, -by_point], axis=2)


def scene_camera(base_T_gripper: Array, X: Array, *, static: bool) -> Array:
    """Cameras (..., 4, 4) in the scene's frame from poses of the gripper; ``static``: the scene moves."""
    return frames.inverse(base_T_gripper) @ X if static else base_T_gripper @ X


def gripper_pose(scene_T_camera: Array, X: Array, *, static: bool) -> Array:
    """The poses (..., 4, 4) of the gripper that put the camera there."""
    gripper = scene_T_camera @ frames.inverse(X)
    return frames.inverse(gripper) if static else gripper
