"""The main flow: from images and robot poses to X with its uncertainty, in numbered steps."""

import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from handeye_fg.frames import Array
from handeye_fg.graph import View, refine_views
from handeye_fg.inputs import CameraSource, Inputs, PosesSource, TargetSource, read_inputs
from handeye_fg.io.files import sole_use
from handeye_fg.io.holdout import HoldoutReport
from handeye_fg.io.image_arrays import ImageArrays, as_folder
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.known import in_world_units, require_known_unit
from handeye_fg.options import Options
from handeye_fg.outcome import assemble, require_agreement
from handeye_fg.progress import Progress, Stopwatch, silent
from handeye_fg.proof import of_new_images, read_new
from handeye_fg.scene import Scene, find_scene, require_one_world
from handeye_fg.solvers.rig import rig_start

Prove = Callable[[Scene, View, Array, Options, Progress], HoldoutReport]


def calibrate(
    images: str | Path | ImageArrays,
    poses: PosesSource,
    camera: CameraSource = None,
    masks: str | Path | ImageArrays | None = None,
    options: Options | None = None,
    *,
    target: TargetSource = None,
    holdout: tuple[str | Path | ImageArrays, PosesSource] | None = None,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Result:
    """Find the pose of a camera on a robot arm from ordinary images.

    Args:
        images: folder of the images, of several cameras with a sub-folder for each; or {image name: array}, grey
            (h, w) or RGB (h, w, 3), uint8, of several cameras with names such as "cam0/000.png".
        poses: file of poses, or {image name: base_T_gripper (4, 4)} in metres.
        camera: camera file, or intrinsics; of several cameras a folder with a file for each, or
            those that all have; None: they are found from the images.
        masks: folder of masks ``NAME.png``, white = use; or {image name: array}, boolean or uint8.
        options: None: defaults.
        target: target file, or a known target that images show; None: no target.
        holdout: images and poses that have no part in the calibration; ``result.holdout`` is how X predicts
            them. None: there are none.
        output: folder in which ``sfm/`` and ``stages/`` are kept for the next run, which continues where
            this one ended if it was interrupted; None: nothing is kept.
        progress: told of every stage.

    Returns:
        X with its covariance, and what is known of every image.

    Raises:
        HandEyeError: see its subclasses; the message says what to do.

    Examples:
        From files, with what ``handeye-fg calibrate`` does (half a minute, so that it is not run here):

        >>> import handeye_fg as hf
        >>> result = hf.calibrate("images", "poses.csv", camera="camera.yaml")  # doctest: +SKIP
        >>> print(result.status, result.matrix)  # doctest: +SKIP

        Without files: images as arrays, poses as matrices, the camera as a value. What cannot be calibrated is
        refused with a sentence on what to do:

        >>> import numpy as np
        >>> images = {f"{i}.png": np.full((480, 640), 100, dtype=np.uint8) for i in range(2)}
        >>> camera = hf.CameraModel(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240])
        >>> poses = {name: np.eye(4) for name in images}
        >>> hf.calibrate(images, poses, camera=camera)  # doctest: +ELLIPSIS
        Traceback (most recent call last):
            ...
        handeye_fg.errors.InputDataError: only 2 images of ... have a pose, but at least 3 are needed, ...
    """
    options, clock = options or Options(), Stopwatch()
    require_known_unit(options.priors)
    with ExitStack() as files:
        # 1. Read everything, and pair images and poses by name.
        folder = files.enter_context(as_folder(images))
        masked = None if masks is None else files.enter_context(as_folder(masks, ".png"))
        inputs = read_inputs(folder, poses, camera, masked, options, progress, target)
        new = None
        if holdout is not None:
            new_folder = files.enter_context(as_folder(holdout[0]))
            new = read_new(new_folder, holdout[1], inputs, options, progress)
        clock.lap("input")
        # 2. Structure from motion: camera poses and points up to a similarity. With a target: in metres.
        #    Whether the robot's poses are as they are said to be shows here.
        kept = Path(output or files.enter_context(tempfile.TemporaryDirectory()))
        files.enter_context(sole_use(kept))
        scene, inputs = find_scene(inputs, kept / "sfm", options, progress)
        clock.lap("sfm")
        prove = None if new is None else partial(of_new_images, new, kept / "sfm")
        return solve_scene(scene, inputs, options, clock, progress, prove)


def solve_scene(
    scene: Scene,
    inputs: Inputs,
    options: Options,
    clock: Stopwatch,
    progress: Progress,
    prove: Prove | None = None,
) -> Result:
    """The steps from a reconstruction on; ``prove``: holds X against what it has not seen."""
    model, known = scene.model, scene.known
    rig, reported = inputs.arm(model)
    # 3. Linear start: X and the scale in closed form, from wide-baseline motion pairs.
    priors = in_world_units(options.priors, model.names, model.world_T_camera)
    linear = rig_start(reported, model.world_T_camera, rig, priors=priors)
    require_one_world(model, reported, rig, linear)
    clock.lap("linear start")
    # 4. Joint refinement in the factor graph, with the robot's noise modelled and estimated.
    parent = parent_frame(options.setup)
    given = inputs.given(model)
    view = refine_views(model, reported, given, linear, options, parent, progress, known, rig)
    require_agreement(view.refinement)
    clock.lap("refinement")
    proof = None if prove is None else prove(scene, view, reported, options, progress)
    # 5. X, its covariance, and what is to be known of every image.
    return assemble(scene, inputs, linear, view, options, clock.timing_s, proof)
