"""``solve``: from pose pairs alone."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM, pycolmap and matplotlib

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from handeye_fg.commands.outcome import failure_as_json, told, written
from handeye_fg.console import stderr_console
from handeye_fg.options import (
    CameraNoise,
    MethodName,
    PoseFileOptions,
    RobotNoise,
    Setup,
    TaskOptions,
)
from handeye_fg.priors import Priors


@dataclass(frozen=True, slots=True, kw_only=True)
class Solve:
    """Calibrate from pose pairs alone, without images.

    Rows are paired by name. Writes result.json and report.html to --output.
    """

    robot: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROBOT.csv")]
    """File of the poses of the gripper in the robot's base: CSV with the header image,x,y,z,qx,qy,qz,qw
    (metres, Hamilton quaternion; the column image holds any name of the row), or any other --pose-format."""
    camera: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="CAMERA.csv")]
    """Such a file too (for its format --camera-file.pose-format), with the same names, or times: the pose of the camera in the world, or, for eye-to-hand, in what
    moves with the gripper. In any unit of length for andreff_scale and pose_graph, in
    metres for the others."""
    method: MethodName = "andreff_scale"
    """Closed form to use, or pose_graph: least squares with the noise of both lists modelled."""
    setup: Setup = "eye-in-hand"
    """Camera on the gripper, or static camera that looks at an object on the gripper."""
    robust: bool = True
    """Leave out, and name, rows that disagree with the majority."""
    metric: tyro.conf.FlagCreatePairsOff[bool] = False
    """For pose_graph: the camera's translations are in metres; else it finds their unit."""
    camera_noise: CameraNoise = "auto"
    """For pose_graph: each camera pose has an error of its own (independent), or each motion to the
    next pose has, so that errors accumulate (odometry); auto: the data tell."""
    noise: RobotNoise = field(default_factory=RobotNoise)
    priors: Priors = ()
    """What is known beforehand, as for calibrate; scale is the unit of CAMERA.csv."""
    robot_file: Annotated[PoseFileOptions, tyro.conf.arg(name="")] = field(
        default_factory=PoseFileOptions
    )
    camera_file: PoseFileOptions = field(default_factory=PoseFileOptions)
    task: TaskOptions = field(default_factory=TaskOptions)
    seed: int = 0
    """Seed of everything random."""
    output: Path = Path("handeye-fg-out")
    """Folder for the results."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""

    def run(self) -> int:
        """Solve, write the results and say what came out."""
        with failure_as_json(self.setup, json=self.json):
            from handeye_fg.from_poses import solve

            result = solve(
                self.robot,
                self.camera,
                self.method,
                setup=self.setup,
                robust=self.robust,
                metric=self.metric,
                camera_noise=self.camera_noise,
                noise=self.noise,
                priors=self.priors,
                robot_file=self.robot_file,
                camera_file=self.camera_file,
                seed=self.seed,
                task=self.task,
            )
        report = written(result, self.output)
        return told(result, report, stderr_console(), json=self.json, quiet=self.quiet)
