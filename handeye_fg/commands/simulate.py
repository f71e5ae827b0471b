"""``simulate``: a synthetic data set with its truth."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for scipy and pycolmap

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from handeye_fg.commands.exit_codes import EXIT_OK
from handeye_fg.console import say, stderr_console
from handeye_fg.errors import InputDataError


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulate:
    """Make a synthetic data set with its truth.

    Writes model/ (a COLMAP model with its tracks; no images are rendered), poses.csv, camera.yaml and truth.json
    to OUT.
    """

    output: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """Folder of the data set."""
    images: int = 15
    """Number of images."""
    points: int = 300
    """Number of scene points."""
    motion: Literal["general", "one_axis", "pure_translation", "pure_rotation"] = "general"
    """What the gripper does; all but general leave something undetermined."""
    pixel_px: float = 0.3
    """Standard deviation of an observation, per axis, in pixels."""
    robot_rotation_deg: float = 0.01
    """Standard deviation of a reported robot orientation, per axis, in degrees."""
    robot_translation_mm: float = 0.05
    """Standard deviation of a reported robot position, per axis, in millimetres."""
    seed: int = 0
    """Seed of everything random."""

    def run(self) -> int:
        """Simulate and write."""
        self._check()
        import numpy as np

        from handeye_fg.simulate import simulate_scene
        from handeye_fg.synthetic_set import write_scene

        scene = simulate_scene(
            np.random.default_rng(self.seed),
            n_images=self.images,
            n_points=self.points,
            motion=self.motion,
            pixel_sigma=self.pixel_px,
            robot_rotation_sigma=math.radians(self.robot_rotation_deg),
            robot_translation_sigma=self.robot_translation_mm / 1e3,
        )
        folder = write_scene(scene, self.output)
        say(
            stderr_console(),
            f"Data set: {folder} ({self.images} images; the truth is in truth.json)",
        )
        return EXIT_OK

    def _check(self) -> None:
        bounds = {
            "images": (3, 10_000),
            "points": (10, 1_000_000),
            "seed": (0, 2**63),
            "pixel_px": (0.0, 100.0),
            "robot_rotation_deg": (0.0, 90.0),
            "robot_translation_mm": (0.0, 1e4),
        }
        for name, (least, most) in bounds.items():
            value = getattr(self, name)
            if not least <= value <= most:
                raise InputDataError(
                    f"--{name.replace('_', '-')} is {value}, but must be from {least:g} to {most:g}"
                )
