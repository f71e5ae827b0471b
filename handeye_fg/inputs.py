"""What a calibration starts from: read, checked and paired by name."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.cameras import read_camera
from handeye_fg.io.images import check_masks, list_images, pair_names, read_image_set
from handeye_fg.io.poses import poses_from_mapping, read_poses
from handeye_fg.io.targets import read_target
from handeye_fg.options import Options
from handeye_fg.patterns import Target
from handeye_fg.progress import Progress
from handeye_fg.types import CameraModel, RobotPoses, SfmModel, Tracks

PosesSource = str | Path | Mapping[str, Array] | RobotPoses
CameraSource = str | Path | CameraModel | None
TargetSource = str | Path | Target | None

_FEWEST_IMAGES = 3  # two motions, the least that determine X


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """Checked inputs.

    Attributes:
        images: folder of the images.
        names: names with an image and a pose.
        left_out: (name, reason) of the images without pose and the poses without image.
        poses: reported poses of all names; of base_T_gripper, or its inverse for eye-to-hand.
        camera: given intrinsics, or None.
        masks: folder of the masks, or None.
        target: known target that images show, or None.
        digest: SHA-256 of everything that was read.
    """

    images: Path
    names: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...]
    poses: RobotPoses
    camera: CameraModel | None
    masks: Path | None
    digest: str
    target: Target | None = None

    def robot_poses(self, names: Sequence[str]) -> Array:
        """Poses (n, 4, 4) of the named images, in that order."""
        index = {name: i for i, name in enumerate(self.poses.names)}
        return self.poses.base_T_gripper[[index[name] for name in names]]


def read_inputs(
    images: Path,
    poses: PosesSource,
    camera: CameraSource,
    masks: str | Path | None,
    options: Options,
    progress: Progress,
    target: TargetSource = None,
) -> Inputs:
    """Read and check all inputs of ``calibrate``.

    Raises:
        InputDataError: something is missing, damaged or does not fit together.
    """
    robot = _robot_poses(poses, options)
    intrinsics = read_camera(Path(camera)) if isinstance(camera, str | Path) else camera
    pattern = read_target(Path(target)) if isinstance(target, str | Path) else target
    pairing = pair_names(list_images(images), robot.names)
    names = pairing.paired
    if len(names) < _FEWEST_IMAGES:
        raise InputDataError(
            f"only {len(names)} images of {images} have a pose, but at least {_FEWEST_IMAGES} are "
            "needed, and 10 or more are advisable; add images with poses"
        )
    size = read_image_set(images, names, progress)
    if intrinsics is not None and (intrinsics.width, intrinsics.height) != size:
        raise InputDataError(
            f"the camera file is for images of {intrinsics.width}x{intrinsics.height} pixels, but "
            f"those in {images} have {size[0]}x{size[1]}; give the file of this resolution"
        )
    mask_folder = None if masks is None else Path(masks)
    if mask_folder is not None:
        check_masks(mask_folder, names, size)
    left_out = [(name, "no pose has this name") for name in pairing.images_without_pose]
    left_out += [(name, "no image has this name") for name in pairing.poses_without_image]
    files = [images / name for name in names]
    files += [] if mask_folder is None else [mask_folder / f"{name}.png" for name in names]
    return Inputs(
        images=images,
        names=names,
        left_out=tuple(left_out),
        poses=robot,
        camera=intrinsics,
        masks=mask_folder,
        digest=_digest(robot, intrinsics, files, pattern),
        target=pattern,
    )


def read_model_inputs(
    model: SfmModel, poses: PosesSource, options: Options
) -> tuple[Inputs, SfmModel]:
    """Check the poses for an existing model; the model comes back with the paired images only.

    Raises:
        InputDataError: the poses break their format, or fewer than three belong to the model.
    """
    robot = _robot_poses(poses, options)
    pairing = pair_names(model.names, robot.names)
    if len(pairing.paired) < _FEWEST_IMAGES:
        raise InputDataError(
            f"only {len(pairing.paired)} images of the model have a pose, but at least "
            f"{_FEWEST_IMAGES} are needed; add poses under the model's image names"
        )
    left_out = [(name, "no pose has this name") for name in pairing.images_without_pose]
    left_out += [(name, "the model has no such image") for name in pairing.poses_without_image]
    inputs = Inputs(
        images=Path(),
        names=pairing.paired,
        left_out=tuple(left_out),
        poses=robot,
        camera=model.camera,
        masks=None,
        digest=_digest(robot, model.camera, []),
    )
    return inputs, _only(model, pairing.paired)


def _robot_poses(poses: PosesSource, options: Options) -> RobotPoses:
    """The poses in the form of the equations: for eye-to-hand their inverses."""
    if isinstance(poses, str | Path):
        poses = read_poses(Path(poses))
    elif not isinstance(poses, RobotPoses):
        poses = poses_from_mapping(poses)
    if options.setup == "eye-in-hand":
        return poses
    return RobotPoses(names=poses.names, base_T_gripper=frames.inverse(poses.base_T_gripper))


def _only(model: SfmModel, names: Sequence[str]) -> SfmModel:
    """The model without the images that are not named."""
    rows = np.array([model.names.index(name) for name in names])
    new_index = np.full(len(model.names), -1)
    new_index[rows] = np.arange(len(rows))
    tracks = model.tracks
    kept = new_index[tracks.image_index] >= 0
    return SfmModel(
        names=tuple(names),
        world_T_camera=model.world_T_camera[rows],
        camera=model.camera,
        tracks=Tracks(
            points_world=tracks.points_world,
            image_index=new_index[tracks.image_index[kept]],
            point_index=tracks.point_index[kept],
            pixels=tracks.pixels[kept],
        ),
        mean_reprojection_px=model.mean_reprojection_px,
        unregistered=model.unregistered,
    )


def _digest(
    robot: RobotPoses,
    camera: CameraModel | None,
    files: Sequence[Path],
    target: Target | None = None,
) -> str:
    """SHA-256 over poses, intrinsics, target and files; the same for the same content."""
    total = hashlib.sha256()
    for name, matrix in sorted(zip(robot.names, robot.base_T_gripper, strict=True)):
        total.update(name.encode() + matrix.tobytes())
    if camera is not None:
        total.update(f"{camera.model} {camera.width} {camera.height}".encode())
        total.update(camera.params.tobytes())
    if target is not None:
        total.update(repr(target).encode())
    for path in files:
        total.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()
