"""What came out of a calibration, in a few sentences for a person."""

from collections.abc import Mapping, Sequence

import numpy as np

from handeye_fg.findings import FocalOffset, SecondStart
from handeye_fg.graph import Refinement, View
from handeye_fg.inputs import Inputs
from handeye_fg.io.holdout import HoldoutReport
from handeye_fg.scene import Scene
from handeye_fg.types import Setup, SfmModel, folders_of

# Static features below this part of all do no harm.
_WORTH_TELLING = 0.01
_STATIC: Mapping[Setup, str] = {
    "eye-in-hand": "text drawn over the images, or the gripper in view",
    "eye-to-hand": "the static background",
}
# Images without pose that the message names; the list of images has all.
_MOST_NAMED = 5
# A proof that fails by chance this seldom has failed.
_FALSE_ALARM = 0.01


def message(
    scene: Scene, inputs: Inputs, view: View, proof: HoldoutReport | None, setup: Setup
) -> str:
    """What came out, what was left out and why, and what is to be done.

    Args:
        scene: camera poses and points, before the refinement.
        inputs: the inputs.
        view: the refinement and its intrinsics.
        proof: how X predicts the robot poses that were kept out of it; None where none were.
        setup: where the camera is.
    """
    model, final = scene.model, view.refinement
    without = (*inputs.unusable, *model.unregistered)
    n, total = len(model.names), len(inputs.names) + len(inputs.unusable)
    parts = [f"Calibrated from {n} of {total} images."]
    if without:
        parts.append(_named(without))
    if missing := missing_cameras(inputs, model):
        parts.append(
            f"No image of {', '.join(missing)} could be placed, so that there is no X of it; take images "
            "that overlap with those of the other cameras."
        )
    if inputs.convention_note:
        parts.append(inputs.convention_note)
    new = () if proof is None else tuple(one.name for one in proof.images)
    if left_out := [name for name, _ in inputs.left_out if name not in new]:
        parts.append(f"{len(left_out)} names without image or pose were left out.")
    if model.static_share >= _WORTH_TELLING:
        parts.append(
            f"{100.0 * model.static_share:.0f} % of the features stayed at their pixel while the robot "
            f"turned ({_STATIC[setup]}) and were left out; masks would tell better what to leave out."
        )
    if model.by_robot:
        parts.append(
            f"{model.by_robot} of the images, which too few matches join to the others, were placed with the "
            "help of the robot's poses."
        )
    if scene.board is not None:
        parts.append(f"The target was found in {len(scene.board.names)} of them.")
    if view.scale_note:
        parts.append(view.scale_note)
    if bad := _bad_poses(model, final):
        parts.append(
            f"The robot poses of {', '.join(bad)} disagree with the others and were left out."
        )
    for k, one in enumerate(view.intrinsics):
        if one.focal_offset is not None and one.focal_offset.confounded:
            parts.append(_confounded(one.focal_offset, k if len(view.intrinsics) > 1 else None))
    if not final.converged:
        parts.append("The refinement stopped at its limit of iterations before it converged.")
    if proof is not None:
        parts.append(_proof(proof))
    if final.second_start is not None:
        parts += _told(final.second_start)
    guessed = [name for name, level in final.level_certainties.items() if level.source == "prior"]
    if guessed:
        parts.append(
            f"The noise level of {' and '.join(guessed).replace('_', ' ')} is a guess for usual arms: the "
            "images say next to nothing about it."
        )
    if not final.arm.found.white:
        parts.append(final.arm.found.reason)
    for found in final.observabilities:  # of several cameras one sentence for what they share
        free = [direction.description for direction in found.free_directions]
        parts += [description for description in free if description not in parts]
    return " ".join(parts)


def missing_cameras(inputs: Inputs, model: SfmModel) -> list[str]:
    """The cameras, by their folders, of which the reconstruction placed no image."""
    return sorted({*folders_of(inputs.names)} - {*folders_of(model.names)})


def _named(without: Sequence[tuple[str, str]]) -> str:
    """The images that were not used, with the reason of each."""
    told = [f"{name} ({reason})" for name, reason in without[:_MOST_NAMED]]
    if more := len(without) - len(told):
        told.append(f"{more} more, see the list of images")
    return f"Not used: {', '.join(told)}."


def _bad_poses(model: SfmModel, final: Refinement) -> list[str]:
    """The images whose robot poses were left out, with how far these are off."""
    lengths = np.linalg.norm(final.residuals.reshape(-1, 2, 3), axis=2)
    named = []
    for name, pose in zip(model.names, final.state.rig.pose, strict=True):
        if final.outliers[pose]:
            degrees, millimetres = np.rad2deg(lengths[pose, 0]), 1e3 * lengths[pose, 1]
            w_test = final.w_test[pose]
            named.append(
                f"{name} ({_plain(millimetres)} mm, {_plain(degrees)} deg, w {_plain(w_test)})"
            )
    return named


def _told(second: SecondStart) -> list[str]:
    """What a user must know of the second start."""
    parts = []
    if second.restarted:
        parts.append(
            "The linear start led to a false optimum; the refinement was repeated from another start."
        )
    if not second.agrees:
        parts.append(
            "A second start of the refinement ended elsewhere, "
            f"{_plain(np.rad2deg(second.rotation))} deg and {_plain(1e3 * second.translation)} mm "
            "away: X is not reliable; take more images, with large rotations about different axes."
        )
    return parts


def _confounded(offset: FocalOffset, camera: int | None) -> str:
    """The warning that focal length and position are confounded; ``camera``: None if there is but one."""
    of = "" if camera is None else f" of camera {camera}"
    return (
        f"Focal length and position along the optical axis{of} are hardly told apart (correlation "
        f"{offset.correlation:.2f}): 1 % of the one is {1e3 * abs(offset.metres_per_percent):.2g} mm "
        "of the other; add poses tilted 20 degrees or more about axes across the view."
    )


def _proof(found: HoldoutReport) -> str:
    """What the held-out poses prove, in words."""
    pixels, expected_pixels = found.reprojection_rms, found.expected_reprojection
    seen = "" if pixels is None else f", and their points to {_plain(pixels)} px"
    expected = "" if expected_pixels is None else f" and {_plain(expected_pixels)} px"
    verdict = (
        "as the uncertainty lets expect"
        if found.probability >= _FALSE_ALARM
        else "more than the uncertainty explains: it is too small, or these poses are wrong"
    )
    what = "new images" if found.new_images else "images that were kept out of it"
    return (
        f"X predicts the robot poses of {len(found.images)} {what} to "
        f"{np.rad2deg(found.rotation):.2g} deg and {1e3 * found.translation:.2g} mm{seen}; "
        f"{np.rad2deg(found.expected_rotation):.2g} deg, {1e3 * found.expected_translation:.2g} mm{expected} are to be "
        f"expected: {verdict} (p = {found.probability:.2g})."
    )


def _plain(value: float) -> str:
    """A positive number with two digits or more, and no exponent unless it is tiny."""
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"
