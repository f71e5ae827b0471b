"""How X predicts what it has not seen: robot poses that were kept out of it, and new images."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from handeye_fg import sfm
from handeye_fg.conventions import converted
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.graph import HeldOut, NewImages, View, of_model, predicted
from handeye_fg.inputs import Inputs, PosesSource, in_equations, read_robot_poses
from handeye_fg.io.holdout import HeldOutImage, HoldoutReport
from handeye_fg.io.images import list_images, pair_names, read_image_set
from handeye_fg.options import Options
from handeye_fg.progress import Progress
from handeye_fg.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class NewSet:
    """Images and robot poses that have no part in the calibration.

    Attributes:
        images: folder of the images.
        names: those that have a pose.
        size: of the images, pixels.
        base_T_gripper: their robot poses (n, 4, 4), metres, in the form of the equations.
    """

    images: Path
    names: tuple[str, ...]
    size: tuple[int, int]
    base_T_gripper: Array


def read_new(
    images: Path, poses: PosesSource, inputs: Inputs, options: Options, progress: Progress
) -> NewSet:
    """Read new images and their robot poses, as those of the calibration are read.

    Args:
        images: folder of the new images.
        poses: of the robot.
        inputs: of the calibration.
        options: of the calibration.
        progress: told of the reading.

    Raises:
        InputDataError: something is missing, damaged or does not fit together.
    """
    if inputs.cameras is not None and len(inputs.cameras) > 1:
        raise InputDataError(
            f"new images {images}: can be held against one camera only, but the calibration has "
            f"{len(inputs.cameras)}; calibrate one folder of images, or use --holdout"
        )
    listed = list_images(images)
    robot = read_robot_poses(poses, options, listed).poses
    if inputs.convention:
        robot = converted(robot, inputs.convention)
    names = pair_names(listed, robot.names).paired
    found = read_image_set(images, names, progress)
    usable = tuple(name for name in names if name in found.looks)
    if not usable:
        name, reason = found.unusable[0]
        raise InputDataError(
            f"new images {images}: none can be used, {name}: {reason}; give others"
        )
    robot = in_equations(robot, options.setup)
    rows = [robot.names.index(name) for name in usable]
    return NewSet(
        images=images, names=usable, size=found.size, base_T_gripper=robot.base_T_gripper[rows]
    )


def of_new_images(
    new: NewSet,
    folder: Path,
    scene: Scene,
    view: View,
    reported: Array,
    options: Options,
    progress: Progress,
) -> HoldoutReport:
    """How robot and X predict new images of the scene.

    Args:
        new: the images.
        folder: of the reconstruction.
        scene: camera poses and points, before the refinement.
        view: the refinement.
        reported: robot poses (r, 4, 4) of the calibration.
        options: of the calibration.
        progress: told of the stages.

    Raises:
        InputDataError: the calibration is of several cameras.
        ReconstructionError: no new image shows enough of the scene.
    """
    final = view.refinement
    if len(final.state.cameras) > 1:
        raise InputDataError(
            f"new images {new.images}: can be held against one camera only, but the calibration has "
            f"{len(final.state.cameras)}; calibrate one folder of images, or use --holdout"
        )
    camera = final.state.cameras[0]
    if new.size != (camera.width, camera.height):
        raise InputDataError(
            f"new images {new.images}: have {new.size[0]}x{new.size[1]} pixels, but those of the calibration have "
            f"{camera.width}x{camera.height}; take them with the same camera and settings"
        )
    n_known = 0 if scene.known is None else len(scene.known.points_world)
    unknown = final.tracks.point_index >= n_known
    tracks = replace(
        final.tracks,
        points_world=final.state.points_world,
        image_index=final.tracks.image_index[unknown],
        point_index=final.tracks.point_index[unknown],
        pixels=final.tracks.pixels[unknown],
    )
    found = sfm.find_in_scene(
        folder,
        new.images,
        new.names,
        replace(scene.model, tracks=tracks, cameras=final.state.cameras),
        final.noise.pixel,
        options=options.sfm,
        seed=options.seed,
        progress=progress,
    )
    placed = [name for name in new.names if name in found]
    if not placed:
        raise ReconstructionError(
            f"none of the {len(new.names)} new images in {new.images} shows enough of the scene of the "
            "calibration; take them of the same scene, from where its images were taken"
        )
    counts = [len(found[name].pixels) for name in placed]
    held = predicted(
        NewImages(
            base_T_gripper=new.base_T_gripper[[new.names.index(name) for name in placed]],
            image_index=np.repeat(np.arange(len(placed)), counts),
            point_index=np.concatenate([found[name].point_index for name in placed]),
            pixels=np.concatenate([found[name].pixels for name in placed]),
        ),
        reported,
        final,
        view.beliefs,
        scene.known,
        of_model(options.priors, scene.model, final.state.rig),
        inverted=options.setup == "eye-to-hand",
    )
    return replace(report_of(held, enumerate(placed)), new_images=True)


def report_of(found: HeldOut, images: Iterable[tuple[int, str]]) -> HoldoutReport:
    """What is told of poses that X has not seen.

    Args:
        found: what was found.
        images: number of the pose and name of each image.
    """
    lengths = np.linalg.norm(found.errors.reshape(-1, 2, 3), axis=2)
    place = {pose: k for k, pose in enumerate(found.poses.tolist())}
    rotation, translation = np.sqrt(np.mean(lengths**2, axis=0)).tolist()
    return HoldoutReport(
        images=tuple(
            HeldOutImage(
                name=name,
                rotation=float(lengths[place[pose], 0]),
                translation=float(lengths[place[pose], 1]),
                reprojection_rms=_known(found.reprojection_rms[pose]),
                expected_reprojection=_known(found.expected_reprojection[pose]),
            )
            for pose, name in images
            if pose in place
        ),
        rotation=rotation,
        translation=translation,
        expected_rotation=float(found.expected[0]),
        expected_translation=float(found.expected[1]),
        normalised=found.normalised,
        probability=found.probability,
        within=_known(found.within),
    )


def _known(value: float | np.floating[Any]) -> float | None:
    """A figure, or None where there is none."""
    return float(value) if np.isfinite(value) else None
