"""The linear start of several cameras on one arm; entry point ``rig_start``.

Where cameras share robot poses, structure from motion alone gives the pose of one in the other, in its
own unit. Their images then are images of one camera, and the closed form serves for all together. A
camera that is not tied to the others so is placed by the robot, in the world that they gave; the robot
poses of its images are trusted where they agree with each other.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from handeye_fg import frames
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array
from handeye_fg.known import OfXAndScale
from handeye_fg.motions import PosePairs
from handeye_fg.solvers import linear_start, trusted_rows
from handeye_fg.types import Rig


def rig_start(
    base_T_gripper: Array,
    world_T_camera: Array,
    rig: Rig,
    *,
    seed: int = 0,
    priors: Sequence[OfXAndScale] = (),
) -> LinearStart:
    """X of every camera, Z and the scale in closed form.

    Args:
        base_T_gripper: robot poses (r, 4, 4), metres.
        world_T_camera: camera poses (n, 4, 4) of all images, up to a similarity.
        rig: which camera took an image, and at which robot pose.
        seed: as for ``linear_start``.
        priors: likewise, of the first camera.

    Raises:
        InputDataError, UnobservableError: as ``linear_start``.
    """
    lead = int(np.argmax(np.bincount(rig.camera)))
    lead_T_cameras, tied = _in_lead(world_T_camera, rig, lead)
    images = np.flatnonzero(tied[rig.camera])
    # Of several images at a robot pose that of the first camera counts.
    images = images[np.argsort(rig.camera[images], kind="stable")]
    poses, first = np.unique(rig.pose[images], return_index=True)
    as_lead = world_T_camera @ frames.inverse(lead_T_cameras)[rig.camera]
    start = linear_start(
        base_T_gripper[poses],
        as_lead[images[first]],
        seed=seed,
        priors=priors if lead == 0 else (),
    )
    scale, base_T_world = start.metres_per_world_unit, np.asarray(start.base_T_world)
    X = start.gripper_T_camera @ frames.scaled(lead_T_cameras, scale)
    trusted = np.ones(len(base_T_gripper), dtype=bool)
    if start.trusted is not None:
        trusted[poses] = start.trusted
    for k in np.flatnonzero(~tied).tolist():
        seen = rig.camera == k
        base_T_camera = base_T_world @ frames.scaled(world_T_camera[seen], scale)
        robot = base_T_gripper[rig.pose[seen]]
        X[k] = typical_pose(frames.inverse(robot) @ base_T_camera)
        trusted[rig.pose[seen]] = trusted_rows(
            PosePairs(base_T_gripper=robot, world_T_camera=base_T_camera), scale_known=True
        )
    first_T_cameras = frames.inverse(X[0]) @ X
    return replace(start, gripper_T_camera=X[0], first_T_cameras=first_T_cameras, trusted=trusted)


def _in_lead(world_T_camera: Array, rig: Rig, lead: int) -> tuple[Array, NDArray[np.bool_]]:
    """Pose (k, 4, 4) of each camera in the lead, in world units, and whether (k,) images give it."""
    image = np.full((rig.n_cameras, int(rig.pose.max()) + 1), -1)
    image[rig.camera, rig.pose] = np.arange(len(rig.pose))
    taken = image >= 0
    found = np.tile(np.eye(4), (rig.n_cameras, 1, 1))
    known = np.arange(rig.n_cameras) == lead
    while True:
        shared = np.where(known, 0, (taken & taken[known].any(axis=0)).sum(axis=1))
        k = int(np.argmax(shared))
        if shared[k] == 0:
            return found, known
        others, poses = np.nonzero(taken & taken[k] & known[:, None])
        seen = (
            frames.inverse(world_T_camera[image[others, poses]]) @ world_T_camera[image[k, poses]]
        )
        found[k], known[k] = typical_pose(found[others] @ seen), True


def typical_pose(poses: Array) -> Array:
    """The median of poses (m, 4, 4) that are alike but for some: rotations about the most central one."""
    rotations = poses[:, :3, :3]
    angles = frames.rotation_angle(np.swapaxes(rotations, 1, 2)[:, None] @ rotations)
    centre = rotations[int(np.argmin(angles.sum(axis=1)))]
    vectors = Rotation.from_matrix(centre.T @ rotations).as_rotvec()
    turn = Rotation.from_rotvec(np.median(vectors, axis=0)).as_matrix()
    return frames.pose(centre @ turn, np.median(poses[:, :3, 3], axis=0))
