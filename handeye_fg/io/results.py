"""The result of a calibration, and ``result.json``, its form on disk (``result.schema.json``).

In the file rotations are degrees and translations of residuals, noise and standard deviations are
millimetres, as their names say; matrices and the covariance are in metres and radians, at full
precision. A figure that is not finite is null.
"""

import json
import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from importlib import resources
from pathlib import Path
from typing import Literal, cast

from handeye_fg.export_options import ExportOptions
from handeye_fg.findings import (
    FocalOffset,
    FreeDirection,
    LinearStart,
    NoiseLevels,
    OtherIntrinsics,
    SecondStart,
)
from handeye_fg.frames import Array
from handeye_fg.io.accuracy import accuracy_document
from handeye_fg.io.camera_results import (
    CameraReport,
    Document,
    calibration_document,
    cameras_document,
    intrinsics_document,
    nested,
)
from handeye_fg.io.certainty import CertaintyReport, certainty_document
from handeye_fg.io.checks import check_finite, set_array, set_pose
from handeye_fg.io.files import write_atomic
from handeye_fg.io.holdout import HoldoutReport, holdout_document
from handeye_fg.io.image_results import ImageReport, image_document
from handeye_fg.io.read_as import ReadAs, read_as_document
from handeye_fg.io.scene_file import SCENE_NAME, RefinedScene, write_scene
from handeye_fg.point_errors import Accuracy
from handeye_fg.types import CameraModel, Setup

SCHEMA_VERSION = "1"
FILE_NAME = "result.json"


Status = Literal["ok", "partial"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SfmSummary:
    """Size and quality of the reconstruction."""

    n_images: int
    n_registered: int
    n_points: int
    n_observations: int
    mean_reprojection_px: float

    def __post_init__(self) -> None:
        check_finite(self, "mean_reprojection_px")


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
        set_pose(self, "base_T_target")
        for name in ("rms_px", "corner_px"):
            check_finite(self, name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """X = parent_T_camera with its uncertainty, and all that a report needs.

    Attributes:
        status: "ok", or "partial" where ``free_directions`` is not empty, for any camera.
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
        intrinsics_correlation: of ``camera.params`` (k) with the components of X, in the order of the covariance:
            (k, 6); zeros for what is fixed, None where all are.
        other_intrinsics: X with the other choice, free or fixed; None where no intrinsics were given.
        focal_offset: how focal length and the camera's position along its axis are tied; None where
            there were no images, or the motion does not determine the position.
        sfm: size of the reconstruction; None where there were no images.
        target: what a known target gave; None without target.
        second_start: whether another start of the refinement leads to the same optimum; None where
            there was no refinement.
        holdout: how X predicts robot poses that were kept out of it; None where none were.
        certainty: intervals of X, scale and noise levels; None where there was no refinement.
        cameras: one entry for each of several cameras, the first of which has the figures above; empty
            for one camera.
        accuracy: the error that X causes at the tool and over the distance; None where X has free
            directions, or no covariance.
        poses_read_as: how the files of poses were read, of the "robot" and the "camera"; without those that
            came as arrays.
        repeatability: position repeatability by the arm's data sheet, metres; None where nobody said it.
        scene: points, observations and small images, for pictures; in a file of its own, ``scene.npz``.
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
    intrinsics_correlation: Array | None = None
    other_intrinsics: OtherIntrinsics | None = None
    focal_offset: FocalOffset | None = None
    sfm: SfmSummary | None = None
    target: TargetSummary | None = None
    second_start: SecondStart | None = None
    holdout: HoldoutReport | None = None
    certainty: CertaintyReport | None = None
    cameras: tuple[CameraReport, ...] = ()
    accuracy: Accuracy | None = None
    poses_read_as: Mapping[str, ReadAs] = field(default_factory=dict)
    repeatability: float | None = None
    scene: RefinedScene | None = None

    def __post_init__(self) -> None:
        set_pose(self, "matrix")
        if self.base_T_world is not None:
            set_pose(self, "base_T_world")
        if self.covariance is not None:
            set_array(self, "covariance", (6, 6))
        if (self.camera is None) != (self.intrinsics_std is None):
            raise ValueError("camera and intrinsics_std must be given together")
        if self.camera is not None:
            set_array(self, "intrinsics_std", self.camera.params.shape)
            if self.intrinsics_correlation is not None:
                set_array(self, "intrinsics_correlation", (len(self.camera.params), 6))
        check_finite(self, "metres_per_world_unit")
        if self.noise is not None:
            of_images = () if self.sfm is None else ("pixel",)
            for name in ("robot_rotation", "robot_translation", *of_images):
                check_finite(self.noise, name)
        for name in ("metres_per_world_unit", "residual_rotation", "residual_translation"):
            check_finite(self.initial, name)
        if self.certainty is not None and self.noise is None:
            raise ValueError("certainty must come with noise")
        if self.second_start is not None:
            for name in ("rotation", "translation"):
                check_finite(self.second_start, name)
        free = [*self.free_directions]
        free += [direction for camera in self.cameras for direction in camera.free_directions]
        if (self.status == "partial") != bool(free):
            raise ValueError(f"{self.status=} with {len(free)} free directions")
        for direction in free:
            if direction.kind != "scale" and direction.frame != parent_frame(self.setup):
                raise ValueError(
                    f"{direction.frame=} but expected {parent_frame(self.setup)!r}, the parent of X"
                )

    def save(self, folder: str | Path) -> Path:
        """Write ``result.json``, and ``scene.npz`` where there is a scene; each whole or not at all.

        Args:
            folder: where to; it is made if it does not exist.

        Returns:
            The file ``result.json``.

        Raises:
            InputDataError: a file cannot be written.
        """
        folder = Path(folder)
        if self.scene is not None:
            write_scene(self.scene, folder)
        else:  # that of an earlier result would not belong to this one
            (folder / SCENE_NAME).unlink(missing_ok=True)
        return write_atomic(folder / FILE_NAME, to_json(to_document(self)))

    def export(self, form: str, options: ExportOptions | None = None) -> str:
        """X in the form that another program reads, as text.

        Args:
            form: a format of text, such as "ros2" or "urdf"; ``handeye_fg.export`` lists them, writes files, and
                has the COLMAP model, which is no text.
            options: names of frames; None: defaults.

        Raises:
            InputDataError: there is no such format, or it cannot hold this result.
        """
        from handeye_fg.io.exports import export_text  # noqa: PLC0415  # exports are made of results

        return export_text(self, form, options)


def parent_frame(setup: Setup) -> Literal["gripper", "base"]:
    """The parent frame of X."""
    return "gripper" if setup == "eye-in-hand" else "base"


def result_schema() -> Document:
    """The JSON Schema (2020-12) of ``result.json``."""
    text = resources.files("handeye_fg.io").joinpath("result.schema.json").read_text("utf-8")
    return cast("Document", json.loads(text))


def _data_sheet(result: Result) -> Document:
    """What the user said of the arm."""
    if result.repeatability is None:
        return {}
    return {"data_sheet": {"repeatability_mm": 1e3 * result.repeatability}}


def to_document(result: Result) -> Document:
    """The content of ``result.json``: dicts, lists, strings, finite numbers, booleans and None."""
    parent = parent_frame(result.setup)
    scale_is_free = any(direction.kind == "scale" for direction in result.free_directions)
    return {
        "schema_version": SCHEMA_VERSION,
        "status": result.status,
        "setup": result.setup,
        "message": result.message,
        "calibration": calibration_document(result, parent),
        "metres_per_world_unit": {
            "value": float(result.metres_per_world_unit),
            "std": None if scale_is_free else _finite(result.metres_per_world_unit_std),
        },
        "base_T_world": nested(result.base_T_world),
        "noise": _noise_document(result.noise),
        "initial": _start_document(result.initial),
        "images": [image_document(image) for image in result.images],
        "intrinsics": intrinsics_document(result),
        "sfm": None if result.sfm is None else asdict(result.sfm),
        **({"cameras": cameras_document(result.cameras, parent)} if result.cameras else {}),
        **({} if result.target is None else {"target": _target_document(result.target)}),
        **_second_start_document(result.second_start),
        **({} if result.holdout is None else {"holdout": holdout_document(result.holdout)}),
        **_certainty(result),
        **_data_sheet(result),
        **({} if result.accuracy is None else {"accuracy": accuracy_document(result.accuracy)}),
        **_read_as(result.poses_read_as),
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


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _noise_document(noise: NoiseLevels | None) -> Document | None:
    if noise is None:
        return None
    return {
        "pixel_px": _finite(noise.pixel),
        "robot_rotation_deg": math.degrees(noise.robot_rotation),
        "robot_translation_mm": 1e3 * float(noise.robot_translation),
        "estimated": bool(noise.estimated),
        "image_inflation": float(noise.image_inflation),
        "corner_px": noise.corner,
    }


def _certainty(result: Result) -> Document:
    if result.certainty is None or result.noise is None:
        return {}
    return {"certainty": certainty_document(result.certainty, result.noise)}


def _read_as(of: Mapping[str, ReadAs]) -> Document:
    return {"poses_read_as": read_as_document(of)} if of else {}


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
        "base_T_world": nested(start.base_T_world),
        "metres_per_world_unit": float(start.metres_per_world_unit),
        "residual_rotation_deg": math.degrees(start.residual_rotation),
        "residual_translation_mm": 1e3 * float(start.residual_translation),
    }
