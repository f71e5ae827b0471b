"""From matches to camera poses: incremental mapping at several settings; entry point ``map_images``."""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pycolmap

from handeye_fg.progress import Progress
from handeye_fg.sfm.native import run_cancellable
from handeye_fg.sfm.self_calibration import keeps_near
from handeye_fg.types import CameraModel

# The strict settings are COLMAP's. The relaxed ones place the images of small or weakly textured
# sets: an initial pair at 4 degrees (16) with 30 inliers (100), poses from 12 inliers (30), pairs
# of 10 (15). With them 8 of 8 images of a floor were placed, of which the strict ones placed 2.
_RELAXED_TRIANGULATION_DEG = 4.0
_RELAXED_INITIAL_INLIERS = 30
_RELAXED_POSE_INLIERS = 12
_RELAXED_PAIR_MATCHES = 10
# Models that are begun from other pairs, when the first left images out.
_MOST_MODELS = 5
# Of many images, the whole is adjusted once each time that it has doubled (COLMAP: has grown by a tenth, and
# then up to five times): half the time, and the same X. The joint refinement adjusts it again.
_MANY, _GROWTH, _TOLERANCE = 30, 2.0, 1e-5
# More threads were not faster with 80,000 observations, and let the last digits differ between runs.
_THREADS = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class Rung:
    """One setting of the mapper.

    Attributes:
        relaxed: accept narrower angles and fewer matches.
        refine: let the mapper refine the intrinsics.
    """

    relaxed: bool
    refine: bool

    @property
    def name(self) -> str:
        """Of the setting."""
        return f"{'relaxed' if self.relaxed else 'strict'}-{'refined' if self.refine else 'fixed'}"


def largest(
    one: pycolmap.Reconstruction | None, other: pycolmap.Reconstruction | None
) -> pycolmap.Reconstruction | None:
    """The reconstruction with more images, then with more points; the first of equals."""
    return max((one, other), key=_size)


def _size(reconstruction: pycolmap.Reconstruction | None) -> tuple[int, int]:
    return (n_registered(reconstruction), reconstruction.num_points3D() if reconstruction else 0)


def n_registered(reconstruction: pycolmap.Reconstruction | None) -> int:
    """The number of images that have a pose; 0 for no reconstruction."""
    return 0 if reconstruction is None else reconstruction.num_reg_images()


def map_images(
    database: Path,
    images: Path,
    rung: Rung,
    *,
    n_images: int,
    file_cameras: Mapping[str, CameraModel] | None,
    seed: int,
    progress: Progress,
    names: Sequence[str] = (),
    begun: pycolmap.Reconstruction | None = None,
) -> list[pycolmap.Reconstruction]:
    """Reconstruct from the matches of a database.

    Args:
        database: with features and verified matches, and cameras as start.
        images: folder of the images.
        rung: the settings.
        n_images: number of images, for the progress.
        file_cameras: given intrinsics, for each folder of images, that a refinement must stay near; or
            None.
        seed: of the random samples.
        progress: told "registered".
        names: the images to place; none: all.
        begun: a model of some of the images, to which the others are added; None: it begins with a pair.

    Returns:
        The acceptable models, the largest first; they share few images or none.

    Raises:
        ReconstructionError: COLMAP failed.
    """
    pipeline = _pipeline_options(rung, seed)
    if n_images > _MANY:
        pipeline.ba_global_frames_ratio = pipeline.ba_global_points_ratio = _GROWTH
        pipeline.ba_global_max_refinements = pipeline.ba_local_max_refinements = 1
        pipeline.ba_global_function_tolerance = _TOLERANCE
    pipeline.image_names = list(names)
    registered = n_registered(begun)

    def pair_placed() -> None:
        nonlocal registered
        registered = 2

    def image_placed() -> None:
        nonlocal registered
        registered += 1

    attempt = database.with_suffix(".attempt")
    shutil.rmtree(attempt, ignore_errors=True)  # of a run that was killed
    attempt.mkdir()
    start = attempt / "begun"
    if begun is not None:
        start.mkdir()
        begun.write(start)
    try:
        models = run_cancellable(
            lambda token: pycolmap.incremental_mapping(
                database,
                images,
                attempt,
                pipeline,
                input_path="" if begun is None else start,
                initial_image_pair_callback=pair_placed,
                next_image_callback=image_placed,
                cancellation_token=token,
            ),
            "the placing of images",
            lambda: progress("registered", min(registered, n_images), n_images),
        )
    finally:
        shutil.rmtree(attempt, ignore_errors=True)
    acceptable = [
        models[index]
        for index in sorted(models)
        if file_cameras is None or keeps_near(models[index], file_cameras)
    ]
    return sorted(acceptable, key=_size, reverse=True)


def _pipeline_options(rung: Rung, seed: int) -> pycolmap.IncrementalPipelineOptions:
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.extract_colors = False
    pipeline.min_model_size = 3
    pipeline.random_seed = seed
    pipeline.num_threads = _THREADS
    pipeline.multiple_models = rung.relaxed
    pipeline.max_num_models = _MOST_MODELS
    if rung.relaxed:
        pipeline.min_num_matches = _RELAXED_PAIR_MATCHES
        pipeline.mapper.init_min_tri_angle = _RELAXED_TRIANGULATION_DEG
        pipeline.mapper.init_min_num_inliers = _RELAXED_INITIAL_INLIERS
        pipeline.mapper.abs_pose_min_num_inliers = _RELAXED_POSE_INLIERS
    pipeline.ba_refine_focal_length = rung.refine
    pipeline.ba_refine_extra_params = rung.refine
    pipeline.mapper.abs_pose_refine_focal_length = rung.refine
    pipeline.mapper.abs_pose_refine_extra_params = rung.refine
    return pipeline
