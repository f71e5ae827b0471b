"""Images that a reconstruction was not made from, found in it; entry point ``find_in_scene``."""

import shutil
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap
from scipy.spatial import KDTree

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress
from handeye_fg.sfm.cache import file_digests
from handeye_fg.sfm.database import matching_options, verification_options
from handeye_fg.sfm.eight_bit import readable
from handeye_fg.sfm.features import STRICT, find_features
from handeye_fg.sfm.model_files import model_folder
from handeye_fg.sfm.native import native_camera, native_threads, run_cancellable
from handeye_fg.sfm.stages import DATABASE, prepare
from handeye_fg.types import Indices, SfmModel

# A feature of an old image is the one that was refined if it is no farther off (pixels).
_SAME = 1e-3
# Fewer points do not place an image for sure.
_FEWEST_POINTS = 15
# Of a feature's place, in standard deviations.
_REJECTION_SIGMAS = 4.0
_LEAST_ERROR_PX = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Seen:
    """What a new image shows of the scene.

    Attributes:
        point_index: points (m,).
        pixels: where (m, 2).
    """

    point_index: Indices
    pixels: Array


def find_in_scene(
    database: Path,
    images: Path,
    names: Sequence[str],
    image_camera: Sequence[int],
    model: SfmModel,
    sigma: float,
    *,
    options: SfmOptions,
    seed: int,
    progress: Progress,
) -> dict[str, Seen]:
    """Find the points of a scene in new images.

    Args:
        database: of the reconstruction; it is not written to.
        images: folder of the new images.
        names: of these.
        image_camera: which of the model's cameras took each.
        model: the scene as it is now: names, intrinsics of the cameras, points, and where images show them.
        sigma: standard deviation of a feature's place, pixels.
        options: how features were searched for.
        seed: of the random samples.
        progress: told "features".

    Returns:
        By name what agrees with one pose of the camera; images that show too little of the scene are missing.

    Raises:
        InputDataError: an image cannot be read, or the database is not that of the model.
        ReconstructionError: COLMAP failed.
    """
    with TemporaryDirectory() as scratch:
        work = Path(scratch)
        stages = prepare(work / "stages")
        source, contents = readable(stages, images, file_digests(images, names, None))
        features = find_features(
            stages,
            source,
            contents,
            masks=None,
            sensitivity=STRICT,
            options=options,
            progress=progress,
        )
        copy = work / DATABASE
        shutil.copyfile(database, copy)
        cameras = dict(zip(names, image_camera, strict=True))
        _require_features(copy, model, database)
        old, numbers = _added(copy, features.database, work, model, cameras, options, seed)
        with pycolmap.Database.open(copy) as db:
            votes = _votes(db, old, numbers, model)
            return {
                name: seen
                for name, number in numbers.items()
                if (seen := _agreeing(db, number, votes[name], model, cameras[name], sigma, seed))
                is not None
            }


def model_database(model: Path) -> Path | None:
    """The database beside a COLMAP model: in its folder, or in the one that has it in ``sparse/0``; None: none."""
    folder = model_folder(model) or model
    places = (folder, folder.parent, folder.parent.parent)
    return next((place / DATABASE for place in places if (place / DATABASE).is_file()), None)


def _require_features(copy: Path, model: SfmModel, database: Path) -> None:
    """Refuse a database without the features by which the model's images show its points.

    Raises:
        InputDataError: it is of another model, has other features, or is no database.
    """
    try:
        with pycolmap.Database.open(copy) as db:
            problem = _lacking(db, model)
    except (RuntimeError, ValueError) as error:
        problem = f"cannot be read ({error})"
    if problem:
        raise InputDataError(
            f"database {database}: {problem}; give a model that lies beside the database it was made from, with "
            "SIFT features"
        )


def _lacking(db: pycolmap.Database, model: SfmModel) -> str:
    """What a database lacks of a model's features; "" for nothing."""
    numbers = {image.name: image.image_id for image in db.read_all_images()}
    for i, name in enumerate(model.names):
        own = model.tracks.image_index == i
        if name not in numbers:
            return f"has no image {name} of the model"
        if not own.any():
            continue
        descriptors = db.read_descriptors(numbers[name])
        if descriptors.type != pycolmap.FeatureExtractorType.SIFT or len(descriptors.data) == 0:
            return f"has no SIFT features of {name}"
        places = np.asarray(db.read_keypoints(numbers[name])[:, :2], dtype=np.float64)
        if np.median(KDTree(places).query(model.tracks.pixels[own])[0]) > _SAME:
            return f"has other features of {name} than the model"
    return ""


def _added(
    database: Path,
    features: Path,
    work: Path,
    model: SfmModel,
    image_camera: Mapping[str, int],
    options: SfmOptions,
    seed: int,
) -> tuple[dict[str, int], dict[str, int]]:
    """Add images with their features to a database, and match them with those of the model; the numbers of both."""
    with pycolmap.Database.open(database) as db, pycolmap.Database.open(features) as source:
        images = db.read_all_images()
        old = {image.name: image.image_id for image in images}
        # COLMAP's number of each camera: that of its first image.
        numbers = {image.name: image.camera_id for image in images}
        _, first = np.unique(model.image_camera, return_index=True)
        natives = [
            native_camera(camera, numbers[model.names[i]])
            for camera, i in zip(model.cameras, first.tolist(), strict=True)
        ]
        for native in natives:
            native.has_prior_focal_length = True
            db.update_camera(native)
        for image in (
            images
        ):  # a blank would end a name in a list of pairs, and new images may have the same
            image.name = f"old/{image.image_id}"
            db.update_image(image)
        new, pairs = {}, []
        for image in source.read_all_images():
            camera_id = natives[image_camera[image.name]].camera_id
            added = pycolmap.Image(name=f"new/{image.image_id}", camera_id=camera_id)
            number = db.write_image(added)
            db.write_keypoints(number, source.read_keypoints(image.image_id))
            db.write_descriptors(number, source.read_descriptors(image.image_id))
            new[image.name] = number
            pairs += [f"{added.name} old/{old[name]}" for name in model.names]
    listed = work / "pairs.txt"
    listed.write_text("\n".join(pairs), encoding="utf-8")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    matching = matching_options(STRICT)
    matching.num_threads = native_threads(options)
    pycolmap.set_random_seed(seed)
    run_cancellable(
        lambda token: pycolmap.match_image_pairs(
            database,
            matching_options=matching,
            pairing_options=pairing,
            verification_options=verification_options(seed),
            device=pycolmap.Device.cpu,
            cancellation_token=token,
        ),
        "the matching of features",
        lambda: None,
    )
    return old, new


def _votes(
    db: pycolmap.Database, old: Mapping[str, int], numbers: Mapping[str, int], model: SfmModel
) -> dict[str, dict[int, Counter[int]]]:
    """By new image and feature which points the matching features of old images are, and how many."""
    votes: dict[str, dict[int, Counter[int]]] = {name: {} for name in numbers}
    for i, name in enumerate(model.names):
        own = np.flatnonzero(model.tracks.image_index == i)
        if len(own) == 0:
            continue
        places = np.asarray(db.read_keypoints(old[name])[:, :2], dtype=np.float64)
        distance, nearest = KDTree(model.tracks.pixels[own]).query(places)
        point = np.where(distance < _SAME, model.tracks.point_index[own[nearest]], -1)
        for new, number in numbers.items():
            if not db.exists_two_view_geometry(number, old[name]):
                continue
            matches = db.read_two_view_geometry(number, old[name]).inlier_matches
            for feature, other in np.asarray(matches).tolist():
                if point[other] >= 0:
                    votes[new].setdefault(feature, Counter())[int(point[other])] += 1
    return votes


def _agreeing(
    db: pycolmap.Database,
    number: int,
    votes: Mapping[int, Counter[int]],
    model: SfmModel,
    camera: int,
    sigma: float,
    seed: int,
) -> Seen | None:
    """The features of a new image that agree with one pose of the camera; None: too few do."""
    chosen = {feature: points.most_common(1)[0] for feature, points in votes.items()}
    # A point is one place: of several features that match it the one with the most votes.
    best: dict[int, tuple[int, int]] = {}
    for feature, (point, count) in sorted(chosen.items()):
        if count > best.get(point, (0, 0))[1]:
            best[point] = (feature, count)
    if len(best) < _FEWEST_POINTS:
        return None
    point_index = np.array(sorted(best), dtype=np.int64)
    places = np.asarray(db.read_keypoints(number)[:, :2], dtype=np.float64)
    pixels = places[[best[point][0] for point in point_index.tolist()]]
    estimation = pycolmap.AbsolutePoseEstimationOptions()
    estimation.ransac.max_error = max(_REJECTION_SIGMAS * sigma, _LEAST_ERROR_PX)
    estimation.ransac.random_seed = seed
    found = pycolmap.estimate_and_refine_absolute_pose(
        pixels,
        model.tracks.points_world[point_index],
        native_camera(model.cameras[camera], 1),
        estimation,
    )
    if found is None or found["num_inliers"] < _FEWEST_POINTS:
        return None
    agrees = np.asarray(found["inlier_mask"], dtype=bool)
    return Seen(point_index=point_index[agrees], pixels=pixels[agrees])
