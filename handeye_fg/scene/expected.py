"""Where the robot says that cameras were; entry point ``all_cameras``.

A reconstruction of some of the images gives X and the scale in closed form; with them, the robot's poses
say where in the reconstruction's world all other cameras were, to some pixels.
"""

import numpy as np

from handeye_fg import frames
from handeye_fg.errors import HandEyeError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array
from handeye_fg.inputs import Inputs
from handeye_fg.known import in_world_units
from handeye_fg.options import Options
from handeye_fg.solvers.rig import rig_start
from handeye_fg.types import SfmModel, folder_of

# A linear start of so many images whose residuals (radians; part of the cameras' extent) are no larger
# places further cameras to some pixels.
_FEWEST_IMAGES = 5
_SURE_ROTATION, _SURE_TRANSLATION = np.deg2rad(1.0), 0.02


def all_cameras(model: SfmModel, inputs: Inputs, options: Options) -> Array | None:
    """Where the cameras of all images were.

    Args:
        model: of some of the images.
        inputs: with the robot's poses.
        options: with what is known beforehand.

    Returns:
        Camera poses (n, 4, 4) in the model's world, its own where it has the image; None where robot and
        model do not agree well, or the model has no image of some camera.
    """
    names = inputs.names
    of_folder = dict(zip(map(folder_of, model.names), model.image_camera.tolist(), strict=True))
    if any(folder_of(name) not in of_folder for name in names):
        return None
    try:
        rig, reported = inputs.arm(model)
        priors = in_world_units(options.priors, model.names, model.world_T_camera)
        linear = rig_start(reported, model.world_T_camera, rig, priors=priors)
    except HandEyeError:
        return None
    Z, scale = linear.base_T_world, linear.metres_per_world_unit
    if Z is None or not _sure(linear, model):
        return None
    X = linear.gripper_T_camera @ np.asarray(linear.first_T_cameras)
    base_T_camera = inputs.robot_poses(names) @ X[[of_folder[folder_of(name)] for name in names]]
    placed = frames.scaled(frames.inverse(Z) @ base_T_camera, 1.0 / scale)
    placed[[names.index(name) for name in model.names]] = model.world_T_camera
    return placed


def _sure(linear: LinearStart, model: SfmModel) -> bool:
    """Whether a linear start can say where further cameras were.

    What the motions leave undetermined of X does not matter as long as the others are of the same kind.
    """
    centres = linear.metres_per_world_unit * model.world_T_camera[:, :3, 3]
    extent = float(np.sqrt(np.sum(np.var(centres, axis=0))))
    return (
        len(model.names) >= _FEWEST_IMAGES
        and linear.residual_rotation < _SURE_ROTATION
        and linear.residual_translation < _SURE_TRANSLATION * extent
    )
