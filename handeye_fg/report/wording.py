"""The words and the numbers that the page and the terminal share."""

import math
from collections.abc import Sequence

from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Calibrated
from handeye_fg.io.certainty import CertaintyReport
from handeye_fg.io.direction import direction as direction_of
from handeye_fg.io.holdout import HoldoutReport
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result, TargetSummary, parent_frame

MISSING = "—"
COVARIANCE_CONVENTION = (
    "Order (rotation, translation); right perturbation in the camera frame: "
    "X = mean · Exp(ξ), ξ ~ N(0, covariance), as in GTSAM."
)

_FOCAL, _TWO_FOCAL = ("f", "cx", "cy"), ("fx", "fy", "cx", "cy")
_PARAMETERS = {
    "SIMPLE_PINHOLE": _FOCAL,
    "PINHOLE": _TWO_FOCAL,
    "SIMPLE_RADIAL": (*_FOCAL, "k"),
    "RADIAL": (*_FOCAL, "k1", "k2"),
    "OPENCV": (*_TWO_FOCAL, "k1", "k2", "p1", "p2"),
    "OPENCV_FISHEYE": (*_TWO_FOCAL, "k1", "k2", "k3", "k4"),
    "FULL_OPENCV": (*_TWO_FOCAL, "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
}


def transform_name(result: Result) -> str:
    """X by its frames, such as gripper_T_camera."""
    return f"{parent_frame(result.setup)}_T_camera"


def meaning(result: Result) -> str:
    """One sentence on what X is."""
    carrier = "mounted on the gripper" if result.setup == "eye-in-hand" else "standing in the cell"
    return (
        f"X = {transform_name(result)} is the pose of the camera, {carrier}, in the "
        f"{parent_frame(result.setup)} frame (camera frame: z forward, x right, y down)."
    )


def direction(result: Result) -> str:
    """One sentence on which way X maps points, with a worked number."""
    return direction_of(result.matrix, parent_frame(result.setup))


def parameter_names(model: str, n: int) -> tuple[str, ...]:
    """Names of a camera model's parameters in COLMAP's order; numbers for an unlisted model."""
    names = _PARAMETERS.get(model, ())
    return names if len(names) == n else tuple(str(i + 1) for i in range(n))


def scale_is_free(result: Result) -> bool:
    """Whether the data leave the scale undetermined."""
    return any(item.kind == "scale" for item in result.free_directions)


def extent(result: Result) -> str:
    """How much of the input was of use."""
    if result.sfm is not None:
        return f"{result.sfm.n_registered} of {result.sfm.n_images} registered"
    return f"{sum(row.registered for row in result.images)} of {len(result.images)} paired"


def used(result: Result) -> str:
    """How many images or rows X rests on."""
    held = kept_out(result)
    kept = [row for row in result.images if row.registered and not row.outlier]
    return f"{sum(row.name not in held for row in kept)} of {len(result.images)}"


def became(image: ImageReport, *, held_out: bool) -> str:
    """What became of an image, in a word or two."""
    if image.outlier:
        return "rejected"
    if held_out:
        return "kept out"
    return "used" if image.registered else "not used"


def kept_out(result: Result) -> frozenset[str]:
    """Names of images whose robot pose was kept out of X, for a proof.

    Poses of new images may stand in the file of the others. A new image may have the name of one that X rests on.
    """
    if result.holdout is None:
        return frozenset()
    held = frozenset(one.name for one in result.holdout.images)
    if not result.holdout.new_images:
        return held
    return held.difference(image.name for image in result.images if image.registered)


def target_text(target: TargetSummary) -> str:
    """What a known target gave."""
    return (
        f"{target.kind} in {target.n_images} images, {target.n_corners} corners, "
        f"{target.rms_px:.3f} px rms. {target.note}"
    )


def covered(result: Result) -> str:
    """What the intervals of X are, and what errors are in them."""
    if result.certainty is None:
        errors = (
            "They cover random errors of the images and of the reported poses; a systematic error, such as a robot "
            "whose links are not as its controller believes, is not in them."
        )
    else:
        errors = result.certainty.robot.reason
    return f"{_intervals(result.certainty)} {errors}"


def _intervals(certainty: CertaintyReport | None) -> str:
    if certainty is None:
        return "The intervals are 1.96 standard deviations: normal errors, each axis by itself."
    freedom = float(certainty.degrees_of_freedom[:6].min())
    if math.isinf(freedom):
        return (
            "The intervals are those of normal errors with known noise levels, each axis by itself."
        )
    return (
        "The intervals are those of Student's t, since the noise levels are estimates, with "
        f"{significant(freedom, 2)} degrees of freedom or more, each axis by itself."
    )


def rejected(result: Result) -> str:
    """How many poses were taken for wrong."""
    n = sum(image.outlier for image in result.images)
    noun = "robot pose" if result.sfm is not None else "row"
    return f"{n} {noun}{'' if n == 1 else 's'} rejected"


def scale_text(result: Result) -> str:
    """The scale with its standard deviation, where it has one."""
    value = f"{significant(result.metres_per_world_unit, 7)} metres per world unit"
    if scale_is_free(result):
        return f"{value} (undetermined)"
    if math.isnan(result.metres_per_world_unit_std):
        return value
    std = significant(result.metres_per_world_unit_std, 2)
    return value.replace(" metres", f" ± {std} metres", 1)


def second_start(result: Result) -> str:
    """What a second start of the refinement came to; "" without one."""
    second = result.second_start
    if second is None:
        return ""
    begun = "The refinement was repeated from another start, with a better end. "
    if second.agrees:
        verdict = "A start far off leads to the same optimum."
    else:
        verdict = (
            f"A start far off leads elsewhere: X is {significant(math.degrees(second.rotation), 2)} deg "
            f"and {significant(1000.0 * second.translation, 2)} mm from there."
        )
    return f"{begun if second.restarted else ''}{verdict}"


def residual_text(result: Result) -> str:
    """What the closed form leaves over the pairs of motions."""
    start = result.initial
    return (
        f"{number(math.degrees(start.residual_rotation), 3)} deg and "
        f"{number(1000.0 * start.residual_translation, 2)} mm"
    )


def number(value: float | None, digits: int = 3) -> str:
    """A number with fixed digits, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    text = f"{value:.{digits}f}"
    # No "-0.000": the sign of a zero says nothing.
    return text.removeprefix("-") if float(text) == 0.0 else text


def significant(value: float | None, digits: int = 3) -> str:
    """A number with significant digits, or a dash where there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f"{value:.{digits}g}"


def numbers(values: Sequence[float | None] | Array, digits: int = 3) -> tuple[str, ...]:
    """Several numbers with fixed digits."""
    return tuple(number(None if value is None else float(value), digits) for value in values)


def printable(text: str) -> str:
    """Text with every character that a terminal or a font cannot show as an escape."""
    return "".join(
        char if char.isprintable() else char.encode("unicode_escape").decode() for char in text
    )


def shortened(text: str, length: int = 22) -> str:
    """Text with its middle left out where it is longer than a label may be."""
    if len(text) <= length:
        return text
    half = (length - 1) // 2
    return f"{text[:half]}…{text[-half:]}"


def holdout_text(found: HoldoutReport) -> str:
    """How X predicts what it has not seen, against what is to be expected."""
    within = (
        ""
        if found.within is None
        else f" {number(100.0 * found.within, 0)} % of the points are in their ellipses of 95 %."
    )
    of = (
        f"{len(found.images)} new images"
        if found.new_images
        else f"{len(found.images)} images that were kept out of it"
    )
    return (
        f"X predicts the robot poses of {of}: root mean square errors beside those "
        "that the uncertainty of X, images and robot lets expect. In their own standard deviations the mean square error "
        f"is {significant(found.normalised, 2)} (1 is to be expected); a larger one comes by chance with probability "
        f"{significant(found.probability, 2)}.{within}"
    )


def other_intrinsics_text(result: Calibrated) -> str:
    """What X would be with the other choice of intrinsics, and how it is tied to the focal length."""
    parts = []
    if (other := result.other_intrinsics) is not None:
        case = "free intrinsics" if other.kind == "free" else "the given intrinsics fixed"
        parts.append(
            f"With {case}, X would be {significant(math.degrees(other.shift_rotation), 2)} deg and "
            f"{significant(1e3 * other.shift_translation, 2)} mm from here: "
            f"{number(other.shift_sigma, 2)} times the standard deviation of this change."
        )
    if (offset := result.focal_offset) is not None:
        away = 1e3 * offset.metres_per_percent
        parts.append(
            f"If the focal length were 1 % larger, the camera would be {significant(abs(away), 2)} mm farther "
            f"{'forward' if away > 0.0 else 'back'} along its optical axis (correlation {number(offset.correlation, 2)})."
        )
    return " ".join(parts)
