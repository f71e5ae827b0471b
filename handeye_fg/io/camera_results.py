"""What a result says of one camera: X with its uncertainty, and the intrinsics, as values and as JSON."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from handeye_fg.findings import FocalOffset, FreeDirection, OtherIntrinsics
from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.checks import check_finite, set_array, set_pose
from handeye_fg.io.direction import direction as direction_of
from handeye_fg.io.other_intrinsics import offset_document, other_document
from handeye_fg.observability import free_lean
from handeye_fg.types import CameraModel

FREE_COMPONENT = 0.1
"""A component of a pose has no standard deviation where a free direction leans on its axis by more."""

Document = dict[str, object]
Stds = tuple[float | None, ...]


class Uncertain(Protocol):
    """X with its uncertainty."""

    @property
    def matrix(self) -> Array:
        """X (4, 4), metres."""

    @property
    def covariance(self) -> Array | None:
        """Of X (6, 6), on the determined subspace."""

    @property
    def free_directions(self) -> tuple[FreeDirection, ...]:
        """What the data leave undetermined."""


class Calibrated(Uncertain, Protocol):
    """What a whole result and the report of one of several cameras share."""

    @property
    def camera(self) -> CameraModel | None:
        """Final intrinsics."""

    @property
    def intrinsics_refined(self) -> bool:
        """Whether they were estimated."""

    @property
    def intrinsics_std(self) -> Array | None:
        """Standard deviations of their parameters."""

    @property
    def intrinsics_note(self) -> str:
        """What was done with them and why."""

    @property
    def intrinsics_correlation(self) -> Array | None:
        """Correlation of their parameters with X."""

    @property
    def other_intrinsics(self) -> OtherIntrinsics | None:
        """X with the other choice, free or fixed."""

    @property
    def focal_offset(self) -> FocalOffset | None:
        """How focal length and the position along the axis are tied."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraReport:
    """One of several cameras on an arm.

    Attributes:
        name: the folder of its images.
        matrix: X (4, 4), metres, as in ``Result``.
        covariance: of X (6, 6), as in ``Result``.
        free_directions: what the data leave undetermined.
        camera: final intrinsics.
        intrinsics_refined: whether they were estimated.
        intrinsics_std: standard deviations (k,) of ``camera.params``; zeros where fixed.
        intrinsics_note: what was done with the intrinsics and why, in words.
        intrinsics_correlation: as in ``Result``.
        pixel: standard deviation of an observation in its images, pixels; the noise of the result has
            that of all cameras together.
        other_intrinsics, focal_offset: as in ``Result``.
        first_T_camera: the camera's pose in the first camera (4, 4), metres.
        first_T_camera_covariance: its covariance (6, 6), order (rotation, translation), right
            perturbation, radians and metres; on the determined subspace; zeros for the first camera.
    """

    name: str
    matrix: Array
    covariance: Array
    free_directions: tuple[FreeDirection, ...]
    camera: CameraModel
    intrinsics_refined: bool
    intrinsics_std: Array
    intrinsics_note: str
    pixel: float
    other_intrinsics: OtherIntrinsics | None
    focal_offset: FocalOffset | None
    first_T_camera: Array
    first_T_camera_covariance: Array
    intrinsics_correlation: Array | None = None

    def __post_init__(self) -> None:
        for name in ("matrix", "first_T_camera"):
            set_pose(self, name)
        for name in ("covariance", "first_T_camera_covariance"):
            set_array(self, name, (6, 6))
        set_array(self, "intrinsics_std", self.camera.params.shape)
        if self.intrinsics_correlation is not None:
            set_array(self, "intrinsics_correlation", (len(self.camera.params), 6))
        check_finite(self, "pixel")


def std_rotation_deg(result: Uncertain) -> Stds:
    """Standard deviations (3,) of X's rotation about the camera's axes; None where free or unknown."""
    return _degrees(result.covariance, _free(result, "rotation"))


def std_translation_mm(result: Uncertain) -> Stds:
    """Standard deviations (3,) of X's position along the camera's axes; None where free or unknown."""
    return _millimetres(result.covariance, _free(result, "translation"))


def relative_std_rotation_deg(report: CameraReport) -> Stds:
    """Likewise of the camera's rotation in the first camera."""
    covariance = report.first_T_camera_covariance
    return _degrees(covariance, free_lean(covariance)[:3])


def relative_std_translation_mm(report: CameraReport) -> Stds:
    """Likewise of its position in the first camera."""
    covariance = report.first_T_camera_covariance
    return _millimetres(covariance, free_lean(covariance)[3:])


def _free(result: Uncertain, kind: Literal["rotation", "translation"]) -> Array:
    """How much free directions lean (3,) on each axis of the camera."""
    lean = np.zeros(3)
    for direction in result.free_directions:
        if direction.kind == kind:
            lean = np.maximum(lean, np.abs(result.matrix[:3, :3].T @ direction.vector))
    if result.free_directions and result.covariance is not None:
        # A free direction of one kind may move the other with it.
        moved = free_lean(result.covariance)
        lean = np.maximum(lean, moved[:3] if kind == "rotation" else moved[3:])
    return lean


def _degrees(covariance: Array | None, lean: Array) -> Stds:
    if covariance is None:
        return (None,) * 3
    return _stds(np.degrees(np.degrees(covariance[:3, :3])), lean)


def _millimetres(covariance: Array | None, lean: Array) -> Stds:
    if covariance is None:
        return (None,) * 3
    return _stds(1e6 * covariance[3:, 3:], lean)


def _stds(covariance: Array, lean: Array) -> Stds:
    """Standard deviations (3,) from a covariance (3, 3); None along the axes that are free."""
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))  # rounding leaves -1e-20 on a projection
    return tuple(
        None if is_free else value
        for value, is_free in zip(std.tolist(), (lean > FREE_COMPONENT).tolist(), strict=True)
    )


def calibration_document(result: Calibrated, parent: str) -> Document:
    """X as JSON."""
    return {
        "parent": parent,
        "child": "camera",
        "sentence": direction_of(result.matrix, parent),
        **_pose_document(result.matrix, result.covariance),
        "std_rotation_deg": list(std_rotation_deg(result)),
        "std_translation_mm": list(std_translation_mm(result)),
        "free_directions": [
            {
                "kind": direction.kind,
                "vector": direction.vector.tolist(),
                "frame": direction.frame,
                "description": direction.description,
            }
            for direction in result.free_directions
        ],
    }


def _pose_document(matrix: Array, covariance: Array | None) -> Document:
    return {
        "matrix": matrix.tolist(),
        "translation_m": matrix[:3, 3].tolist(),
        "quaternion_xyzw": quaternion_xyzw(matrix[:3, :3]).tolist(),
        "covariance": nested(covariance),
    }


def intrinsics_document(result: Calibrated) -> Document | None:
    """The intrinsics as JSON; None where there were no images."""
    camera, other = result.camera, result.other_intrinsics
    if camera is None:
        return None
    covariance = None if other is None else other.covariance
    return {
        "model": camera.model,
        "params": camera.params.tolist(),
        "width": int(camera.width),
        "height": int(camera.height),
        "first_pixel_centre": 0.5,
        "refined": bool(result.intrinsics_refined),
        "std": nested(result.intrinsics_std),
        "note": result.intrinsics_note,
        "correlation": nested(result.intrinsics_correlation),
        "other": other_document(
            other,
            _degrees(covariance, _free(result, "rotation")),
            _millimetres(covariance, _free(result, "translation")),
        ),
        "focal_offset": offset_document(result.focal_offset),
    }


def cameras_document(cameras: Sequence[CameraReport], parent: str) -> list[Document]:
    """Several cameras as JSON."""
    return [
        {
            "name": report.name,
            "calibration": calibration_document(report, parent),
            "intrinsics": intrinsics_document(report),
            "pixel_px": float(report.pixel),
            "first_T_camera": {
                **_pose_document(report.first_T_camera, report.first_T_camera_covariance),
                "std_rotation_deg": list(relative_std_rotation_deg(report)),
                "std_translation_mm": list(relative_std_translation_mm(report)),
            },
        }
        for report in cameras
    ]


def nested(array: Array | None) -> object:
    """An array as lists."""
    return None if array is None else array.tolist()
