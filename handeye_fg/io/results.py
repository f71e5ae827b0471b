"""The result of a calibration, and ``result.json``, its form on disk (schema published beside it)."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from handeye_fg.frames import Array
from handeye_fg.types import CameraModel, FreeDirection, LinearStart, NoiseLevels, Setup


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
        outlier: whether its robot pose disagrees with the rest beyond its noise.
        reason: why it is unregistered, left out or an outlier; "" otherwise.
    """

    name: str
    registered: bool
    base_T_camera: Array | None = None
    residual_rotation: float | None = None
    residual_translation: float | None = None
    reprojection_rms: float | None = None
    outlier: bool = False
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SfmSummary:
    """Size and quality of the reconstruction."""

    n_images: int
    n_registered: int
    n_points: int
    n_observations: int
    mean_reprojection_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Result:
    """X = parent_T_camera with its uncertainty, and all that a report needs.

    Attributes:
        status: "ok", or "partial" where ``free_directions`` is not empty.
        setup: "eye-in-hand" or "eye-to-hand".
        message: one sentence for a person.
        matrix: X (4, 4), metres: gripper_T_camera, or base_T_camera for eye-to-hand.
        covariance: 6x6 of X, order (rotation, translation), right perturbation in the camera frame,
            radians and metres; of the determined subspace only, where directions are free.
        free_directions: what the data leave undetermined.
        metres_per_world_unit, metres_per_world_unit_std: scale of the SfM model and its standard
            deviation.
        base_T_world: Z (4, 4), metres.
        noise: noise levels used.
        initial: the linear start.
        images: one entry for each image or pose row of the input.
        camera: final intrinsics.
        intrinsics_refined: whether they were estimated.
        intrinsics_std: standard deviations (k,) of ``camera.params``; zeros where fixed.
        intrinsics_note: what was done with the intrinsics and why, in words.
        sfm: size of the reconstruction.
        observability: named figures about what the motion determines.
        timing_s: seconds by stage.
        provenance: versions, options digest, input digest, seed.
    """

    status: Literal["ok", "partial"]
    setup: Setup
    message: str
    matrix: Array
    covariance: Array
    free_directions: tuple[FreeDirection, ...]
    metres_per_world_unit: float
    metres_per_world_unit_std: float
    base_T_world: Array
    noise: NoiseLevels
    initial: LinearStart
    images: tuple[ImageReport, ...]
    camera: CameraModel
    intrinsics_refined: bool
    intrinsics_std: Array
    intrinsics_note: str
    sfm: SfmSummary
    observability: Mapping[str, float]
    timing_s: Mapping[str, float]
    provenance: Mapping[str, str | int]
