"""X in the forms that other programs read; entry point ``export_text``.

``placed`` names frames and picks cameras; ``ros``, ``numbers`` and ``trajectories`` write. Numbers are written so
that they read back exactly. The COLMAP model, which is no text, is in ``handeye_fg.sfm``.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import get_args

from handeye_fg.errors import InputDataError
from handeye_fg.export_options import ExportOptions, TextFormat
from handeye_fg.io.exports import numbers, ros, trajectories
from handeye_fg.io.exports.placed import Placed, placed
from handeye_fg.io.exports.trajectories import scene_cameras, scene_poses
from handeye_fg.io.fields import shown
from handeye_fg.io.results import Result

_TRANSFORMS: Mapping[str, Callable[[Sequence[Placed]], str]] = {
    "ros2": ros.ros2,
    "ros2-launch": ros.ros2_launch,
    "ros1": ros.ros1,
    "ros1-launch": ros.ros1_launch,
    "urdf": ros.urdf,
    "xacro": ros.xacro,
    "easy-handeye2": ros.easy_handeye2,
    "easy-handeye": ros.easy_handeye,
    "moveit": ros.ros1_launch,
    "opencv": numbers.opencv,
    "covariance": numbers.covariance,
    "json": numbers.as_json,
}
_TRAJECTORIES: Mapping[str, Callable[[Result, ExportOptions], str]] = {
    "nerfstudio": trajectories.nerfstudio,
    "tum": trajectories.tum,
}


def export_text(result: Result, form: str, options: ExportOptions | None = None) -> str:
    """The result as the text of a file that another program reads.

    Args:
        result: the result.
        form: one of ``TextFormat``.
        options: names of frames; None: defaults.

    Raises:
        InputDataError: there is no such format, or it cannot hold this result.
    """
    options = options or ExportOptions()
    if form in _TRANSFORMS:
        return _TRANSFORMS[form](placed(result, options))
    if form in _TRAJECTORIES:
        return _TRAJECTORIES[form](result, options)
    raise InputDataError(
        f"there is no format {shown(form)} of text; choose one of {', '.join(get_args(TextFormat))}"
    )


__all__ = ["export_text", "scene_cameras", "scene_poses"]
