"""From images to a model of cameras and points; entry point ``reconstruct``."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from handeye_fg.errors import ReconstructionError
from handeye_fg.intrinsics import covers_image
from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress
from handeye_fg.sfm.cache import (
    check_replaceable,
    file_digests,
    inputs_digest,
    publish,
    stored_model,
)
from handeye_fg.sfm.eight_bit import readable
from handeye_fg.sfm.ladder import Task, climb
from handeye_fg.sfm.mapping import n_registered
from handeye_fg.sfm.model import FEWEST_IMAGES, to_sfm_model, too_few
from handeye_fg.sfm.pairs import RobotGuide, by_robot
from handeye_fg.sfm.self_calibration import with_centre
from handeye_fg.sfm.stages import prepare
from handeye_fg.sfm.unplaced import fragments_of, unplaced
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, SfmModel

_STATIC = (
    "; {:.0f} % of the features stay at their pixel while the robot turns (background of a static camera, "
    "text over the images) and were left out: give masks of what moves (--masks)"
)


def reconstruct(
    images: Path,
    names: Sequence[str],
    cameras: Mapping[str, CameraModel] | None,
    *,
    masks: Path | None,
    folder: Path,
    options: SfmOptions,
    seed: int,
    progress: Progress,
    refine_intrinsics: bool = False,
    turns: RobotTurns | None = None,
    guide: RobotGuide | None = None,
) -> SfmModel:
    """Reconstruct camera poses and points, up to a similarity, from images.

    The images in a folder share a camera; those of one camera may be in none.

    Args:
        images: folder of the images.
        names: the images to use, relative to it; others in the folder are not.
        cameras: for each folder of images ("." for none) the intrinsics, kept fixed as long as the
            images can be placed so; None: OPENCV, found from the images.
        masks: folder of masks ``NAME.png``, white = use; None: everything is used.
        folder: where model and database are kept. A model there is returned when nothing changed; of what
            led to it, in the folder ``stages`` beside it, what did not change is used again.
        options: limits.
        seed: of the random samples.
        progress: told "features", "pairs" and "registered".
        refine_intrinsics: refine the given intrinsics from the start.
        turns: how the robot turned from image to image, in the order of the names: static features
            are left out, and pairs of images that contradict the robot where they win. None: it is
            not asked.
        guide: what the robot knows of where the images were taken, in the order of the names; where the
            options say so, it tells which pairs of images are matched.

    Returns:
        The model; its ``cameras`` are what was used in the end.

    Raises:
        InputDataError: the folder cannot be written, or an image cannot be read.
        ReconstructionError: fewer than 3 images were placed, or COLMAP failed.
    """
    folder, names = Path(folder), tuple(names)
    guide = guide if by_robot(options, len(names)) else None
    files = file_digests(images, names, masks)
    digest = inputs_digest(
        files,
        cameras,
        options,
        seed,
        refine_intrinsics=refine_intrinsics,
        turns=turns,
        poses=None if guide is None else guide.base_T_gripper,
    )
    model = stored_model(folder, digest)
    if model is not None:
        progress("registered", len(model.names), len(names))
        return model
    check_replaceable(folder)
    stages = prepare(folder.parent / "stages")
    images, contents = readable(stages, images, files)
    task = Task(
        stages=stages,
        images=images,
        files=contents,
        cameras=cameras,
        masks=masks,
        options=options,
        seed=seed,
        progress=progress,
        refine=refine_intrinsics or cameras is None or not all(map(covers_image, cameras.values())),
        turns=turns,
        guide=guide,
    )
    found = climb(task)
    registered = n_registered(found.reconstruction)
    progress("registered", registered, len(names))
    if found.reconstruction is None or registered < FEWEST_IMAGES:
        static = _STATIC.format(100.0 * found.static_share) if found.static_share else ""
        raise ReconstructionError(too_few(registered, len(names)) + static)
    reconstruction = found.reconstruction
    if found.refined:
        reconstruction = with_centre(reconstruction)
    unregistered = unplaced(reconstruction, found.matches.database, names)
    model = to_sfm_model(reconstruction, unregistered)
    model = replace(
        model,
        static_share=found.static_share,
        fragments=fragments_of(found.fragments, [name for name, _ in unregistered]),
    )
    publish(task.stages, folder, found.matches.database, reconstruction, model, digest)
    return model
