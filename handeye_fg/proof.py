"""How X predicts what it has not seen: robot poses that were kept out of it, and new images."""

from collections.abc import Iterable, Mapping, Sequence
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
from handeye_fg.io.fields import shown
from handeye_fg.io.holdout import HeldOutImage, HoldoutReport
from handeye_fg.io.images import list_cameras, pair_names, pose_name, read_image_set
from handeye_fg.options import Options
from handeye_fg.progress import Progress
from handeye_fg.scene import Scene
from handeye_fg.types import Indices, Rig, folder_of, folders_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NewSet:
    """Images and robot poses that have no part in the calibration.

    Attributes:
        images: folder of the images.
        names: those that have a pose; of several cameras with their folders.
        sizes: of the images in each folder, pixels.
        base_T_gripper: robot poses (r, 4, 4), metres, in the form of the equations.
        pose: which of them an image was taken at (n,).
    """

    images: Path
    names: tuple[str, ...]
    sizes: Mapping[str, tuple[int, int]]
    base_T_gripper: Array
    pose: Indices


def read_new(
    images: Path, poses: PosesSource, inputs: Inputs, options: Options, progress: Progress
) -> NewSet:
    """Read new images and their robot poses, as those of the calibration are read.

    Args:
        images: folder of the new images; of several cameras with a sub-folder for each.
        poses: of the robot.
        inputs: of the calibration.
        options: of the calibration.
        progress: told of the reading.

    Raises:
        InputDataError: something is missing, damaged or does not fit together.
    """
    listed = list_cameras(images)
    robot = read_robot_poses(poses, options, listed).poses
    if inputs.convention:
        robot = converted(robot, inputs.convention)
    names = pair_names(listed, robot.names).paired
    _numbers(images, names, {folder: k for k, folder in enumerate(folders_of(inputs.names))})
    sizes: dict[str, tuple[int, int]] = {}
    usable: list[str] = []
    unusable: list[tuple[str, str]] = []
    for folder in folders_of(names):
        found = read_image_set(images, [n for n in names if folder_of(n) == folder], progress)
        sizes[folder] = found.size
        usable += found.looks
        unusable += found.unusable
    if not usable:
        name, reason = unusable[0]
        raise InputDataError(
            f"new images {images}: none can be used, {name}: {reason}; give others"
        )
    robot = in_equations(robot, options.setup)
    index = {name: i for i, name in enumerate(robot.names)}
    rows = [index[pose_name(name, index) or name] for name in usable]
    return NewSet(
        images=images,
        names=tuple(usable),
        sizes=sizes,
        base_T_gripper=robot.base_T_gripper,
        pose=np.array(rows),
    )


def _numbers(images: Path, names: Sequence[str], cameras: Mapping[str, int]) -> list[int]:
    """Which camera took each of some new images: the one with the name of its folder, or the only one.

    Args:
        images: folder of the new images.
        names: of these.
        cameras: number of the camera for each folder of the calibration's images.

    Raises:
        InputDataError: a folder has the name of no camera.
    """
    if len(set(cameras.values())) == 1:
        return [next(iter(cameras.values()))] * len(names)
    if strange := [folder for folder in folders_of(names) if folder not in cameras]:
        where = (
            "some lie in no sub-folder"
            if strange[0] == "."
            else f"sub-folder {shown(strange[0])} is no camera's"
        )
        raise InputDataError(
            f"new images {images}: {where}, but the calibration has the cameras {', '.join(cameras)}; give each of "
            "these a sub-folder of its name"
        )
    return [cameras[folder_of(name)] for name in names]


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
        folder: of the reconstruction, with its database or beside it.
        scene: camera poses and points, before the refinement.
        view: the refinement.
        reported: robot poses (r, 4, 4) of the calibration.
        options: of the calibration.
        progress: told of the stages.

    Raises:
        InputDataError: the images are not of the cameras of the calibration, or the database not of its scene.
        ReconstructionError: no new image shows enough of the scene.
    """
    database = sfm.model_database(folder)
    if database is None:
        raise InputDataError(
            f"model {folder}: there is no database.db in or above its folder, but the features of its images are "
            "needed to find its points in new images; keep COLMAP's database with the model, or calibrate from the "
            "images"
        )
    final, model = view.refinement, scene.model
    of_folder = {
        folder_of(name): k for name, k in zip(model.names, model.image_camera.tolist(), strict=True)
    }
    numbers = _numbers(new.images, new.names, of_folder)
    for name, k in zip(new.names, numbers, strict=True):
        camera, size = final.state.cameras[k], new.sizes[folder_of(name)]
        if size != (camera.width, camera.height):
            raise InputDataError(
                f"new images {new.images / folder_of(name)}: have {size[0]}x{size[1]} pixels, but those of the "
                f"calibration have {camera.width}x{camera.height}; take them with the same camera and settings"
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
        database,
        new.images,
        new.names,
        numbers,
        replace(model, tracks=tracks, cameras=final.state.cameras),
        final.noise.pixel,
        options=options.sfm,
        seed=options.seed,
        progress=progress,
    )
    placed = [i for i, name in enumerate(new.names) if name in found]
    if not placed:
        raise ReconstructionError(
            f"none of the {len(new.names)} new images in {new.images} shows enough of the scene of the "
            "calibration; take them of the same scene, from where its images were taken"
        )
    views = [found[new.names[i]] for i in placed]
    poses, pose = np.unique(new.pose[placed], return_inverse=True)
    held = predicted(
        NewImages(
            base_T_gripper=new.base_T_gripper[poses],
            rig=Rig(
                n_cameras=len(final.state.cameras),
                camera=np.array(numbers)[placed],
                pose=pose,
            ),
            image_index=np.repeat(np.arange(len(placed)), [len(one.pixels) for one in views]),
            point_index=np.concatenate([one.point_index for one in views]),
            pixels=np.concatenate([one.pixels for one in views]),
        ),
        reported,
        final,
        view.beliefs,
        scene.known,
        of_model(options.priors, model, final.state.rig),
        inverted=options.setup == "eye-to-hand",
    )
    names = [new.names[i] for i in placed]
    return replace(report_of(held, zip(pose.tolist(), names, strict=True)), new_images=True)


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
