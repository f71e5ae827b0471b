"""What is there before a plan: the scene, the camera, the images taken; from a result, or assumed."""

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.summary import aligned
from handeye_fg.io.exports.trajectories import scene_poses
from handeye_fg.io.results import Result
from handeye_fg.options import NoiseOptions
from handeye_fg.parts import only
from handeye_fg.planning.candidates import Cameras
from handeye_fg.planning.sight import Sight, gripper_pose, in_image
from handeye_fg.priors import PosePrior, Prior
from handeye_fg.types import CameraModel, Indices, Rig, SfmModel, Tracks, folder_of

# So many points tell what images see; all of them would take long.
_MOST_POINTS = 600
# Two lines of sight that meet at this angle; a smaller one leaves the depth to the noise.
_LEAST_PARALLAX = 0.02
_LEAST_MATCHED = 0.05
# From the vertical, before the first image: neighbours on a ring of ten tilted by this see each other's features.
_WIDEST_VIEW = float(np.deg2rad(55.0))
_FEWEST_IMAGES = 3
# What rounding leaves of differences between poses of the gripper that are one.
_SAME = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Situation:
    """What a plan starts from.

    Attributes:
        cameras: the scene and the cameras.
        names: of several cameras; ("",) of one.
        scene_T_camera: where images were taken (n, 4, 4), in the scene's frame, metres.
        rig: which camera took an image, and at which robot pose.
        trusted: (r,) which robot poses are used, or may be.
        kept_out: (r,) which of them X has not seen, for a proof of it.
        image_index, point_index: which image saw which point (m,).
        levels: of each camera (k,) the standard deviation of its observations, relative to the noise's.
        sample: how many observations each of them stands for.
        matched: part of the points in sight that an image finds.
        noise: the levels.
        known: those that are not estimated.
        refine_intrinsics: (k,) whether the intrinsics are unknowns.
        priors: what is known of the first X beforehand.
    """

    cameras: Cameras
    names: tuple[str, ...]
    scene_T_camera: Array
    rig: Rig
    trusted: NDArray[np.bool_]
    kept_out: NDArray[np.bool_]
    image_index: Indices
    point_index: Indices
    levels: Array
    sample: float
    matched: float
    noise: NoiseLevels
    known: NoiseOptions
    refine_intrinsics: tuple[bool, ...]
    priors: tuple[Prior | PosePrior, ...] = ()

    @property
    def sight(self) -> Sight:
        """The scene and the first camera."""
        return self.cameras.sights[0]

    @property
    def frame(self) -> str:
        """The parent frame of X."""
        return "base" if self.cameras.static else "gripper"

    @property
    def taken(self) -> Array:
        """The poses (r, 4, 4) of the gripper at which images were taken, metres."""
        _, first = np.unique(self.rig.pose, return_index=True)
        X = self.cameras.gripper_T_cameras[self.rig.camera[first]]
        return gripper_pose(self.scene_T_camera[first], X, static=self.cameras.static)


def situation_of(
    rng: np.random.Generator,
    result: Result,
    model: SfmModel,
    priors: tuple[Prior | PosePrior, ...] = (),
) -> Situation:
    """What a calibration leaves.

    Args:
        rng: chooses the points that stand for all.
        result: the calibration.
        model: the reconstruction that it was made from.
        priors: what was known of the first X beforehand.

    Raises:
        InputDataError: the result has no images, or does not belong to the model.
    """
    if result.noise is None or result.camera is None:
        raise InputDataError(
            "the result has no images, so that nobody knows what the camera sees; plan for a calibration "
            "from images"
        )
    static = result.setup == "eye-to-hand"
    model, placed, points = _in_scene(result, model)
    several = result.cameras
    names = tuple(one.name for one in several) or ("",)
    lenses = tuple(one.camera for one in several) or (result.camera,)
    refined = tuple(one.intrinsics_refined for one in several) or (result.intrinsics_refined,)
    X = np.array([one.matrix for one in several or (result,)])
    levels = np.array([one.pixel / result.noise.pixel for one in several] or [1.0])
    index = {name: i for i, name in enumerate(names)}
    taken_by = np.array([index[folder_of(name)] if several else 0 for name in model.names])
    grippers = gripper_pose(placed, X[taken_by], static=static)
    rig = Rig(n_cameras=len(X), camera=taken_by, pose=_same_pose(model.names, grippers))
    held = result.holdout
    unseen = set() if held is None or held.new_images else {image.name for image in held.images}
    trusted = ~_poses_of(rig, model.names, {image.name for image in result.images if image.outlier})
    tracks, sample = _thinned(rng, _clean(model.tracks, placed, points, lenses, taken_by))
    sights = tuple(_sight(tracks, placed, lens) for lens in lenses)
    visible = sum(
        int(np.count_nonzero(sight.visible(placed[taken_by == i])))
        for i, sight in enumerate(sights)
    )
    return Situation(
        cameras=Cameras(sights=sights, gripper_T_cameras=X, static=static),
        names=names,
        scene_T_camera=placed,
        rig=rig,
        trusted=trusted,
        kept_out=_poses_of(rig, model.names, unseen),
        image_index=tracks.image_index,
        point_index=tracks.point_index,
        levels=levels,
        sample=sample,
        matched=float(np.clip(len(tracks.point_index) / max(visible, 1), _LEAST_MATCHED, 1.0)),
        noise=result.noise,
        known=_known(result),
        refine_intrinsics=refined,
        priors=priors,
    )


def _poses_of(rig: Rig, names: Sequence[str], wanted: AbstractSet[str]) -> NDArray[np.bool_]:
    """Which robot poses (r,) are those of some of the images."""
    found = np.zeros(int(rig.pose.max()) + 1, dtype=bool)
    found[rig.pose[[name in wanted for name in names]]] = True
    return found


def _same_pose(names: Sequence[str], base_T_gripper: Array) -> Indices:
    """Which robot pose (n,) each image was taken at: images of one file name in several folders share one."""
    poses: dict[tuple[str, int], int] = {}
    found: list[int] = []
    for name, matrix in zip(names, base_T_gripper, strict=True):
        copy = 0
        while (key := (PurePosixPath(name).name, copy)) in poses:
            other = base_T_gripper[found.index(poses[key])]
            if np.allclose(matrix, other, rtol=0.0, atol=_SAME):
                break
            copy += 1
        found.append(poses.setdefault(key, len(poses)))
    return np.array(found, dtype=np.int64)


def assumed_situation(
    rng: np.random.Generator,
    look_at: Array,
    standoff: float,
    camera: CameraModel,
    X: Array,
    noise: NoiseLevels,
) -> Situation:
    """Before the first image: a flat scene of the size of the view, seen from above.

    Args:
        rng: draws its points.
        look_at: its middle (3,) in the base, metres.
        standoff: distance of the camera from it, metres.
        camera: the intrinsics.
        X: about where the camera is on the gripper (4, 4), metres.
        noise: the levels to expect.
    """
    half_size = 0.35 * standoff * np.array([1.0, 1.0, 0.2])
    points = look_at + rng.uniform(-1.0, 1.0, (_MOST_POINTS // 4, 3)) * half_size
    sight = Sight(
        points=points,
        rays=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
        distances=np.full(len(points), standoff),
        point_index=np.arange(len(points)),
        camera=camera,
        widest_angle=_WIDEST_VIEW,
    )
    none = np.zeros(0, dtype=np.int64)
    return Situation(
        cameras=Cameras(sights=(sight,), gripper_T_cameras=X[None], static=False),
        names=("",),
        scene_T_camera=np.zeros((0, 4, 4)),
        rig=Rig.of_one_camera(0),
        trusted=np.zeros(0, dtype=bool),
        kept_out=np.zeros(0, dtype=bool),
        image_index=none,
        point_index=none,
        levels=np.ones(1),
        sample=1.0,
        matched=1.0,
        noise=noise,
        known=NoiseOptions(),
        refine_intrinsics=(False,),
    )


def _in_scene(result: Result, model: SfmModel) -> tuple[SfmModel, Array, Array]:
    """The images that have a pose in the result; cameras (n, 4, 4) and points (p, 3) in the scene's frame, metres.

    The world of a result with a target is not that of the reconstruction: the cameras tell.

    Raises:
        InputDataError: fewer than three images are in both.
    """
    found = scene_poses(result)
    names = [name for name in model.names if name in found]
    if len(names) < _FEWEST_IMAGES:
        raise InputDataError(
            f"only {len(names)} images of the reconstruction have a pose in the result: the two do not "
            "belong together; calibrate again"
        )
    model = only(model, names)
    cameras = np.array([found[name] for name in names])
    scale = _extent(cameras) / _extent(model.world_T_camera)
    scene_T_world = aligned(cameras, frames.scaled(model.world_T_camera, scale))
    points = scale * model.tracks.points_world @ scene_T_world[:3, :3].T + scene_T_world[:3, 3]
    return model, cameras, points


def _extent(cameras: Array) -> float:
    return float(np.sqrt(np.sum(np.var(cameras[:, :3, 3], axis=0))))


def _clean(
    tracks: Tracks, cameras: Array, points: Array, lenses: Sequence[CameraModel], taken_by: Indices
) -> Tracks:
    """The observations that are where the camera looks, of points with depth; points in metres."""
    image, point = tracks.image_index, tracks.point_index
    offsets = points[point] - cameras[image, :3, 3]
    in_camera = np.einsum("mji,mj->mi", cameras[image, :3, :3], offsets)
    good = np.zeros(len(image), dtype=bool)
    for i, lens in enumerate(lenses):
        own = taken_by[image] == i
        good[own] = in_image(lens, in_camera[own])
    rays = offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    total = np.zeros((len(points), 3))
    np.add.at(total, point[good], rays[good])
    counts = np.bincount(point[good], minlength=len(points))
    together = np.linalg.norm(total, axis=1) / np.maximum(counts, 1)
    good &= (together < np.cos(0.5 * _LEAST_PARALLAX))[point]
    return Tracks(
        points_world=points,
        image_index=image[good],
        point_index=point[good],
        pixels=tracks.pixels[good],
    )


def _thinned(rng: np.random.Generator, tracks: Tracks) -> tuple[Tracks, float]:
    """Some of the points, and how many observations each of theirs stands for."""
    counts = np.bincount(tracks.point_index, minlength=len(tracks.points_world))
    usable = np.flatnonzero(counts >= 2)
    if len(usable) == 0:
        raise InputDataError("the reconstruction has no point that two images see; calibrate again")
    kept = np.sort(rng.permutation(usable)[:_MOST_POINTS])
    chosen = np.isin(tracks.point_index, kept)
    order = np.argsort(tracks.point_index[chosen], kind="stable")
    thin = Tracks(
        points_world=tracks.points_world[kept],
        image_index=tracks.image_index[chosen][order],
        point_index=np.searchsorted(kept, tracks.point_index[chosen])[order],
        pixels=tracks.pixels[chosen][order],
    )
    return thin, float(counts[usable].sum() / np.count_nonzero(chosen))


def _sight(tracks: Tracks, cameras: Array, camera: CameraModel) -> Sight:
    offsets = cameras[tracks.image_index, :3, 3] - tracks.points_world[tracks.point_index]
    distances = np.linalg.norm(offsets, axis=1)
    return Sight(
        points=tracks.points_world,
        rays=offsets / distances[:, None],
        distances=distances,
        point_index=tracks.point_index,
        camera=camera,
    )


def _known(result: Result) -> NoiseOptions:
    """The noise levels that the user gave."""
    levels = {} if result.certainty is None else result.certainty.levels
    given = {name for name, level in levels.items() if level.source == "user"}
    noise = result.noise
    if noise is None:
        return NoiseOptions()
    return NoiseOptions(
        pixel_px=noise.pixel if "pixel" in given else None,
        robot_rotation_deg=float(np.rad2deg(noise.robot_rotation))
        if "robot_rotation" in given
        else None,
        robot_translation_mm=1e3 * noise.robot_translation
        if "robot_translation" in given
        else None,
    )
