"""What the graph determines of X and the scale; entry point ``determined``."""

from dataclasses import dataclass, replace

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.graph.certainty import Certainty
from handeye_fg.graph.levels import LevelSpread, certainty_of, level_spread
from handeye_fg.graph.noise import Solution, solve
from handeye_fg.graph.reduced import Layout, Linearised, predicted_covariance
from handeye_fg.graph.rig import image_poses, is_plain, to_images
from handeye_fg.graph.variables import LOG_SCALE, State
from handeye_fg.observability import LIMITS, feigned_information, without_feigned
from handeye_fg.options import NoiseOptions


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Determined:
    """The solution of the linearised problem with nothing held, and its statistics.

    Attributes:
        linearised, solution: the problem, its noise levels and covariance.
        spread: how certain the noise levels are.
        derivatives: of (X, ln metres_per_world_unit) of each camera by the shared unknowns (k, 7, d).
        certainties: of the same.
        feigned: information (k, 7, 7) on the same that only noise feigns.
    """

    linearised: Linearised
    solution: Solution
    spread: LevelSpread
    derivatives: Array
    certainties: tuple[Certainty, ...]
    feigned: Array

    @property
    def inflation(self) -> float:
        """What covariances of white noise are multiplied with to be those of t distributions."""
        return 1.0 + float(self.certainties[0].growths[0])

    @property
    def joints(self) -> Array:
        """Covariance (k, 7, 7) of (X, ln metres_per_world_unit), less the feigned information."""
        joints = []
        for certainty, feigned in zip(self.certainties, self.feigned, strict=True):
            scaled = certainty.covariance / np.outer(LIMITS, LIMITS)
            variances, vectors = np.linalg.eigh(scaled)
            smallest = np.finfo(float).eps * variances[-1]
            joints.append(without_feigned(1.0 / np.maximum(variances, smallest), vectors, feigned))
        return np.array(joints)


def determined(
    state: State, linearised: Linearised, solution: Solution, options: NoiseOptions
) -> Determined:
    """The certainty of X and the scale, and the information that only noise feigns.

    Args:
        state: where the problem was linearised.
        linearised: the problem.
        solution: gives the noise levels.
        options: those that the user knows.
    """
    if linearised.held is not None:
        linearised = replace(linearised, held=None)
        solution = solve(linearised, solution.noise)
    spread = level_spread(linearised, solution, options)
    robot = linearised.robot
    predicted = predicted_covariance(robot, solution.covariance)
    variance = np.diagonal(predicted, axis1=1, axis2=2)
    # Before the optimum, the poses are off by more: by what the step is going to correct.
    correction = np.einsum("nij,nj->ni", robot.jacobian, solution.step[robot.columns])
    variance = (variance + correction**2).mean(axis=0).reshape(2, 3).mean(axis=1)
    noise = solution.noise
    derivatives = np.array(
        [_x_and_scale(state, linearised.layout, k) for k in range(len(state.gripper_T_cameras))]
    )
    feigned = [
        feigned_information(
            gripper_T_camera,
            len(predicted) - 1,
            np.sqrt(variance),
            np.array([noise.robot_rotation, noise.robot_translation]),
            _camera_from_grippers(state, k) if linearised.inverted else None,
        )
        for k, gripper_T_camera in enumerate(state.gripper_T_cameras)
    ]
    return Determined(
        linearised=linearised,
        solution=solution,
        spread=spread,
        derivatives=derivatives,
        certainties=tuple(
            certainty_of(linearised, solution, spread, derivative, 6) for derivative in derivatives
        ),
        feigned=np.array(feigned),
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
