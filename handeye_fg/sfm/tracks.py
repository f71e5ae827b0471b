"""Reconstruction from points that are already known to belong together; entry point ``from_tracks``."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap

from handeye_fg.errors import ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.progress import Progress, silent
from handeye_fg.sfm.mapping import Rung, map_images, n_registered
from handeye_fg.sfm.model import FEWEST_IMAGES, to_sfm_model, too_few
from handeye_fg.sfm.native import run_cancellable
from handeye_fg.types import CameraModel, Indices, SfmModel, folder_of, folders_of

_NOT_PLACED = "too few of its points could be placed"


def from_tracks(
    names: Sequence[str],
    image_index: Indices,
    point: Indices,
    pixels: Array,
    camera: CameraModel,
    *,
    seed: int = 0,
    progress: Progress = silent,
) -> SfmModel:
    """Reconstruct camera poses and points, up to a similarity, from tracks instead of images.

    The corners of a target, for instance, without what is known of their places.

    Args:
        names: names (n,) of the images.
        image_index: for each observation the index (m,) of its image.
        point: for each observation the number (m,) of its point, the same in all images.
        pixels: observed positions (m, 2); once at most for a point in an image.
        camera: intrinsics, kept fixed.
        seed: of the random samples.
        progress: told "registered".

    Raises:
        ReconstructionError: fewer than 3 images were placed, or COLMAP failed.
    """
    with TemporaryDirectory() as folder:
        database = Path(folder) / "tracks.db"
        _fill(database, names, image_index, point, pixels, dict.fromkeys(folders_of(names), camera))
        verification = pycolmap.TwoViewGeometryOptions()
        verification.ransac.random_seed = seed
        run_cancellable(
            lambda token: pycolmap.geometric_verification(
                database, two_view_geometry_options=verification, cancellation_token=token
            ),
            "the verification of matches",
            lambda: None,
        )
        models = map_images(
            database,
            Path(folder),
            Rung(relaxed=True, refine=False),
            n_images=len(names),
            file_cameras=None,
            seed=seed,
            progress=progress,
        )
        found = next(iter(models), None)
        if found is None or n_registered(found) < FEWEST_IMAGES:
            raise ReconstructionError(too_few(n_registered(found), len(names)))
        placed = {found.images[i].name for i in found.reg_image_ids()}
        return to_sfm_model(
            found, tuple((name, _NOT_PLACED) for name in names if name not in placed)
        )


def _fill(
    database: Path,
    names: Sequence[str],
    image_index: Indices,
    point: Indices,
    pixels: Array,
    cameras: Mapping[str, CameraModel],
) -> None:
    """Write the tracks as features and matches of a database; ``cameras``: for each folder of images."""
    rows = [np.flatnonzero(image_index == i) for i in range(len(names))]
    with pycolmap.Database.open(database) as db:
        rigs = {folder: _add_camera(db, camera) for folder, camera in cameras.items()}
        ids = []
        for name, seen in zip(names, rows, strict=True):
            rig = rigs[folder_of(name)]
            image = pycolmap.Image(name=name, camera_id=rig.ref_sensor_id.id)
            image.image_id = db.write_image(image)
            frame = pycolmap.Frame()
            frame.rig_id = rig.rig_id
            frame.add_data_id(image.data_id)
            db.write_frame(frame)
            db.write_keypoints(image.image_id, pixels[seen].astype(np.float32))
            ids.append(image.image_id)
        for i, j in combinations(range(len(names)), 2):
            _, first, second = np.intersect1d(
                point[rows[i]], point[rows[j]], assume_unique=True, return_indices=True
            )
            matches = np.column_stack([first, second]).astype(np.uint32)
            db.write_matches(ids[i], ids[j], matches)


def _add_camera(db: pycolmap.Database, camera: CameraModel) -> pycolmap.Rig:
    """Write a camera and a rig of it alone."""
    native = pycolmap.Camera(
        model=camera.model, width=camera.width, height=camera.height, params=camera.params
    )
    native.has_prior_focal_length = True
    native.camera_id = db.write_camera(native)
    rig = pycolmap.Rig()
    rig.add_ref_sensor(native.sensor_id)
    rig.rig_id = db.write_rig(rig)
    return rig
