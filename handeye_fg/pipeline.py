"""The main flow: from images and robot poses to X with its uncertainty, in numbered steps."""

import tempfile
from pathlib import Path

from handeye_fg.graph import refine_views
from handeye_fg.inputs import CameraSource, Inputs, PosesSource, TargetSource, read_inputs
from handeye_fg.io.files import sole_use
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.known import in_world_units, require_known_unit
from handeye_fg.options import Options
from handeye_fg.outcome import assemble, require_agreement
from handeye_fg.progress import Progress, Stopwatch, silent
from handeye_fg.scene import Scene, find_scene
from handeye_fg.solvers.rig import rig_start
from handeye_fg.turns import require_same_turns


def calibrate(
    images: str | Path,
    poses: PosesSource,
    camera: CameraSource = None,
    masks: str | Path | None = None,
    options: Options | None = None,
    *,
    target: TargetSource = None,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Result:
    """Find the pose of a camera on a robot arm from ordinary images.

    Args:
        images: folder of the images, of several cameras with a sub-folder for each.
        poses: CSV file, or {image name: base_T_gripper (4, 4)} in metres.
        camera: camera file, or intrinsics; of several cameras a folder with a file for each, or
            those that all have; None: they are found from the images.
        masks: folder of masks ``NAME.png``, white = use.
        options: None: defaults.
        target: target file, or a known target that images show; None: no target.
        output: folder in which ``sfm/`` and ``stages/`` are kept for the next run, which continues where
            this one ended if it was interrupted; None: nothing is kept.
        progress: told of every stage.

    Raises:
        HandEyeError: see its subclasses; the message says what to do.
    """
    options, clock = options or Options(), Stopwatch()
    require_known_unit(options.priors)
    # 1. Read everything, and pair images and poses by name.
    inputs = read_inputs(Path(images), poses, camera, masks, options, progress, target)
    clock.lap("input")
    # 2. Structure from motion: camera poses and points up to a similarity. With a target: in metres.
    with tempfile.TemporaryDirectory() as scratch, sole_use(Path(output or scratch)):
        scene = find_scene(inputs, Path(output or scratch) / "sfm", options, progress)
        clock.lap("sfm")
        return solve_scene(scene, inputs, options, clock, progress)


def solve_scene(
    scene: Scene, inputs: Inputs, options: Options, clock: Stopwatch, progress: Progress
) -> Result:
    """The steps from a reconstruction on."""
    model, known = scene.model, scene.known
    rig, reported = inputs.arm(model)
    # 3. Linear start: X and the scale in closed form, from wide-baseline motion pairs.
    first = model.image_camera == 0
    turns = inputs.turns(model.names, options.setup).only(first)
    require_same_turns(turns, model.world_T_camera[first, :3, :3])
    priors = in_world_units(options.priors, model.names, model.world_T_camera)
    linear = rig_start(reported, model.world_T_camera, rig, priors=priors)
    clock.lap("linear start")
    # 4. Joint refinement in the factor graph, with the robot's noise modelled and estimated.
    parent = parent_frame(options.setup)
    given = inputs.given(model)
    view = refine_views(model, reported, given, linear, options, parent, progress, known, rig)
    require_agreement(view.refinement)
    clock.lap("refinement")
    # 5. X, its covariance, and what is to be known of every image.
    return assemble(scene, inputs, linear, view, options, clock.timing_s)
