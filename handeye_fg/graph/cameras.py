"""What is done with the intrinsics: kept as given, or unknowns of the graph; entry ``refine_views``.

Either way the observations are held against the camera's own model, and a model that is refined has its
own parameters for unknowns, no more and no fewer.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg.errors import InputDataError
from handeye_fg.findings import FocalOffset, LinearStart, OtherIntrinsics
from handeye_fg.frames import Array
from handeye_fg.graph.freed import Freed, focal_offset, freed, other, refined
from handeye_fg.graph.holdout import chosen
from handeye_fg.graph.known import Known, of_model
from handeye_fg.graph.problem import IntrinsicsPrior
from handeye_fg.graph.refine import refine, start_state
from handeye_fg.graph.summary import Refinement, scale_agrees
from handeye_fg.intrinsics import covers_image, nearest
from handeye_fg.lens import embedding, generalised, lens_of, refinable
from handeye_fg.options import Options
from handeye_fg.priors import CameraPrior
from handeye_fg.progress import Progress
from handeye_fg.types import CameraModel, KnownPoints, Rig, SfmModel

# Standard deviations of a camera file's values: what a factory or a hasty calibration leaves.
_FILE_FOCAL = 0.01  # of the focal length
_FILE_CENTRE = 0.01  # of the image width
_FILE_RADIAL, _FILE_TANGENTIAL = 0.1, 0.005
# With k3 the three radial terms trade with each other, and a file's values of them say little one by one:
# factors for k1, k2 and k3.
_THREE_TERMS = (1.0, 10.0, 30.0)
# Without a file, so wide that they only keep a degenerate problem finite.
_FREE_FOCAL, _FREE_CENTRE = 0.5, 0.05
_FREE_RADIAL, _FREE_TANGENTIAL = 1.0, 0.05

# The images contradict the file where its values are this improbable.
_CONTRADICTION = 1e-6
# A standard deviation of the logarithm of the scale that leaves it to the robot.
_FREE_LOG_SCALE = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Intrinsics:
    """Final intrinsics of a camera.

    Attributes:
        camera: the intrinsics; the given ones where they were kept.
        refined: whether they were unknowns.
        std: standard deviations (k,) of ``camera.params``, zeros where kept.
        note: what was done and why, in words.
        focal_offset: how focal length and the camera's position along its axis are tied; None where the
            motion does not determine the latter.
        other: X with the intrinsics free where they were kept, or at the given values where they were
            refined; None where none were given, or those given fold the image over.
        contradiction: how the images contradict kept ones, in words, and the camera to be refined; None
            if they do not.
    """

    camera: CameraModel
    refined: bool
    std: Array
    note: str
    focal_offset: FocalOffset | None
    other: OtherIntrinsics | None = None
    contradiction: tuple[str, CameraModel] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A refinement and the intrinsics that belong to it.

    Attributes:
        refinement: the optimum.
        intrinsics: of each camera.
        beliefs: the prior of each camera's intrinsics in the refinement.
        scale_note: in words, if the size of a known target was not kept; "" otherwise.
    """

    refinement: Refinement
    intrinsics: tuple[Intrinsics, ...]
    beliefs: tuple[IntrinsicsPrior, ...]
    scale_note: str = ""


def _prior(camera: CameraModel, *, free: bool, given: CameraPrior | None = None) -> IntrinsicsPrior:
    """The prior around a camera; ``given``: what the user says of a camera file, if anything."""
    focal, centre, radial, tangential = (
        (_FREE_FOCAL, _FREE_CENTRE, _FREE_RADIAL, _FREE_TANGENTIAL)
        if free
        else (_FILE_FOCAL, _FILE_CENTRE, _FILE_RADIAL, _FILE_TANGENTIAL)
    )
    lens, into = lens_of(camera), embedding(camera.model)
    coefficients = np.full(8, radial)
    if not lens.fisheye:
        coefficients[2:4] = tangential
    if camera.model == "FULL_OPENCV":
        coefficients[[0, 1, 4]] *= _THREE_TERMS
    centre_px = centre * camera.width
    if given is not None:
        focal, centre_px = 0.01 * given.focal_percent, given.centre_px
    family = np.concatenate([focal * lens.focal, [centre_px] * 2, coefficients])
    sigmas, unknown = np.zeros(len(camera.params)), refinable(camera.model)
    sigmas[unknown] = (into.T @ family / into.sum(axis=0))[unknown]
    return IntrinsicsPrior(params=camera.params, sigmas=sigmas)


def free_intrinsics(camera: CameraModel) -> IntrinsicsPrior:
    """Intrinsics that the images alone determine, around a camera."""
    return _prior(camera, free=True)


def kept_intrinsics(camera: CameraModel) -> IntrinsicsPrior:
    """Intrinsics that stay as they are."""
    return IntrinsicsPrior(params=camera.params, sigmas=np.zeros(len(camera.params)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Call:
    """What every refinement shares; the attributes are the arguments of ``refine_views``."""

    model: SfmModel
    base_T_gripper: Array
    linear: LinearStart
    rig: Rig | None
    options: Options
    frame: str
    progress: Progress
    known: KnownPoints | None

    @property
    def priors(self) -> tuple[Known, ...]:
        """What the user knows beforehand, in terms of the unknowns."""
        return of_model(self.options.priors, self.model, self.rig)

    @property
    def held(self) -> NDArray[np.bool_] | None:
        """Which robot poses are kept out."""
        share = self.options.holdout
        return chosen(self.base_T_gripper, share, self.options.seed) if share > 0.0 else None

    @property
    def of_file(self) -> CameraPrior | None:
        """What the user says of the camera file."""
        found = [prior for prior in self.options.priors if isinstance(prior, CameraPrior)]
        return found[-1] if found else None

    @property
    def inverted(self) -> bool:
        """Whether the robot poses are gripper_T_base."""
        return self.options.setup == "eye-to-hand"

    def refined(
        self,
        given: Sequence[CameraModel],
        notes: Mapping[int, str],
        *,
        free: bool,
        from_file: bool = True,
    ) -> View:
        """Refine, with the intrinsics of some cameras as unknowns.

        Args:
            given: intrinsics of each camera; those that are refined have their prior there.
            notes: the cameras whose intrinsics are refined, and why.
            free: whether the prior is wide.
            from_file: whether the intrinsics were given by the user.
        """
        cameras, beliefs = list(given), [kept_intrinsics(camera) for camera in given]
        for k in notes:
            cameras[k], _ = nearest(self.model.cameras[k], given[k])
            beliefs[k] = _prior(given[k], free=free, given=self.of_file)
        final = refine(
            self.model,
            self.base_T_gripper,
            start_state(self.model, cameras, self.linear, self.rig),
            intrinsics=beliefs if notes else (),
            noise=self.options.noise,
            options=self.options.graph,
            progress=self.progress,
            frame=self.frame,
            known=self.known,
            priors=self.priors,
            inverted=self.inverted,
            trusted=self.linear.trusted,
            held=self.held,
        )
        intrinsics = self._kept(final, given, beliefs)
        for k, note in notes.items():
            joint, camera = refined(final, beliefs[k], k), final.state.cameras[k]
            usable = from_file and covers_image(given[k])
            intrinsics[k] = Intrinsics(
                camera=camera,
                refined=True,
                std=np.sqrt(np.diag(final.intrinsics_covariances[k])),
                note=note,
                focal_offset=focal_offset(final, joint, beliefs[k].unknown, k),
                other=other(final, joint, k, kept=False) if usable else None,
            )
        return View(
            refinement=final,
            intrinsics=tuple(intrinsics[k] for k in range(len(given))),
            beliefs=tuple(beliefs),
        )

    def _kept(
        self,
        final: Refinement,
        given: Sequence[CameraModel],
        beliefs: Sequence[IntrinsicsPrior],
    ) -> dict[int, Intrinsics]:
        """The cameras whose intrinsics were kept, and what the images say of these."""
        kept = [k for k, belief in enumerate(beliefs) if not belief.unknown]
        if not kept:
            return {}
        cameras, wide = list(final.state.cameras), list(beliefs)
        for k in kept:
            cameras[k] = generalised(given[k])
            wide[k] = _prior(cameras[k], free=True)
        found = freed(
            self.base_T_gripper,
            final,
            replace(final.state, cameras=tuple(cameras)),
            wide,
            self.options.noise,
            self.known,
            self.priors,
            inverted=self.inverted,
        )
        result = {}
        for k in kept:
            unknown = refinable(given[k].model).tolist()
            into = embedding(given[k].model)[np.ix_(wide[k].unknown, unknown)]
            own = found[k].within(into)
            result[k] = Intrinsics(
                camera=given[k],
                refined=False,
                std=np.zeros(len(given[k].params)),
                note="The camera file's intrinsics were kept.",
                focal_offset=focal_offset(final, own, unknown, k),
                other=other(final, own, k, kept=True),
                contradiction=_contradiction(found[k], own, given[k], cameras[k]),
            )
        return result


def refine_views(
    model: SfmModel,
    base_T_gripper: Array,
    given: Sequence[CameraModel] | None,
    linear: LinearStart,
    options: Options,
    frame: str,
    progress: Progress,
    known: KnownPoints | None = None,
    rig: Rig | None = None,
) -> View:
    """Refine with the intrinsics kept or refined, as the options and the images ask for.

    Where the robot contradicts the size of a known target, the robot's measure counts: a print that
    came out at another size, or a length mistyped, is commoner than an arm of the wrong size.

    Args:
        model: the SfM model; where no camera is given, its intrinsics are the start.
        base_T_gripper: reported robot poses (n, 4, 4), metres, in the order of the rig, or of the
            model's images; for eye-to-hand their inverses.
        given: the given intrinsics of each camera, or None.
        linear: the linear start.
        options: of the calibration.
        frame: parent frame of X.
        progress: told the number of iterations.
        known: positions of the model's first points, the corners of a target; None: there are none.
        rig: which camera took an image, and at which robot pose; None: one camera.

    Raises:
        InputDataError: a camera's model is unknown, or cannot be kept as it is.
        ReconstructionError, ConvergenceError: as ``refine``.
    """
    call = _Call(
        model=model,
        base_T_gripper=base_T_gripper,
        linear=linear,
        rig=rig,
        options=options,
        frame=frame,
        progress=progress,
        known=known,
    )
    if known is None:
        return _with_intrinsics(call, given)
    # The robot is asked first: imposed, a wrong size makes the robot look noisy, which hides it.
    asked = replace(call, known=replace(known, log_scale_sigma=_FREE_LOG_SCALE))
    view = _with_intrinsics(asked, given)
    if scale_agrees(view.refinement, known):
        return _with_intrinsics(call, given)
    ratio = float(np.exp(view.refinement.state.log_scale))
    return replace(
        view,
        scale_note=(
            f"By the robot's measure the target is {ratio:.4f} ± "
            f"{ratio * view.refinement.log_scale_std:.4f} times as large as its file says; the robot's "
            "measure was used; check the lengths in the target file."
        ),
    )


def _with_intrinsics(call: _Call, given: Sequence[CameraModel] | None) -> View:
    """Refine with the intrinsics kept or refined.

    Raises:
        InputDataError: see ``refine_views``.
    """
    wish = call.options.graph.intrinsics
    if call.of_file is not None:
        if given is None or wish in ("fixed", "free"):
            raise InputDataError(
                "a prior of kind intrinsics says how right a camera file is, but the intrinsics are "
                f"{'found without one' if given is None else wish}; give the file, and leave "
                "--graph.intrinsics at auto or prior"
            )
        wish = "prior"
    if given is None:
        note = "No camera file was given: the intrinsics were found from the images."
        found = call.model.cameras
        notes = dict.fromkeys(range(len(found)), note)
        return call.refined(found, notes, free=True, from_file=False)
    if wish in ("prior", "free"):
        note = f"The camera file's intrinsics were refined ({wish})."
        notes = dict.fromkeys(range(len(given)), note)
        return call.refined(given, notes, free=wish == "free")
    reasons = {k: _folds(camera) for k, camera in enumerate(given) if not covers_image(camera)}
    if reasons and wish == "fixed":
        raise InputDataError(
            f"{next(iter(reasons.values()))}, so pixels there have no line of sight; use "
            "--graph.intrinsics prior to refine it, or calibrate the camera again"
        )
    cameras = list(given)
    while True:
        notes = {
            k: f"{reason}: its intrinsics were refined, with the file's values as prior."
            for k, reason in reasons.items()
        }
        view = call.refined(cameras, notes, free=False)
        more = {k: one.contradiction for k, one in enumerate(view.intrinsics) if one.contradiction}
        if not more or wish == "fixed":
            return view
        for k, (reason, camera) in more.items():
            reasons[k], cameras[k] = reason, camera


def _folds(camera: CameraModel) -> str:
    return f"The camera file's distortion ({camera.model}) folds the image over before its corners"


def _contradiction(
    wide: Freed, own: Freed, camera: CameraModel, general: CameraModel
) -> tuple[str, CameraModel] | None:
    """How the images contradict kept intrinsics, in words, and the camera to be refined.

    That is the given one, or, where the images see a distortion that its model cannot have, the general
    one of its family. None if there is no contradiction.
    """
    count, more = len(wide.offset), len(wide.offset) - len(own.offset)
    if not _improbable(wide.pull, count):
        return None
    reason = f"The images contradict the camera file (chi-square {wide.pull:.0f} of {count})"
    if not _improbable(wide.pull - own.pull, more):
        return reason, camera
    return f"{reason} and see more distortion than {camera.model} has, but {general.model}", general


def _improbable(square: float, count: int) -> bool:
    """Whether a chi-square of ``count`` is too large for right intrinsics."""
    return bool(count > 0 and square > special.chdtri(count, _CONTRADICTION))
