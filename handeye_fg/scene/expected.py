"""Where the robot says that cameras were; entry point ``all_cameras``.

A reconstruction of some of the images gives X and the scale in closed form; with them, the robot's poses
say where in the reconstruction's world all other cameras were, to some pixels. Several reconstructions, of
different cameras, come together in the robot's base.
"""

from collections.abc import Sequence

import numpy as np

from handeye_fg import frames
from handeye_fg.errors import HandEyeError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array
from handeye_fg.inputs import Inputs
from handeye_fg.known import in_world_units
from handeye_fg.options import Options
from handeye_fg.parts import moved, united
from handeye_fg.solvers.rig import rig_start
from handeye_fg.types import SfmModel, folder_of

# A linear start of so many images whose residuals (radians; part of the cameras' extent) are no larger
# places further cameras to some pixels.
_FEWEST_IMAGES = 5
_SURE_ROTATION, _SURE_TRANSLATION = np.deg2rad(1.0), 0.02


def all_cameras(
    models: Sequence[SfmModel], inputs: Inputs, options: Options
) -> tuple[SfmModel, Array] | None:
    """Where the cameras of all images were.

    Args:
        models: of some of the images, each in a world of its own; no two have images of one camera.
        inputs: with the robot's poses.
        options: with what is known beforehand.

    Returns:
        The models as one in the first one's world, and camera poses (n, 4, 4) there, of the images in the
        models their own; None where robot and models do not agree well, or no model has an image of some
        camera.
    """
    X: dict[str, Array] = {}
    worlds: list[LinearStart] = []
    for model in models:
        linear = _start(model, inputs, options)
        if linear is None:
            return None
        of_cameras = linear.gripper_T_camera @ np.asarray(linear.first_T_cameras)
        cameras = model.image_camera.tolist()
        X |= {folder_of(n): of_cameras[k] for n, k in zip(model.names, cameras, strict=True)}
        worlds.append(linear)
    names = inputs.names
    if any(folder_of(name) not in X for name in names):
        return None
    Z, unit = np.asarray(worlds[0].base_T_world), worlds[0].metres_per_world_unit
    whole = models[0]
    for model, linear in zip(models[1:], worlds[1:], strict=True):
        home_T_world = frames.scaled(
            frames.inverse(Z) @ np.asarray(linear.base_T_world), 1.0 / unit
        )
        whole = united(whole, moved(model, home_T_world, linear.metres_per_world_unit / unit))
    base_T_camera = inputs.robot_poses(names) @ [X[folder_of(name)] for name in names]
    placed = frames.scaled(frames.inverse(Z) @ base_T_camera, 1.0 / unit)
    placed[[names.index(name) for name in whole.names]] = whole.world_T_camera
    return whole, placed


def _start(model: SfmModel, inputs: Inputs, options: Options) -> LinearStart | None:
    """X of a model's cameras, Z and the scale in closed form; None where they are not sure."""
    # What is known beforehand is of the first camera.
    first = folder_of(model.names[0]) == min(map(folder_of, inputs.names))
    try:
        rig, reported = inputs.arm(model)
        priors = in_world_units(options.priors, model.names, model.world_T_camera) if first else ()
        linear = rig_start(reported, model.world_T_camera, rig, priors=priors)
    except HandEyeError:
        return None
    return linear if linear.base_T_world is not None and _sure(linear, model) else None


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
