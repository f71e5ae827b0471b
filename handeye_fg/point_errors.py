"""What the uncertainty of X makes of the points that the camera measures; entry point ``accuracy``.

A point p in camera coordinates is put into the parent frame of X by X p. With X perturbed on the right by
(w, v), the point moves in camera coordinates by ``w x p + v``. The error grows with the distance, and
depends on the direction: a rotation of the camera moves what is far by more.
"""

from dataclasses import dataclass

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array

_LEVEL = 0.95  # part of the errors that the radius holds
# Directions of errors that the quantile is taken over: it is then known to a part of 0.003.
_DRAWS = 100_000
_SEED = 0
_FEWEST = 3.0  # degrees of freedom; with two or fewer a t distribution has no covariance
_DISTANCES = np.array([0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0])  # parts of the working distance
_USUAL_DISTANCE = 0.5  # metres, where no scene tells the working distance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointError:
    """The error of a point that X puts into its parent frame, the camera's own error left aside.

    Attributes:
        point_camera: the point (3,) in camera coordinates, metres.
        covariance: of its error (3, 3), along the camera's axes, metres squared.
        within_95: 95 % of the errors are no longer than this, metres.
    """

    point_camera: Array
    covariance: Array
    within_95: float

    @property
    def distance(self) -> float:
        """From the camera, metres."""
        return float(np.linalg.norm(self.point_camera))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Accuracy:
    """The error that X causes.

    Attributes:
        working_distance: of the task, metres: as given, or the median depth of the scene's points; None where
            neither is known.
        tool: at the origin of X's parent frame: the gripper, or the base.
        along_axis: at points on the optical axis, the nearest first; one is at the working distance.
        tolerance: what is good enough there, metres; None: nobody said.
    """

    working_distance: float | None
    tool: PointError
    along_axis: tuple[PointError, ...]
    tolerance: float | None = None

    @property
    def at_work(self) -> PointError:
        """At the working distance, or at half a metre."""
        wanted = self.working_distance or _USUAL_DISTANCE
        return min(self.along_axis, key=lambda error: abs(error.distance - wanted))


def accuracy(
    gripper_T_camera: Array,
    covariance: Array,
    degrees_of_freedom: float,
    working_distance: float | None,
    tolerance: float | None = None,
) -> Accuracy:
    """The error that an X without free directions causes at the tool and over the distance.

    Args:
        gripper_T_camera: X (4, 4), metres.
        covariance: of X (6, 6), (rotation, translation), right perturbation: that of a t distribution.
        degrees_of_freedom: of this distribution; infinite: it is normal.
        working_distance: of the task, metres, or None.
        tolerance: what is good enough there, metres, or None.
    """
    depths = _DISTANCES * (working_distance or _USUAL_DISTANCE)
    on_axis = np.stack([np.zeros_like(depths), np.zeros_like(depths), depths], axis=1)
    points = np.vstack([frames.inverse(gripper_T_camera)[:3, 3], on_axis])
    covariances = _covariances(points, covariance)
    radii = _radii(covariances, degrees_of_freedom)
    errors = [
        PointError(point_camera=point, covariance=of_point, within_95=float(radius))
        for point, of_point, radius in zip(points, covariances, radii, strict=True)
    ]
    return Accuracy(
        working_distance=working_distance,
        tool=errors[0],
        along_axis=tuple(errors[1:]),
        tolerance=tolerance,
    )


def _covariances(points_camera: Array, covariance: Array) -> Array:
    """Covariances (m, 3, 3) of the errors of points (m, 3)."""
    by_x = np.zeros((len(points_camera), 3, 6))
    by_x[:, :, :3] = np.swapaxes(np.cross(np.eye(3), points_camera[:, None]), 1, 2)
    by_x[:, :, 3:] = np.eye(3)
    return np.asarray(by_x @ covariance @ np.swapaxes(by_x, 1, 2))


def _radii(covariances: Array, degrees_of_freedom: float) -> Array:
    """Lengths (m,) that hold 95 % of errors with these covariances (m, 3, 3), t distributed."""
    rng = np.random.default_rng(_SEED)
    squares = rng.standard_normal((_DRAWS, 3)) ** 2
    if np.isfinite(degrees_of_freedom):
        freedom = max(degrees_of_freedom, _FEWEST)
        squares *= ((freedom - 2.0) / rng.chisquare(freedom, _DRAWS))[:, None]
    variances = np.maximum(np.linalg.eigvalsh(covariances), 0.0)
    return np.asarray(np.sqrt(np.quantile(squares @ variances.T, _LEVEL, axis=0)))
