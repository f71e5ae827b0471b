"""The database that is matched and mapped: features that move, given cameras, matches of earlier runs.

Entry points ``begin_matching`` and ``adopt_matches``.
"""

import hashlib
import shutil
from collections.abc import Container, Mapping
from itertools import combinations
from pathlib import Path
from typing import Any

import pycolmap

from handeye_fg.frames import Array
from handeye_fg.sfm.features import Sensitivity, set_cameras, settings_of
from handeye_fg.sfm.stages import DATABASE, Stage, digest_of, open_stage
from handeye_fg.sfm.static import drop_static
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, Indices


def begin_matching(
    stages: Path,
    features: Stage,
    cameras: Mapping[str, CameraModel] | None,
    *,
    sensitivity: Sensitivity,
    seed: int,
    turns: RobotTurns | None,
    base_T_gripper: Array | None = None,
) -> Stage:
    """Begin a database for matches, without the static features.

    Args:
        stages: folder of all stages.
        features: the stage of the features.
        cameras: intrinsics to start from, for each folder of images; None: COLMAP's guess.
        sensitivity: how pairs are matched.
        seed: of the random samples.
        turns: how the robot turned from image to image; None: static features are kept.
        base_T_gripper: poses (n, 4, 4) that say which pairs are matched; None: all are.

    Returns:
        The stage. Its facts: ``static_share``, the part of the features that were left out because they
        are static, and ``images``, a digest of the features of each; COLMAP numbers them in this order
        from 1 on.

    Raises:
        InputDataError: the stage cannot be written.
    """
    geometry = {
        "options": settings_of(verification_options(seed)),
        "guided": sensitivity.guided,
        "cameras": described(cameras),
    }
    key = {
        "features": features.digest,
        "turns": None if turns is None else [turns.setup, turns.rotations.tolist()],
        "poses": None if base_T_gripper is None else base_T_gripper.tolist(),
        "matching": settings_of(matching_options(sensitivity)),
        "geometry": geometry,
    }

    def build(folder: Path, _: tuple[Stage, ...]) -> Mapping[str, Any]:
        database = folder / DATABASE
        shutil.copyfile(features.database, database)
        share = 0.0 if turns is None else drop_static(database, turns)
        with pycolmap.Database.open(database) as db:
            if cameras is not None:
                set_cameras(db, cameras)
            names = {image.image_id: image.name for image in db.read_all_images()}
            images = {names[image_id]: _content(db, image_id) for image_id in sorted(names)}
        return {"static_share": share, "images": images}

    stage = open_stage(stages, f"{sensitivity.name}-matches", key, build)
    _restore_names(stage)
    return stage


def adopt_matches(stage: Stage, pairs: Indices | None = None) -> None:
    """Copy what earlier runs found of pairs of images whose features did not change.

    Of pairs whose cameras or samples changed the matches are copied, and COLMAP finds their geometry again.

    Args:
        stage: with the database to fill.
        pairs: of images (k, 2), as indices in the order of their names; None: all.
    """
    with pycolmap.Database.open(stage.database) as db:
        ids = {name: k for k, name in enumerate(stage.facts["images"], start=1)}
        wanted = None if pairs is None else {(i + 1, j + 1) for i, j in pairs.tolist()}
        for older in stage.older:
            if older.key["matching"] == stage.key["matching"]:
                same = older.key["geometry"] == stage.key["geometry"]
                kept = stage.facts["images"].items() & older.facts["images"].items()
                _copy(older, db, {name: ids[name] for name, _ in kept}, wanted, geometry=same)


def content_of(stage: Stage, some: tuple[str, ...] = ()) -> str:
    """Digest of all in a database that mapping depends on, whatever it was made from.

    Args:
        stage: with the database.
        some: the images to be mapped; none: all.
    """
    images = {n: digest for n, digest in stage.facts["images"].items() if not some or n in some}
    chosen = {k for k, name in enumerate(stage.facts["images"], start=1) if name in images}
    with pycolmap.Database.open(stage.database) as db:
        pairs = db.read_two_view_geometry_num_inliers()[0]
    among = [pair for pair in pairs if chosen.issuperset(pycolmap.pair_id_to_image_pair(pair))]
    return digest_of([images, stage.key["matching"], stage.key["geometry"], sorted(among)])


def _restore_names(stage: Stage) -> None:
    """Give the images their names, which a run that was killed may have left without blanks."""
    with pycolmap.Database.open(stage.database) as db:
        names = dict(enumerate(stage.facts["images"], start=1))
        for image in db.read_all_images():
            if image.name != names[image.image_id]:
                image.name = names[image.image_id]
                db.update_image(image)


def _copy(
    older: Stage,
    db: pycolmap.Database,
    ids: Mapping[str, int],
    wanted: Container[tuple[int, int]] | None,
    *,
    geometry: bool,
) -> None:
    """Copy pairs of the images with these numbers, those without matches too; ``wanted``: None copies all."""
    with pycolmap.Database.open(older.database) as source:
        ours = [
            (k, ids[name]) for k, name in enumerate(older.facts["images"], start=1) if name in ids
        ]
        for (i, first), (j, second) in combinations(ours, 2):
            if wanted is not None and (first, second) not in wanted:
                continue
            if db.exists_matches(first, second) or not source.exists_matches(i, j):
                continue
            db.write_matches(first, second, source.read_matches(i, j))
            if geometry and source.exists_two_view_geometry(i, j):
                found = source.read_two_view_geometry(i, j)
                db.write_two_view_geometry(first, second, found)


def _content(db: pycolmap.Database, image_id: int) -> str:
    """SHA-256 of an image's features."""
    total = hashlib.sha256(db.read_keypoints(image_id).tobytes())
    total.update(db.read_descriptors(image_id).data.tobytes())
    return total.hexdigest()


def described(cameras: Mapping[str, CameraModel] | None) -> dict[str, list[object]] | None:
    """Cameras as JSON can hold them."""
    if cameras is None:
        return None
    return {
        folder: [camera.model, camera.width, camera.height, camera.params.tolist()]
        for folder, camera in cameras.items()
    }


def matching_options(sensitivity: Sensitivity) -> pycolmap.FeatureMatchingOptions:
    """How features are matched, on as many threads as there are."""
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.guided_matching = sensitivity.guided
    return options


def verification_options(seed: int) -> pycolmap.TwoViewGeometryOptions:
    """How the geometry of a pair is found."""
    options = pycolmap.TwoViewGeometryOptions()
    options.ransac.random_seed = seed
    return options
