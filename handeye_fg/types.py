"""Frozen values that cross module borders; shapes and frames are checked once, here.

Arrays are copied to float64 (indices to int64) and made read-only. Types that hold arrays compare by identity.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array

Setup = Literal["eye-in-hand", "eye-to-hand"]
Indices = NDArray[np.int64]


def frozen_array(value: Array, shape: tuple[int | None, ...], name: str) -> Array:
    """A read-only float64 copy of an array with the given shape (None: any length)."""
    array = np.array(value, dtype=np.float64)
    fits = array.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{name}: {array.shape=} but expected {shape}")
    array.setflags(write=False)
    return array


def frozen_indices(value: Indices, length: int, name: str) -> Indices:
    """A read-only int64 copy of a vector of indices."""
    array = np.array(value, dtype=np.int64)
    if array.shape != (length,):
        raise ValueError(f"{name}: {array.shape=} but expected ({length},)")
    array.setflags(write=False)
    return array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraModel:
    """Intrinsics of one camera, under COLMAP's names and parameter order.

    Attributes:
        model: PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV, OPENCV_FISHEYE ...
        width, height: image size in pixels.
        params: parameters (k,) in COLMAP's order; the centre of the first pixel is at (0.5, 0.5).
    """

    model: str
    width: int
    height: int
    params: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "params", frozen_array(self.params, (None,), "params"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotPoses:
    """What the controller reported, by image name.

    Attributes:
        names: image names (n,), unique.
        base_T_gripper: poses (n, 4, 4), metres.
    """

    names: tuple[str, ...]
    base_T_gripper: Array

    def __post_init__(self) -> None:
        shape = (len(self.names), 4, 4)
        object.__setattr__(
            self, "base_T_gripper", frozen_array(self.base_T_gripper, shape, "base_T_gripper")
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tracks:
    """Scene points and where images see them, as a structure of arrays.

    Attributes:
        points_world: positions (p, 3) in world units.
        image_index: for each observation the index (m,) of its image.
        point_index: for each observation the index (m,) of its point.
        pixels: observed positions (m, 2).
    """

    points_world: Array
    image_index: Indices
    point_index: Indices
    pixels: Array

    def __post_init__(self) -> None:
        n = len(self.pixels)
        object.__setattr__(
            self, "points_world", frozen_array(self.points_world, (None, 3), "points_world")
        )
        object.__setattr__(self, "pixels", frozen_array(self.pixels, (None, 2), "pixels"))
        for name in ("image_index", "point_index"):
            object.__setattr__(self, name, frozen_indices(getattr(self, name), n, name))


def folder_of(image: str) -> str:
    """The folder in an image's name, "." without one: of several cameras each has a folder."""
    return str(PurePosixPath(image).parent)


def folders_of(images: Sequence[str]) -> tuple[str, ...]:
    """The folders of images, sorted."""
    return tuple(sorted({folder_of(image) for image in images}))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Which camera of an arm took an image, and at which robot pose.

    Attributes:
        n_cameras: number of cameras.
        camera: index (n,) of the camera, for each image.
        pose: index (n,) of the robot pose; images of several cameras may share one.
    """

    n_cameras: int
    camera: Indices
    pose: Indices

    def __post_init__(self) -> None:
        for name in ("camera", "pose"):
            object.__setattr__(
                self, name, frozen_indices(getattr(self, name), len(self.camera), name)
            )

    @staticmethod
    def of_one_camera(n_images: int) -> "Rig":
        """One camera, each image at a robot pose of its own."""
        return Rig(n_cameras=1, camera=np.zeros(n_images, dtype=np.int64), pose=np.arange(n_images))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fragment:
    """Images that hang together, in a world of their own: its frame and unit are no other's.

    Attributes:
        names: names (n,) of the images.
        world_T_camera: camera poses (n, 4, 4).
        cameras: the intrinsics for each folder of images.
    """

    names: tuple[str, ...]
    world_T_camera: Array
    cameras: Mapping[str, CameraModel]

    def __post_init__(self) -> None:
        poses = frozen_array(self.world_T_camera, (len(self.names), 4, 4), "world_T_camera")
        object.__setattr__(self, "world_T_camera", poses)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SfmModel:
    """A reconstruction up to a similarity: the registered images only.

    Attributes:
        names: names (n,) of the registered images.
        world_T_camera: camera poses (n, 4, 4), translations in world units.
        cameras: the intrinsics that the reconstruction used (refined by it, or as given), by camera.
        image_camera: index (n,) of the camera that took an image.
        tracks: points and observations; ``image_index`` refers to ``names``.
        mean_reprojection_px: mean length of the reprojection errors.
        unregistered: (image name, reason) of the images that were read but have no pose.
        static_share: part of the features that stayed at their pixel while the robot turned; they were
            left out.
        fragments: what hangs together of the images without pose, largest first.
        by_robot: number of images that were joined to the others through the robot's poses.
    """

    names: tuple[str, ...]
    world_T_camera: Array
    cameras: tuple[CameraModel, ...]
    image_camera: Indices
    tracks: Tracks
    mean_reprojection_px: float
    unregistered: tuple[tuple[str, str], ...]
    static_share: float = 0.0
    fragments: tuple[Fragment, ...] = ()
    by_robot: int = 0

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(
            self, "image_camera", frozen_indices(self.image_camera, n, "image_camera")
        )
        object.__setattr__(
            self, "world_T_camera", frozen_array(self.world_T_camera, (n, 4, 4), "world_T_camera")
        )

    @property
    def camera(self) -> CameraModel:
        """The first camera."""
        return self.cameras[0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownPoints:
    """The first points of a model's tracks where their positions are known: corners of a target.

    They make the model's world metric: its unit is the target's metre.

    Attributes:
        points_world: positions (k, 3), metres.
        sigma: standard deviation of a position, per axis, metres.
        log_scale_sigma: standard deviation of ln(metres_per_world_unit), the scale of all positions.
    """

    points_world: Array
    sigma: float
    log_scale_sigma: float

    def __post_init__(self) -> None:
        object.__setattr__(
            self, "points_world", frozen_array(self.points_world, (None, 3), "points_world")
        )
