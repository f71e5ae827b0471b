"""The ladder from images to a model: strict settings first; entry point ``reconstruct``."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from handeye_fg.errors import ReconstructionError
from handeye_fg.intrinsics import covers_image, fitted_opencv
from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress, silent
from handeye_fg.sfm.cache import (
    RECIPE,
    check_replaceable,
    file_digests,
    inputs_digest,
    publish,
    stored_model,
)
from handeye_fg.sfm.database import begin_matching, content_of, described
from handeye_fg.sfm.eight_bit import readable
from handeye_fg.sfm.features import (
    SENSITIVE,
    STRICT,
    Sensitivity,
    find_features,
    set_cameras,
)
from handeye_fg.sfm.guided import agreeing_pairs, likelier_turns, model_agreement
from handeye_fg.sfm.mapping import Rung, largest, map_images, n_registered
from handeye_fg.sfm.matching import Matcher, matching_summary
from handeye_fg.sfm.model import FEWEST_IMAGES, to_fragment, to_sfm_model, too_few
from handeye_fg.sfm.pairs import RobotGuide, by_robot, match_by_robot
from handeye_fg.sfm.self_calibration import with_centre
from handeye_fg.sfm.stages import DATABASE, Stage, open_stage, prepare
from handeye_fg.sfm.unplaced import fragments_of, unplaced
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, Fragment, SfmModel

_log = logging.getLogger(__name__)

# The search for more features doubles the time: only for sets of which more than this is missing.
_ENOUGH = 0.9
# Points that the median image sees. With 75 an image of a repeating pattern was placed half a turn
# off; the plain cases have 400 and more.
_FEWEST_POINTS = 150
# Inliers in the best pair of the median image, twenty times what makes a pair: enough to place it.
_PLENTY_OF_MATCHES = 300
# Part of all pairs of images that turn as the robot does; with a fifth of the robot poses wrong it is 0.64.
_AGREEMENT = 0.5
_STATIC = (
    "; {:.0f} % of the features stay at their pixel while the robot turns (background of a static camera, "
    "text over the images) and were left out: give masks of what moves (--masks)"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """What all rungs share."""

    stages: Path
    images: Path
    files: Mapping[str, Sequence[str | None]]
    cameras: Mapping[str, CameraModel] | None
    masks: Path | None
    options: SfmOptions
    seed: int
    progress: Progress
    refine: bool
    turns: RobotTurns | None
    guide: RobotGuide | None

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(self.files)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """The best model so far and the database it was made from; the poses of all models so far."""

    reconstruction: pycolmap.Reconstruction | None
    matches: Stage
    refined: bool = False
    static_share: float = 0.0
    fragments: tuple[Fragment, ...] = ()


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
    task = _Task(
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
    found = _by_robot(task, _climb(task))
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


def _climb(task: _Task) -> _Found:
    """Try rung after rung, until all images are placed; the best model."""
    best = _Found(reconstruction=None, matches=_matched(task, STRICT))
    for sensitivity in (STRICT, SENSITIVE):
        matches = best.matches if sensitivity is STRICT else _matched(task, sensitivity)
        best = replace(best, static_share=matches.facts["static_share"])
        rungs = [
            Rung(relaxed=False, refine=task.refine),
            Rung(relaxed=True, refine=task.refine),
        ]
        last = sensitivity is SENSITIVE
        for rung in rungs:
            best = _better(task, best, matches, rung)
            complete = n_registered(best.reconstruction) == len(task.names)
            if complete and not _thin(best.reconstruction):
                return best
        # Images that match well and still have no model need no more features: the intrinsics are
        # wrong, or the camera never moved. A search for more would take many minutes, in vain.
        last = last or (best.reconstruction is None and _well_matched(matches.database))
        if last and not task.refine:
            best = _better(task, best, matches, Rung(relaxed=True, refine=True))
        if last:
            return best
        if _n_placed(task, best) >= _ENOUGH * len(task.names) and not _thin(best.reconstruction):
            return best
    return best


def _n_placed(task: _Task, found: _Found) -> int:
    """The number of images in the best model or, where the robot can join them to it, in others."""
    if task.turns is None:
        return n_registered(found.reconstruction)
    return len({name for fragment in found.fragments for name in fragment.names})


def _thin(reconstruction: pycolmap.Reconstruction | None) -> bool:
    """Whether so few points hold the images that their poses may be false."""
    if reconstruction is None:
        return True
    images = [reconstruction.images[i] for i in reconstruction.reg_image_ids()]
    return float(np.median([image.num_points3D for image in images])) < _FEWEST_POINTS


def _well_matched(database: Path) -> bool:
    """Whether the median image has plenty of matches with another one."""
    best_pairs = [inliers for _, inliers in matching_summary(database).values()]
    return float(np.median(best_pairs)) >= _PLENTY_OF_MATCHES


def _by_robot(task: _Task, found: _Found) -> _Found:
    """The model of the pairs that agree with the robot, where that of all pairs contradicts it."""
    if task.turns is None:
        return found
    turns = likelier_turns(found.matches.database, task.turns, task.seed)
    main = [] if found.reconstruction is None else [to_fragment(found.reconstruction)]
    agreement = model_agreement(main, task.names, turns)
    agreeing = None if agreement >= _AGREEMENT else _agreeing(task, found.matches, turns)
    if agreeing is None:
        return found
    other = _better(
        task,
        replace(found, reconstruction=None, fragments=()),
        agreeing,
        Rung(relaxed=True, refine=task.refine),
    )
    if model_agreement(other.fragments, task.names, turns) <= agreement:
        return found
    return replace(other, matches=found.matches)  # with all pairs


def _agreeing(task: _Task, matches: Stage, turns: RobotTurns) -> Stage | None:
    """The pairs that agree with the robot; None where no more do than by chance."""
    key = {
        "recipe": RECIPE,
        "matches": content_of(matches),
        "matching": matches.key["matching"],
        "geometry": matches.key["geometry"],
        "turns": [turns.setup, turns.rotations.tolist()],
        "seed": task.seed,
    }

    def build(folder: Path, _: tuple[Stage, ...]) -> Mapping[str, Any]:
        found = agreeing_pairs(matches.database, folder / DATABASE, turns, task.seed)
        return {"significant": found, "images": matches.facts["images"]}

    stage = open_stage(task.stages, "agreeing", key, build)
    stage.finish()
    return stage if stage.facts["significant"] else None


def _matched(task: _Task, sensitivity: Sensitivity) -> Stage:
    """Features and matches."""
    features = find_features(
        task.stages,
        task.images,
        task.files,
        masks=task.masks,
        sensitivity=sensitivity,
        options=task.options,
        progress=task.progress,
    )
    stage = begin_matching(
        task.stages,
        features,
        _start(task, refine=task.refine),
        sensitivity=sensitivity,
        seed=task.seed,
        turns=task.turns,
        base_T_gripper=None if task.guide is None else task.guide.base_T_gripper,
    )
    matcher = Matcher(
        stage=stage,
        sensitivity=sensitivity,
        options=task.options,
        seed=task.seed,
        progress=task.progress,
    )
    if task.guide is None:
        matcher.match_all()
    else:
        match_by_robot(matcher, task.names, task.guide, partial(_some, task, stage))
    stage.finish()
    return stage


def _some(task: _Task, matches: Stage, names: tuple[str, ...]) -> SfmModel | None:
    """A model of some of the images."""
    models = _mapped(task, matches, Rung(relaxed=False, refine=task.refine), names)
    found = next(iter(models), None)
    if found is None or found.num_reg_images() < FEWEST_IMAGES or _thin(found):
        return None
    return to_sfm_model(found)


def _start(task: _Task, *, refine: bool) -> Mapping[str, CameraModel] | None:
    """The cameras to start from."""
    return _refinable(task.cameras) if refine else task.cameras


def _refinable(cameras: Mapping[str, CameraModel] | None) -> Mapping[str, CameraModel] | None:
    """The cameras in their own models, but FULL_OPENCV as OPENCV: images do not determine all its 12."""
    if cameras is None:
        return None
    return {
        folder: fitted_opencv(camera)[0] if camera.model == "FULL_OPENCV" else camera
        for folder, camera in cameras.items()
    }


def _better(task: _Task, best: _Found, matches: Stage, rung: Rung) -> _Found:
    """The better of the best model so far and that of a rung."""
    models = _mapped(task, matches, rung)
    _log.info("%s: %s of %d images", rung, list(map(n_registered, models)), len(task.names))
    best = replace(best, fragments=(*best.fragments, *map(to_fragment, models)))
    chosen = largest(best.reconstruction, next(iter(models), None))
    if chosen is best.reconstruction:
        return best
    return replace(best, reconstruction=chosen, matches=matches, refined=rung.refine)


def _mapped(
    task: _Task, matches: Stage, rung: Rung, some: tuple[str, ...] = ()
) -> list[pycolmap.Reconstruction]:
    """The models of a rung, the largest first; ``some``: of these images only."""
    start = _start(task, refine=rung.refine)
    key = {
        "recipe": RECIPE,
        "matches": content_of(matches, some),
        "rung": asdict(rung),
        "cameras": described(task.cameras),
        "seed": task.seed,
    }

    def build(folder: Path, _: tuple[Stage, ...]) -> Mapping[str, Any]:
        if start is not None:
            with pycolmap.Database.open(matches.database) as db:
                set_cameras(db, start)
        models = map_images(
            matches.database,
            task.images,
            rung,
            n_images=len(task.names),
            file_cameras=task.cameras,
            seed=task.seed,
            progress=silent if some else task.progress,
            names=some,
        )
        for k, model in enumerate(models):
            (folder / str(k)).mkdir()
            model.write(folder / str(k))
        return {"models": len(models)}

    stage = open_stage(task.stages, f"{matches.kind}-{'some' if some else rung.name}", key, build)
    stage.finish()
    folders = [stage.folder / str(k) for k in range(stage.facts["models"])]
    return [pycolmap.Reconstruction(folder) for folder in folders]
