"""One function for each measurement type; each returns a small graph, the caller adds them up."""

from collections.abc import Sequence
from typing import Literal

import gtsam
import numpy as np
from numpy.typing import NDArray

from factors import camera_distance_factor, camera_spread_factor, robot_pose_factor
from handeye_fg.frames import Array
from handeye_fg.graph.known import Known, KnownDistance, KnownSpread
from handeye_fg.graph.variables import (
    BASE_T_WORLD,
    GRIPPER_T_CAMERA,
    LOG_SCALE,
    State,
    camera_key,
    intrinsics_key,
    point_key,
    x_key,
)
from handeye_fg.known import pose_of
from handeye_fg.observability import LIMITS
from handeye_fg.priors import PosePrior, Prior
from handeye_fg.types import KnownPoints

Gauge = Literal["base", "first camera"]

# Radians and metres; a millimetre off, it moves what is determined to 10 um by 1e-15 m.
_WIDE = 10.0
# Metres; where nothing fits, the scale falls towards zero, and GTSAM takes a sigma of zero for a constraint.
_LEAST_EXTENT = 1e-6
# Standard deviation, in units of the limits of observability, of X along directions that are kept.
_HELD = 0.01


def pose_sigmas(rotation: float, translation: float) -> Array:
    """Sigmas (6,) of a pose in GTSAM's order: rotation in radians, then translation in metres."""
    return np.repeat([rotation, translation], 3)


def robot_graph(
    base_T_gripper: Array,
    sigmas: Array,
    trusted: NDArray[np.bool_] | None = None,
    *,
    inverted: bool = False,
) -> gtsam.NonlinearFactorGraph:
    """Reported robot poses (n, 4, 4) as measurements with the robot's noise, sigmas (6,).

    The noise is that of base_T_gripper in the gripper frame. Where the poses are gripper_T_base, with
    the reported one M and the predicted one P, ``Log(M P^-1) = -Ad(M) Log(M^-1 P)`` exactly, so that the
    same factor serves with its residual in other axes: those of base_T_gripper, with the sign
    reversed. Its rotation error then acts on the translation with the whole reach of the arm as lever.

    Args:
        base_T_gripper: reported poses, metres.
        sigmas: of base_T_gripper: radians and metres.
        trusted: (n,) which of them are used; None: all.
        inverted: the poses are gripper_T_base.
    """
    graph = gtsam.NonlinearFactorGraph()
    used = range(len(base_T_gripper)) if trusted is None else np.flatnonzero(trusted).tolist()
    for i in used:
        graph.push_back(
            robot_pose_factor(
                camera_key(i),
                GRIPPER_T_CAMERA,
                BASE_T_WORLD,
                LOG_SCALE,
                pose := gtsam.Pose3(base_T_gripper[i]),
                _robot_noise(pose, sigmas, inverted=inverted),
            )
        )
    return graph


def _robot_noise(pose: gtsam.Pose3, sigmas: Array, *, inverted: bool) -> gtsam.noiseModel.Gaussian:
    """Noise of a robot factor's residual."""
    if not inverted:
        return gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    return gtsam.noiseModel.Gaussian.SqrtInformation(pose.AdjointMap() / sigmas[:, None])


def gauge_graph(state: State, gauge: Gauge) -> gtsam.NonlinearFactorGraph:
    """Fix the seven freedoms of the SfM world: six by a pose, one by the scale.

    The measurements do not change along the gauge, so these seven residuals are exactly zero at the
    optimum whatever their weight, and X, its covariance and every other quantity that does not
    depend on the gauge come out the same. The weight is therefore chosen for the optimiser, which
    is slowed down by stiff factors: each freedom may move about as much as the scene is large.

    Args:
        state: the values at which the gauge is held.
        gauge: which pose holds it: Z = base_T_world, or the first camera.
    """
    graph = gtsam.NonlinearFactorGraph()
    graph.addPriorDouble(LOG_SCALE, state.log_scale, gtsam.noiseModel.Isotropic.Sigma(1, 1.0))
    extent = float(np.ptp(state.world_T_camera[:, :3, 3], axis=0).max())
    if gauge == "base":
        metres = max(extent * float(np.exp(state.log_scale)), _LEAST_EXTENT)
        model = gtsam.noiseModel.Diagonal.Sigmas(pose_sigmas(1.0, metres))
        graph.addPriorPose3(BASE_T_WORLD, gtsam.Pose3(state.base_T_world), model)
    else:
        model = gtsam.noiseModel.Diagonal.Sigmas(pose_sigmas(1.0, extent))
        graph.addPriorPose3(camera_key(0), gtsam.Pose3(state.world_T_camera[0]), model)
    return graph


def known_points_graph(known: KnownPoints, unit: float = 1.0) -> gtsam.NonlinearFactorGraph:
    """Known points, and the scale that they give; they fix the world, no other gauge is needed.

    Args:
        known: positions and how sure they are.
        unit: factor of all standard deviations.
    """
    graph = gtsam.NonlinearFactorGraph()
    scale = gtsam.noiseModel.Isotropic.Sigma(1, unit * known.log_scale_sigma)
    graph.addPriorDouble(LOG_SCALE, 0.0, scale)
    model = gtsam.noiseModel.Isotropic.Sigma(3, unit * known.sigma)
    for j, point in enumerate(known.points_world):
        graph.push_back(gtsam.PriorFactorPoint3(point_key(j), point, model))
    return graph


def wide_prior_graph(state: State) -> gtsam.NonlinearFactorGraph:
    """Keep X finite where the motion leaves it free, without weight where it is determined.

    Cameras likewise: one that shares no points with the others hangs on its robot pose, which may come
    to be left out.
    """
    graph = gtsam.NonlinearFactorGraph()
    extent = float(np.ptp(state.world_T_camera[:, :3, 3], axis=0).max())
    anywhere = gtsam.noiseModel.Diagonal.Sigmas(pose_sigmas(1.0, extent))
    for i, world_T_camera in enumerate(state.world_T_camera):
        graph.addPriorPose3(camera_key(i), gtsam.Pose3(world_T_camera), anywhere)
    model = gtsam.noiseModel.Isotropic.Sigma(6, _WIDE)
    for k, gripper_T_camera in enumerate(state.gripper_T_cameras):
        graph.addPriorPose3(x_key(k), gtsam.Pose3(gripper_T_camera), model)
    return graph


def held_graph(gripper_T_camera: Array, free: Array) -> gtsam.NonlinearFactorGraph:
    """Keep the first X where it is along its free directions, and let it go along the others.

    Args:
        gripper_T_camera: X (4, 4), metres.
        free: orthonormal columns (6, k), in units of ``LIMITS``.
    """
    graph = gtsam.NonlinearFactorGraph()
    root = free @ free.T / LIMITS[:6] / _HELD
    model = gtsam.noiseModel.Gaussian.SqrtInformation(root)
    graph.addPriorPose3(GRIPPER_T_CAMERA, gtsam.Pose3(gripper_T_camera), model)
    return graph


def known_graph(priors: Sequence[Known], unit: float = 1.0) -> gtsam.NonlinearFactorGraph:
    """What is known beforehand; ``unit`` is a factor of all standard deviations."""
    graph = gtsam.NonlinearFactorGraph()
    for prior in priors:
        match prior:
            case Prior():
                graph.push_back(_translation_along(prior, unit))
            case PosePrior():
                graph.push_back(_known_pose(prior, unit))
            case KnownDistance():
                noise = gtsam.noiseModel.Isotropic.Sigma(1, unit * prior.std)
                ends = camera_key(prior.one), camera_key(prior.other)
                graph.push_back(camera_distance_factor(*ends, LOG_SCALE, prior.metres, noise))
            case KnownSpread():
                noise = gtsam.noiseModel.Isotropic.Sigma(1, unit * prior.std / prior.metres)
                keys = [camera_key(i) for i in range(prior.n_poses)]
                graph.push_back(camera_spread_factor(keys, LOG_SCALE, prior.metres, noise))
    return graph


def _translation_along(prior: Prior, unit: float) -> gtsam.NonlinearFactor:
    """GTSAM's prior of a translation has three rows; the two across the axis get no weight."""
    axis = np.asarray(prior.axis)
    root = np.zeros((3, 3))
    root[0] = axis / (unit * prior.std)
    model = gtsam.noiseModel.Gaussian.SqrtInformation(root)
    return gtsam.PoseTranslationPrior3D(GRIPPER_T_CAMERA, prior.value * axis, model)


def _known_pose(prior: PosePrior, unit: float) -> gtsam.NonlinearFactorGraph:
    """Rotation and position apart: one of them may be unknown."""
    graph, known = gtsam.NonlinearFactorGraph(), gtsam.Pose3(pose_of(prior))
    if prior.std_rotation_deg is not None:
        sigma = unit * float(np.deg2rad(prior.std_rotation_deg))
        model = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
        graph.push_back(gtsam.PoseRotationPrior3D(GRIPPER_T_CAMERA, known.rotation(), model))
    if prior.std_translation_mm is not None:
        model = gtsam.noiseModel.Isotropic.Sigma(3, unit * 1e-3 * prior.std_translation_mm)
        position = known.translation()
        graph.push_back(gtsam.PoseTranslationPrior3D(GRIPPER_T_CAMERA, position, model))
    return graph


def intrinsics_graph(camera: int, params: Array, sigmas: Array) -> gtsam.NonlinearFactorGraph:
    """Prior on the unknown intrinsics (k,) of a camera with standard deviations (k,)."""
    graph = gtsam.NonlinearFactorGraph()
    model = gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    graph.push_back(gtsam.PriorFactorVector(intrinsics_key(camera), params, model))
    return graph


def joined(graphs: Sequence[gtsam.NonlinearFactorGraph]) -> gtsam.NonlinearFactorGraph:
    """The sum of the graphs."""
    total = gtsam.NonlinearFactorGraph()
    for graph in graphs:
        total.push_back(graph)
    return total
