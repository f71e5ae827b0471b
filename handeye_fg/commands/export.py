"""``export``: a result in the form that another program reads."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from handeye_fg.commands.exit_codes import EXIT_OK, EXIT_PARTIAL
from handeye_fg.console import say, stderr_console
from handeye_fg.export_options import ExportFormat, ExportOptions


@dataclass(frozen=True, slots=True, kw_only=True)
class Export:
    """Give the result of a calibration in the form that another program reads.

    The text goes to stdout, or to --output. ros2, ros1: commands that publish the transform; ros2-launch,
    ros1-launch, moveit: launch files; urdf, xacro: a fixed joint; easy-handeye2, easy-handeye: their calibration
    files; opencv: FileStorage; covariance: a table; json: the transform for programs; nerfstudio, tum: the pose of
    each image; colmap: the reconstruction. The last three are in metres in the robot's base; for eye-to-hand in the
    gripper.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """Folder of an earlier calibration."""
    form: Annotated[ExportFormat, tyro.conf.arg(name="format")]
    """What to write."""
    output: Path | None = None
    """File to write, of colmap the folder. Default: stdout."""
    model: Path | None = None
    """For colmap: folder of the reconstruction that the result was made from. Default: OUT/sfm."""
    options: Annotated[ExportOptions, tyro.conf.arg(name="")] = field(default_factory=ExportOptions)
    """Names of frames and files."""

    def run(self) -> int:
        """Read the result and write the other form."""
        from handeye_fg.exporting import export
        from handeye_fg.io.result_reader import load_result

        result, console = load_result(self.folder), stderr_console()
        model = self.model or self.folder / "sfm"
        text = export(result, self.form, self.output, options=self.options, model=model)
        if self.output is None:
            sys.stdout.write(text)
            sys.stdout.flush()
        else:
            say(console, f"Written: {self.output}")
        if self.form == "colmap":
            say(console, text)
        if result.status == "partial":
            say(console, f"PARTIAL: a part of X was chosen, not measured. {result.message}")
            return EXIT_PARTIAL
        return EXIT_OK
