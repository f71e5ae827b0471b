"""Hand-eye calibration from ordinary images, with an honest uncertainty.

``calibrate`` takes images and the robot's poses, ``refine`` an existing model and the poses, ``solve`` pose
pairs alone; all return a ``Result``, of files or of arrays. ``check`` and ``check_model`` say whether the poses
are as they are said to be. ``export`` gives a result to other programs, ``render_report`` and ``summary_text``
to people. The conventions are in ``handeye_fg.frames``, synthetic data in ``handeye_fg.simulate``. Names are
imported when they are first used, so that ``import handeye_fg`` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from handeye_fg.batching.manifest import DataSet
    from handeye_fg.batching.rows import Batch, Row
    from handeye_fg.batching.run import batch
    from handeye_fg.checking import Check, check, check_model
    from handeye_fg.comparison import Comparison, Difference, compare
    from handeye_fg.errors import (
        ConvergenceError,
        HandEyeError,
        InputDataError,
        ReconstructionError,
        UnobservableError,
    )
    from handeye_fg.export_options import ExportOptions
    from handeye_fg.exporting import export
    from handeye_fg.findings import NoiseLevels
    from handeye_fg.from_model import refine
    from handeye_fg.from_poses import solve
    from handeye_fg.io.cameras import read_camera
    from handeye_fg.io.poses import read_poses, write_poses
    from handeye_fg.io.result_reader import load_result
    from handeye_fg.io.results import Result
    from handeye_fg.options import (
        GraphOptions,
        NoiseOptions,
        Options,
        PoseFileOptions,
        RobotNoise,
        SfmOptions,
        TaskOptions,
    )
    from handeye_fg.patterns import AprilTagGrid, Charuco, Grid, Target
    from handeye_fg.pipeline import calibrate
    from handeye_fg.planning import Plan, Workspace, plan, plan_first, read_arm
    from handeye_fg.priors import CameraPrior, DistancePrior, PosePrior, Prior, ScalePrior
    from handeye_fg.report import (
        markdown_text,
        render_report,
        summary_text,
        write_figures,
        write_report,
    )
    from handeye_fg.synthetic_set import write_scene
    from handeye_fg.types import CameraModel, RobotPoses, SfmModel, Tracks

__all__ = [
    "AprilTagGrid",
    "Batch",
    "CameraModel",
    "CameraPrior",
    "Charuco",
    "Check",
    "Comparison",
    "ConvergenceError",
    "DataSet",
    "Difference",
    "DistancePrior",
    "ExportOptions",
    "GraphOptions",
    "Grid",
    "HandEyeError",
    "InputDataError",
    "NoiseLevels",
    "NoiseOptions",
    "Options",
    "Plan",
    "PoseFileOptions",
    "PosePrior",
    "Prior",
    "ReconstructionError",
    "Result",
    "RobotNoise",
    "RobotPoses",
    "Row",
    "ScalePrior",
    "SfmModel",
    "SfmOptions",
    "Target",
    "TaskOptions",
    "Tracks",
    "UnobservableError",
    "Workspace",
    "batch",
    "calibrate",
    "check",
    "check_model",
    "compare",
    "export",
    "load_result",
    "markdown_text",
    "plan",
    "plan_first",
    "read_arm",
    "read_camera",
    "read_poses",
    "refine",
    "render_report",
    "solve",
    "summary_text",
    "write_figures",
    "write_poses",
    "write_report",
    "write_scene",
]

_HOME = {
    "NoiseLevels": "findings",
    **dict.fromkeys(("AprilTagGrid", "Charuco", "Grid", "Target"), "patterns"),
    "ExportOptions": "export_options",
    **dict.fromkeys(("Comparison", "Difference", "compare"), "comparison"),
    "Batch": "batching.rows",
    "DataSet": "batching.manifest",
    **dict.fromkeys(("Plan", "Workspace", "plan", "plan_first", "read_arm"), "planning"),
    "Result": "io.results",
    "Row": "batching.rows",
    "batch": "batching.run",
    "calibrate": "pipeline",
    **dict.fromkeys(("Check", "check", "check_model"), "checking"),
    "export": "exporting",
    "load_result": "io.result_reader",
    "read_camera": "io.cameras",
    "read_poses": "io.poses",
    "refine": "from_model",
    "solve": "from_poses",
    "write_poses": "io.poses",
    "write_scene": "synthetic_set",
    **dict.fromkeys(
        ("markdown_text", "render_report", "summary_text", "write_figures", "write_report"),
        "report",
    ),
    **dict.fromkeys(("CameraModel", "RobotPoses", "SfmModel", "Tracks"), "types"),
    **dict.fromkeys(
        (
            "GraphOptions",
            "NoiseOptions",
            "Options",
            "PoseFileOptions",
            "RobotNoise",
            "SfmOptions",
            "TaskOptions",
        ),
        "options",
    ),
    **dict.fromkeys(("CameraPrior", "DistancePrior", "PosePrior", "Prior", "ScalePrior"), "priors"),
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'handeye_fg' has no attribute {name!r}")
    return getattr(import_module(f"handeye_fg.{_HOME.get(name, 'errors')}"), name)
