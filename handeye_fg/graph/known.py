"""What users know beforehand, in terms of the unknowns; entry point ``of_model``."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.graph.determined import spread
from handeye_fg.graph.rig import is_plain
from handeye_fg.known import OfXAndScale, index_of
from handeye_fg.priors import AnyPrior, CameraPrior, DistancePrior, PosePrior, Prior, ScalePrior
from handeye_fg.types import Rig, SfmModel


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownDistance:
    """The distance of the first camera at two robot poses, with its standard deviation, metres."""

    one: int
    other: int
    metres: float
    std: float


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownSpread:
    """The root mean square distance of the camera's ``n_poses`` places from their mean, metres."""

    n_poses: int
    metres: float
    std: float


Known = Prior | PosePrior | KnownDistance | KnownSpread


def of_model(priors: Sequence[AnyPrior], model: SfmModel, rig: Rig | None) -> tuple[Known, ...]:
    """The priors but for those of intrinsics, in terms of the unknowns.

    Images become robot poses, and a world unit the extent of the model's cameras.

    Args:
        priors: what users know.
        model: gives the names of images, and the world's unit.
        rig: which camera took an image, and at which robot pose; None: one camera.

    Raises:
        InputDataError: a distance names an image without pose or of another camera than the first, or
            the world's unit is given for several cameras.
    """
    rig = rig or Rig.of_one_camera(len(model.names))
    return tuple(
        _of_model(prior, model, rig) for prior in priors if not isinstance(prior, CameraPrior)
    )


def _of_model(
    prior: Prior | PosePrior | ScalePrior | DistancePrior, model: SfmModel, rig: Rig
) -> Known:
    if isinstance(prior, DistancePrior):
        one, other = (index_of(name, prior, model.names) for name in prior.images)
        if rig.camera[one] != 0 or rig.camera[other] != 0:
            raise InputDataError(
                f"the prior on the distance of {' and '.join(prior.images)} must be of two images of "
                "the first camera; name two of them"
            )
        poses = rig.pose[[one, other]].tolist()
        return KnownDistance(one=poses[0], other=poses[1], metres=prior.value, std=prior.std)
    if isinstance(prior, ScalePrior):
        if not is_plain(rig):
            raise InputDataError(
                "a prior on the world's unit (scale) is for one camera; give the distance between two "
                "images of the first camera instead"
            )
        extent = spread(model.world_T_camera)
        return KnownSpread(
            n_poses=len(model.names), metres=prior.value * extent, std=prior.std * extent
        )
    return prior


def with_cameras(known: Known, world_T_camera: Array) -> OfXAndScale:
    """What is known of X and the scale where the first camera's poses (n, 4, 4) are given."""
    match known:
        case KnownDistance():
            offset = world_T_camera[known.one, :3, 3] - world_T_camera[known.other, :3, 3]
            units = float(np.linalg.norm(offset))
        case KnownSpread():
            units = spread(world_T_camera)
        case _:
            return known
    return ScalePrior(known.metres / units, known.std / units)
