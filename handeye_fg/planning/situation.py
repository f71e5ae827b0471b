"""What is there before a plan: the scene, the camera, the images taken; from a result, or assumed."""

from dataclasses import dataclass

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
from handeye_fg.planning.sight import Sight, in_image
from handeye_fg.priors import PosePrior, Prior
from handeye_fg.types import CameraModel, Indices, SfmModel, Tracks

# So many points tell what images see; all of them would take long.
_MOST_POINTS = 600
# Two lines of sight that meet at this angle; a smaller one leaves the depth to the noise.
_LEAST_PARALLAX = 0.02
_LEAST_MATCHED = 0.05
_FEWEST_IMAGES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Situation:
    """What a plan starts from.

    Attributes:
        sight: the scene and the camera.
        X: the camera on the gripper (4, 4), of a static camera in the base, metres.
        scene_T_camera: where images were taken (n, 4, 4), in the scene's frame, metres.
        trusted: (n,) whose robot poses are used.
        image_index, point_index: which image saw which point (m,).
        sample: how many observations each of them stands for.
        matched: part of the points in sight that an image finds.
        noise: the levels.
        known: those that are not estimated.
        refine_intrinsics: whether the intrinsics are unknowns.
        priors: what is known of X beforehand.
        static: whether the camera stands still.
    """

    sight: Sight
    X: Array
    scene_T_camera: Array
    trusted: NDArray[np.bool_]
    image_index: Indices
    point_index: Indices
    sample: float
    matched: float
    noise: NoiseLevels
    known: NoiseOptions
    refine_intrinsics: bool = False
    priors: tuple[Prior | PosePrior, ...] = ()
    static: bool = False

    @property
    def frame(self) -> str:
        """The parent frame of X."""
        return "base" if self.static else "gripper"


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
        priors: what was known of X beforehand.

    Raises:
        InputDataError: the result has no images or several cameras, or does not belong to the model.
    """
    if result.noise is None or result.camera is None:
        raise InputDataError(
            "the result has no images, so that nobody knows what the camera sees; plan for a calibration "
            "from images"
        )
    if result.cameras:
        raise InputDataError(
            f"the result has {len(result.cameras)} cameras, but poses are planned for one; calibrate the "
            "images of one camera by themselves"
        )
    model, cameras, points = _in_scene(result, model)
    outliers = {image.name for image in result.images if image.outlier}
    tracks, sample = _thinned(rng, _clean(model.tracks, cameras, points, result.camera))
    sight = _sight(tracks, cameras, result.camera)
    visible = sight.visible(cameras)
    matched = len(tracks.point_index) / max(int(np.count_nonzero(visible)), 1)
    return Situation(
        sight=sight,
        X=result.matrix,
        scene_T_camera=cameras,
        trusted=np.array([name not in outliers for name in model.names]),
        image_index=tracks.image_index,
        point_index=tracks.point_index,
        sample=sample,
        matched=float(np.clip(matched, _LEAST_MATCHED, 1.0)),
        noise=result.noise,
        known=_known(result),
        refine_intrinsics=result.intrinsics_refined,
        priors=priors,
        static=result.setup == "eye-to-hand",
    )


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
    everywhere = np.arange(len(points))
    return Situation(
        sight=Sight(
            points=points,
            rays=np.tile([0.0, 0.0, 1.0], (len(points), 1)),
            distances=np.full(len(points), standoff),
            point_index=everywhere,
            camera=camera,
            widest_angle=float(np.deg2rad(45.0)),
        ),
        X=X,
        scene_T_camera=np.zeros((0, 4, 4)),
        trusted=np.zeros(0, dtype=bool),
        image_index=np.zeros(0, dtype=np.int64),
        point_index=np.zeros(0, dtype=np.int64),
        sample=1.0,
        matched=1.0,
        noise=noise,
        known=NoiseOptions(),
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


def _clean(tracks: Tracks, cameras: Array, points: Array, camera: CameraModel) -> Tracks:
    """The observations that are where the camera looks, of points with depth; points in metres."""
    image, point = tracks.image_index, tracks.point_index
    offsets = points[point] - cameras[image, :3, 3]
    good = in_image(camera, np.einsum("mji,mj->mi", cameras[image, :3, :3], offsets))
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
