"""``calibrate``: from a folder of images and the robot's poses."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

import logging
import os
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

from handeye_fg.commands.outcome import failure_as_json, told, written
from handeye_fg.console import logged, native_stdout_moved, progress_view, stderr_console
from handeye_fg.errors import InputDataError
from handeye_fg.options import Options
from handeye_fg.progress import Progress, silent

if TYPE_CHECKING:
    from handeye_fg.io.results import Result


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrate:
    """Calibrate from a folder of images and the robot's poses.

    Flags win over the file given with --config, which wins over the defaults. Writes result.json,
    report.html, config.toml (the options as used) and sfm/ (the reconstruction) to --output, and stages/, from
    which the same command continues after an interruption.
    """

    images: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMAGES")]
    """Folder of the images; of several cameras on one arm with a sub-folder for each, in which images of
    one robot pose have the same name. With --model only their names are read, and - stands for all of the
    model."""
    poses: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POSES")]
    """For each image the pose of the gripper in the robot's base: a CSV file with the header
    image,x,y,z,qx,qy,qz,qw (metres, Hamilton quaternion), or a file or folder of any other --pose-format."""
    camera: Path | None = None
    """Camera file of ROS, OpenCV, Kalibr, COLMAP or nerfstudio, or JSON; for several cameras a folder with a file
    for each, named like the sub-folders (cam0.yaml), or one of Kalibr with these names. Without it the intrinsics
    are estimated."""
    masks: Path | None = None
    """Folder with a mask NAME.png for each image NAME (frame_0000.jpg.png, of several cameras
    cam0/frame_0000.jpg.png): white is used."""
    target: Path | None = None
    """Target file (YAML): a board of known size that images show, with or without a scene around it."""
    model: Path | None = None
    """A reconstruction that exists already, instead of one from the images: folder of a COLMAP model, or of a
    transforms.json of nerfstudio, or a file with the camera's trajectory (such as TUM), for which --pair-by holds
    as well. Where it has no points, X comes from its camera poses alone."""
    holdout_images: Path | None = None
    """Folder of new images of the scene that have no part in the calibration, to be predicted by robot and X:
    a proof of X; of several cameras with a sub-folder for each. Needs --holdout-poses; with --model the model's
    database.db as well."""
    holdout_poses: Path | None = None
    """Robot poses of these, in the format of POSES."""
    config: Path | None = None
    """Options as a TOML file, such as the config.toml of an earlier run."""
    output: Path = Path("handeye-fg-out")
    """Folder for the results."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""
    verbose: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-v"])] = False
    """Let the logs of the libraries through."""
    options: Annotated[Options, tyro.conf.arg(name="")] = field(default_factory=Options)
    """Options of the calibration."""

    def run(self) -> int:
        """Calibrate, write the results and say what came out."""
        from handeye_fg.io.config import write_config

        console = stderr_console()
        with failure_as_json(self.options.setup, json=self.json):
            result = self._calibrate(console)
        report = written(result, self.output)
        write_config(self.options, self.output / "config.toml")
        return told(result, report, console, json=self.json, quiet=self.quiet)

    def _calibrate(self, console: Console) -> "Result":
        from handeye_fg.sfm import set_verbosity

        set_verbosity(self.verbose)
        with ExitStack() as stack:
            stack.enter_context(logged(console, self._log_level()))
            stack.enter_context(native_stdout_moved(None if self.verbose else os.devnull))
            view = silent if self.quiet else stack.enter_context(progress_view(console))
            if self.model is not None:
                return self._refine(self.model, view)
            from handeye_fg.pipeline import calibrate

            return calibrate(
                self.images,
                self.poses,
                camera=self.camera,
                masks=self.masks,
                options=self.options,
                target=self.target,
                holdout=self._holdout(),
                output=self.output,
                progress=view,
            )

    def _holdout(self) -> tuple[Path, Path] | None:
        """The new images and their poses."""
        if self.holdout_images is None and self.holdout_poses is None:
            return None
        if self.holdout_images is None or self.holdout_poses is None:
            raise InputDataError(
                "--holdout-images and --holdout-poses belong together; give the other"
            )
        if self.options.holdout > 0.0:
            raise InputDataError(
                "--holdout keeps poses of the calibration out of X, --holdout-images takes others; use one of them"
            )
        return self.holdout_images, self.holdout_poses

    def _refine(self, model: Path, progress: Progress) -> "Result":
        """From the reconstruction that exists already."""
        from handeye_fg.from_model import refine

        given = {
            "--camera": self.camera,
            "--masks": self.masks,
            "--target": self.target,
        }
        if unused := [flag for flag, value in given.items() if value is not None]:
            raise InputDataError(
                f"{' and '.join(unused)} cannot be used with --model, whose reconstruction has its own camera and "
                "is not made again; leave it out"
            )
        images = None if str(self.images) == "-" else self.images
        return refine(
            model,
            self.poses,
            self.options,
            images=images,
            holdout=self._holdout(),
            progress=progress,
        )

    def _log_level(self) -> int:
        if self.quiet:
            return logging.ERROR
        return logging.DEBUG if self.verbose else logging.WARNING
