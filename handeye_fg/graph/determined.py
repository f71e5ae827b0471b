"""What the graph determines of X and the scale; entry point ``determined``."""

from dataclasses import dataclass, replace

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.graph.noise import Solution, degrees_of_freedom, solve
from handeye_fg.graph.reduced import Layout, Linearised, predicted_covariance
from handeye_fg.graph.rig import image_poses, is_plain, to_images
from handeye_fg.graph.variables import LOG_SCALE, State
from handeye_fg.observability import LIMITS, feigned_information, without_feigned

_FEWEST = 3.0  # degrees of freedom; with two or fewer a t distribution has no covariance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Determined:
    """The solution of the linearised problem with nothing held, and its statistics.

    Attributes:
        solution: noise levels and covariance.
        joints: covariance (k, 7, 7) of (X, ln metres_per_world_unit) for each camera.
        degrees_of_freedom: of the covariances, which are those of a t distribution; infinite where
            the noise levels are known.
        inflation: what they have been multiplied with (``joints``), or are to be (``solution``).
    """

    solution: Solution
    joints: Array
    degrees_of_freedom: float
    inflation: float


def determined(state: State, linearised: Linearised, solution: Solution) -> Determined:
    """The covariance of X and the scale, less the information that only noise feigns.

    Args:
        state: where the problem was linearised.
        linearised: the problem.
        solution: gives the noise levels.
    """
    if linearised.held is not None:
        linearised = replace(linearised, held=None)
        solution = solve(linearised, solution.noise)
    freedom = degrees_of_freedom(linearised, solution)
    # With estimated noise levels the errors follow a t distribution; this is its covariance.
    inflation = 1.0 if np.isinf(freedom) else max(freedom, _FEWEST) / (max(freedom, _FEWEST) - 2.0)
    robot = linearised.robot
    predicted = predicted_covariance(robot, solution.covariance)
    variance = np.diagonal(predicted, axis1=1, axis2=2)
    # Before the optimum, the poses are off by more: by what the step is going to correct.
    correction = np.einsum("nij,nj->ni", robot.jacobian, solution.step[robot.columns])
    variance = (variance + correction**2).mean(axis=0).reshape(2, 3).mean(axis=1)
    noise = solution.noise
    joints = []
    for k, gripper_T_camera in enumerate(state.gripper_T_cameras):
        feigned = feigned_information(
            gripper_T_camera,
            len(predicted) - 1,
            np.sqrt(variance),
            np.array([noise.robot_rotation, noise.robot_translation]),
            _camera_from_grippers(state, k) if linearised.inverted else None,
        )
        to_joint = _x_and_scale(state, linearised.layout, k)
        joint = inflation * to_joint @ solution.covariance @ to_joint.T
        variances, vectors = np.linalg.eigh(joint / np.outer(LIMITS, LIMITS))
        smallest = np.finfo(float).eps * variances[-1]
        joints.append(without_feigned(1.0 / np.maximum(variances, smallest), vectors, feigned))
    return Determined(
        solution=solution,
        joints=np.array(joints),
        degrees_of_freedom=freedom,
        inflation=inflation,
    )


def _camera_from_grippers(state: State, camera: int) -> Array:
    """Where a static camera is from each gripper (n, 3), base axes, metres."""
    base_T_camera = state.gripper_T_cameras[camera]
    metric = frames.scaled(state.world_T_camera, float(np.exp(state.log_scale)))
    first_T_camera = frames.inverse(state.gripper_T_camera) @ base_T_camera
    gripper_T_camera = state.base_T_world @ metric @ first_T_camera
    R = base_T_camera[:3, :3] @ np.swapaxes(gripper_T_camera[:, :3, :3], 1, 2)
    return np.asarray(np.einsum("nij,nj->ni", R, gripper_T_camera[:, :3, 3]))


def spread(world_T_camera: Array) -> float:
    """Root mean square distance of the camera centres from their mean."""
    return float(np.sqrt(np.mean(np.sum(_centred(world_T_camera) ** 2, axis=1))))


def _x_and_scale(state: State, layout: Layout, camera: int) -> Array:
    """Derivative (7, d) of a camera's X's tangent and ln(spread in metres) by the shared unknowns."""
    images = replace(layout, n_poses=len(state.rig.pose))
    poses = image_poses(state)
    centred = _centred(poses)
    in_camera = np.einsum("nji,nj->ni", poses[:, :3, :3], centred) / np.sum(centred**2)
    result = np.zeros((7, images.dim))
    result[np.arange(6), images.x_columns(camera)] = 1.0
    result[6, images.columns(LOG_SCALE)] = 1.0
    result[6, : 6 * images.n_poses].reshape(-1, 6)[:, 3:] = in_camera
    return result if is_plain(state.rig) else np.asarray(result @ to_images(state, layout))


def _centred(world_T_camera: Array) -> Array:
    centres = world_T_camera[:, :3, 3]
    return np.asarray(centres - centres.mean(axis=0))
