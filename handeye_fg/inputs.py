"""What a calibration starts from: read, checked and paired by name."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np

from handeye_fg import frames
from handeye_fg.conventions import Reading, converted, file_readings
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.cameras import read_camera, read_cameras
from handeye_fg.io.images import check_masks, list_cameras, pair_names, pose_name, read_image_set
from handeye_fg.io.poses import open_poses, poses_from_mapping
from handeye_fg.io.read_as import ReadAs
from handeye_fg.io.targets import read_target
from handeye_fg.looks import Look, copies
from handeye_fg.options import Options, Setup
from handeye_fg.parts import only
from handeye_fg.patterns import Target
from handeye_fg.progress import Progress
from handeye_fg.turns import RobotTurns
from handeye_fg.types import CameraModel, Rig, RobotPoses, SfmModel, folder_of, folders_of

PosesSource = str | Path | Mapping[str, Array] | RobotPoses
CameraSource = str | Path | CameraModel | None
TargetSource = str | Path | Target | None

_NOT_IN_MODEL = "the model has no such image"
_FEWEST_IMAGES = 3  # two motions, the least that determine X
# An arm that stands still reports poses nearer than this.
_SAME_POSE_DEG, _SAME_POSE_MM = 1.0, 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GivenPoses:
    """Robot poses as they were given.

    Attributes:
        poses: base_T_gripper.
        readings: other readings of their file.
        read_as: how the file was read; None: they came as arrays.
    """

    poses: RobotPoses
    readings: tuple[Reading, ...] = ()
    read_as: ReadAs | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Inputs:
    """Checked inputs.

    Attributes:
        images: folder of the images.
        names: names with an image and a pose.
        left_out: (name, reason) of the images without pose and the poses without image.
        unusable: (name, reason) of the images that have a pose and yet cannot be used.
        looks: how the images look, by name.
        readings: other readings of the poses' file.
        read_as: how that file was read; None: the poses came as arrays.
        convention: by which the poses were converted although nobody asked; "" for none.
        convention_note: what is to be told of the poses' convention; "" for nothing.
        poses: reported poses of all names; of base_T_gripper, or its inverse for eye-to-hand.
        cameras: given intrinsics for each folder of images ("." for none), or None.
        masks: folder of the masks, or None.
        target: known target that images show, or None.
        digest: SHA-256 of everything that was read.
    """

    images: Path
    names: tuple[str, ...]
    left_out: tuple[tuple[str, str], ...]
    poses: RobotPoses
    cameras: Mapping[str, CameraModel] | None
    masks: Path | None
    digest: str
    target: Target | None = None
    unusable: tuple[tuple[str, str], ...] = ()
    looks: Mapping[str, Look] = field(default_factory=dict)
    readings: tuple[Reading, ...] = ()
    read_as: ReadAs | None = None
    convention: str = ""
    convention_note: str = ""

    @property
    def camera(self) -> CameraModel | None:
        """Given intrinsics of the first camera, or None."""
        return None if self.cameras is None else self.cameras[min(self.cameras)]

    def turns(self, names: Sequence[str], setup: Setup) -> RobotTurns:
        """How the robot turned from one named image to the next."""
        return RobotTurns(rotations=self.robot_poses(names)[:, :3, :3], setup=setup)

    def robot_poses(self, names: Sequence[str]) -> Array:
        """Poses (n, 4, 4) of the named images, in that order."""
        return self.poses.base_T_gripper[self.rows(names)]

    def as_read(self, setup: Setup) -> RobotPoses:
        """The poses base_T_gripper, whatever the setup."""
        return in_equations(self.poses, setup)

    def with_poses(self, base_T_gripper: RobotPoses, setup: Setup) -> "Inputs":
        """The same with other poses base_T_gripper."""
        return replace(self, poses=in_equations(base_T_gripper, setup))

    def arm(self, model: SfmModel) -> tuple[Rig, Array]:
        """Which camera took an image of the model, and where; the robot poses (r, 4, 4) in that order.

        Raises:
            InputDataError: two images of one camera have the same robot pose.
        """
        rows, pose = np.unique(self.rows(model.names), return_inverse=True)
        taken: dict[tuple[int, int], str] = {}
        for name, *place in zip(
            model.names, model.image_camera.tolist(), pose.tolist(), strict=True
        ):
            other = taken.setdefault(tuple(place), name)
            if other != name:
                raise InputDataError(
                    f"images {other} and {name} are of one camera and have the robot pose of "
                    f"{self.poses.names[rows[place[1]]]}; give each image a pose of its own, under its "
                    "name with the folder"
                )
        rig = Rig(n_cameras=len(model.cameras), camera=model.image_camera, pose=pose)
        return rig, self.poses.base_T_gripper[rows]

    def given(self, model: SfmModel) -> tuple[CameraModel, ...] | None:
        """Given intrinsics of the model's cameras, or None."""
        if self.cameras is None:
            return None
        _, first = np.unique(model.image_camera, return_index=True)
        return tuple(self.cameras[folder_of(model.names[i])] for i in first)

    def rows(self, names: Sequence[str]) -> list[int]:
        """Where the poses of the named images stand."""
        index = {name: i for i, name in enumerate(self.poses.names)}
        return [index[pose_name(name, index) or name] for name in names]


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
    listed = list_cameras(images)
    given = read_robot_poses(poses, options, listed)
    robot = in_equations(given.poses, options.setup)
    pattern = read_target(Path(target)) if isinstance(target, str | Path) else target
    pairing = pair_names(listed, robot.names)
    names = pairing.paired
    _require_enough(images, names, robot)
    folders = folders_of(names)
    if pattern is not None and len(folders) > 1:
        raise InputDataError(
            f"a target was given, but {images} has the folders {', '.join(folders)}: a target serves one "
            "camera; leave the target out, or calibrate one folder after the other"
        )
    cameras = _cameras(camera, folders)
    mask_folder = None if masks is None else Path(masks)
    looks: dict[str, Look] = {}
    unusable: dict[str, str] = {}
    for folder in folders:
        inside = [name for name in names if folder_of(name) == folder]
        found = read_image_set(images, inside, progress)
        size = found.size
        if cameras is not None and (cameras[folder].width, cameras[folder].height) != size:
            raise InputDataError(
                f"the camera file is for images of {cameras[folder].width}x{cameras[folder].height} "
                f"pixels, but those in {images / folder} have {size[0]}x{size[1]}; give the file of "
                "this resolution"
            )
        unusable |= dict(found.unusable) | _copies(found.looks, robot)
        usable = [name for name in inside if name not in unusable]
        looks |= {name: found.looks[name] for name in usable}
        if mask_folder is not None:
            check_masks(mask_folder, usable, size)
    names = tuple(name for name in names if name in looks)
    _require_enough(images, names, robot, unusable)
    left_out = [(name, "no pose has this name") for name in pairing.images_without_pose]
    left_out += [(name, "no image has this name") for name in pairing.poses_without_image]
    files = [images / name for name in names]
    files += [] if mask_folder is None else [mask_folder / f"{name}.png" for name in names]
    return Inputs(
        images=images,
        names=names,
        left_out=tuple(left_out),
        poses=robot,
        cameras=cameras,
        masks=mask_folder,
        digest=_digest(robot, cameras, files, pattern),
        target=pattern,
        unusable=tuple(unusable.items()),
        looks=looks,
        readings=given.readings,
        read_as=given.read_as,
    )


def _require_enough(
    images: Path, names: Sequence[str], robot: RobotPoses, unusable: Mapping[str, str] | None = None
) -> None:
    """Refuse too few images.

    Raises:
        InputDataError: fewer than three poses have an image that can be used.
    """
    n_poses = len({pose_name(name, set(robot.names)) for name in names})
    if n_poses >= _FEWEST_IMAGES:
        return
    without = "".join(f"; {name}: {reason}" for name, reason in islice((unusable or {}).items(), 3))
    raise InputDataError(
        f"only {n_poses} {'usable ' if unusable else ''}images of {images} have a pose, but at least "
        f"{_FEWEST_IMAGES} are needed, and 10 or more are advisable; add images with poses{without}"
    )


def _copies(looks: Mapping[str, Look], robot: RobotPoses) -> dict[str, str]:
    """Why images are left out that show what another one shows, by name.

    An image that is repeated to the last grey level is one measurement, not two. Two that differ in noise
    only are two, if the robot stood still.
    """
    pose = dict(zip(robot.names, robot.base_T_gripper, strict=True))
    index = {name: pose[pose_name(name, pose) or name] for name in looks}
    reasons = {}
    for name, (first, identical) in copies(looks).items():
        moved = frames.inverse(index[first]) @ index[name]
        degrees = np.rad2deg(frames.rotation_angle(moved[:3, :3]))
        millimetres = 1e3 * np.linalg.norm(moved[:3, 3])
        if degrees > _SAME_POSE_DEG or millimetres > _SAME_POSE_MM:
            reasons[name] = (
                f"it shows the same as {first} although the robot had moved by {millimetres:.0f} mm and "
                f"{degrees:.0f} deg: the image or the pose of one of them is wrong"
            )
        elif identical:
            reasons[name] = f"it is the same image as {first}"
    return reasons


def read_model_inputs(
    model: SfmModel, poses: PosesSource, options: Options, images: Sequence[str] | None = None
) -> tuple[Inputs, SfmModel]:
    """Check the poses for an existing model; the model comes back with the paired images only.

    Args:
        model: the reconstruction.
        poses: of the robot.
        options: of the calibration.
        images: names of the images that are to be used; None: all of the model.

    Raises:
        InputDataError: the poses break their format, or fewer than three belong to the model.
    """
    names, left_out = model.names, []
    if images is not None:
        listed = set(images)
        named = {name: pose_name(name, listed) for name in names}
        names = tuple(name for name in names if named[name] is not None)
        found = set(named.values())
        left_out = [(name, _NOT_IN_MODEL) for name in images if name not in found]
        if not names:
            raise InputDataError(
                f"no image has the name of one in the model: images are named like {images[0]}, those of the "
                f"model like {model.names[0]}; give the images that the model was made from"
            )
    given = read_robot_poses(poses, options, names)
    robot = in_equations(given.poses, options.setup)
    pairing = pair_names(names, robot.names)
    if len(pairing.paired) < _FEWEST_IMAGES:
        raise InputDataError(
            f"only {len(pairing.paired)} images of the model have a pose, but at least "
            f"{_FEWEST_IMAGES} are needed; add poses under the model's image names"
        )
    left_out += [(name, "no pose has this name") for name in pairing.images_without_pose]
    known = {name for name, _ in left_out}
    left_out += [(name, _NOT_IN_MODEL) for name in pairing.poses_without_image if name not in known]
    cameras = {
        folder_of(name): model.cameras[k]
        for name, k in zip(model.names, model.image_camera.tolist(), strict=True)
    }
    inputs = Inputs(
        images=Path(),
        names=pairing.paired,
        left_out=tuple(left_out),
        poses=robot,
        cameras=cameras,
        masks=None,
        digest=_digest(robot, cameras, []),
        readings=given.readings,
        read_as=given.read_as,
    )
    return inputs, only(model, pairing.paired)


def read_robot_poses(
    poses: PosesSource, options: Options, images: Sequence[str] | None
) -> GivenPoses:
    """The poses base_T_gripper as they are given, or as ``options.poses.convention`` has them.

    Args:
        poses: of the robot.
        options: say how a file is read.
        images: names of the images; None: the poses name themselves.

    Raises:
        InputDataError: the poses break their format.
    """
    if isinstance(poses, str | Path):
        file = open_poses(poses, options.poses, images)
        given = GivenPoses(poses=file.poses(), readings=file_readings(file), read_as=file.read_as)
    else:
        known = poses if isinstance(poses, RobotPoses) else poses_from_mapping(poses)
        given = GivenPoses(poses=known)
    if options.poses.convention:
        taken = converted(given.poses, options.poses.convention)
        return replace(given, poses=taken, readings=())
    return given


def in_equations(poses: RobotPoses, setup: Setup) -> RobotPoses:
    """The poses as the equations have them: for eye-to-hand the inverses, which are their own inverses again."""
    if setup == "eye-in-hand":
        return poses
    return RobotPoses(names=poses.names, base_T_gripper=frames.inverse(poses.base_T_gripper))


def _cameras(source: CameraSource, folders: Sequence[str]) -> dict[str, CameraModel] | None:
    """The intrinsics for each folder of images: one file for all, or a folder with one for each."""
    if source is None:
        return None
    if isinstance(source, CameraModel):
        return dict.fromkeys(folders, source)
    path = Path(source)
    if len(folders) == 1:
        return {folders[0]: read_camera(path)}
    if path.is_dir():
        return {folder: read_camera(_camera_file(path, folder)) for folder in folders}
    cameras = read_cameras(path)
    if len(cameras) == 1:
        return dict.fromkeys(folders, *cameras.values())
    if missing := [folder for folder in folders if folder not in cameras]:
        raise InputDataError(
            f"camera file {path}: has the cameras {', '.join(cameras)}, but the images lie in the folders "
            f"{', '.join(folders)}, so that {', '.join(missing)} has none; name the folders as the cameras"
        )
    return {folder: cameras[folder] for folder in folders}


def _camera_file(folder: Path, name: str) -> Path:
    """The file of one of several cameras, of whatever kind."""
    found = sorted(
        folder / f"{name}{suffix}"
        for suffix in (".yaml", ".yml", ".json", ".txt")
        if (folder / f"{name}{suffix}").is_file()
    )
    if len(found) > 1:
        raise InputDataError(
            f"camera files {' and '.join(map(str, found))}: are of one camera; keep one of them"
        )
    return found[0] if found else folder / f"{name}.yaml"


def _digest(
    robot: RobotPoses,
    cameras: Mapping[str, CameraModel] | None,
    files: Sequence[Path],
    target: Target | None = None,
) -> str:
    """SHA-256 over poses, intrinsics, target and files; the same for the same content."""
    total = hashlib.sha256()
    for name, matrix in sorted(zip(robot.names, robot.base_T_gripper, strict=True)):
        total.update(name.encode() + matrix.tobytes())
    for camera in (cameras or {}).values():
        total.update(f"{camera.model} {camera.width} {camera.height}".encode())
        total.update(camera.params.tobytes())
    if target is not None:
        total.update(repr(target).encode())
    for path in files:
        total.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()
