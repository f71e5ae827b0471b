"""Several cameras on one arm, with a known truth; entry point ``simulate_rig``."""

from dataclasses import dataclass, replace

import numpy as np

from handeye_fg.frames import Array, exp, inverse, scaled
from handeye_fg.simulate.scenes import (
    ROBOT_ROTATION_SIGMA,
    ROBOT_TRANSLATION_SIGMA,
    Motion,
    Scene,
    Truth,
    default_camera,
    disturbed,
    scene_of,
    truth_of,
)
from handeye_fg.types import Rig, RobotPoses

# The other cameras are within a hand's breadth of the first, and see much of what it sees.
_ASIDE = 0.04  # standard deviation of their positions, per axis, metres
_TURNED = 0.15  # likewise of their rotation vectors, radians


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigScene:
    """What is seen by several cameras that share a gripper and a scene.

    Attributes:
        scene: of all images; its robot poses are those of the images, and its X is the first camera's.
        rig: which camera took an image, and at which robot pose.
        gripper_T_cameras: true X of each camera (k, 4, 4), metres.
        robot_poses: as reported; one error for all images of a pose.
    """

    scene: Scene
    rig: Rig
    gripper_T_cameras: Array
    robot_poses: RobotPoses

    @property
    def first_T_cameras(self) -> Array:
        """True pose of each camera in the first (k, 4, 4), metres."""
        return inverse(self.gripper_T_cameras[0]) @ self.gripper_T_cameras


def simulate_rig(
    rng: np.random.Generator,
    *,
    n_cameras: int = 2,
    n_poses: int = 15,
    n_points: int = 300,
    pixel_sigma: float = 0.3,
    robot_rotation_sigma: float = ROBOT_ROTATION_SIGMA,
    robot_translation_sigma: float = ROBOT_TRANSLATION_SIGMA,
    motion: Motion = "general",
    start_sigma: float = 1e-3,
    missing: frozenset[tuple[int, int]] = frozenset(),
) -> RigScene:
    """Simulate cameras on one arm that look at a desk with relief.

    Args:
        rng: the source of all randomness.
        n_cameras: number of cameras.
        n_poses: number of robot poses, with an image of each camera.
        n_points: number of scene points.
        pixel_sigma: standard deviation of an observation, per axis, pixels.
        robot_rotation_sigma: of a reported orientation, per axis, radians.
        robot_translation_sigma: of a reported position, per axis, metres.
        motion: what the gripper does, as for ``simulate_scene``.
        start_sigma: how far the reconstruction is from the truth, as for ``simulate_scene``.
        missing: (camera, robot pose) of images that were not taken.
    """
    first = truth_of(rng, n_poses, motion)
    spread = np.repeat([_TURNED, _ASIDE], 3)
    first_T_cameras = exp(spread * rng.standard_normal((n_cameras, 6)))
    first_T_cameras[0] = np.eye(4)
    taken = [(k, i) for k in range(n_cameras) for i in range(n_poses) if (k, i) not in missing]
    camera, pose = np.array(taken).T
    metric = scaled(first.world_T_camera, first.metres_per_world_unit)[pose]
    truth = Truth(
        gripper_T_camera=first.gripper_T_camera,
        base_T_world=first.base_T_world,
        metres_per_world_unit=first.metres_per_world_unit,
        base_T_gripper=first.base_T_gripper[pose],
        world_T_camera=scaled(metric @ first_T_cameras[camera], 1.0 / first.metres_per_world_unit),
    )
    reported = disturbed(rng, first.base_T_gripper, robot_rotation_sigma, robot_translation_sigma)
    lens = default_camera()
    scene = scene_of(
        rng,
        truth,
        lens,
        n_points=n_points,
        pixel_sigma=pixel_sigma,
        robot_rotation_sigma=robot_rotation_sigma,
        robot_translation_sigma=robot_translation_sigma,
        visibility=1.0,
        start_sigma=start_sigma,
    )
    files = [f"image_{i:04d}.jpg" for i in range(n_poses)]
    names = tuple(f"cam{k}/{files[i]}" for k, i in taken)
    model = replace(scene.model, names=names, cameras=(lens,) * n_cameras, image_camera=camera)
    per_image = RobotPoses(names=names, base_T_gripper=reported[pose])
    return RigScene(
        scene=replace(scene, model=model, robot_poses=per_image),
        rig=Rig(n_cameras=n_cameras, camera=camera, pose=pose),
        gripper_T_cameras=first.gripper_T_camera @ first_T_cameras,
        robot_poses=RobotPoses(names=tuple(files), base_T_gripper=reported),
    )
