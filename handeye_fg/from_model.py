"""Calibration from an existing reconstruction instead of images: ``refine``."""

import os
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from handeye_fg import sfm
from handeye_fg.conventions import AS_GIVEN
from handeye_fg.errors import InputDataError, ReconstructionError
from handeye_fg.frames import Array
from handeye_fg.from_poses import solve
from handeye_fg.inputs import PosesSource, read_model_inputs, read_robot_poses
from handeye_fg.io.image_arrays import ImageArrays, as_folder
from handeye_fg.io.images import list_cameras
from handeye_fg.io.model_poses import TRANSFORMS, read_camera_poses
from handeye_fg.io.results import Result
from handeye_fg.options import Options, PoseFileOptions, RobotNoise
from handeye_fg.pipeline import solve_scene
from handeye_fg.progress import Progress, Stopwatch, silent
from handeye_fg.proof import of_new_images, read_new
from handeye_fg.scene import Scene, agreed
from handeye_fg.types import SfmModel, folders_of

Model = sfm.ModelSource | SfmModel | Mapping[str, Array]
"""What ``refine`` takes: a reconstruction, its folder or file, or camera poses by image name."""


def refine(
    model: Model,
    poses: PosesSource,
    options: Options | None = None,
    *,
    images: str | Path | None = None,
    holdout: tuple[str | Path | ImageArrays, PosesSource] | None = None,
    progress: Progress = silent,
) -> Result:
    """Find the pose of a camera on a robot arm from an existing reconstruction.

    A COLMAP model has the images' points, and is refined as after ``calibrate``'s own structure from motion; its
    intrinsics are taken as given. Where there are only camera poses (a model without points, nerfstudio, a
    trajectory from SLAM), X comes from pose pairs as by ``solve`` with ``pose_graph``, which finds their unit.

    Args:
        model: a ``pycolmap.Reconstruction``; the folder of a COLMAP model (.bin or .txt, of COLMAP 3 or 4), or one
            that has it in sparse/0; a transforms.json of nerfstudio or its folder; a file with a trajectory, such as
            TUM; an ``SfmModel`` of arrays; or {image name: world_T_camera (4, 4)}. Rows of a trajectory are paired by name or time, or as
            ``options.poses.pair_by`` says.
        poses: file of poses, or {image name: base_T_gripper (4, 4)} in metres.
        options: None: defaults.
        images: folder of the images: only these are used; None: all of the model.
        holdout: new images of the scene and their robot poses, which have no part in the calibration, as for
            ``calibrate``; needs the folder of a COLMAP model with its database (SIFT features).
        progress: told of every stage.

    Raises:
        HandEyeError: see its subclasses; the message says what to do.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_scene
        >>> scene = simulate_scene(np.random.default_rng(0), n_images=10, n_points=60)

        With points and observations, and with camera poses alone:

        >>> result = hf.refine(scene.model, scene.robot_poses)
        >>> bool(np.allclose(result.matrix, scene.gripper_T_camera, atol=2e-3))
        True
        >>> robot = dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper))
        >>> hf.refine(dict(zip(scene.model.names, scene.world_T_camera)), robot).status
        'ok'
    """
    options, clock = options or Options(), Stopwatch()
    names = None if images is None else list_cameras(Path(images))
    found = _found(model)
    if not isinstance(found, SfmModel):
        if holdout is not None or options.holdout > 0.0:
            raise InputDataError(
                "the model has camera poses without points, by which robot poses that X has not seen cannot be held "
                "against it; give a COLMAP model with its points, and for new images with its database"
            )
        return _from_poses(found, poses, options, names)
    inputs, paired = read_model_inputs(found, poses, options, names)
    inputs = agreed(paired, inputs, options)
    with ExitStack() as files:
        prove = None
        if holdout is not None:
            folder = files.enter_context(as_folder(holdout[0]))
            new = read_new(folder, holdout[1], inputs, options, progress)
            prove = partial(of_new_images, new, _folder(model))
        clock.lap("input")
        return solve_scene(Scene(model=paired), inputs, options, clock, progress, prove)


def _folder(model: Model) -> Path:
    """The folder of a model.

    Raises:
        InputDataError: it was given as a value.
    """
    if not isinstance(model, str | os.PathLike):
        raise InputDataError(
            "new images cannot be held against a model that was given as a value, which has no features; give the "
            "folder of the model, with its database"
        )
    return Path(model)


def _found(model: Model) -> SfmModel | Mapping[str, Array] | Path:
    """The reconstruction with its points; or camera poses, or the file that has them.

    Raises:
        InputDataError: a folder holds neither, or the model cannot be read.
        ReconstructionError: the model has fewer than three images.
    """
    if isinstance(model, SfmModel | Mapping):
        return model
    source: sfm.ModelSource = model
    if isinstance(model, str | os.PathLike) and (path := Path(model)).exists():
        folder = sfm.model_folder(path)
        if folder is None and (path.is_file() or (path / TRANSFORMS).is_file()):
            return path
        if folder is None:
            raise InputDataError(
                f"model {path}: holds no COLMAP model (cameras, images and points3D, .bin or .txt, there or in "
                f"sparse/0) and no {TRANSFORMS}; give the folder of one"
            )
        source = folder
    try:
        return sfm.read_model(source)
    except ReconstructionError:
        known = sfm.read_model_poses(source)
        if len(known) < sfm.FEWEST_IMAGES:
            raise
        return known


def _from_poses(
    model: Mapping[str, Array] | Path,
    poses: PosesSource,
    options: Options,
    images: Sequence[str] | None,
) -> Result:
    """X from pose pairs, by name.

    Raises:
        InputDataError: the images are of several cameras, or poses break their format.
    """
    if images is not None and len(folders_of(images)) > 1:
        raise InputDataError(
            "the model has camera poses without points, which serve one camera, but the images are of several; "
            "give the images of one, or a COLMAP model with its points"
        )
    given = read_robot_poses(poses, options, images)
    robot = given.poses
    wanted = robot.names if images is None else [name for name in robot.names if name in images]
    camera = (
        dict(model)
        if isinstance(model, Mapping)
        else read_camera_poses(model, wanted, options.poses.pair_by)
    )
    noise, named = options.noise, options.poses.convention.split(",")
    result = solve(
        {
            name: np.asarray(matrix)
            for name, matrix in zip(robot.names, robot.base_T_gripper, strict=True)
            if name in set(wanted)
        },
        camera,
        "pose_graph",
        setup=options.setup,
        noise=RobotNoise(
            robot_rotation_deg=noise.robot_rotation_deg,
            robot_translation_mm=noise.robot_translation_mm,
        ),
        priors=options.priors,
        robot_file=PoseFileOptions(
            # Named conversions are done; that the poses are not to be doubted remains to be said.
            convention=AS_GIVEN if AS_GIVEN in named else "",
            auto_convention=options.poses.auto_convention,
        ),
        seed=options.seed,
    )
    if any(named):
        provenance = {**result.provenance, "convention": options.poses.convention}
        result = replace(result, provenance=provenance)
    return (
        result if given.read_as is None else replace(result, poses_read_as={"robot": given.read_as})
    )
