"""Closed forms of hand-eye calibration: one paper, one module; numpy and scipy only.

A solver takes ``PosePairs`` or ``MotionPairs`` and returns a ``Solution``; ``METHODS`` lists them.
``linear_start`` is the entry point of a calibration from images: it leaves wrong rows out, solves the rest, and
adds base_T_world and the residuals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from handeye_fg.errors import UnobservableError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array
from handeye_fg.known import OfXAndScale
from handeye_fg.motions import MotionPairs, PosePairs, as_motions
from handeye_fg.solvers.andreff import andreff
from handeye_fg.solvers.andreff_scale import andreff_scale
from handeye_fg.solvers.consensus import only
from handeye_fg.solvers.daniilidis import daniilidis
from handeye_fg.solvers.horaud_dornaika import horaud_dornaika
from handeye_fg.solvers.li import li
from handeye_fg.solvers.park_martin import park_martin
from handeye_fg.solvers.partial import first_order_covariance, partial
from handeye_fg.solvers.residuals import (
    average_base_T_world,
    motion_residuals,
    row_residuals,
    world_of,
)
from handeye_fg.solvers.robust import Majority, majority, trusted_rows
from handeye_fg.solvers.shah import shah
from handeye_fg.solvers.solution import Solution, Solver
from handeye_fg.solvers.tsai_lenz import tsai_lenz

__all__ = [
    "METHODS",
    "Majority",
    "Method",
    "Solution",
    "andreff",
    "andreff_scale",
    "average_base_T_world",
    "daniilidis",
    "first_order_covariance",
    "horaud_dornaika",
    "li",
    "linear_start",
    "majority",
    "motion_residuals",
    "only",
    "park_martin",
    "partial",
    "row_residuals",
    "shah",
    "start_of",
    "trusted_rows",
    "tsai_lenz",
    "world_of",
]


@dataclass(frozen=True, slots=True)
class Method:
    """A closed form.

    Attributes:
        solve: the solver.
        scale_known: whether it takes the camera's translations in metres; else it finds their unit.
    """

    solve: Solver
    scale_known: bool


METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "andreff_scale": Method(andreff_scale, scale_known=False),
        "andreff": Method(andreff, scale_known=True),
        "daniilidis": Method(daniilidis, scale_known=True),
        "horaud_dornaika": Method(horaud_dornaika, scale_known=True),
        "li": Method(li, scale_known=True),
        "park_martin": Method(park_martin, scale_known=True),
        "shah": Method(shah, scale_known=True),
        "tsai_lenz": Method(tsai_lenz, scale_known=True),
    }
)


def linear_start(
    base_T_gripper: Array,
    world_T_camera: Array,
    *,
    seed: int = 0,
    priors: Sequence[OfXAndScale] = (),
) -> LinearStart:
    """X, Z and the scale in closed form over wide-baseline pairs of the poses that agree.

    Where the motions do not determine everything, the rest is chosen as ``partial`` says.

    Args:
        base_T_gripper: robot poses (n, 4, 4), metres.
        world_T_camera: camera poses (n, 4, 4) of the same instants, up to a similarity.
        seed: of the samples that tell wrong rows from right ones.
        priors: what is known of X and the scale where the motions do not determine it.

    Raises:
        InputDataError: fewer than two poses, matrices that are not poses, or a negative scale
            (another convention).
        UnobservableError: the robot or the camera did not move.
    """
    data = PosePairs(base_T_gripper=base_T_gripper, world_T_camera=world_T_camera)
    trusted = trusted_rows(data, scale_known=False, seed=seed)
    agreeing = only(data, trusted)
    try:
        solution, method = andreff_scale(agreeing), "andreff_scale"
    except UnobservableError:
        solution, method = partial(agreeing, scale_known=False, priors=priors), "partial"
    return replace(start_of(agreeing, solution, method), trusted=trusted)


def start_of(data: PosePairs | MotionPairs, solution: Solution, method: str) -> LinearStart:
    """A solution with Z, where the data have a world, and the residuals over the motion pairs.

    Args:
        data: what was solved.
        solution: of the data.
        method: the solver's name.
    """
    X, scale = np.asarray(solution.gripper_T_camera), solution.metres_per_world_unit
    angles, lengths = motion_residuals(as_motions(data), X, scale)
    Z = solution.base_T_world if isinstance(data, PosePairs) else None
    return LinearStart(
        method=method,
        gripper_T_camera=X,
        base_T_world=world_of(data, X, scale) if Z is None else Z,
        metres_per_world_unit=scale,
        residual_rotation=float(np.sqrt(np.mean(angles**2))),
        residual_translation=float(np.sqrt(np.mean(lengths**2))),
    )
