"""Images that incremental mapping left out, placed where the robot says they were; ``complete``.

Mapping joins images only through points that they share. The robot joins those as well that show
another side of the object: with X known nearly, it tells where each camera was, and which pairs of
images match rightly.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.sfm.adjustment import adjust
from handeye_fg.sfm.model import to_sfm_model
from handeye_fg.sfm.native import native_camera, run_cancellable
from handeye_fg.sfm.stages import DATABASE
from handeye_fg.types import CameraModel, SfmModel, folder_of

# Matches this near to their epipolar lines agree with the cameras (pixels): an X that is off by a degree's
# tenth and a millimetre or two moves them by two.
_NEAR_PX = 3.0
# A pair is right if so many of its matches agree, and this part of them: of look-alikes up to 0.6 do.
_FEWEST_MATCHES, _AGREE = 15, 0.7
# Points that must hold an image.
_FEWEST_POINTS = 15
# The cameras are near, not exact: adjusted, they let more matches be points.
_ROUNDS = 3
_LARGEST_ERROR_PX, _LEAST_ANGLE_DEG = 2.0, 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pair:
    """Two images by number, and the matches (m, 2) that the cameras agree with."""

    first: int
    second: int
    essential: Array
    matches: NDArray[np.uint32]


def complete(
    folder: Path,
    model: SfmModel,
    expected: Mapping[str, Array],
    cameras: Mapping[str, CameraModel],
) -> SfmModel:
    """Place images that a model left out.

    Args:
        folder: of the reconstruction, with its database.
        model: the reconstruction.
        expected: by name of an image that it left out, where the camera was: world_T_camera (4, 4), to
            some pixels.
        cameras: the intrinsics for each folder of images.

    Returns:
        The model with those of the images whose matches agree; itself if there are none.

    Raises:
        ReconstructionError: COLMAP failed.
    """
    poses = dict(zip(model.names, model.world_T_camera, strict=True)) | dict(expected)
    with TemporaryDirectory() as scratch:
        work = Path(scratch)
        with pycolmap.Database.open(folder / DATABASE) as source:
            images = {image.name: image for image in source.read_all_images()}
            numbers = {name: image.image_id for name, image in images.items()}
            at = {numbers[name]: pose for name, pose in poses.items()}
            lenses = {
                numbers[n]: native_camera(cameras[folder_of(n)], images[n].camera_id) for n in poses
            }
            pairs = _agreeing(source, at, lenses)
            new = {numbers[name] for name in expected}
            joined = {i for pair in pairs for i in (pair.first, pair.second)} & new
            if not joined:
                return model
            known = {i: pose for i, pose in at.items() if i in joined or i not in new}
            start = _reconstruction(source, known, lenses)
        database = _database(folder / DATABASE, pairs, work / DATABASE)
        found = _adjusted(start, database, work)
    for image in list(found.images.values()):
        if image.image_id in joined and image.num_points3D < _FEWEST_POINTS:
            found.deregister_frame(image.frame_id)
    placed = {found.images[i].name for i in found.reg_image_ids()}
    unregistered = tuple(row for row in model.unregistered if row[0] not in placed)
    return replace(to_sfm_model(found, unregistered), static_share=model.static_share)


def _agreeing(
    db: pycolmap.Database, at: Mapping[int, Array], lenses: Mapping[int, pycolmap.Camera]
) -> list[_Pair]:
    """The pairs of images whose verified matches agree with their cameras."""
    rays = {
        i: np.insert(
            lenses[i].cam_from_img(np.asarray(db.read_keypoints(i)[:, :2], dtype=float)), 2, 1.0, 1
        )
        for i in at
    }
    found = []
    pair_ids, inliers = db.read_two_view_geometry_num_inliers()
    for pair_id, n in zip(pair_ids, inliers, strict=True):
        first, second = pycolmap.pair_id_to_image_pair(pair_id)
        if n < _FEWEST_MATCHES or first not in at or second not in at:
            continue
        matches = np.asarray(db.read_two_view_geometry(first, second).inlier_matches)
        essential = _essential(frames.inverse(at[second]) @ at[first])
        focal = np.mean([lenses[first].mean_focal_length(), lenses[second].mean_focal_length()])
        distance = focal * _epipolar_distance(
            essential, rays[first][matches[:, 0]], rays[second][matches[:, 1]]
        )
        near = distance < _NEAR_PX
        if near.sum() >= max(_FEWEST_MATCHES, _AGREE * n):
            found.append(
                _Pair(first=first, second=second, essential=essential, matches=matches[near])
            )
    return found


def _essential(second_T_first: Array) -> Array:
    """Essential matrix (3, 3) of two cameras."""
    x, y, z = second_T_first[:3, 3]
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(skew @ second_T_first[:3, :3])


def _epipolar_distance(essential: Array, first: Array, second: Array) -> Array:
    """Sampson's distance (m,) of rays (m, 3) with unit depth."""
    lines, back = first @ essential.T, second @ essential
    square = np.sum(lines[:, :2] ** 2, axis=1) + np.sum(back[:, :2] ** 2, axis=1)
    return np.asarray(np.abs(np.sum(second * lines, axis=1)) / np.sqrt(square))


def _database(source: Path, pairs: Sequence[_Pair], copy: Path) -> Path:
    """A copy of a database with these pairs only."""
    shutil.copyfile(source, copy)
    with pycolmap.Database.open(copy) as db:
        db.clear_two_view_geometries()
        for pair in pairs:
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.E = pair.essential
            geometry.inlier_matches = pair.matches
            db.write_two_view_geometry(pair.first, pair.second, geometry)
    return copy


def _reconstruction(
    db: pycolmap.Database, at: Mapping[int, Array], lenses: Mapping[int, pycolmap.Camera]
) -> pycolmap.Reconstruction:
    """Cameras with their poses and features, without points."""
    result = pycolmap.Reconstruction()
    for lens in {lenses[i].camera_id: lenses[i] for i in at}.values():
        result.add_camera_with_trivial_rig(lens)
    for image in db.read_all_images():
        if image.image_id in at:
            posed = pycolmap.Image(
                name=image.name,
                keypoints=np.asarray(db.read_keypoints(image.image_id)[:, :2], dtype=np.float64),
                camera_id=image.camera_id,
                image_id=image.image_id,
            )
            camera_T_world = pycolmap.Rigid3d(frames.inverse(at[image.image_id])[:3])
            result.add_image_with_trivial_frame(posed, camera_T_world)
    return result


def _adjusted(
    start: pycolmap.Reconstruction, database: Path, work: Path
) -> pycolmap.Reconstruction:
    """Points from the matches, and cameras that fit them."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1  # the same result in every run
    # Sides of an object that two images show have no longer tracks; their pairs are known to be right.
    options.triangulation.ignore_two_view_tracks = False
    # The intrinsics are kept; some matches are wrong.
    kept = pycolmap.BundleAdjustmentOptions()
    kept.refine_focal_length = kept.refine_extra_params = False
    kept.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    found = start
    for _ in range(_ROUNDS):
        found = run_cancellable(
            lambda token, found=found: pycolmap.triangulate_points(  # type: ignore[misc]  # a default
                found,
                database,
                work,
                work,
                clear_points=False,
                options=options,
                cancellation_token=token,
            ),
            "the triangulation of points",
            lambda: None,
        )
        adjust(found, kept, "the adjustment of added images")
        pycolmap.ObservationManager(found).filter_all_points3D(_LARGEST_ERROR_PX, _LEAST_ANGLE_DEG)
    return found
