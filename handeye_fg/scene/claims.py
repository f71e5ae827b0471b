"""Whether the robot poses are as they are said to be, before anything rests on them; entry ``agreed``."""

from dataclasses import dataclass, replace

import numpy as np

from handeye_fg.conventions import AS_GIVEN, Verdict, judge, sentence
from handeye_fg.errors import ConvergenceError, InputDataError
from handeye_fg.frames import Array
from handeye_fg.inputs import Inputs
from handeye_fg.options import Options
from handeye_fg.types import Indices, SfmModel

# More observations tell the same depth.
_MOST_OBSERVATIONS = 5000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Checked:
    """A verdict on poses.

    Attributes:
        verdict: the verdict.
        sentence: the same in words.
        names: images of the rows that were judged.
    """

    verdict: Verdict
    sentence: str
    names: tuple[str, ...]


def check_poses(
    model: SfmModel,
    inputs: Inputs,
    options: Options,
    *,
    scale_known: bool = False,
    thorough: bool = False,
) -> Checked:
    """Hold the poses against a reconstruction.

    Args:
        model: of which the camera with the most images is used.
        inputs: the inputs.
        options: of the calibration.
        scale_known: whether the model is in metres.
        thorough: try all readings, even where the poses fit as they are.
    """
    camera = int(np.argmax(np.bincount(model.image_camera)))
    taken = np.flatnonzero(model.image_camera == camera)
    rows = np.array(inputs.rows([model.names[k] for k in taken]))
    # In the order of the poses: what stands one after the other there was lost together.
    order = np.argsort(rows, kind="stable")
    taken, rows = taken[order], rows[order]
    verdict = judge(
        inputs.as_read(options.setup),
        rows,
        model.world_T_camera[taken],
        setup=options.setup,
        others=inputs.readings,
        depth=_depth(model, taken),
        scale_known=scale_known,
        thorough=thorough,
    )
    names = tuple(model.names[k] for k in taken)
    return Checked(verdict=verdict, sentence=sentence(verdict, names), names=names)


def agreed(
    model: SfmModel, inputs: Inputs, options: Options, *, scale_known: bool = False
) -> Inputs:
    """The inputs whose poses agree with the camera's; with ``auto_convention`` converted, and noted.

    Args:
        model: the reconstruction, before it is changed by what the poses say.
        inputs: the inputs.
        options: of the calibration.
        scale_known: whether the model is in metres.

    Raises:
        InputDataError: the poses follow another convention.
        ConvergenceError: robot and camera contradict each other under every convention.
    """
    if AS_GIVEN in options.poses.convention.split(","):
        return inputs
    checked = check_poses(model, inputs, options, scale_known=scale_known)
    verdict = checked.verdict
    if verdict.kind == "contradiction":
        raise ConvergenceError(checked.sentence)
    if verdict.kind == "right":
        return inputs
    if verdict.kind == "undecided" and not verdict.doubtful:
        return replace(inputs, convention_note=f"{checked.sentence}.")
    if not (options.poses.auto_convention and verdict.fixable):
        raise InputDataError(checked.sentence)
    poses = verdict.converted(inputs.as_read(options.setup))
    found, *_ = checked.sentence.split(";")
    note = f"Y{found[1:]}, and were taken as such (--auto-convention: {verdict.convention})."
    return replace(
        inputs.with_poses(poses, options.setup),
        convention=verdict.convention,
        convention_note=note,
    )


def _depth(model: SfmModel, images: Indices) -> float | None:
    """Typical distance of the points from the cameras that see them, world units."""
    tracks = model.tracks
    seen = np.flatnonzero(np.isin(tracks.image_index, images))
    if not len(seen):
        return None
    seen = seen[:: max(1, len(seen) // _MOST_OBSERVATIONS)]
    centres: Array = model.world_T_camera[tracks.image_index[seen], :3, 3]
    points = tracks.points_world[tracks.point_index[seen]]
    return float(np.median(np.linalg.norm(points - centres, axis=1)))
