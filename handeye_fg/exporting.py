"""A result in the forms that other programs read: ``export``."""

from pathlib import Path
from typing import TYPE_CHECKING, get_args

from handeye_fg.errors import InputDataError
from handeye_fg.export_options import ExportFormat, ExportOptions, TextFormat
from handeye_fg.io.exports import export_text, scene_cameras, scene_poses
from handeye_fg.io.fields import shown
from handeye_fg.io.files import write_atomic
from handeye_fg.io.results import Result

if TYPE_CHECKING:
    from handeye_fg.sfm import ModelSource


def export(
    result: Result,
    form: str,
    output: str | Path | None = None,
    *,
    options: ExportOptions | None = None,
    model: "ModelSource | None" = None,
) -> str:
    """Give a result in the form that another program reads; its numbers read back exactly.

    ``ros2``, ``ros1``: commands that publish the transform; ``ros2-launch``, ``ros1-launch``, ``moveit``: launch
    files; ``urdf``, ``xacro``: a fixed joint; ``easy-handeye2``, ``easy-handeye``: their calibration files;
    ``opencv``: FileStorage with X and the intrinsics; ``covariance``: a table; ``json``: X for programs;
    ``nerfstudio``, ``tum``: the pose of each image; ``colmap``: the reconstruction. The last three are in metres in
    the robot's base; for eye-to-hand, where the object moves with the gripper, in the gripper.

    Args:
        result: of a calibration.
        form: the format.
        output: file to write, of ``colmap`` the folder; None: nothing is written.
        options: names of frames; None: defaults.
        model: for ``colmap`` the reconstruction that the result was made from: ``sfm/`` in the folder of the
            result, or a ``pycolmap.Reconstruction``.

    Returns:
        The text; of ``colmap`` a sentence on what the folder holds.

    Raises:
        InputDataError: there is no such format, it cannot hold this result, or the output cannot be written.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, truth = simulate_poses(np.random.default_rng(0), n_poses=12)
        >>> result = hf.solve(robot, camera)
        >>> names = hf.ExportOptions(gripper_frame="tool0", camera_frame="camera_color_optical_frame")
        >>> print(hf.export(result, "ros2", options=names).splitlines()[-1])  # doctest: +ELLIPSIS
        ros2 run tf2_ros static_transform_publisher --x ... --child-frame-id camera_color_optical_frame
    """
    if form != "colmap":
        if form not in get_args(TextFormat):
            raise InputDataError(
                f"there is no format {shown(form)}; choose one of {', '.join(get_args(ExportFormat))}"
            )
        text = export_text(result, form, options)
        if output is not None:
            write_atomic(Path(output), text)
        return text
    if output is None or model is None:
        raise InputDataError(
            "the format colmap is a folder, made from the reconstruction; give the output folder, and the "
            "model that the result was made from"
        )
    return _export_model(result, Path(output), model, options or ExportOptions())


def _export_model(
    result: Result, folder: Path, model: "ModelSource", options: ExportOptions
) -> str:
    from handeye_fg import sfm  # noqa: PLC0415  # COLMAP is for this format alone

    poses = scene_poses(result, options.camera)
    frame = "base" if result.setup == "eye-in-hand" else "gripper"
    note = (
        f"COLMAP model in metres in the {frame} frame of the robot: put a point given in camera coordinates into "
        f"{frame} coordinates by p_{frame} = inverse(cam_from_world) p_camera."
    )
    missing = sfm.write_metric(model, poses, scene_cameras(result), folder, note)
    if missing:
        note += (
            f" {len(missing)} images that the model has not were left out: {', '.join(missing)}."
        )
    return note
