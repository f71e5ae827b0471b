"""How well poses fit a camera's, as a likelihood that ranks readings; entry point ``evidence_of``.

All readings have the same unknowns (X, Z, the scale) and keep the volume of what was measured, so that their
restricted likelihoods compare as they are. A row is either right, with normal errors whose size is
found from the rows, or wrong, and then anywhere.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.motions import PosePairs
from handeye_fg.solvers import majority

# Better than this (radians; part of the extent) is no arm with a camera: closer fits are not better.
_BEST_ROTATION, _BEST_TRANSLATION = math.radians(0.03), 5e-4
# A row is wrong beforehand with this probability.
_WRONG = 0.1
_ROUNDS = 20
# Of a fit that says anything, however bad arm and images are: radians, part of the extent, part of the
# rows.
_FITS_ROTATION, _FITS_TRANSLATION, _FITS_ROWS = math.radians(15.0), 0.2, 0.5
# Of one that no noise explains away.
_WELL_ROTATION, _WELL_TRANSLATION = math.radians(4.0), 0.08
# Median length of three standard normal components.
_MEDIAN = 1.538


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Evidence:
    """What speaks for poses.

    Attributes:
        log_likelihood: restricted, natural logarithm; minus infinity where nothing fits.
        rotation: root mean square of the angles of the right rows, radians.
        translation: of their distances, metres.
        typical: median angle (radians) and distance (metres) of all rows.
        right: (n,) which rows are right.
        gripper_T_camera: X (4, 4) in metres.
        metres_per_world_unit: the scale.
        several_axes: whether robot and camera turn about two axes or more.
        fits: whether robot and camera agree at all.
        fits_well: whether they agree as a usual arm and camera do.
    """

    log_likelihood: float
    rotation: float
    translation: float
    typical: tuple[float, float]
    right: NDArray[np.bool_]
    gripper_T_camera: Array
    metres_per_world_unit: float
    several_axes: bool
    fits: bool
    fits_well: bool


def extent_of(base_T_gripper: Array) -> float:
    """Length (metres) that distances are measured by: the spread of the positions.

    Of poses or their inverses, whichever is larger, so that a reading and its inverse are judged alike,
    and a gripper that turns about its own origin has one.
    """
    positions = base_T_gripper[:, :3, 3]
    turned = np.einsum("nji,nj->ni", base_T_gripper[:, :3, :3], positions)
    spreads = [math.sqrt(float(np.sum(np.var(one, axis=0)))) for one in (positions, turned)]
    return max(*spreads, 1e-9)


def evidence_of(
    base_T_gripper: Array, world_T_camera: Array, extent: float, *, scale_known: bool = False
) -> Evidence:
    """What speaks for poses (n, 4, 4), in the form of the equations, of the camera's (n, 4, 4).

    Args:
        base_T_gripper: a reading of the robot's poses, metres.
        world_T_camera: camera poses of the same instants.
        extent: of the poses as given; the same for all readings.
        scale_known: whether the camera's translations are in metres.
    """
    n = len(base_T_gripper)
    pairs = PosePairs(base_T_gripper=base_T_gripper, world_T_camera=world_T_camera)
    found = majority(pairs, scale_known=scale_known)
    if found is None or not found.metres_per_world_unit > 0.0:
        return Evidence(
            log_likelihood=-math.inf,
            rotation=math.nan,
            translation=math.nan,
            typical=(math.nan, math.nan),
            right=np.zeros(n, dtype=bool),
            gripper_T_camera=np.eye(4),
            metres_per_world_unit=math.nan,
            several_axes=False,
            fits=False,
            fits_well=False,
        )
    scaled = found.residuals / [1.0, extent]
    typical = np.median(scaled, axis=0)
    starts = (typical / _MEDIAN, np.sqrt(np.mean(scaled**2, axis=0) / 3.0))
    log_likelihood, sigmas, right = max(
        (_mixture(scaled, start) for start in starts), key=lambda one: one[0]
    )
    rms = math.sqrt(3.0) * sigmas
    fits = right.mean() >= _FITS_ROWS and rms[0] < _FITS_ROTATION and rms[1] < _FITS_TRANSLATION
    return Evidence(
        log_likelihood=log_likelihood,
        rotation=float(rms[0]),
        translation=float(rms[1]) * extent,
        typical=(float(typical[0]), float(typical[1]) * extent),
        right=right,
        gripper_T_camera=found.gripper_T_camera,
        metres_per_world_unit=found.metres_per_world_unit,
        several_axes=found.several_axes,
        fits=bool(fits),
        fits_well=bool(fits and rms[0] < _WELL_ROTATION and rms[1] < _WELL_TRANSLATION),
    )


def _mixture(scaled: Array, sigmas: Array) -> tuple[float, Array, NDArray[np.bool_]]:
    """Log-likelihood, standard deviations (2,) per axis and right rows, from a start.

    Args:
        scaled: angles and distances (n, 2), distances in units of the extent.
        sigmas: (2,) to start from.
    """
    n = len(scaled)
    best = np.array([_BEST_ROTATION, _BEST_TRANSLATION])
    # Anywhere: all rotations, and a ball of twice the extent.
    nowhere = math.log(_WRONG) - math.log(8.0 * math.pi**2) - math.log(4.0 / 3.0 * math.pi * 8.0)
    right, m = np.ones(n, dtype=bool), n
    for _ in range(_ROUNDS):
        sigmas = np.maximum(sigmas, best)
        densities = -0.5 * np.sum((scaled / sigmas) ** 2, axis=1)
        densities += math.log(1.0 - _WRONG) - 3.0 * float(np.log(2.0 * math.pi * sigmas.prod()))
        before, right = right, densities > nowhere
        m = int(right.sum())
        if m < min(n, 4):
            return -math.inf, sigmas, right
        squares = np.sum(scaled[right] ** 2, axis=0)
        # X, Z and the scale take six and seven of the equations.
        sigmas = np.sqrt(squares / np.maximum(3.0 * m - np.array([6.0, 7.0]), 1.0))
        if np.array_equal(before, right):
            break
    sigmas = np.maximum(sigmas, best)
    freedom = np.maximum(3.0 * m - np.array([6.0, 7.0]), 1.0)
    inside = -float(freedom @ (np.log(sigmas) + 0.5 * math.log(2.0 * math.pi * math.e)))
    inside += m * math.log(1.0 - _WRONG)
    return inside + (n - m) * nowhere, sigmas, right
