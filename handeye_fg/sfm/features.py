"""Features of a set of images in a COLMAP database; entry point ``find_features``."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pycolmap

from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress
from handeye_fg.sfm.native import native_threads, run_cancellable
from handeye_fg.sfm.presets import effort_of
from handeye_fg.sfm.stages import DATABASE, Stage, open_stage
from handeye_fg.types import CameraModel, folder_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """How eagerly features are taken.

    Attributes:
        name: of the setting.
        peak_threshold: least contrast of a feature; None: COLMAP's 0.0067.
        guided: match again along the epipolar lines once a pair's geometry is known.
    """

    name: str
    peak_threshold: float | None = None
    guided: bool = False


STRICT = Sensitivity(name="strict")
# A third of the default contrast doubles the features of weak textures and dark images; guided
# matching finds five times as many matches where a texture repeats.
SENSITIVE = Sensitivity(name="sensitive", peak_threshold=0.002, guided=True)


def find_features(
    stages: Path,
    images: Path,
    digests: Mapping[str, Sequence[str | None]],
    *,
    masks: Path | None,
    sensitivity: Sensitivity,
    options: SfmOptions,
    progress: Progress,
) -> Stage:
    """Find features in images; those of images that did not change are taken from earlier runs.

    Args:
        stages: folder of all stages.
        images: folder of the images.
        digests: the images to use by name, in their order, with digests of all that is in their files
            and their masks'.
        masks: folder of masks ``NAME.png``, white = use; None: everything is used.
        sensitivity: how eagerly features are taken.
        options: limits.
        progress: told "features".

    Returns:
        The stage; its database has the images, with COLMAP's guess of their cameras, and the features.

    Raises:
        InputDataError: the stage cannot be written.
        ReconstructionError: COLMAP failed.
    """
    names = list(digests)
    effort = effort_of(options, len(names))
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.num_threads = native_threads(options)
    extraction.sift.max_num_features = effort.max_features
    extraction.sift.first_octave = effort.first_octave
    if sensitivity.peak_threshold is not None:
        extraction.sift.peak_threshold = sensitivity.peak_threshold
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "OPENCV"
    if masks is not None:
        reader.mask_path = masks
    key = {
        "pycolmap": pycolmap.__version__,
        "options": settings_of(extraction),
        "images": {name: list(one) for name, one in digests.items()},
    }

    def build(folder: Path, older: tuple[Stage, ...]) -> Mapping[str, Any]:
        # Entered beforehand, images get their numbers in the order of the names, not in the order in
        # which threads finish: what follows depends on the numbers.
        with pycolmap.Database.open(folder / DATABASE) as db:
            run_cancellable(
                lambda _: pycolmap.import_images(
                    folder / DATABASE,
                    images,
                    camera_mode=pycolmap.CameraMode.PER_FOLDER,
                    image_names=names,
                    options=reader,
                ),
                "the reading of images",
                lambda: None,
            )
            for stage in older:
                if stage.key["options"] == key["options"]:
                    _adopt(stage, db, key["images"])
        return {}

    stage = open_stage(stages, f"{sensitivity.name}-features", key, build)
    # The counts are read over a connection of pycolmap's own SQLite. Python's sqlite3 is another copy
    # of the library: two copies on one file in one process break each other's locks and crash.
    with pycolmap.Database.open(stage.database) as counts:
        ids = [image.image_id for image in counts.read_all_images()]

        def count() -> None:
            progress("features", sum(map(counts.exists_descriptors, ids)), len(names))

        count()
        # Images that have features already are passed over.
        run_cancellable(
            lambda token: pycolmap.extract_features(
                stage.database,
                images,
                image_names=names,
                camera_mode=pycolmap.CameraMode.PER_FOLDER,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
                cancellation_token=token,
            ),
            "the search for features",
            count,
        )
    stage.finish()
    return stage


def settings_of(options: Any) -> Any:  # any of COLMAP's option blocks
    """What options say, but for the number of threads, as JSON can hold it."""
    settings = {name: value for name, value in options.todict().items() if name != "num_threads"}
    return json.loads(json.dumps(settings, default=str))


def _adopt(stage: Stage, db: pycolmap.Database, digests: Mapping[str, Any]) -> None:
    """Copy features of images that have the same content."""
    with pycolmap.Database.open(stage.database) as source:
        ids = {image.name: image.image_id for image in source.read_all_images()}
        of_content = {tuple(digest): ids[name] for name, digest in stage.key["images"].items()}
        for image in db.read_all_images():
            other = of_content.get(tuple(digests[image.name]))
            if other is None or db.exists_keypoints(image.image_id):
                continue
            if source.exists_keypoints(other) and source.exists_descriptors(other):
                db.write_keypoints(image.image_id, source.read_keypoints(other))
                db.write_descriptors(image.image_id, source.read_descriptors(other))


def set_cameras(database: pycolmap.Database, cameras: Mapping[str, CameraModel]) -> None:
    """Give the cameras of a database other intrinsics, for each folder of images."""
    folders = {image.camera_id: folder_of(image.name) for image in database.read_all_images()}
    for native in database.read_all_cameras():
        camera = cameras[folders[native.camera_id]]
        native.model = pycolmap.CameraModelId.__members__[camera.model]
        native.params = list(camera.params)
        native.has_prior_focal_length = True
        database.update_camera(native)
