"""``check``: whether poses, images and motions are fit for a calibration; calibrates nothing."""

import math
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from handeye_fg import sfm
from handeye_fg.conventions import Judged, Verdict, table
from handeye_fg.conventions.verdict import Kind
from handeye_fg.inputs import CameraSource, Inputs, PosesSource, read_inputs, read_model_inputs
from handeye_fg.io.files import sole_use
from handeye_fg.io.image_arrays import ImageArrays, as_folder
from handeye_fg.motion_kinds import MotionKind, classify
from handeye_fg.motions import PosePairs
from handeye_fg.options import Options
from handeye_fg.progress import Progress, silent
from handeye_fg.scene import Checked, check_poses, reconstructed
from handeye_fg.types import SfmModel

_MOTIONS = {
    "none": "The gripper does not move: nothing of X is determined.",
    "translations": (
        "The gripper never turns: the camera's orientation is determined, its position is not; add poses that "
        "turn it by 20 degrees and more about two axes."
    ),
    "rotations": (
        "The gripper only turns about its own origin: the scale and the camera's distance are not determined; "
        "add poses that move it by a tenth of a metre and more."
    ),
    "planar": (
        "All rotations share one axis: the camera's position along it is not determined; add poses that turn "
        "the gripper by 20 degrees and more about another one."
    ),
    "one_axis": (
        "All rotations share one axis: the camera's position along it is not determined; add poses that turn "
        "the gripper by 20 degrees and more about another one."
    ),
    "enough": "The motions turn about two axes and more: they determine X and the scale.",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Check:
    """What a check found.

    Attributes:
        kind: "right": the poses are as they are said to be. "wrong": they follow another convention.
            "undecided": they may be right, but the motions cannot tell. "contradiction": they agree
            with the images under no convention.
        message: the verdict in a sentence, with what to do.
        convention: what makes the poses right, as for ``--convention``; "" for nothing.
        verdict: every reading of the poses that was held against the images.
        motion: of what kind the robot's motions are.
        motion_message: the same in a sentence.
        n_images: images that have a pose and are fit for use.
        n_placed: of these those that structure from motion placed.
        left_out: (name, reason) of the others, and of poses without image.
    """

    kind: Kind
    message: str
    convention: str
    verdict: Verdict
    motion: MotionKind
    motion_message: str
    n_images: int
    n_placed: int
    left_out: tuple[tuple[str, str], ...]

    @property
    def table(self) -> str:
        """The readings that were tried, best first, with residuals, as text."""
        return table(self.verdict)

    def to_document(self) -> dict[str, Any]:
        """Everything, for JSON: degrees and millimetres; null where nothing fits."""
        return {
            "verdict": self.kind,
            "message": self.message,
            "convention": self.convention,
            "readings": [_reading(one) for one in self.verdict.tried],
            "motion": {"kind": self.motion.kind, "axes": self.motion.n_axes},
            "motion_message": self.motion_message,
            "images": self.n_images,
            "placed": self.n_placed,
            "left_out": [{"name": name, "reason": reason} for name, reason in self.left_out],
        }


def check(
    images: str | Path | ImageArrays,
    poses: PosesSource,
    camera: CameraSource = None,
    masks: str | Path | ImageArrays | None = None,
    options: Options | None = None,
    *,
    output: str | Path | None = None,
    progress: Progress = silent,
) -> Check:
    """Read, pair, place the images, and hold every reading of the poses against them.

    Args:
        images: as for ``calibrate``, like everything else.
        poses: of the robot.
        camera: intrinsics.
        masks: of the images.
        options: None: defaults.
        output: folder in which the reconstruction is kept, for ``calibrate`` to use.
        progress: told of every stage.

    Returns:
        The verdict, in words and in numbers.

    Raises:
        InputDataError: the input cannot be read or does not fit together.
        ReconstructionError: too few images can be placed.

    Examples:
        >>> import handeye_fg as hf
        >>> found = hf.check("images", "poses.csv", camera="camera.yaml")  # doctest: +SKIP
        >>> print(found.kind, found.message)  # doctest: +SKIP
    """
    options = options or Options()
    with ExitStack() as files:
        folder = files.enter_context(as_folder(images))
        masked = None if masks is None else files.enter_context(as_folder(masks, ".png"))
        inputs = read_inputs(folder, poses, camera, masked, options, progress)
        kept = Path(output or files.enter_context(tempfile.TemporaryDirectory()))
        files.enter_context(sole_use(kept))
        model = reconstructed(inputs, kept / "sfm", options, progress)
        return _checked(model, inputs, options)


def check_model(
    model: SfmModel | sfm.ModelSource, poses: PosesSource, options: Options | None = None
) -> Check:
    """Like ``check``, with an existing model instead of images.

    Args:
        model: of COLMAP, a ``pycolmap.Reconstruction`` or its folder; or of arrays.
        poses: of the robot.
        options: None: defaults.

    Returns:
        The verdict, in words and in numbers.

    Raises:
        InputDataError: the input cannot be read or does not fit together.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_scene
        >>> scene = simulate_scene(np.random.default_rng(0), n_images=8, n_points=60)
        >>> poses = dict(zip(scene.robot_poses.names, np.linalg.inv(scene.robot_poses.base_T_gripper)))
        >>> found = hf.check_model(scene.model, poses)
        >>> found.kind, found.convention
        ('wrong', 'inverted')
    """
    options = options or Options()
    found = model if isinstance(model, SfmModel) else sfm.read_model(model)
    inputs, paired = read_model_inputs(found, poses, options)
    return _checked(paired, inputs, options)


def _checked(model: SfmModel, inputs: Inputs, options: Options) -> Check:
    checked: Checked = check_poses(model, inputs, options, thorough=True)
    reported = inputs.robot_poses(checked.names)
    motion = classify(PosePairs(base_T_gripper=reported, world_T_camera=reported))
    return Check(
        kind=checked.verdict.kind,
        message=f"{checked.sentence[:1].upper()}{checked.sentence[1:].rstrip('.')}.",
        convention=checked.verdict.convention,
        verdict=checked.verdict,
        motion=motion,
        motion_message=_motions(motion),
        n_images=len(inputs.names),
        n_placed=len(model.names),
        left_out=(*model.unregistered, *inputs.unusable, *inputs.left_out),
    )


def _motions(motion: MotionKind) -> str:
    if motion.kind in _MOTIONS:
        return _MOTIONS[motion.kind]
    return _MOTIONS["one_axis" if motion.n_axes == 1 else "enough"]


def _reading(one: Judged) -> Mapping[str, Any]:
    evidence = one.evidence
    degrees, millimetres = math.degrees(evidence.typical[0]), 1e3 * evidence.typical[1]
    return {
        "name": one.reading.name,
        "words": one.reading.words,
        "residual_rotation_deg": degrees if math.isfinite(degrees) else None,
        "residual_translation_mm": millimetres if math.isfinite(millimetres) else None,
        "rows": int(evidence.right.sum()),
        "fits": evidence.fits,
    }
