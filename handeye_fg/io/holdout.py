"""How X predicts what was kept out of it, and its form in ``result.json``: the key ``holdout``."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from handeye_fg.io.checks import check_finite
from handeye_fg.io.fields import Fields

Document = dict[str, object]


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutImage:
    """One image whose robot pose X has not seen.

    Attributes:
        name: of the image.
        rotation, translation: how far its reported robot pose is from the one that its image and X say,
            radians and metres.
        reprojection_rms: of its points, seen from where robot pose and X have the camera, pixels; None
            without points.
        expected_reprojection: the same as the uncertainty of X, images and robot lets expect.
    """

    name: str
    rotation: float
    translation: float
    reprojection_rms: float | None
    expected_reprojection: float | None = None

    def __post_init__(self) -> None:
        for name in ("rotation", "translation"):
            check_finite(self, name)


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldoutReport:
    """The proof on robot poses that X has not seen.

    Attributes:
        images: one entry for each image of such a pose.
        rotation, translation: root mean square errors, radians and metres.
        expected_rotation, expected_translation: those that the uncertainty of X, images and robot lets expect.
        normalised: mean square of the errors in their own standard deviations, all together: 1 on average
            where the uncertainty is right.
        probability: of a larger one by chance.
        within: part of all points that are, seen so, in their ellipse of 95 %; None without points.
        new_images: whether the images had no part in the reconstruction either.
    """

    images: tuple[HeldOutImage, ...]
    rotation: float
    translation: float
    expected_rotation: float
    expected_translation: float
    normalised: float
    probability: float
    within: float | None = None
    new_images: bool = False

    def __post_init__(self) -> None:
        for name in (
            "rotation",
            "translation",
            "expected_rotation",
            "expected_translation",
            "normalised",
            "probability",
        ):
            check_finite(self, name)

    @property
    def reprojection_rms(self) -> float | None:
        """Root mean square of that of the images, pixels."""
        return _root_mean_square([one.reprojection_rms for one in self.images])

    @property
    def expected_reprojection(self) -> float | None:
        """Likewise of what is to be expected."""
        return _root_mean_square([one.expected_reprojection for one in self.images])


def _root_mean_square(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return math.sqrt(sum(value**2 for value in known) / len(known)) if known else None


def holdout_document(report: HoldoutReport) -> Document:
    """The content of the key ``holdout``."""
    return {
        "rotation_deg": math.degrees(report.rotation),
        "translation_mm": 1e3 * report.translation,
        "expected_rotation_deg": math.degrees(report.expected_rotation),
        "expected_translation_mm": 1e3 * report.expected_translation,
        "reprojection_px": report.reprojection_rms,
        "expected_reprojection_px": report.expected_reprojection,
        "within_95": report.within,
        "new_images": report.new_images,
        "normalised": report.normalised,
        "probability": report.probability,
        "images": [
            {
                "name": one.name,
                "rotation_deg": math.degrees(one.rotation),
                "translation_mm": 1e3 * one.translation,
                "reprojection_px": one.reprojection_rms,
                "expected_reprojection_px": one.expected_reprojection,
            }
            for one in report.images
        ],
    }


def read_holdout(fields: Fields) -> HoldoutReport:
    """The report from the content of the key ``holdout``.

    Raises:
        InputDataError: it has not the form of one.
    """
    return HoldoutReport(
        images=tuple(
            HeldOutImage(
                name=one.text("name"),
                rotation=math.radians(one.number("rotation_deg")),
                translation=1e-3 * one.number("translation_mm"),
                reprojection_rms=one.optional_number("reprojection_px"),
                expected_reprojection=one.optional_number("expected_reprojection_px"),
            )
            for one in fields.mappings("images")
        ),
        rotation=math.radians(fields.number("rotation_deg")),
        translation=1e-3 * fields.number("translation_mm"),
        expected_rotation=math.radians(fields.number("expected_rotation_deg")),
        expected_translation=1e-3 * fields.number("expected_translation_mm"),
        normalised=fields.number("normalised"),
        probability=fields.number("probability"),
        within=fields.optional_number("within_95"),
        new_images=fields.flag("new_images"),
    )
