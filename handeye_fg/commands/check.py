"""``check``: whether poses, images and motions are fit for a calibration."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for pycolmap

import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from handeye_fg.commands.exit_codes import EXIT_FAILED, EXIT_OK, EXIT_PARTIAL
from handeye_fg.commands.outcome import failure_as_json
from handeye_fg.console import native_stdout_moved, progress_view, say, stderr_console
from handeye_fg.options import Options
from handeye_fg.progress import silent

if TYPE_CHECKING:
    from handeye_fg.checking import Check as Found


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Check the input of a calibration: reads, pairs, tests conventions and motions; calibrates nothing.

    Places the images, and holds the poses against them as they are and under some hundreds of other
    readings: units, quaternion and Euler orders, inverted, transposed, mirrored, rows shifted. Exit codes: 0 the
    poses are as they are said to be; 1 they are not; 2 the input cannot be read; 3 the motions cannot tell.
    """

    images: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IMAGES")]
    """Folder of the images, as for calibrate."""
    poses: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="POSES")]
    """File of the robot's poses, as for calibrate."""
    camera: Path | None = None
    """Camera file. Without it the intrinsics are estimated."""
    masks: Path | None = None
    """Folder with a mask NAME.png for each image NAME: white is used."""
    config: Path | None = None
    """Options as a TOML file, such as the config.toml of an earlier run."""
    output: Path | None = None
    """Folder in which the reconstruction (sfm/) is kept, for calibrate to use; none is kept by default."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print what was found as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""
    options: Annotated[Options, tyro.conf.arg(name="")] = field(default_factory=Options)
    """Options of the calibration; only those of input and reconstruction matter."""

    def run(self) -> int:
        """Check, and say what was found."""
        from handeye_fg.io.results import to_json

        with failure_as_json(self.options.setup, json=self.json):
            found = self._found()
        if not self.quiet:
            say(stderr_console(), _text(found))
        if self.json:
            sys.stdout.write(to_json(found.to_document()))
            sys.stdout.flush()
        if found.kind == "undecided":
            return EXIT_PARTIAL
        return EXIT_OK if found.kind == "right" else EXIT_FAILED

    def _found(self) -> "Found":
        from handeye_fg.checking import check
        from handeye_fg.sfm import set_verbosity

        set_verbosity(False)
        with ExitStack() as stack:
            stack.enter_context(native_stdout_moved(os.devnull))
            view = silent if self.quiet else stack.enter_context(progress_view(stderr_console()))
            return check(
                self.images,
                self.poses,
                camera=self.camera,
                masks=self.masks,
                options=self.options,
                output=self.output,
                progress=view,
            )


def _text(found: "Found") -> str:
    """What was found, as a person reads it."""
    lines = [f"{found.n_placed} of {found.n_images} images were placed."]
    lines += [f"  left out: {name}: {reason}" for name, reason in found.left_out]
    lines += [found.motion_message, "", found.table, "", found.message]
    return "\n".join(lines)
