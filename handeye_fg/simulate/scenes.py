"""Synthetic hand-eye data with a known truth: robots, cameras, noise.

``simulate_scene`` gives what stages 1 and 2 of a calibration deliver (robot poses and a
reconstruction with tracks), ``simulate_poses`` only the two lists of poses. Everything is a pure
function of a random generator. No image is rendered here.
"""

import math
from dataclasses import dataclass
from typing import Literal, assert_never

import numpy as np

from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.lens import lens_of
from handeye_fg.types import CameraModel, Indices, RobotPoses, SfmModel, Tracks

Motion = Literal["general", "one_axis", "pure_translation", "pure_rotation"]

# A good industrial arm: repeatability of a few hundredths of a millimetre.
ROBOT_ROTATION_SIGMA = math.radians(0.01)
ROBOT_TRANSLATION_SIGMA = 5e-5

# The scene: a patch of desk with relief, in reach in front of the robot. Metres, base axes.
SCENE_CENTRE = np.array([0.5, 0.0, 0.05])
SCENE_HALF_SIZE = np.array([0.25, 0.25, 0.06])
CAMERA_DISTANCE = (0.3, 0.6)
# Largest tilt of the view from the vertical that still sees the tops of the relief.
DOME_TILT = math.radians(50.0)
# How far from the scene's centre the camera aims.
AIM_SIGMA = 0.04

# Points nearer to the camera than this (metres) are not seen.
NEAREST_DEPTH = 0.02
# Directions beyond this multiple of the image's corner are never seen: polynomial distortion folds
# far directions back into the image.
FOLD_GUARD = 1.5


def _read_only(value: Array) -> Array:
    array = np.array(value, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What a calibration should find: base_T_gripper X = Z scaled(world_T_camera), exactly.

    Attributes:
        gripper_T_camera: X (4, 4), metres.
        base_T_world: Z (4, 4), metres.
        metres_per_world_unit: the scale.
        base_T_gripper: true robot poses (n, 4, 4), metres.
        world_T_camera: true camera poses (n, 4, 4), world units.
    """

    gripper_T_camera: Array
    base_T_world: Array
    metres_per_world_unit: float
    base_T_gripper: Array
    world_T_camera: Array

    def __post_init__(self) -> None:
        for name in ("gripper_T_camera", "base_T_world", "base_T_gripper", "world_T_camera"):
            object.__setattr__(self, name, _read_only(getattr(self, name)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene(Truth):
    """The truth, and what the robot and the reconstruction report of it.

    Attributes:
        points_world: true points (p, 3), world units, in the order of ``model.tracks``.
        camera: the true intrinsics.
        noise: standard deviations of the observations and of the reported robot poses.
        robot_poses: the reported robot poses.
        model: the reconstruction: observations with noise, poses and points near the truth, in the
            true world frame (no gauge is fixed).
    """

    points_world: Array
    camera: CameraModel
    noise: NoiseLevels
    robot_poses: RobotPoses
    model: SfmModel

    def __post_init__(self) -> None:
        Truth.__post_init__(self)
        object.__setattr__(self, "points_world", _read_only(self.points_world))


def default_camera() -> CameraModel:
    """A 1280x960 camera of 60 degrees with mild distortion (OPENCV: fx fy cx cy k1 k2 p1 p2)."""
    params = np.array([1100.0, 1100.0, 645.0, 475.0, -0.06, 0.03, 0.0004, -0.0003])
    return CameraModel(model="OPENCV", width=1280, height=960, params=params)


def project(camera: CameraModel, points_camera: Array) -> Array:
    """Pixels (..., 2) of points (..., 3) in the camera frame, in front of the camera.

    Args:
        camera: of any model of ``handeye_fg.lens``.
        points_camera: coordinates in any unit of length; the optical axis is z.
    """
    normalised = points_camera[..., :2] / points_camera[..., 2:]
    pixels = lens_of(camera).pixels(*normalised.reshape(-1, 2).T)
    return pixels.reshape(normalised.shape)


def simulate_scene(
    rng: np.random.Generator,
    *,
    n_images: int = 15,
    n_points: int = 300,
    pixel_sigma: float = 0.3,
    robot_rotation_sigma: float = ROBOT_ROTATION_SIGMA,
    robot_translation_sigma: float = ROBOT_TRANSLATION_SIGMA,
    camera: CameraModel | None = None,
    motion: Motion = "general",
    visibility: float = 1.0,
    start_sigma: float = 1e-3,
) -> Scene:
    """Simulate a camera on an arm that looks at a desk with relief.

    Args:
        rng: the source of all randomness.
        n_images: number of images, all registered.
        n_points: number of scene points; those that fewer than two images see are left out.
        pixel_sigma: standard deviation of an observation, per axis, pixels.
        robot_rotation_sigma: of the rotation vector (gripper frame) by which a reported pose is off,
            per axis, radians.
        robot_translation_sigma: of the position by which a reported pose is off, per axis, metres.
        camera: intrinsics; ``default_camera()`` if None.
        motion: what the gripper does; "one_axis" turns about the base's vertical only and
            translates freely; "pure_rotation" turns about the gripper's origin, which rests.
        visibility: probability that an image sees a point that projects inside it.
        start_sigma: how far the poses and points of the model are from the truth: radians, and
            relative to the mean distance of the camera. 0: at the truth.

    Raises:
        ValueError: the camera sees too little of the scene: no point in two images.
    """
    return scene_of(
        rng,
        truth_of(rng, n_images, motion),
        default_camera() if camera is None else camera,
        n_points=n_points,
        pixel_sigma=pixel_sigma,
        robot_rotation_sigma=robot_rotation_sigma,
        robot_translation_sigma=robot_translation_sigma,
        visibility=visibility,
        start_sigma=start_sigma,
    )


def scene_of(
    rng: np.random.Generator,
    truth: Truth,
    camera: CameraModel,
    *,
    n_points: int,
    pixel_sigma: float,
    robot_rotation_sigma: float,
    robot_translation_sigma: float,
    visibility: float,
    start_sigma: float,
) -> Scene:
    """What is observed and reported of a truth; arguments and errors are those of ``simulate_scene``."""
    distance = float(np.mean(CAMERA_DISTANCE)) / truth.metres_per_world_unit

    # 1. Scene points, in the world frame.
    points_base = SCENE_CENTRE + rng.uniform(-1.0, 1.0, (n_points, 3)) * SCENE_HALF_SIZE
    world_T_base = inverse(truth.base_T_world)
    points_world = _transform(world_T_base, points_base) / truth.metres_per_world_unit

    # 2. Which image sees which point, and where.
    image_index, point_index = _observed(rng, camera, truth, points_world, visibility)
    if len(point_index) == 0:
        raise ValueError(f"no point is seen by two images: {n_points=}, {camera=}")
    kept, point_index = np.unique(point_index, return_inverse=True)
    points_world = points_world[kept]
    exact = _pixels(camera, truth.world_T_camera, points_world, image_index, point_index)
    pixels = exact + pixel_sigma * rng.standard_normal(exact.shape)

    # 3. What is reported.
    reported = disturbed(rng, truth.base_T_gripper, robot_rotation_sigma, robot_translation_sigma)
    start_poses = disturbed(rng, truth.world_T_camera, start_sigma, start_sigma * distance)
    start_points = points_world + start_sigma * distance * rng.standard_normal(points_world.shape)
    start_pixels = _pixels(camera, start_poses, start_points, image_index, point_index)
    names = tuple(f"image_{i:04d}.jpg" for i in range(len(truth.world_T_camera)))
    model = SfmModel(
        names=names,
        world_T_camera=start_poses,
        cameras=(camera,),
        image_camera=np.zeros(len(names), dtype=np.int64),
        tracks=Tracks(
            points_world=start_points,
            image_index=image_index,
            point_index=point_index,
            pixels=pixels,
        ),
        mean_reprojection_px=float(np.linalg.norm(pixels - start_pixels, axis=1).mean()),
        unregistered=(),
    )
    noise = NoiseLevels(
        pixel=pixel_sigma,
        robot_rotation=robot_rotation_sigma,
        robot_translation=robot_translation_sigma,
        estimated=False,
    )
    return Scene(
        gripper_T_camera=truth.gripper_T_camera,
        base_T_world=truth.base_T_world,
        metres_per_world_unit=truth.metres_per_world_unit,
        base_T_gripper=truth.base_T_gripper,
        world_T_camera=truth.world_T_camera,
        points_world=points_world,
        camera=camera,
        noise=noise,
        robot_poses=RobotPoses(names=names, base_T_gripper=reported),
        model=model,
    )


def simulate_poses(
    rng: np.random.Generator,
    *,
    n_poses: int = 15,
    motion: Motion = "general",
    robot_rotation_sigma: float = 0.0,
    robot_translation_sigma: float = 0.0,
    camera_rotation_sigma: float = 0.0,
    camera_translation_sigma: float = 0.0,
) -> tuple[Array, Array, Truth]:
    """Simulate robot and camera poses without images.

    Args:
        rng: the source of all randomness.
        n_poses: number of poses.
        motion: as in ``simulate_scene``.
        robot_rotation_sigma: noise of base_T_gripper, per axis, radians.
        robot_translation_sigma: noise of base_T_gripper, per axis, metres.
        camera_rotation_sigma: noise of world_T_camera, per axis, radians.
        camera_translation_sigma: noise of world_T_camera, per axis, metres (not world units).

    Returns:
        base_T_gripper (n, 4, 4) in metres and world_T_camera (n, 4, 4) in world units, both with
        noise, and the truth.
    """
    truth = truth_of(rng, n_poses, motion)
    world_sigma = camera_translation_sigma / truth.metres_per_world_unit
    return (
        disturbed(rng, truth.base_T_gripper, robot_rotation_sigma, robot_translation_sigma),
        disturbed(rng, truth.world_T_camera, camera_rotation_sigma, world_sigma),
        truth,
    )


def disturbed(
    rng: np.random.Generator, a_T_b: Array, rotation_sigma: float, translation_sigma: float
) -> Array:
    """Poses (n, 4, 4) with noise: a rotation vector in frame b, a position offset in frame a.

    An isotropic offset has the same distribution in any axes, so to first order this is the right
    perturbation ``a_T_b Exp(xi)`` with xi ~ N(0, diag(rotation_sigma^2, translation_sigma^2)).
    """
    noise = rng.standard_normal((len(a_T_b), 6))
    rotation_vector = np.hstack([rotation_sigma * noise[:, :3], np.zeros((len(a_T_b), 3))])
    rotation = a_T_b[:, :3, :3] @ exp(rotation_vector)[:, :3, :3]
    return pose(rotation, a_T_b[:, :3, 3] + translation_sigma * noise[:, 3:])


def truth_of(rng: np.random.Generator, n: int, motion: Motion) -> Truth:
    """Random X, Z, scale and poses."""
    gripper_T_camera = pose(
        _rotation(_directions(rng, 1)[0] * rng.uniform(0.0, np.pi / 2)),
        _directions(rng, 1)[0] * rng.uniform(0.02, 0.1),
    )
    base_T_world = pose(
        _rotation(_directions(rng, 1)[0] * rng.uniform(0.0, np.pi)), rng.uniform(-1.0, 1.0, 3)
    )
    # Any unit: from a twentieth of a metre to five metres.
    metres_per_world_unit = float(np.exp(rng.uniform(np.log(0.05), np.log(5.0))))
    base_T_gripper = _gripper_poses(rng, n, motion, inverse(gripper_T_camera))
    world_T_camera = inverse(base_T_world) @ base_T_gripper @ gripper_T_camera
    return Truth(
        gripper_T_camera=gripper_T_camera,
        base_T_world=base_T_world,
        metres_per_world_unit=metres_per_world_unit,
        base_T_gripper=base_T_gripper,
        world_T_camera=scaled(world_T_camera, 1.0 / metres_per_world_unit),
    )


def _gripper_poses(
    rng: np.random.Generator, n: int, motion: Motion, camera_T_gripper: Array
) -> Array:
    """base_T_gripper (n, 4, 4) from which the camera looks at the scene."""
    distance = rng.uniform(*CAMERA_DISTANCE, n)
    aim = SCENE_CENTRE + AIM_SIGMA * rng.standard_normal((n, 3))
    roll = rng.uniform(-np.pi, np.pi, n)
    azimuth = rng.uniform(-np.pi, np.pi, n)
    # The square root spreads the views evenly over the dome.
    tilt = DOME_TILT * np.sqrt(rng.uniform(0.0, 1.0, n))
    match motion:
        case "general":
            rotation = _looking_down(azimuth, tilt, roll)
        case "pure_translation":
            rotation = np.broadcast_to(_looking_down(azimuth[:1], tilt[:1], roll[:1]), (n, 3, 3))
        case "one_axis":
            first = _looking_down(azimuth[:1], 0.5 * tilt[:1], roll[:1])
            vertical = np.stack([np.zeros(n), np.zeros(n), roll], axis=1)
            rotation = _rotation(vertical) @ first
        case "pure_rotation":
            # Tilts stay small: the camera hardly moves, and must keep the scene in sight.
            rotation = _looking_down(azimuth, 0.25 * tilt, roll)
            upright = pose(_looking_down(np.zeros(1), np.zeros(1), np.zeros(1))[0], np.zeros(3))
            position = (upright @ camera_T_gripper)[:3, 3] + SCENE_CENTRE
            position[2] += np.mean(CAMERA_DISTANCE)
            return pose(rotation @ camera_T_gripper[:3, :3], np.broadcast_to(position, (n, 3)))
        case _:
            assert_never(motion)
    base_T_camera = pose(rotation, aim - distance[:, None] * rotation[:, :, 2])
    return base_T_camera @ camera_T_gripper


def _looking_down(azimuth: Array, tilt: Array, roll: Array) -> Array:
    """Camera orientations (n, 3, 3) in base: optical axis down, tilted, turned about itself."""
    zero = np.zeros_like(roll)
    down = np.diag([1.0, -1.0, -1.0])
    tilted = _rotation(np.stack([tilt * np.cos(azimuth), tilt * np.sin(azimuth), zero], axis=1))
    return tilted @ down @ _rotation(np.stack([zero, zero, roll], axis=1))


def _observed(
    rng: np.random.Generator,
    camera: CameraModel,
    truth: Truth,
    points_world: Array,
    visibility: float,
) -> tuple[Indices, Indices]:
    """Image and point indices (m,) of the observations of points that two images or more see."""
    camera_T_world = inverse(truth.world_T_camera)
    points_camera = np.stack([_transform(pose_, points_world) for pose_ in camera_T_world])
    depth = points_camera[..., 2] * truth.metres_per_world_unit
    in_front = depth > NEAREST_DEPTH
    safe = np.where(in_front[..., None], points_camera, [0.0, 0.0, 1.0])
    pixels = project(camera, safe)
    size = np.array([camera.width, camera.height])
    fx, fy = lens_of(camera).focal
    corner = math.hypot(camera.width / fx, camera.height / fy) / 2.0
    near_axis = np.hypot(safe[..., 0], safe[..., 1]) < FOLD_GUARD * corner * safe[..., 2]
    inside = np.all((pixels >= 0.0) & (pixels <= size), axis=-1)
    seen = in_front & near_axis & inside & (rng.uniform(size=in_front.shape) < visibility)
    seen &= seen.sum(axis=0) >= 2
    image_index, point_index = np.nonzero(seen)
    return image_index, point_index


def _pixels(
    camera: CameraModel,
    world_T_camera: Array,
    points_world: Array,
    image_index: Indices,
    point_index: Indices,
) -> Array:
    """Noise-free pixels (m, 2) of the observations."""
    camera_T_world = inverse(world_T_camera)[image_index]
    points = points_world[point_index]
    rotated = np.einsum("mij,mj->mi", camera_T_world[:, :3, :3], points)
    return project(camera, rotated + camera_T_world[:, :3, 3])


def _transform(a_T_b: Array, points_b: Array) -> Array:
    """Points (p, 3) of frame b in frame a."""
    return points_b @ a_T_b[:3, :3].T + a_T_b[:3, 3]


def _rotation(rotation_vector: Array) -> Array:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3)."""
    xi = np.concatenate([rotation_vector, np.zeros_like(rotation_vector)], axis=-1)
    return exp(xi)[..., :3, :3]


def _directions(rng: np.random.Generator, n: int) -> Array:
    """Uniform unit vectors (n, 3)."""
    vectors = rng.standard_normal((n, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
