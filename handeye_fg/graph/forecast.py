"""What a refinement would report of certain images and robot poses; entry point ``forecast``.

The covariance depends on where the cameras and points are, on which of them see each other and on the
noise levels, but not on the errors themselves, so that it is known before any image is taken.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.cameras import free_intrinsics, kept_intrinsics
from handeye_fg.graph.determined import determined
from handeye_fg.graph.known import Known
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.noise import solve
from handeye_fg.graph.problem import make_problem
from handeye_fg.graph.reprojection import reprojection_errors
from handeye_fg.graph.rig import first_camera_poses, is_plain
from handeye_fg.graph.threads import one_blas_thread
from handeye_fg.graph.variables import State
from handeye_fg.observability import Observability, analyse
from handeye_fg.options import NoiseOptions
from handeye_fg.types import CameraModel, Indices, Rig, Tracks


@one_blas_thread()
def forecast(
    scene_T_camera: Array,
    rig: Rig,
    points: Array,
    image_index: Indices,
    point_index: Indices,
    sigma_scale: Array,
    gripper_T_cameras: Array,
    cameras: Sequence[CameraModel],
    noise: NoiseLevels,
    options: NoiseOptions,
    *,
    trusted: NDArray[np.bool_] | None = None,
    refine_intrinsics: Sequence[bool] = (),
    priors: Sequence[Known] = (),
    frame: str = "gripper",
    inverted: bool = False,
) -> tuple[Observability, ...]:
    """For each camera the covariance of X, and what would be free, if these images were taken.

    Args:
        scene_T_camera: camera of each image (n, 4, 4) in the frame in which the scene stands still (the
            base; for static cameras the gripper), metres.
        rig: which camera takes an image, and at which robot pose.
        points: positions (p, 3) there.
        image_index: of each observation the index (m,) of its image.
        point_index: that of its point (m,).
        sigma_scale: relative standard deviations (m,) of these observations.
        gripper_T_cameras: X of each camera, or base_T_camera of static ones (k, 4, 4), metres.
        cameras: the intrinsics of each.
        noise: the levels.
        options: those that are known and need not be estimated.
        trusted: (r,) which of the robot poses are used; None: all.
        refine_intrinsics: of which cameras the intrinsics are unknowns; empty: of none.
        priors: what else is known beforehand.
        frame: parent frame of X, for the words on free directions.
        inverted: the cameras are static.
    """
    state = State(
        world_T_camera=scene_T_camera,
        points_world=points,
        gripper_T_cameras=gripper_T_cameras,
        base_T_world=np.eye(4),
        log_scale=0.0,
        cameras=tuple(cameras),
        rig=rig,
    )
    if not is_plain(rig):
        state = first_camera_poses(state, scene_T_camera)
    tracks = Tracks(
        points_world=points,
        image_index=image_index,
        point_index=point_index,
        pixels=np.zeros((len(image_index), 2)),
    )
    tracks = replace(tracks, pixels=reprojection_errors(state, tracks))  # exact: no step is left
    kept = Kept(state=state, tracks=tracks, sigma_scale=sigma_scale, pixel=noise.pixel, corner=1.0)
    beliefs = [
        free_intrinsics(camera) if free else kept_intrinsics(camera)
        for camera, free in zip(cameras, refine_intrinsics or [False] * len(cameras), strict=True)
    ]
    problem = make_problem(
        kept,
        state.world_T_camera @ frames.inverse(state.gripper_T_camera),
        "base",
        beliefs if any(refine_intrinsics) else (),
        None,
        priors,
        trusted,
        inverted=inverted,
    )
    linearised = problem.linearised(state)
    found = determined(state, linearised, solve(linearised, noise), options)
    return tuple(
        analyse(joint, X, frame) for joint, X in zip(found.joints, gripper_T_cameras, strict=True)
    )
