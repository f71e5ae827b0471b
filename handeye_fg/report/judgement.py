"""What a result is good for, what limits it and what to do next, in words."""

import math

import numpy as np

from handeye_fg.io.camera_results import std_rotation_deg, std_translation_mm
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.report.wording import number, parameter_names, significant

_USUAL_TOLERANCES_MM = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_HIGH = 0.8  # a correlation above which a person should know
_COMPONENTS = tuple(
    f"{kind} {axis}" for kind in ("the rotation about", "the position along") for axis in "xyz"
)
# By ISO 9283 the repeatability is the mean distance plus three of its standard deviations; of normal errors
# of one size on all axes that is so many times the standard deviation of an axis.
_REPEATABILITY = 3.62
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


def ties(result: Result) -> tuple[str, ...]:
    """What the data can hardly tell apart: high correlations, each in a sentence."""
    said = [*_ties_within(result), *_ties_of_intrinsics(result)]
    offset = result.focal_offset
    if offset is not None and abs(offset.correlation) >= _HIGH:
        said.append(
            f"Focal length and the position along the optical axis (correlation {number(offset.correlation, 2)}): "
            "an error of one is an error of the other; more tilt of the camera tells them apart."
        )
    return tuple(said)


def _ties_of_intrinsics(result: Result) -> list[str]:
    if result.camera is None or result.intrinsics_correlation is None:
        return []
    names = parameter_names(result.camera.model, len(result.camera.params))
    return [
        f"The camera's {name} and {_COMPONENTS[j]} (correlation {number(value, 2)})."
        for name, row in zip(names, result.intrinsics_correlation.tolist(), strict=True)
        for j, value in enumerate(row)
        if abs(value) >= _HIGH
    ]


def data_sheet(result: Result) -> str:
    """The noise of the reported positions against the arm's data sheet; "" where nobody stated that."""
    if result.repeatability is None or result.noise is None:
        return ""
    stated = 1e3 * result.repeatability
    times = 1e3 * result.noise.robot_translation / (stated / _REPEATABILITY)
    return (
        f"The data sheet states a repeatability of {significant(stated)} mm, which is {significant(stated / _REPEATABILITY, 2)} mm "
        f"per axis. The reported positions are off by {significant(times, 2)} times as much: to return to a place is easier "
        "than to know where it is, so several times are usual, and dozens mean a wrong tool, time or calibration of the arm."
    )


def _ties_within(result: Result) -> list[str]:
    if result.covariance is None:
        return []
    stds = (*std_rotation_deg(result), *std_translation_mm(result))
    known = [k for k, std in enumerate(stds) if std]
    sigmas = np.sqrt(np.diag(result.covariance))
    return [
        f"{_COMPONENTS[i].capitalize()} and {_COMPONENTS[j]} (correlation {number(value, 2)})."
        for i in known
        for j in known
        if i < j and abs(value := float(result.covariance[i, j] / (sigmas[i] * sigmas[j]))) >= _HIGH
    ]
