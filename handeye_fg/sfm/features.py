"""Features of a set of images in a COLMAP database; entry point ``extract_features``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pycolmap

from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress
from handeye_fg.sfm.native import native_threads, run_cancellable
from handeye_fg.sfm.presets import effort_of
from handeye_fg.sfm.static import drop_static
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, folder_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """How eagerly features are taken.

    Attributes:
        peak_threshold: least contrast of a feature; None: COLMAP's 0.0067.
        guided: match again along the epipolar lines once a pair's geometry is known.
    """

    peak_threshold: float | None = None
    guided: bool = False


STRICT = Sensitivity()
# A third of the default contrast doubles the features of weak textures and dark images; guided
# matching finds five times as many matches where a texture repeats.
SENSITIVE = Sensitivity(peak_threshold=0.002, guided=True)


def extract_features(
    database: Path,
    images: Path,
    names: Sequence[str],
    cameras: Mapping[str, CameraModel] | None,
    *,
    masks: Path | None,
    sensitivity: Sensitivity,
    options: SfmOptions,
    seed: int,
    progress: Progress,
    turns: RobotTurns | None = None,
) -> float:
    """Find features in the named images.

    Args:
        database: file to write; it must not exist.
        images: folder of the images.
        names: the images to use.
        cameras: intrinsics to start from, for each folder of images; None: OPENCV with COLMAP's guess
            of the focal length.
        masks: folder of masks ``NAME.png``, white = use; None: everything is used.
        sensitivity: how eagerly features are taken.
        options: limits.
        seed: of the random samples.
        progress: told "features".
        turns: how the robot turned from image to image; None: static features are kept.

    Returns:
        Part of the features that were left out because they are static.

    Raises:
        ReconstructionError: COLMAP failed.
    """
    effort = effort_of(options, len(names))
    reader_options = pycolmap.ImageReaderOptions()
    reader_options.camera_model = "OPENCV"
    if cameras is not None:
        camera = cameras[folder_of(names[0])]
        reader_options.camera_model = camera.model
        reader_options.camera_params = ",".join(repr(float(p)) for p in camera.params)
    if masks is not None:
        reader_options.mask_path = masks
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.num_threads = native_threads(options)
    extraction.sift.max_num_features = effort.max_features
    extraction.sift.first_octave = effort.first_octave
    if sensitivity.peak_threshold is not None:
        extraction.sift.peak_threshold = sensitivity.peak_threshold
    pycolmap.set_random_seed(seed)
    # The counts are read over a connection of pycolmap's own SQLite. Python's sqlite3 is another copy
    # of the library: two copies on one file in one process break each other's locks and crash.
    with pycolmap.Database.open(database) as counts:
        total = len(names)
        progress("features", 0, total)
        # Entered beforehand, images get their numbers in the order of the names, not in the order in
        # which threads finish: what follows depends on the numbers.
        run_cancellable(
            lambda _: pycolmap.import_images(
                database,
                images,
                camera_mode=pycolmap.CameraMode.PER_FOLDER,
                image_names=list(names),
                options=reader_options,
            ),
            "the reading of images",
            lambda: None,
        )
        if cameras is not None and len(cameras) > 1:
            set_cameras(counts, cameras)
        ids = [image.image_id for image in counts.read_all_images()]
        run_cancellable(
            lambda token: pycolmap.extract_features(
                database,
                images,
                image_names=list(names),
                camera_mode=pycolmap.CameraMode.PER_FOLDER,
                reader_options=reader_options,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
                cancellation_token=token,
            ),
            "the search for features",
            lambda: progress("features", sum(map(counts.exists_keypoints, ids)), total),
        )
        return 0.0 if turns is None else drop_static(database, turns)


def set_cameras(database: pycolmap.Database, cameras: Mapping[str, CameraModel]) -> None:
    """Give the cameras of a database other intrinsics, for each folder of images."""
    folders = {image.camera_id: folder_of(image.name) for image in database.read_all_images()}
    for native in database.read_all_cameras():
        camera = cameras[folders[native.camera_id]]
        native.model = pycolmap.CameraModelId.__members__[camera.model]
        native.params = list(camera.params)
        database.update_camera(native)
