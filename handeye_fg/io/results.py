"""The result of a calibration, and ``result.json``, its form on disk (``result.schema.json``).

In the file rotations are degrees and translations of residuals, noise and standard deviations are
millimetres, as their names say; matrices and the covariance are in metres and radians, at full
precision. A figure that is not finite is null.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Literal, cast

import numpy as np

from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.files import write_atomic
from handeye_fg.io.other_intrinsics import offset_document, other_document
from handeye_fg.observability import free_lean
from handeye_fg.types import (
    CameraModel,
    FocalOffset,
    FreeDirection,
    LinearStart,
    NoiseLevels,
    OtherIntrinsics,
    SecondStart,
    Setup,
)

SCHEMA_VERSION = "1"
FILE_NAME = "result.json"
FREE_COMPONENT = 0.1
"""A component of X has no standard deviation where a free direction leans on its axis by more."""

_FIGURES_OF_IMAGES = (
    "residual_rotation",
    "residual_translation",
    "reprojection_rms",
    "w_test",
    "influence_rotation",
    "influence_translation",
)

Document = dict[str, object]
Status = Literal["ok", "partial"]


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
        reason: why it is unregistered, left out or an outlier; "" otherwise.
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
    reason: str = ""

    def __post_init__(self) -> None:
        if self.base_T_camera is not None:
            _set_pose(self, "base_T_camera")
        for name in _FIGURES_OF_IMAGES:
            if getattr(self, name) is not None:
                _check_finite(self, name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SfmSummary:
    """Size and quality of the reconstruction."""

    n_images: int
    n_registered: int
    n_points: int
    n_observations: int
    mean_reprojection_px: float

    def __post_init__(self) -> None:
        _check_finite(self, "mean_reprojection_px")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetSummary:
    """What a known target gave.

    Attributes:
        kind: "charuco", "chessboard", "circles", "acircles" or "apriltag_grid".
        n_images: images that show it.
        n_corners: observed corners that were used.
        rms_px: root mean square length of their reprojection errors, pixels.
        corner_px: standard deviation of an observed corner, per axis, pixels.
        base_T_target: its pose (4, 4), metres; for eye-to-hand gripper_T_target.
        note: what was done with the lengths of the target file, in words.
    """

    kind: str
    n_images: int
    n_corners: int
    rms_px: float
    corner_px: float
    base_T_target: Array
    note: str

    def __post_init__(self) -> None:
        _set_pose(self, "base_T_target")
        for name in ("rms_px", "corner_px"):
            _check_finite(self, name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """X = parent_T_camera with its uncertainty, and all that a report needs.

    Attributes:
        status: "ok", or "partial" where ``free_directions`` is not empty.
        setup: "eye-in-hand" or "eye-to-hand".
        message: one sentence for a person.
        matrix: X (4, 4), metres: gripper_T_camera, or base_T_camera for eye-to-hand.
        covariance: 6x6 of X, order (rotation, translation), right perturbation in the camera frame,
            radians and metres; of the determined subspace only, where directions are free. None
            where the method gives none.
        free_directions: what the data leave undetermined.
        metres_per_world_unit, metres_per_world_unit_std: scale of the SfM model and its standard
            deviation; the latter is written as null, and read as NaN, where the scale is free or
            has none.
        base_T_world: Z (4, 4), metres; for eye-to-hand, where the scene moves with the gripper, it is
            gripper_T_world. None for motions, which have no world.
        initial: the closed form: the start of a refinement, or the answer itself.
        images: one entry for each image or pose row of the input.
        observability: named figures about what the motion determines.
        timing_s: seconds by stage.
        provenance: versions, options digest, input digest, seed.
        noise: noise levels used; None where the method models none.
        camera: final intrinsics; None where there were no images.
        intrinsics_refined: whether they were estimated.
        intrinsics_std: standard deviations (k,) of ``camera.params``; zeros where fixed.
        intrinsics_note: what was done with the intrinsics and why, in words.
        other_intrinsics: X with the other choice, free or fixed; None where no intrinsics were given.
        focal_offset: how focal length and the camera's position along its axis are tied; None where
            there were no images.
        sfm: size of the reconstruction; None where there were no images.
        target: what a known target gave; None without target.
        second_start: whether another start of the refinement leads to the same optimum; None where
            there was no refinement.
    """

    status: Status
    setup: Setup
    message: str
    matrix: Array
    covariance: Array | None
    free_directions: tuple[FreeDirection, ...]
    metres_per_world_unit: float
    metres_per_world_unit_std: float
    base_T_world: Array | None
    initial: LinearStart
    images: tuple[ImageReport, ...]
    observability: Mapping[str, float]
    timing_s: Mapping[str, float]
    provenance: Mapping[str, str | int]
    noise: NoiseLevels | None = None
    camera: CameraModel | None = None
    intrinsics_refined: bool = False
    intrinsics_std: Array | None = None
    intrinsics_note: str = ""
    other_intrinsics: OtherIntrinsics | None = None
    focal_offset: FocalOffset | None = None
    sfm: SfmSummary | None = None
    target: TargetSummary | None = None
    second_start: SecondStart | None = None

    def __post_init__(self) -> None:
        _set_pose(self, "matrix")
        if self.base_T_world is not None:
            _set_pose(self, "base_T_world")
        if self.covariance is not None:
            _set_array(self, "covariance", (6, 6))
        if (self.camera is None) != (self.intrinsics_std is None):
            raise ValueError("camera and intrinsics_std must be given together")
        if self.camera is not None:
            _set_array(self, "intrinsics_std", self.camera.params.shape)
        _check_finite(self, "metres_per_world_unit")
        if self.noise is not None:
            of_images = () if self.sfm is None else ("pixel",)
            for name in ("robot_rotation", "robot_translation", *of_images):
                _check_finite(self.noise, name)
        for name in ("metres_per_world_unit", "residual_rotation", "residual_translation"):
            _check_finite(self.initial, name)
        if self.second_start is not None:
            for name in ("rotation", "translation"):
                _check_finite(self.second_start, name)
        if (self.status == "partial") != bool(self.free_directions):
            raise ValueError(f"{self.status=} with {len(self.free_directions)} free directions")
        for direction in self.free_directions:
            if direction.kind != "scale" and direction.frame != parent_frame(self.setup):
                raise ValueError(
                    f"{direction.frame=} but expected {parent_frame(self.setup)!r}, the parent of X"
                )

    def save(self, folder: Path) -> Path:
        """Write ``result.json``, whole or not at all.

        Args:
            folder: where to; it is made if it does not exist.

        Returns:
            The file.

        Raises:
            InputDataError: the file cannot be written.
        """
        return write_atomic(Path(folder) / FILE_NAME, to_json(to_document(self)))


def parent_frame(setup: Setup) -> Literal["gripper", "base"]:
    """The parent frame of X."""
    return "gripper" if setup == "eye-in-hand" else "base"


def std_rotation_deg(result: Result) -> tuple[float | None, ...]:
    """Standard deviations (3,) of X's rotation about the camera's axes; None where free or unknown."""
    return _std_rotation_deg(result, result.covariance)


def std_translation_mm(result: Result) -> tuple[float | None, ...]:
    """Standard deviations (3,) of X's position along the camera's axes; None where free or unknown."""
    return _std_translation_mm(result, result.covariance)


def _std_rotation_deg(result: Result, covariance: Array | None) -> tuple[float | None, ...]:
    if covariance is None:
        return (None,) * 3
    return _without_free(np.degrees(np.degrees(covariance[:3, :3])), result, "rotation")


def _std_translation_mm(result: Result, covariance: Array | None) -> tuple[float | None, ...]:
    if covariance is None:
        return (None,) * 3
    return _without_free(1e6 * covariance[3:, 3:], result, "translation")


def result_schema() -> Document:
    """The JSON Schema (2020-12) of ``result.json``."""
    text = resources.files("handeye_fg.io").joinpath("result.schema.json").read_text("utf-8")
    return cast("Document", json.loads(text))


def to_document(result: Result) -> Document:
    """The content of ``result.json``: dicts, lists, strings, finite numbers, booleans and None."""
    parent = parent_frame(result.setup)
    scale_is_free = any(direction.kind == "scale" for direction in result.free_directions)
    return {
        "schema_version": SCHEMA_VERSION,
        "status": result.status,
        "setup": result.setup,
        "message": result.message,
        "calibration": {
            "parent": parent,
            "child": "camera",
            "sentence": (
                f"Put a point given in camera coordinates into {parent} coordinates:"
                f" p_{parent} = {parent}_T_camera p_camera."
            ),
            "matrix": result.matrix.tolist(),
            "translation_m": result.matrix[:3, 3].tolist(),
            "quaternion_xyzw": quaternion_xyzw(result.matrix[:3, :3]).tolist(),
            "covariance": _nested(result.covariance),
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
        },
        "metres_per_world_unit": {
            "value": float(result.metres_per_world_unit),
            "std": None if scale_is_free else _finite(result.metres_per_world_unit_std),
        },
        "base_T_world": _nested(result.base_T_world),
        "noise": _noise_document(result.noise),
        "initial": _start_document(result.initial),
        "images": [_image_document(image) for image in result.images],
        "intrinsics": _intrinsics_document(result),
        "sfm": None if result.sfm is None else asdict(result.sfm),
        **({} if result.target is None else {"target": _target_document(result.target)}),
        **_second_start_document(result.second_start),
        "observability": {name: _finite(value) for name, value in result.observability.items()},
        "timing_s": {name: _finite(value) for name, value in result.timing_s.items()},
        "provenance": dict(result.provenance),
    }


def failed_document(setup: Setup, message: str) -> Document:
    """The content of ``result.json`` for a calibration that gave nothing."""
    return {
        "schema_version": SCHEMA_VERSION,
        "status": "failed",
        "setup": setup,
        "message": message,
    }


def to_json(document: Mapping[str, object]) -> str:
    """JSON text (ASCII, finite numbers only), each row of numbers on a line of its own."""
    text = json.dumps(document, indent=2, allow_nan=False)
    rows = re.compile(r"\[\n\s+([^\[\]{}\"]*?)\n\s+\]")  # strings hold no raw line ends
    return rows.sub(lambda row: "[" + " ".join(row[1].split()) + "]", text) + "\n"


def _set_array(owner: object, name: str, shape: tuple[int, ...]) -> None:
    """Replace an array by a checked, read-only copy."""
    array = np.array(getattr(owner, name), dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name}: {array.shape=} but expected finite numbers of shape {shape}")
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def _set_pose(owner: object, name: str) -> None:
    """Replace a pose by a checked, read-only copy."""
    _set_array(owner, name, (4, 4))
    matrix: Array = getattr(owner, name)
    rotation = matrix[:3, :3]
    is_rigid = (
        np.abs(rotation).max() < 2.0  # else its square may overflow
        and np.allclose(rotation @ rotation.T, np.eye(3), rtol=0.0, atol=1e-6)
        and np.linalg.det(rotation) > 0.0
        and np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0))
    )
    if not is_rigid:
        raise ValueError(f"{name}: not a rigid transform")


def _check_finite(owner: object, name: str) -> None:
    if not math.isfinite(getattr(owner, name)):
        raise ValueError(f"{name} is {getattr(owner, name)} but expected a finite number")


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _without_free(
    covariance: Array, result: Result, kind: Literal["rotation", "translation"]
) -> tuple[float | None, ...]:
    """Standard deviations (3,) from a covariance (3, 3); None along the axes that are free."""
    free = np.zeros(3, dtype=bool)
    for direction in result.free_directions:
        if direction.kind == kind:
            free |= np.abs(result.matrix[:3, :3].T @ direction.vector) > FREE_COMPONENT
    if result.free_directions and result.covariance is not None:
        # A free direction of one kind may move the other with it.
        lean = free_lean(result.covariance)
        free |= (lean[:3] if kind == "rotation" else lean[3:]) > FREE_COMPONENT
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))  # rounding leaves -1e-20 on a projection
    return tuple(
        None if is_free else value
        for value, is_free in zip(std.tolist(), free.tolist(), strict=True)
    )


def _nested(array: Array | None) -> object:
    return None if array is None else array.tolist()


def _noise_document(noise: NoiseLevels | None) -> Document | None:
    if noise is None:
        return None
    return {
        "pixel_px": _finite(noise.pixel),
        "robot_rotation_deg": math.degrees(noise.robot_rotation),
        "robot_translation_mm": 1e3 * float(noise.robot_translation),
        "estimated": bool(noise.estimated),
    }


def _intrinsics_document(result: Result) -> Document | None:
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
        "std": _nested(result.intrinsics_std),
        "note": result.intrinsics_note,
        "other": other_document(
            other, _std_rotation_deg(result, covariance), _std_translation_mm(result, covariance)
        ),
        "focal_offset": offset_document(result.focal_offset),
    }


def _target_document(target: TargetSummary) -> Document:
    return {**asdict(target), "base_T_target": target.base_T_target.tolist()}


def _second_start_document(second: SecondStart | None) -> Document:
    if second is None:
        return {}
    return {
        "second_start": {
            "agrees": bool(second.agrees),
            "restarted": bool(second.restarted),
            "rotation_deg": math.degrees(second.rotation),
            "translation_mm": 1e3 * float(second.translation),
        }
    }


def _start_document(start: LinearStart) -> Document:
    return {
        "method": start.method,
        "matrix": start.gripper_T_camera.tolist(),
        "base_T_world": _nested(start.base_T_world),
        "metres_per_world_unit": float(start.metres_per_world_unit),
        "residual_rotation_deg": math.degrees(start.residual_rotation),
        "residual_translation_mm": 1e3 * float(start.residual_translation),
    }


def _image_document(image: ImageReport) -> Document:
    return {
        "name": image.name,
        "registered": bool(image.registered),
        "base_T_camera": _nested(image.base_T_camera),
        "residual_rotation_deg": _degrees(image.residual_rotation),
        "residual_translation_mm": _millimetres(image.residual_translation),
        "reprojection_rms_px": _number(image.reprojection_rms),
        "outlier": bool(image.outlier),
        "w_test": _number(image.w_test),
        "influence_rotation_deg": _degrees(image.influence_rotation),
        "influence_translation_mm": _millimetres(image.influence_translation),
        "reason": image.reason,
    }


def _number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _degrees(radians: float | None) -> float | None:
    return None if radians is None else math.degrees(radians)


def _millimetres(metres: float | None) -> float | None:
    return None if metres is None else 1e3 * float(metres)
