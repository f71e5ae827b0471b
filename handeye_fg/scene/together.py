"""Whether the cameras on an arm stand in one world, before anything is refined; ``require_one_world``."""

import numpy as np

from handeye_fg import frames
from handeye_fg.errors import ConvergenceError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array
from handeye_fg.solvers.residuals import differences
from handeye_fg.types import Rig, SfmModel, folder_of

# No camera whose images stand rightly beside the others' is off by more: radians, part of the extent.
_FAR_ROTATION, _FAR_TRANSLATION = np.deg2rad(10.0), 0.2


def require_one_world(
    model: SfmModel, base_T_gripper: Array, rig: Rig, linear: LinearStart
) -> None:
    """Refuse several cameras that no poses on the arm bring together.

    Args:
        model: the reconstruction.
        base_T_gripper: reported robot poses (r, 4, 4), metres, in the order of the rig.
        rig: which camera took an image, and at which robot pose.
        linear: the linear start of all cameras.

    Raises:
        ConvergenceError: the model has most images of a camera far from where robot and linear start do.
    """
    if rig.n_cameras == 1:
        return
    X = linear.gripper_T_camera @ np.asarray(linear.first_T_cameras)
    seen = frames.scaled(model.world_T_camera, linear.metres_per_world_unit)
    angle, distance = differences(
        base_T_gripper[rig.pose] @ X[rig.camera], np.asarray(linear.base_T_world) @ seen
    )
    extent = np.sqrt(np.sum(np.var(seen[:, :3, 3], axis=0)))
    for k in range(rig.n_cameras):
        own = rig.camera == k
        degrees, metres = np.rad2deg(np.median(angle[own])), np.median(distance[own])
        if degrees > np.rad2deg(_FAR_ROTATION) or metres > _FAR_TRANSLATION * extent:
            name = folder_of(model.names[int(np.argmax(own))])
            raise ConvergenceError(
                f"camera {name}: the images put it {degrees:.0f} deg and {1e3 * metres:.0f} mm from where any "
                "one place on the gripper would; things that only look alike may link its images to those of "
                "the other cameras, or its rows of robot poses are wrong; mask what looks alike, or calibrate "
                "the cameras one by one"
            )
