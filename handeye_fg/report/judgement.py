"""What a result is good for, what limits it and what to do next, in words."""

import math

import numpy as np

from handeye_fg.io.camera_results import std_translation_mm
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.report.wording import significant

_USUAL_TOLERANCES_MM = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
# One pose that moves X by so many times what the median pose does carries it.
_CARRIES = 4.0


def verdict(result: Result) -> str:
    """Whether X is good enough, and for what; "" where its error at the work is not known."""
    if result.accuracy is None:
        return ""
    work = result.accuracy.at_work
    radius_mm, tolerance = 1e3 * work.within_95, result.accuracy.tolerance
    place = f"at {significant(1e3 * work.distance)} mm from the camera"
    said = f"95 % of the points there are put within {significant(radius_mm, 2)} mm"
    if tolerance is None:
        usual = next((mm for mm in _USUAL_TOLERANCES_MM if mm >= radius_mm), None)
        if usual is None:
            return f"Too uncertain for most tasks: {place}, {said}."
        return f"Usable for {usual:g} mm tasks {place}: {said}."
    if radius_mm <= 1e3 * tolerance:
        return f"Usable for the tolerance of {1e3 * tolerance:g} mm {place}: {said}."
    return f"Not good enough for the tolerance of {1e3 * tolerance:g} mm {place}: {said}."


def good_enough(result: Result) -> bool:
    """Whether nothing is free, and the tolerance, if there is one, is kept."""
    found = result.accuracy
    narrow = found is not None and found.tolerance is not None
    return result.status == "ok" and not (narrow and bool(advice(result)))


def advice(result: Result) -> str:
    """What to do where X is not good enough for the tolerance; "" where it is, or nobody gave one."""
    found = result.accuracy
    if found is None or found.tolerance is None or found.at_work.within_95 <= found.tolerance:
        return ""
    if result.certainty is not None and not result.certainty.robot.white:
        return (
            "The arm's own errors, which are alike in neighbouring poses, limit X: more images help little; "
            "calibrate the arm, or take poses near those of the task."
        )
    used = sum(image.registered and not image.outlier for image in result.images)
    needed = math.ceil(used * (found.at_work.within_95 / found.tolerance) ** 2)
    return (
        f"The error falls with the square root of the number of images: about {needed} like these, or "
        "fewer that are chosen well (handeye-fg plan), would do."
    )


def limits(result: Result) -> tuple[str, ...]:
    """What makes the error at the work what it is, each in a sentence."""
    said = (_largest_part(result), _carried(result))
    return tuple(sentence for sentence in said if sentence)


def _largest_part(result: Result) -> str:
    """Along which axis the error at the work is largest, and whether turning or shifting X is to blame."""
    if result.accuracy is None:
        return ""
    work = result.accuracy.at_work
    stds = 1e3 * np.sqrt(np.diag(work.covariance))
    axis = int(np.argmax(stds))
    shift = std_translation_mm(result)[axis] or 0.0
    mostly = "position" if shift**2 > 0.5 * stds[axis] ** 2 else "orientation"
    return (
        f"The error at the work is largest along the camera's {'xyz'[axis]} axis (one standard deviation is "
        f"{significant(float(stds[axis]), 2)} mm); most of it comes from the camera's {mostly} on the "
        f"{'arm' if parent_frame(result.setup) == 'gripper' else 'base'}."
    )


def _carried(result: Result) -> str:
    """The pose that X rests on more than on the others."""
    known = [
        (image.influence_translation, image.name)
        for image in result.images
        if image.influence_translation is not None
    ]
    if len(known) < 3:
        return ""
    largest, name = max(known)
    usual = float(np.median([moved for moved, _ in known]))
    if largest <= _CARRIES * usual:
        return ""
    return (
        f"X rests on one pose: without {name} it would move by {significant(1e3 * largest, 2)} mm, without "
        f"the median pose by {significant(1e3 * usual, 2)} mm; take more images like it."
    )


def next_steps(result: Result) -> tuple[str, ...]:
    """What a person can do for a better X, each in a sentence."""
    steps = []
    if any(image.outlier for image in result.images):
        steps.append(
            "Look at the rows and images that were rejected (below): a wrong one costs data."
        )
    if result.certainty is not None and not result.certainty.robot.white:
        steps.append(
            "The arm's own errors are in X: calibrate the arm, or take poses near those of the task."
        )
    if result.focal_offset is not None and result.focal_offset.confounded:
        steps.append(
            "Tilt the camera by 20 degrees and more about axes across the view, or calibrate it beforehand."
        )
    if result.sfm is not None and result.setup == "eye-in-hand":
        steps.append(
            "Run handeye-fg plan on this folder: it proposes the next poses that make X most certain, and says how certain."
        )
    if result.sfm is not None and result.holdout is None:
        steps.append("Calibrate with --holdout 0.2 for a proof on robot poses that X has not seen.")
    return tuple(steps)
