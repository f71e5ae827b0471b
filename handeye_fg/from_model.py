"""Calibration from an existing COLMAP model instead of images."""

from handeye_fg import sfm
from handeye_fg.inputs import PosesSource, read_model_inputs
from handeye_fg.io.results import Result
from handeye_fg.options import Options
from handeye_fg.pipeline import solve_scene
from handeye_fg.progress import Progress, Stopwatch, silent
from handeye_fg.scene import Scene


def refine(
    model: sfm.ModelSource,
    poses: PosesSource,
    options: Options | None = None,
    *,
    progress: Progress = silent,
) -> Result:
    """Find the pose of a camera on a robot arm from an existing reconstruction.

    Args:
        model: a ``pycolmap.Reconstruction`` or the folder of one; its intrinsics are taken as given.
        poses: CSV file, or {image name: base_T_gripper (4, 4)} in metres.
        options: None: defaults.
        progress: told of every stage.

    Raises:
        HandEyeError: see its subclasses; the message says what to do.
    """
    options, clock = options or Options(), Stopwatch()
    inputs, paired = read_model_inputs(sfm.read_model(model), poses, options)
    clock.lap("input")
    return solve_scene(Scene(model=paired), inputs, options, clock, progress)
