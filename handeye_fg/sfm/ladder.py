"""The ladder from matches to a model, strict settings first; entry point ``climb``."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from handeye_fg.intrinsics import fitted_opencv
from handeye_fg.options import SfmOptions
from handeye_fg.progress import Progress, silent
from handeye_fg.sfm.cache import RECIPE
from handeye_fg.sfm.database import begin_matching, content_of, described
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
from handeye_fg.sfm.model import FEWEST_IMAGES, to_fragment, to_sfm_model
from handeye_fg.sfm.pairs import RobotGuide, match_by_robot
from handeye_fg.sfm.stages import DATABASE, Stage, open_stage
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What all rungs share.

    Attributes:
        stages: folder of the stages.
        images: folder of the images.
        files: digests of each image and its mask, by the image's name.
        cameras, masks, options, seed, progress, turns: as in ``reconstruct``.
        refine: whether the intrinsics are refined from the start.
        guide: what the robot knows, where it is to say which pairs are matched.
    """

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
        """Of the images."""
        return tuple(self.files)


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches:
    """Verified matches of images.

    Attributes:
        stage: with their database.
        begun: images of which a model was made that agrees with the robot's poses.
    """

    stage: Stage
    begun: tuple[str, ...] = ()

    @property
    def database(self) -> Path:
        """Of COLMAP, with the matches."""
        return self.stage.database


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """The best model so far.

    Attributes:
        reconstruction: the model; None: there is none.
        matches: what it was made from.
        refined: whether the mapper refined its intrinsics.
        static_share: part of the features that stay at their pixel, and were left out.
        fragments: camera poses of all models so far.
    """

    reconstruction: pycolmap.Reconstruction | None
    matches: Matches
    refined: bool = False
    static_share: float = 0.0
    fragments: tuple[Fragment, ...] = ()


def climb(task: Task) -> Found:
    """Try rung after rung, and what agrees with the robot where the result contradicts it.

    Raises:
        ReconstructionError: COLMAP failed.
        InputDataError: a folder cannot be written, or an image cannot be read.
    """
    return _by_robot(task, _highest(task))


def _highest(task: Task) -> Found:
    """The best model of all rungs; the first that places all images is the last one tried."""
    best = Found(reconstruction=None, matches=_matched(task, STRICT))
    for sensitivity in (STRICT, SENSITIVE):
        matches = best.matches if sensitivity is STRICT else _matched(task, sensitivity)
        best = replace(best, static_share=matches.stage.facts["static_share"])
        rungs = [
            _first_rung(task),
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


def _first_rung(task: Task) -> Rung:
    return Rung(relaxed=False, refine=task.refine)


def _n_placed(task: Task, found: Found) -> int:
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


def _by_robot(task: Task, found: Found) -> Found:
    """The model of the pairs that agree with the robot, where that of all pairs contradicts it."""
    if task.turns is None:
        return found
    turns = likelier_turns(found.matches.database, task.turns, task.seed)
    main = [] if found.reconstruction is None else [to_fragment(found.reconstruction)]
    agreement = model_agreement(main, task.names, turns)
    agreeing = None if agreement >= _AGREEMENT else _agreeing(task, found.matches.stage, turns)
    if agreeing is None:
        return found
    other = _better(
        task,
        replace(found, reconstruction=None, fragments=()),
        Matches(stage=agreeing),
        Rung(relaxed=True, refine=task.refine),
    )
    if model_agreement(other.fragments, task.names, turns) <= agreement:
        return found
    return replace(other, matches=found.matches)  # with all pairs


def _agreeing(task: Task, matches: Stage, turns: RobotTurns) -> Stage | None:
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


def _matched(task: Task, sensitivity: Sensitivity) -> Matches:
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
    begun: tuple[str, ...] = ()
    if task.guide is None:
        matcher.match_all()
    else:
        begun = match_by_robot(matcher, task.names, task.guide, partial(_some, task, stage))
    stage.finish()
    return Matches(stage=stage, begun=begun)


def _some(task: Task, stage: Stage, number: int, names: tuple[str, ...]) -> SfmModel | None:
    """A model of some of the images; ``number``: of the model, of several that are needed together."""
    models = _mapped(task, Matches(stage=stage), _first_rung(task), names, number)
    found = next(iter(models), None)
    if found is None or found.num_reg_images() < FEWEST_IMAGES or _thin(found):
        return None
    return to_sfm_model(found)


def _start(task: Task, *, refine: bool) -> Mapping[str, CameraModel] | None:
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


def _better(task: Task, best: Found, matches: Matches, rung: Rung) -> Found:
    """The better of the best model so far and that of a rung."""
    models = _mapped(task, matches, rung)
    _log.info("%s: %s of %d images", rung, list(map(n_registered, models)), len(task.names))
    best = replace(best, fragments=(*best.fragments, *map(to_fragment, models)))
    chosen = largest(best.reconstruction, next(iter(models), None))
    if chosen is best.reconstruction:
        return best
    return replace(best, reconstruction=chosen, matches=matches, refined=rung.refine)


def _mapped(
    task: Task, matches: Matches, rung: Rung, some: tuple[str, ...] = (), number: int = 0
) -> list[pycolmap.Reconstruction]:
    """The models of a rung, the largest first; ``some``: of these images only, kept under this number.

    At the first rung a model of some of the images that agrees with the robot is continued.
    """
    start = _start(task, refine=rung.refine)
    begun = () if rung.relaxed else matches.begun
    key = {
        "recipe": RECIPE,
        "matches": content_of(matches.stage, some),
        "begun": begun,
        "rung": asdict(rung),
        "cameras": described(task.cameras),
        "seed": task.seed,
    }

    def build(folder: Path, _: tuple[Stage, ...]) -> Mapping[str, Any]:
        confirmed = _mapped(task, replace(matches, begun=()), rung, begun) if begun else []
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
            begun=next(iter(confirmed), None),
        )
        for k, model in enumerate(models):
            (folder / str(k)).mkdir()
            model.write(folder / str(k))
        return {"models": len(models)}

    kind = f"{matches.stage.kind}-{f'some{number}' if some else rung.name}"
    stage = open_stage(task.stages, kind, key, build)
    stage.finish()
    folders = [stage.folder / str(k) for k in range(stage.facts["models"])]
    return [pycolmap.Reconstruction(folder) for folder in folders]
