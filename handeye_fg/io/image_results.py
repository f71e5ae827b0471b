"""What is known of one image, and its form in ``result.json``: the key ``images``."""

import math
from dataclasses import dataclass

from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Document, nested
from handeye_fg.io.checks import check_finite, set_pose
from handeye_fg.io.fields import Fields

_FIGURES_OF_IMAGES = (
    "residual_rotation",
    "residual_translation",
    "reprojection_rms",
    "w_test",
    "influence_rotation",
    "influence_translation",
    "std_growth",
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImageReport:
    """What is known of one image; quantities are None where the image has no pose.

    Attributes:
        name: image name.
        registered: whether the reconstruction placed it.
        base_T_camera: refined pose (4, 4), metres, or None.
        residual_rotation, residual_translation: how far the reported robot pose is from the refined
            one, radians and metres.
        reprojection_rms: root mean square reprojection error, pixels.
        outlier: whether its robot pose disagrees with the rest beyond its noise; such a pose is left
            out, so that its residual is against what the others say.
        w_test: length of the reported robot pose's standardised residual against the calibration
            without it: that of its rotation or of its translation, the larger (Baarda's test). The
            square of either is chi-square of 3 degrees of freedom for a right pose: half of them have
            less than 1.5, one in a thousand more than 4. None where the others do not determine it.
        influence_rotation, influence_translation: how far X would move without this robot pose,
            radians and metres; None where it is not used, or X is not determined without it.
        std_growth: by how much the standard deviation of X in some direction would be larger without this robot
            pose, at most, relatively: what the pose says; None likewise.
        reason: why it is unregistered, left out or an outlier; "" otherwise.
        gripper_T_camera: for eye-to-hand, where the object moves with the gripper, the camera's refined
            pose in it (4, 4), metres; None for eye-in-hand, where it is X in every image.
    """

    name: str
    registered: bool
    base_T_camera: Array | None = None
    residual_rotation: float | None = None
    residual_translation: float | None = None
    reprojection_rms: float | None = None
    outlier: bool = False
    w_test: float | None = None
    influence_rotation: float | None = None
    influence_translation: float | None = None
    std_growth: float | None = None
    reason: str = ""
    gripper_T_camera: Array | None = None

    def __post_init__(self) -> None:
        for name in ("base_T_camera", "gripper_T_camera"):
            if getattr(self, name) is not None:
                set_pose(self, name)
        for name in _FIGURES_OF_IMAGES:
            if getattr(self, name) is not None:
                check_finite(self, name)


def image_document(image: ImageReport) -> Document:
    """The report as it is in ``result.json``."""
    return {
        "name": image.name,
        "registered": bool(image.registered),
        "base_T_camera": nested(image.base_T_camera),
        "residual_rotation_deg": _degrees(image.residual_rotation),
        "residual_translation_mm": _millimetres(image.residual_translation),
        "reprojection_rms_px": _number(image.reprojection_rms),
        "outlier": bool(image.outlier),
        "w_test": _number(image.w_test),
        "influence_rotation_deg": _degrees(image.influence_rotation),
        "influence_translation_mm": _millimetres(image.influence_translation),
        "std_growth": _number(image.std_growth),
        "reason": image.reason,
        **(
            {}
            if image.gripper_T_camera is None
            else {"gripper_T_camera": nested(image.gripper_T_camera)}
        ),
    }


def read_image(fields: Fields) -> ImageReport:
    """The report that an entry of ``images`` says.

    Raises:
        InputDataError: a field is missing, of another type or not finite.
    """
    return ImageReport(
        name=fields.text("name"),
        registered=fields.flag("registered"),
        base_T_camera=fields.optional_array("base_T_camera", (4, 4)),
        residual_rotation=_radians(fields, "residual_rotation_deg"),
        residual_translation=_metres(fields, "residual_translation_mm"),
        reprojection_rms=fields.optional_number("reprojection_rms_px"),
        outlier=fields.flag("outlier"),
        w_test=fields.optional_number("w_test"),
        influence_rotation=_radians(fields, "influence_rotation_deg"),
        influence_translation=_metres(fields, "influence_translation_mm"),
        std_growth=fields.optional_number("std_growth"),
        reason=fields.text("reason"),
        gripper_T_camera=fields.array("gripper_T_camera", (4, 4))
        if "gripper_T_camera" in fields.values
        else None,
    )


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _degrees(radians: float | None) -> float | None:
    return None if radians is None else math.degrees(radians)


def _millimetres(metres: float | None) -> float | None:
    return None if metres is None else 1e3 * float(metres)


def _radians(fields: Fields, name: str) -> float | None:
    degrees = fields.optional_number(name)
    return None if degrees is None else math.radians(degrees)


def _metres(fields: Fields, name: str) -> float | None:
    millimetres = fields.optional_number(name)
    return None if millimetres is None else millimetres / 1e3
