"""What is done with the intrinsics: kept as given, or unknowns of the graph; entry ``refine_views``.

Either way the observations are held against the camera's own model, and a model that is refined has its
own parameters for unknowns, no more and no fewer.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.graph.problem import IntrinsicsPrior
from handeye_fg.graph.refine import intrinsics_pull, refine, start_state
from handeye_fg.graph.summary import Refinement, scale_agrees
from handeye_fg.graph.variables import State
from handeye_fg.intrinsics import covers_image, nearest
from handeye_fg.lens import embedding, lens_of, refinable
from handeye_fg.options import Options
from handeye_fg.progress import Progress
from handeye_fg.types import CameraModel, KnownPoints, LinearStart, SfmModel

# Standard deviations of a camera file's values: what a factory or a hasty calibration leaves.
_FILE_FOCAL = 0.01  # of the focal length
_FILE_CENTRE = 0.01  # of the image width
_FILE_RADIAL, _FILE_TANGENTIAL = 0.1, 0.005
# Without a file, so wide that they only keep a degenerate problem finite.
_FREE_FOCAL, _FREE_CENTRE = 0.5, 0.05
_FREE_RADIAL, _FREE_TANGENTIAL = 1.0, 0.05

# The images contradict the file where its values are this improbable. The errors of features are
# not quite independent, which makes the statistic two to three times as large as chi-square has it.
_CONTRADICTION = 1e-6
_OVERDISPERSION = 3.0
# A standard deviation of the logarithm of the scale that leaves it to the robot.
_FREE_LOG_SCALE = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A refinement and the intrinsics that belong to it.

    Attributes:
        refinement: the optimum.
        camera: final intrinsics; the given ones where they were kept.
        refined: whether they were unknowns.
        std: standard deviations (k,) of ``camera.params``, zeros where kept.
        note: what was done and why, in words.
        scale_note: in words, if the size of a known target was not kept; "" otherwise.
    """

    refinement: Refinement
    camera: CameraModel
    refined: bool
    std: Array
    note: str
    scale_note: str = ""


def _prior(camera: CameraModel, *, free: bool) -> IntrinsicsPrior:
    """The prior around a camera."""
    focal, centre, radial, tangential = (
        (_FREE_FOCAL, _FREE_CENTRE, _FREE_RADIAL, _FREE_TANGENTIAL)
        if free
        else (_FILE_FOCAL, _FILE_CENTRE, _FILE_RADIAL, _FILE_TANGENTIAL)
    )
    lens, into = lens_of(camera), embedding(camera.model)
    coefficients = np.full(8, radial)
    if not lens.fisheye:
        coefficients[2:4] = tangential
    family = np.concatenate([focal * lens.focal, [centre * camera.width] * 2, coefficients])
    sigmas, unknown = np.zeros(len(camera.params)), refinable(camera.model)
    sigmas[unknown] = (into.T @ family / into.sum(axis=0))[unknown]
    return IntrinsicsPrior(params=camera.params, sigmas=sigmas)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Call:
    """The arguments that every refinement shares."""

    options: Options
    progress: Progress
    frame: str
    known: KnownPoints | None
    trusted: NDArray[np.bool_] | None

    @property
    def inverted(self) -> bool:
        """Whether the robot poses are gripper_T_base."""
        return self.options.setup == "eye-to-hand"

    def refine(
        self,
        model: SfmModel,
        base_T_gripper: Array,
        start: State,
        *,
        intrinsics: Sequence[IntrinsicsPrior],
    ) -> Refinement:
        return refine(
            model,
            base_T_gripper,
            start,
            intrinsics=intrinsics,
            noise=self.options.noise,
            options=self.options.graph,
            progress=self.progress,
            frame=self.frame,
            known=self.known,
            known_x=self.options.priors,
            inverted=self.inverted,
            trusted=self.trusted,
        )


def _refined(
    model: SfmModel,
    base_T_gripper: Array,
    camera: CameraModel,
    linear: LinearStart,
    call: _Call,
    *,
    note: str,
    free: bool,
) -> View:
    """Refine with the intrinsics as unknowns, the prior around ``camera``."""
    used, _ = nearest(model.camera, camera)
    refinement = call.refine(
        model,
        base_T_gripper,
        start_state(model, [used], linear),
        intrinsics=[_prior(camera, free=free)],
    )
    return View(
        refinement=refinement,
        camera=refinement.state.cameras[0],
        refined=True,
        std=np.sqrt(np.diag(refinement.intrinsics_covariances[0])),
        note=note,
    )


def refine_views(
    model: SfmModel,
    base_T_gripper: Array,
    camera: CameraModel | None,
    linear: LinearStart,
    options: Options,
    frame: str,
    progress: Progress,
    known: KnownPoints | None = None,
) -> View:
    """Refine with the intrinsics kept or refined, as the options and the images ask for.

    Where the robot contradicts the size of a known target, the robot's measure counts: a print that
    came out at another size, or a length mistyped, is commoner than an arm of the wrong size.

    Args:
        model: the SfM model; where no camera is given, its intrinsics are the start.
        base_T_gripper: reported robot poses (n, 4, 4), metres, in the order of the model's images; for
            eye-to-hand their inverses.
        camera: the given intrinsics, or None.
        linear: the linear start.
        options: of the calibration.
        frame: parent frame of X.
        progress: told the number of iterations.
        known: positions of the model's first points, the corners of a target; None: there are none.

    Raises:
        InputDataError: the camera's model is unknown, or cannot be kept as it is.
        ReconstructionError, ConvergenceError: as ``refine``.
    """
    call = _Call(
        options=options, progress=progress, frame=frame, known=known, trusted=linear.trusted
    )
    if known is None:
        return _with_intrinsics(model, base_T_gripper, camera, linear, call)
    # The robot is asked first: imposed, a wrong size makes the robot look noisy, which hides it.
    asked = replace(call, known=replace(known, log_scale_sigma=_FREE_LOG_SCALE))
    view = _with_intrinsics(model, base_T_gripper, camera, linear, asked)
    if scale_agrees(view.refinement, known):
        return _with_intrinsics(model, base_T_gripper, camera, linear, call)
    ratio = float(np.exp(view.refinement.state.log_scale))
    return replace(
        view,
        scale_note=(
            f"By the robot's measure the target is {ratio:.4f} ± "
            f"{ratio * view.refinement.log_scale_std:.4f} times as large as its file says; the robot's "
            "measure was used; check the lengths in the target file."
        ),
    )


def _with_intrinsics(
    model: SfmModel,
    base_T_gripper: Array,
    camera: CameraModel | None,
    linear: LinearStart,
    call: _Call,
) -> View:
    """Refine with the intrinsics kept or refined."""
    if camera is None:
        note = "No camera file was given: the intrinsics were found from the images."
        return _refined(model, base_T_gripper, model.camera, linear, call, note=note, free=True)
    wish = call.options.graph.intrinsics
    if wish in ("prior", "free"):
        note = f"The camera file's intrinsics were refined ({wish})."
        return _refined(model, base_T_gripper, camera, linear, call, note=note, free=wish == "free")
    if not covers_image(camera):
        if wish == "fixed":
            raise InputDataError(
                f"the camera file's distortion ({camera.model}) folds the image over before its "
                "corners, so pixels there have no line of sight; use --graph.intrinsics prior to "
                "refine it, or calibrate the camera again"
            )
        reason = "The camera file's distortion folds the image over before its corners"
    else:
        start = start_state(model, [camera], linear)
        kept = call.refine(model, base_T_gripper, start, intrinsics=())
        contradiction = None if wish == "fixed" else _contradiction(base_T_gripper, kept, call)
        if contradiction is None:
            return View(
                refinement=kept,
                camera=camera,
                refined=False,
                std=np.zeros(len(camera.params)),
                note="The camera file's intrinsics were kept.",
            )
        reason = contradiction
    note = f"{reason}: its intrinsics were refined, with the file's values as prior."
    return _refined(model, base_T_gripper, camera, linear, call, note=note, free=False)


def _contradiction(base_T_gripper: Array, kept: Refinement, call: _Call) -> str | None:
    """In words how the images contradict kept intrinsics, or None if they do not."""
    prior = _prior(kept.state.cameras[0], free=False)
    (pull,) = intrinsics_pull(
        base_T_gripper, kept, [prior], call.known, call.options.priors, inverted=call.inverted
    )
    count = len(prior.unknown)
    if pull <= _OVERDISPERSION * special.chdtri(count, _CONTRADICTION):
        return None
    return f"The images contradict the camera file (chi-square {pull:.0f} of {count})"
