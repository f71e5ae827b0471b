"""Where the images were taken: from structure from motion, from a known target, or from both."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from handeye_fg import sfm
from handeye_fg.errors import ReconstructionError
from handeye_fg.inputs import Inputs
from handeye_fg.intrinsics import covers_image
from handeye_fg.looks import flaws
from handeye_fg.options import Options
from handeye_fg.parts import only
from handeye_fg.patterns import Detections, Target
from handeye_fg.progress import Progress
from handeye_fg.scene.claims import agreed
from handeye_fg.scene.expected import all_cameras
from handeye_fg.scene.joining import elsewhere, few_points, joined
from handeye_fg.targets import BoardPoses, find_target, on_target, place_on_board
from handeye_fg.types import CameraModel, KnownPoints, SfmModel

_FEWEST_IMAGES = 3
_FOREIGN = (
    "its matches put it elsewhere than the robot does: it shows something else or too "
    "little, or its robot pose is wrong"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Camera poses and points.

    Attributes:
        model: in units and a frame of its own; with a target in that frame, in metres.
        board: what the images show of the target; None without target.
        known: the target's corners, the first points of the model; None without target.
        kind: of the target; "" without target.
    """

    model: SfmModel
    board: BoardPoses | None = None
    known: KnownPoints | None = None
    kind: str = ""


def find_scene(
    inputs: Inputs, folder: Path, options: Options, progress: Progress
) -> tuple[Scene, Inputs]:
    """Place the images, and hold the robot poses against them before they are used.

    With a target the target alone suffices, where the intrinsics are given: then structure from
    motion may fail.

    Args:
        inputs: the checked inputs.
        folder: where the reconstruction is kept.
        options: of the calibration.
        progress: told of every stage.

    Returns:
        The scene, and the inputs, their poses converted if that was asked for.

    Raises:
        InputDataError: the poses follow another convention than they are said to.
        ReconstructionError: too few images can be placed, or no image shows the target.
        ConvergenceError: robot and camera contradict each other.
    """
    target = inputs.target
    if target is None:
        model, inputs = _agreed_and_joined(inputs, folder, options, progress)
        return Scene(model=model), inputs
    # The target first: whether the images show it is known in seconds.
    corners = find_target(inputs.images, inputs.names, target.pattern, progress)
    try:
        model, inputs = _agreed_and_joined(inputs, folder, options, progress)
    except ReconstructionError as error:
        if inputs.camera is None:
            raise ReconstructionError(
                f"{error}; or give the camera file: with known intrinsics the target alone suffices"
            ) from error
        scene = _with_target(inputs, target, corners, inputs.camera, None)
        return scene, agreed(scene.model, inputs, options, scale_known=True)
    given = inputs.camera if inputs.camera is not None and covers_image(inputs.camera) else None
    return _with_target(inputs, target, corners, given or model.camera, model), inputs


def _with_target(
    inputs: Inputs,
    target: Target,
    corners: Detections,
    camera: CameraModel,
    model: SfmModel | None,
) -> Scene:
    """The scene in the target's frame."""
    board = place_on_board(corners, camera, target, inputs.robot_poses(corners.names))
    joined, known = on_target(model, board, target, camera)
    if len(joined.names) < _FEWEST_IMAGES:
        raise ReconstructionError(
            f"the target gives poses to only {len(joined.names)} of {len(inputs.names)} images, but at "
            f"least {_FEWEST_IMAGES} are needed; take more images that show it whole and sharp"
        )
    return Scene(model=joined, board=board, known=known, kind=target.pattern.kind)


def reconstructed(inputs: Inputs, folder: Path, options: Options, progress: Progress) -> SfmModel:
    """Camera poses and points as structure from motion gives them.

    Raises:
        ReconstructionError: too few images can be placed.
    """
    return sfm.reconstruct(
        inputs.images,
        inputs.names,
        inputs.cameras,
        masks=inputs.masks,
        folder=folder,
        options=options.sfm,
        seed=options.seed,
        progress=progress,
        turns=inputs.turns(inputs.names, options.setup),
        guide=sfm.RobotGuide(
            base_T_gripper=inputs.robot_poses(inputs.names),
            place=lambda models: all_cameras(models, inputs, options),
        ),
    )


def _agreed_and_joined(
    inputs: Inputs, folder: Path, options: Options, progress: Progress
) -> tuple[SfmModel, Inputs]:
    model = reconstructed(inputs, folder, options, progress)
    inputs = agreed(model, inputs, options)
    return _judged(joined(model, inputs, folder), inputs), inputs


def _judged(model: SfmModel, inputs: Inputs) -> SfmModel:
    """The model without images that hang on few points, and look or move as none of the others.

    An image that structure from motion can use well stays, whatever it looks like: its robot pose may be
    wrong. What an image without pose looks like is told as its reason.
    """
    flawed = flaws(inputs.looks)
    points = np.bincount(model.tracks.image_index, minlength=len(model.names))
    suspect, far = few_points(model).tolist(), elsewhere(model, inputs).tolist()
    weak = {
        name: f"{flawed.get(name, _FOREIGN)}; only {points[i]} points hold it"
        for i, name in enumerate(model.names)
        if suspect[i] and (name in flawed or far[i])
    }
    if len(model.names) - len(weak) < _FEWEST_IMAGES:
        weak = {}
    unregistered = tuple(
        (name, f"{flawed[name]}; {reason}" if name in flawed else reason)
        for name, reason in model.unregistered
    )
    kept = only(model, [name for name in model.names if name not in weak])
    return replace(kept, unregistered=(*unregistered, *weak.items()))
