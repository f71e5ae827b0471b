"""The linearised problem with the points eliminated: small, dense, and all that statistics need.

The shared unknowns are the camera poses, X of each camera, Z, the logarithm of the scale, where refined
the intrinsics of each camera, and the known points, whose prior makes them different from the others. Image observations
enter as one quadratic form, their points eliminated, robot poses as Jacobian rows, so that solutions
and covariances for other noise levels need no new elimination.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.graph.variables import (
    BASE_T_WORLD,
    LOG_SCALE,
    camera_key,
    intrinsics_key,
    point_key,
    x_key,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Where each shared unknown stands in the vector of shared unknowns.

    Attributes:
        n_poses: number of camera poses.
        n_cameras: number of cameras.
        intrinsics: which parameters of each camera are unknowns; empty: none.
        n_known: number of known points.
    """

    n_poses: int
    n_cameras: int = 1
    intrinsics: tuple[tuple[int, ...], ...] = ()
    n_known: int = 0

    @property
    def dim(self) -> int:
        """Length of the vector."""
        return self._first_point + 3 * self.n_known

    @property
    def _after_x(self) -> int:
        return 6 * (self.n_poses + self.n_cameras)

    @property
    def first_intrinsics(self) -> int:
        """Where the intrinsics start."""
        return self._after_x + 7

    @property
    def _first_point(self) -> int:
        return self.first_intrinsics + len(self.intrinsics_columns)

    @property
    def keys(self) -> list[int]:
        """Keys of the shared unknowns, in their order: c, X, Z, l, K, known points."""
        keys = [camera_key(i) for i in range(self.n_poses)]
        keys += [x_key(k) for k in range(self.n_cameras)]
        keys += [BASE_T_WORLD, LOG_SCALE]
        keys += [intrinsics_key(k) for k, unknown in enumerate(self.intrinsics) if unknown]
        return [*keys, *(point_key(j) for j in range(self.n_known))]

    def columns(self, key: int) -> NDArray[np.int64]:
        """Indices of an unknown's tangent, in GTSAM's order."""
        index = gtsam.symbolIndex(key)
        sizes = [len(unknown) for unknown in self.intrinsics]
        first, size = {
            "c": (6 * index, 6),
            "x": (6 * (self.n_poses + index), 6),
            "z": (self._after_x, 6),
            "l": (self._after_x + 6, 1),
            "k": (self.first_intrinsics + sum(sizes[:index]), sum(sizes[index : index + 1])),
            "p": (self._first_point + 3 * index, 3),
        }[chr(gtsam.symbolChr(key))]
        return np.arange(first, first + size)

    def x_columns(self, camera: int = 0) -> NDArray[np.int64]:
        """Indices of the tangent of a camera's X."""
        return self.columns(x_key(camera))

    @property
    def all_x_columns(self) -> NDArray[np.int64]:
        """Indices of the tangents of all X."""
        return np.arange(6 * self.n_poses, self._after_x)

    @property
    def intrinsics_columns(self) -> NDArray[np.int64]:
        """Indices of the intrinsics of all cameras; none where they are fixed."""
        n = sum(map(len, self.intrinsics))
        return np.arange(self.first_intrinsics, self.first_intrinsics + n)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Quadratic:
    """``1/2 (d' H d - 2 g' d + constant)``, the cost of some measurements around an estimate."""

    hessian: Array
    gradient: Array
    constant: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """Measurements that were not summed up: ``residual + jacobian d`` by image.

    Attributes:
        jacobian: (n, 6, k) with respect to the unknowns in ``columns``.
        residual: (n, 6), rotation in radians, then translation in metres.
        columns: (n, k).
    """

    jacobian: Array
    residual: Array
    columns: NDArray[np.int64]

    def only(self, which: NDArray[np.bool_]) -> "Rows":
        """The rows of some images."""
        return Rows(
            jacobian=self.jacobian[which],
            residual=self.residual[which],
            columns=self.columns[which],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearised:
    """Everything about the problem around an estimate.

    Attributes:
        reprojections: image observations of unknown points; their sigmas have the unit
            ``pixel_unit_px`` (pixels).
        corners: image observations of known points, with sigmas of 1 pixel.
        robot: residuals of the robot poses that are used.
        reported: those of all robot poses.
        prior: gauge, known points and other priors.
        pixel_unit_px: see ``reprojections``.
        pixel_redundancy: observed pixel coordinates of unknown points less point coordinates.
        corner_rows: observed pixel coordinates of known points.
        layout: of the shared unknowns.
        inverted: the robot poses are gripper_T_base; their residuals are those of base_T_gripper.
        point_steps: steps (p, 3) of the eliminated points that belong to a step (d,) of the shared
            unknowns.
        held: what keeps free directions of X where they are; None: nothing.
    """

    reprojections: Quadratic
    corners: Quadratic
    robot: Rows
    reported: Rows
    prior: Quadratic
    pixel_unit_px: float
    pixel_redundancy: int
    corner_rows: int
    layout: Layout
    inverted: bool
    point_steps: Callable[[Array], Array]
    held: Quadratic | None = None

    def using(self, trusted: NDArray[np.bool_]) -> "Linearised":
        """The problem with some (n,) of the robot poses."""
        return replace(self, robot=self.reported.only(trusted))


def summed(linear: gtsam.GaussianFactorGraph, layout: Layout) -> Quadratic:
    """Factors on the shared unknowns, summed up."""
    seen = set(linear.keyVector())
    keys = [key for key in layout.keys if key in seen]
    hessian, gradient = np.zeros((layout.dim, layout.dim)), np.zeros(layout.dim)
    if not keys:
        return Quadratic(hessian=hessian, gradient=gradient, constant=0.0)
    order = gtsam.Ordering()
    for key in keys:
        order.push_back(key)
    dense = np.asarray(linear.augmentedHessian(order))
    columns = np.concatenate([layout.columns(key) for key in keys])
    hessian[np.ix_(columns, columns)] = dense[:-1, :-1]
    gradient[columns] = dense[:-1, -1]
    return Quadratic(hessian=hessian, gradient=gradient, constant=float(dense[-1, -1]))


def robot_rows(linear: gtsam.GaussianFactorGraph, layout: Layout) -> Rows:
    """Robot factors, which were made with unit sigmas, in natural units."""
    jacobians, residuals, columns = [], [], []
    for k in range(linear.size()):
        factor = linear.at(k)
        jacobian, right = factor.jacobian()
        jacobians.append(jacobian)
        residuals.append(-right.ravel())
        columns.append(np.concatenate([layout.columns(key) for key in factor.keys()]))
    return Rows(
        jacobian=np.array(jacobians), residual=np.array(residuals), columns=np.array(columns)
    )


def scatter(rows: Rows, weights: Array, dim: int) -> tuple[Array, Array]:
    """Information matrix (dim, dim) and vector (dim,) of rows with weights (6,) by component."""
    hessian, gradient = np.zeros((dim, dim)), np.zeros(dim)
    weighted = rows.jacobian * weights[:, None]
    for jacobian, residual, w_jacobian, columns in zip(
        rows.jacobian, rows.residual, weighted, rows.columns, strict=True
    ):
        hessian[np.ix_(columns, columns)] += jacobian.T @ w_jacobian
        gradient[columns] -= w_jacobian.T @ residual
    return hessian, gradient


def predicted_covariance(rows: Rows, covariance: Array) -> Array:
    """Covariance (n, 6, 6) of the rows' predictions, from that of the shared unknowns."""
    return np.array(
        [
            jacobian @ covariance[np.ix_(columns, columns)] @ jacobian.T
            for jacobian, columns in zip(rows.jacobian, rows.columns, strict=True)
        ]
    )


def predicted_together(rows: Rows, covariance: Array) -> Array:
    """Covariance (6 n, 6 n) of all predictions of the rows, from that of the shared unknowns."""
    dim, n = len(covariance), len(rows.columns)
    half = np.concatenate(
        [
            jacobian @ covariance[columns]
            for jacobian, columns in zip(rows.jacobian, rows.columns, strict=True)
        ]
        or [np.zeros((0, dim))]
    )
    result = np.empty((6 * n, 6 * n))
    for i, (jacobian, columns) in enumerate(zip(rows.jacobian, rows.columns, strict=True)):
        result[:, 6 * i : 6 * i + 6] = half[:, columns] @ jacobian.T
    return result
