"""Several cameras on one arm: where each image was taken, as a function of the shared unknowns.

With the first camera at c_i (world units) at robot pose i, the k-th camera is there at::

    world_T_camera_ik = c_i T_k,    T_k = scaled(X_0^-1 X_k, e^-l)

The robot's noise at a pose is common to all images taken there. With right perturbations, and Ad the
adjoint::

    d(world_T_camera_ik) = Ad(T_k^-1) dc_i + D (dX_k - Ad(X_k^-1 X_0) dX_0) - (0, R_k' t_k) dl

where D = diag(1, 1, 1, e^-l, e^-l, e^-l) and T_k = (R_k, t_k). Points are eliminated with an unknown
for each image; the result is then carried to the shared unknowns by this linear map.
"""

from dataclasses import replace

import numpy as np
from scipy import sparse

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.graph.reduced import Layout, Quadratic
from handeye_fg.graph.variables import LOG_SCALE, State, camera_key, x_key
from handeye_fg.types import Rig


def is_plain(rig: Rig) -> bool:
    """Whether every image has an unknown pose of its own: one camera, one image at each robot pose."""
    return rig.n_cameras == 1 and np.array_equal(rig.pose, np.arange(len(rig.pose)))


def first_T_cameras(state: State) -> Array:
    """T_k of every camera (k, 4, 4), translations in world units."""
    metric = frames.inverse(state.gripper_T_camera) @ state.gripper_T_cameras
    return frames.scaled(metric, float(np.exp(-state.log_scale)))


def image_poses(state: State) -> Array:
    """world_T_camera of every image (n, 4, 4), translations in world units."""
    rig = state.rig
    if is_plain(rig):
        return state.world_T_camera
    return np.asarray(state.world_T_camera[rig.pose] @ first_T_cameras(state)[rig.camera])


def first_camera_poses(state: State, world_T_camera: Array) -> State:
    """The state with the first camera where images put it.

    At a robot pose with several images the one of the first of the cameras counts.

    Args:
        state: gives everything else.
        world_T_camera: of every image (n, 4, 4), translations in world units.
    """
    rig = state.rig
    implied = world_T_camera @ frames.inverse(first_T_cameras(state))[rig.camera]
    order = np.lexsort([rig.camera, rig.pose])
    poses, first = np.unique(rig.pose[order], return_index=True)
    if len(poses) != int(rig.pose.max()) + 1:
        raise ValueError(f"{len(poses)=} robot poses have images, but {rig.pose.max()=}")
    return replace(state, world_T_camera=implied[order[first]])


def apart(state: State, world_T_camera: Array) -> State:
    """The state with a robot pose for each image, so that every image is where it is said to be.

    Args:
        state: gives everything else.
        world_T_camera: of every image (n, 4, 4), translations in world units.
    """
    rig = replace(state.rig, pose=np.arange(len(world_T_camera)))
    return first_camera_poses(replace(state, rig=rig), world_T_camera)


def to_images(state: State, layout: Layout) -> sparse.csr_array:
    """Steps of the unknowns with a pose for each image, by steps (d,) of the shared unknowns.

    The former are ordered as the latter, with the poses of all images instead of those of the first
    camera; the others stay what they are.
    """
    rig, n_images = state.rig, len(state.rig.pose)
    blocks = np.array([_by_shared(state, k) for k in range(rig.n_cameras)])[rig.camera]
    columns = np.array(
        [
            np.concatenate(
                [layout.columns(key) for key in (camera_key(i), x_key(0), x_key(k), LOG_SCALE)]
            )
            for k, i in zip(rig.camera.tolist(), rig.pose.tolist(), strict=True)
        ]
    )
    rows = np.arange(6 * n_images).reshape(n_images, 6)
    after_poses = 6 * layout.n_poses
    others = np.arange(after_poses, layout.dim)
    moved = others - after_poses + 6 * n_images
    return sparse.csr_array(
        (
            np.append(blocks, np.ones(len(others))),
            (
                np.append(np.repeat(rows, blocks.shape[2]), moved),
                np.append(np.repeat(columns, 6, axis=0), others),
            ),
        )
    )


def _by_shared(state: State, camera: int) -> Array:
    """Derivative (6, 19) of a camera's poses by c, X_0, X_k and l; zero by X_0 and X_k if these are one."""
    T, X = first_T_cameras(state)[camera], state.gripper_T_cameras
    to_world = np.diag(np.repeat([1.0, float(np.exp(-state.log_scale))], 3))
    by_log_scale = np.concatenate([np.zeros(3), -T[:3, :3].T @ T[:3, 3]])
    return np.hstack(
        [
            frames.adjoint(frames.inverse(T)),
            -to_world @ frames.adjoint(frames.inverse(X[camera]) @ X[0]),
            to_world,
            by_log_scale[:, None],
        ]
    )


def carried(quadratic: Quadratic, to: sparse.csr_array) -> Quadratic:
    """A cost of some unknowns as one of those of which they are a linear function."""
    half = to.T @ quadratic.hessian  # symmetric
    return Quadratic(
        hessian=np.asarray(to.T @ half.T),
        gradient=np.asarray(to.T @ quadratic.gradient),
        constant=quadratic.constant,
    )
