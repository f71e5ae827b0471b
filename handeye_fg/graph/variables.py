"""The unknowns of the factor graph: their keys, their order, and values in and out of GTSAM.

Unknowns: camera poses c_i = world_T_camera, points p_j (world units), X = gripper_T_camera,
Z = base_T_world, l = ln(metres_per_world_unit), and the intrinsics K where they are refined. The first
points may be known ones, corners of a target.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import C, K, L, P, X, Z

from handeye_fg import frames
from handeye_fg.frames import Array

GRIPPER_T_CAMERA = X(0)
BASE_T_WORLD = Z(0)
LOG_SCALE = L(0)
INTRINSICS = K(0)
CALIBRATION_DIM = 9  # tangent size of Cal3DS2: fx, fy, skew, cx, cy, k1, k2, p1, p2

camera_key = C
point_key = P


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of all unknowns.

    Attributes:
        world_T_camera: (n, 4, 4), translations in world units.
        points_world: (p, 3), world units.
        gripper_T_camera, base_T_world: X and Z, (4, 4), metres.
        log_scale: ln(metres_per_world_unit).
        opencv_params: (8,): fx, fy, cx, cy, k1, k2, p1, p2.
    """

    world_T_camera: Array
    points_world: Array
    gripper_T_camera: Array
    base_T_world: Array
    log_scale: float
    opencv_params: Array


def calibration(opencv_params: Array) -> gtsam.Cal3DS2:
    """COLMAP's OPENCV parameters (8,) as GTSAM's model, which is the same."""
    fx, fy, cx, cy, k1, k2, p1, p2 = (float(value) for value in opencv_params)
    return gtsam.Cal3DS2(fx, fy, 0.0, cx, cy, k1, k2, p1, p2)


def to_values(state: State, *, with_intrinsics: bool, n_points: int | None = None) -> gtsam.Values:
    """The state, with its first ``n_points`` points (None: all), as ``gtsam.Values``."""
    values = gtsam.Values()
    for i, matrix in enumerate(state.world_T_camera):
        values.insert(camera_key(i), gtsam.Pose3(matrix))
    for j, point in enumerate(state.points_world[:n_points]):
        values.insert(point_key(j), point)
    values.insert(GRIPPER_T_CAMERA, gtsam.Pose3(state.gripper_T_camera))
    values.insert(BASE_T_WORLD, gtsam.Pose3(state.base_T_world))
    values.insert(LOG_SCALE, float(state.log_scale))
    if with_intrinsics:
        values.insert(INTRINSICS, calibration(state.opencv_params))
    return values


def matrix_of(pose: gtsam.Pose3) -> Array:
    """A pose as a 4x4 matrix whose rotation is orthonormal to rounding."""
    return frames.pose(frames.orthonormalised(pose.rotation().matrix()), pose.translation())


def shared_keys(n_cameras: int, *, with_intrinsics: bool, n_known: int = 0) -> list[int]:
    """All keys but the unknown points', in the order of the reduced system: cameras, X, Z, l, K, known."""
    keys = [camera_key(i) for i in range(n_cameras)]
    keys += [GRIPPER_T_CAMERA, BASE_T_WORLD, LOG_SCALE]
    keys += [INTRINSICS] if with_intrinsics else []
    return [*keys, *(point_key(j) for j in range(n_known))]


def moved(state: State, steps: gtsam.VectorValues, point_steps: Array) -> State:
    """The state after a step.

    Args:
        state: where the step starts.
        steps: tangents by key, of the cameras, X, Z, the scale and what else is an unknown but for the
            unknown points; the intrinsics stay without skew.
        point_steps: of the last points (p, 3), which are the unknown ones.
    """
    with_intrinsics = steps.exists(INTRINSICS)
    n_known = len(state.points_world) - len(point_steps)
    values = to_values(state, with_intrinsics=with_intrinsics, n_points=n_known).retract(steps)
    params = state.opencv_params
    if with_intrinsics:
        params = np.delete(np.asarray(values.atCal3DS2(INTRINSICS).vector()), 2)
    cameras = [matrix_of(values.atPose3(camera_key(i))) for i in range(len(state.world_T_camera))]
    known = [values.atPoint3(point_key(j)) for j in range(n_known)]
    return State(
        world_T_camera=np.array(cameras),
        points_world=np.concatenate(
            [np.reshape(known, (-1, 3)), state.points_world[n_known:] + point_steps]
        ),
        gripper_T_camera=matrix_of(values.atPose3(GRIPPER_T_CAMERA)),
        base_T_world=matrix_of(values.atPose3(BASE_T_WORLD)),
        log_scale=float(values.atDouble(LOG_SCALE)),
        opencv_params=params,
    )
