"""Poses as measurements: factors in rows of independent noise, each row with its variance component.

Unknowns: true camera poses c_i, X, Z, and the logarithm of the scale, one for all poses or, where it
drifts, one for each (the camera's distance from the world's origin is what drifts).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L
from scipy import sparse

from factors import robot_pose_factor
from handeye_fg.frames import Array
from handeye_fg.graph.poses.chain import ChainRows
from handeye_fg.graph.variables import BASE_T_WORLD, GRIPPER_T_CAMERA, camera_key

CameraNoise = Literal["independent", "odometry"]
Scale = Literal["known", "free", "drifting"]
Component = Literal[
    "robot_rotation",
    "robot_translation",
    "camera_rotation",
    "camera_across",
    "camera_along",
    "odometry_rotation",
    "odometry_translation",
    "scale_drift",
]

_ROBOT: tuple[Component, ...] = ("robot_rotation", "robot_translation")
_TIE_SIGMA = 1e-6  # of what is equal by definition, radians and metres


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseModel:
    """What is random in the poses.

    Attributes:
        camera: each camera pose has noise of its own, or each motion to the next pose has.
        scale: known to be one, one unknown for all poses, or a random walk along the poses.
    """

    camera: CameraNoise
    scale: Scale

    @property
    def components(self) -> tuple[Component, ...]:
        """The variance components."""
        camera: tuple[Component, ...] = (
            ("camera_rotation", "camera_across", "camera_along")
            if self.camera == "independent"
            else ("odometry_rotation", "odometry_translation")
        )
        drift: tuple[Component, ...] = ("scale_drift",) if self.scale == "drifting" else ()
        return _ROBOT + camera + drift


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurement:
    """One factor, before its noise is known.

    Attributes:
        factor: makes the factor from its noise.
        axes: (d, d); turns the factor's residual into rows of independent noise.
        components: variance component of each row; None: its standard deviation is one.
    """

    factor: Callable[[gtsam.noiseModel.Base], gtsam.NonlinearFactor]
    axes: Array
    components: tuple[Component | None, ...]

    def with_noise(self, sigmas: Mapping[Component, float]) -> gtsam.NonlinearFactor:
        """The factor under certain standard deviations; a component without one has one."""
        return self.factor(gtsam.noiseModel.Gaussian.SqrtInformation(self._whitener(sigmas)))

    def covariance(self, sigmas: Mapping[Component, float]) -> Array:
        """Covariance (d, d) of the factor's residual."""
        root = np.linalg.inv(self._whitener(sigmas))
        return np.asarray(root @ root.T)

    def _whitener(self, sigmas: Mapping[Component, float]) -> Array:
        scale = [1.0 if name is None else sigmas.get(name, 1.0) for name in self.components]
        return np.asarray(self.axes / np.array(scale)[:, None])


def robot_measurements(
    base_T_gripper: Array, weights: Array, scale: Scale, *, inverted: bool
) -> list[Measurement]:
    """Reported robot poses; their noise is in the gripper frame.

    Args:
        base_T_gripper: (n, 4, 4), metres.
        weights: of the squared residuals (n,), positive.
        scale: whether each pose has a scale of its own.
        inverted: the poses are gripper_T_base: the gripper is their parent frame.
    """

    def measurement(i: int, pose: gtsam.Pose3) -> Measurement:
        key = L(i) if scale == "drifting" else L(0)
        return Measurement(
            factor=lambda noise: robot_pose_factor(
                camera_key(i), GRIPPER_T_CAMERA, BASE_T_WORLD, key, pose, noise
            ),
            axes=np.sqrt(weights[i]) * (pose.AdjointMap() if inverted else np.eye(6)),
            components=("robot_rotation",) * 3 + ("robot_translation",) * 3,
        )

    return [measurement(i, gtsam.Pose3(matrix)) for i, matrix in enumerate(base_T_gripper)]


def camera_measurements(world_T_camera: Array, weights: Array) -> list[Measurement]:
    """Camera poses with independent noise, and weights (n,) of their squared residuals.

    What a camera sees at the world's origin (a target, a scene) it sees with errors across its
    optical axis, along it, and in the orientation of what it sees: three sigmas. With the measured
    pose M and the true one c, camera_T_world is off by ``M^-1 = c^-1 Exp(w, R_c^T d)``: w the error in
    orientation, d that of the origin in camera axes. The prior's residual ``Log(M^-1 c)`` is the
    same error in the camera frame.
    """

    def measurement(i: int, pose: gtsam.Pose3) -> Measurement:
        axes = pose.AdjointMap()
        axes[3:] = pose.rotation().matrix().T @ axes[3:]
        return Measurement(
            factor=lambda noise: gtsam.PriorFactorPose3(camera_key(i), pose, noise),
            axes=np.sqrt(weights[i]) * axes,
            components=("camera_rotation",) * 3 + ("camera_across",) * 2 + ("camera_along",),
        )

    return [measurement(i, gtsam.Pose3(matrix)) for i, matrix in enumerate(world_T_camera)]


def odometry_measurements(world_T_camera: Array) -> list[Measurement]:
    """Motions of the camera from each pose to the next; the first pose defines the world."""
    poses = [gtsam.Pose3(matrix) for matrix in world_T_camera]

    def measurement(i: int) -> Measurement:
        motion = poses[i].between(poses[i + 1])
        return Measurement(
            factor=lambda noise: gtsam.BetweenFactorPose3(
                camera_key(i), camera_key(i + 1), motion, noise
            ),
            axes=np.eye(6),
            components=("odometry_rotation",) * 3 + ("odometry_translation",) * 3,
        )

    first = Measurement(
        factor=lambda noise: gtsam.PriorFactorPose3(camera_key(0), poses[0], noise),
        axes=np.eye(6) / _TIE_SIGMA,
        components=(None,) * 6,
    )
    return [first, *(measurement(i) for i in range(len(poses) - 1))]


def scale_measurements(n_poses: int, scale: Scale) -> list[Measurement]:
    """What is known of the scale: that it is one, that it walks, or nothing."""

    def walk(i: int) -> Measurement:
        return Measurement(
            factor=lambda noise: gtsam.BetweenFactorDouble(L(i), L(i + 1), 0.0, noise),
            axes=np.eye(1),
            components=("scale_drift",),
        )

    if scale == "drifting":
        return [walk(i) for i in range(n_poses - 1)]
    if scale == "free":
        return []
    known = Measurement(
        factor=lambda noise: gtsam.PriorFactorDouble(L(0), 0.0, noise),
        axes=np.eye(1) / _TIE_SIGMA,
        components=(None,),
    )
    return [known]


def tie() -> Measurement:
    """Z = X, where the poses are motions: A X = X B."""
    return Measurement(
        factor=lambda noise: gtsam.BetweenFactorPose3(
            GRIPPER_T_CAMERA, BASE_T_WORLD, gtsam.Pose3(), noise
        ),
        axes=np.eye(6) / _TIE_SIGMA,
        components=(None,) * 6,
    )


def graph_of(
    measurements: Sequence[Measurement],
    priors: gtsam.NonlinearFactorGraph,
    sigmas: Mapping[Component, float],
) -> gtsam.NonlinearFactorGraph:
    """Measurements under certain sigmas, and priors, as one graph."""
    graph = gtsam.NonlinearFactorGraph(priors)
    for measurement in measurements:
        graph.push_back(measurement.with_noise(sigmas))
    return graph


@dataclass(frozen=True, slots=True, kw_only=True)
class Columns:
    """Where each unknown stands: the chain (for each pose c_i, and its l_i), then X, Z and l."""

    n_poses: int
    scale: Scale

    @property
    def stride(self) -> int:
        """Chain unknowns of one pose."""
        return 7 if self.scale == "drifting" else 6

    @property
    def n_chain(self) -> int:
        """Chain unknowns."""
        return self.stride * self.n_poses

    @property
    def total(self) -> int:
        """All unknowns."""
        return self.n_chain + (12 if self.scale == "drifting" else 13)

    @property
    def wanted(self) -> list[int]:
        """X and the logarithm of the scale (where it drifts, at the first pose)."""
        scale = 6 if self.scale == "drifting" else self.n_chain + 12
        return [*range(self.n_chain, self.n_chain + 6), scale]

    @property
    def ordering(self) -> gtsam.Ordering:
        """The chain first, pose by pose; the shared unknowns last."""
        order = gtsam.Ordering()
        for i in range(self.n_poses):
            order.push_back(camera_key(i))
            if self.scale == "drifting":
                order.push_back(L(i))
        for key in (GRIPPER_T_CAMERA, BASE_T_WORLD, *([] if self.scale == "drifting" else [L(0)])):
            order.push_back(key)
        return order

    def of(self, key: int) -> range:
        """Columns of a key's tangent."""
        symbol, index = chr(gtsam.symbolChr(key)), gtsam.symbolIndex(key)
        first, size = {
            "c": (self.stride * index, 6),
            "x": (self.n_chain, 6),
            "z": (self.n_chain + 6, 6),
            "l": (7 * index + 6 if self.scale == "drifting" else self.n_chain + 12, 1),
        }[symbol]
        return range(first, first + size)


def rows_of(
    measurements: Sequence[Measurement],
    priors: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    columns: Columns,
    components: Sequence[Component],
) -> ChainRows:
    """The measurements linearised, each row in the unit of its component, and the priors."""
    linear = graph_of(measurements, priors, {}).linearize(values)
    n_priors = priors.size()
    factors = [linear.at(k) for k in range(linear.size())]
    n_rows = sum(len(factor.jacobian()[0]) for factor in factors[:n_priors])
    names: list[Component | None] = [None] * n_rows
    names += [name for measurement in measurements for name in measurement.components]
    number: dict[Component | None, int] = {name: k for k, name in enumerate(components)}
    number[None] = -1
    entries, rows, where, residuals, start = [], [], [], [], 0
    for factor in factors:
        jacobian, right = factor.jacobian()
        at = np.concatenate([columns.of(key) for key in factor.keys()])
        residuals.append(-np.ravel(right))
        entries.append(np.ravel(jacobian))
        rows.append(np.repeat(np.arange(start, start + len(jacobian)), len(at)))
        where.append(np.tile(at, len(jacobian)))
        start += len(jacobian)
    index = (np.concatenate(rows), np.concatenate(where))
    return ChainRows(
        jacobian=sparse.csr_array((np.concatenate(entries), index), shape=(start, columns.total)),
        residual=np.concatenate(residuals),
        component=np.array([number[name] for name in names]),
        n_chain=columns.n_chain,
        block=columns.stride,
        log_variance=-2.0 * sum(float(np.linalg.slogdet(m.axes)[1]) for m in measurements),
    )
