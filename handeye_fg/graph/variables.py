"""The unknowns of the factor graph: their keys, their order, and values in and out of GTSAM.

Unknowns: poses c_i = world_T_camera of the first camera, one at each robot pose, points p_j (world
units), X_k = gripper_T_camera of each camera, Z = base_T_world, l = ln(metres_per_world_unit), and the
intrinsics K_k of each camera where they are refined. The first points may be known ones, corners of a
target.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, K, L, P, X, Z

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.types import CameraModel, Rig

GRIPPER_T_CAMERA = X(0)  # of the first camera
BASE_T_WORLD = Z(0)
LOG_SCALE = L(0)

camera_key = C
point_key = P
x_key = X
intrinsics_key = K


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of all unknowns.

    Attributes:
        world_T_camera: the first camera at each robot pose (n, 4, 4), whether it took an image there
            or not; translations in world units.
        points_world: (p, 3), world units.
        gripper_T_cameras: X of each camera (k, 4, 4), metres.
        base_T_world: Z (4, 4), metres.
        log_scale: ln(metres_per_world_unit).
        cameras: intrinsics of each camera, of any model of ``handeye_fg.lens``.
        rig: which camera took an image, and at which robot pose.
    """

    world_T_camera: Array
    points_world: Array
    gripper_T_cameras: Array
    base_T_world: Array
    log_scale: float
    cameras: tuple[CameraModel, ...]
    rig: Rig

    @property
    def gripper_T_camera(self) -> Array:
        """X of the first camera (4, 4), metres."""
        return np.asarray(self.gripper_T_cameras[0])


def to_values(
    state: State, *, intrinsics: Sequence[Sequence[int]] = (), n_points: int | None = None
) -> gtsam.Values:
    """The state as ``gtsam.Values``.

    Args:
        state: the values.
        intrinsics: which parameters of each camera are unknowns; empty: none.
        n_points: so many points; None: all.
    """
    values = gtsam.Values()
    for i, matrix in enumerate(state.world_T_camera):
        values.insert(camera_key(i), gtsam.Pose3(matrix))
    for j, point in enumerate(state.points_world[:n_points]):
        values.insert(point_key(j), point)
    for k, matrix in enumerate(state.gripper_T_cameras):
        values.insert(x_key(k), gtsam.Pose3(matrix))
    values.insert(BASE_T_WORLD, gtsam.Pose3(state.base_T_world))
    values.insert(LOG_SCALE, float(state.log_scale))
    for k, unknown in enumerate(intrinsics):
        if len(unknown):
            values.insert(intrinsics_key(k), state.cameras[k].params[list(unknown)])
    return values


def matrix_of(pose: gtsam.Pose3) -> Array:
    """A pose as a 4x4 matrix whose rotation is orthonormal to rounding."""
    return frames.pose(frames.orthonormalised(pose.rotation().matrix()), pose.translation())


def moved(
    state: State,
    steps: gtsam.VectorValues,
    point_steps: Array,
    intrinsics: Sequence[Sequence[int]] = (),
) -> State:
    """The state after a step.

    Args:
        state: where the step starts.
        steps: tangents by key, of the cameras, X, Z, the scale and what else is an unknown but for the
            unknown points.
        point_steps: of the last points (p, 3), which are the unknown ones.
        intrinsics: which parameters of each camera are unknowns; empty: none.
    """
    n_cameras = len(state.gripper_T_cameras)
    n_known = len(state.points_world) - len(point_steps)
    values = to_values(state, intrinsics=intrinsics, n_points=n_known).retract(steps)
    cameras = list(state.cameras)
    for k, unknown in enumerate(intrinsics):
        if len(unknown):
            params = cameras[k].params.copy()
            params[list(unknown)] = values.atVector(intrinsics_key(k))
            cameras[k] = replace(cameras[k], params=params)
    poses = [matrix_of(values.atPose3(camera_key(i))) for i in range(len(state.world_T_camera))]
    known = [values.atPoint3(point_key(j)) for j in range(n_known)]
    return State(
        world_T_camera=np.array(poses),
        points_world=np.concatenate(
            [np.reshape(known, (-1, 3)), state.points_world[n_known:] + point_steps]
        ),
        gripper_T_cameras=np.array([matrix_of(values.atPose3(x_key(k))) for k in range(n_cameras)]),
        base_T_world=matrix_of(values.atPose3(BASE_T_WORLD)),
        log_scale=float(values.atDouble(LOG_SCALE)),
        cameras=tuple(cameras),
        rig=state.rig,
    )
