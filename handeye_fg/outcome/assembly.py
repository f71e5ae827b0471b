"""From the stages' answers to the result that users get."""

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from handeye_fg.errors import ConvergenceError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array
from handeye_fg.graph import Refinement, View, corner_fit, median_depth
from handeye_fg.inputs import Inputs
from handeye_fg.io.camera_results import CameraReport, std_rotation_deg, std_translation_mm
from handeye_fg.io.certainty import CertaintyReport
from handeye_fg.io.config import options_digest
from handeye_fg.io.holdout import HoldoutReport
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result, SfmSummary, TargetSummary
from handeye_fg.options import Options, TaskOptions
from handeye_fg.outcome.message import message, missing_cameras
from handeye_fg.outcome.refined_scene import refined_scene
from handeye_fg.point_errors import Accuracy, accuracy
from handeye_fg.proof import report_of
from handeye_fg.scene import Scene
from handeye_fg.types import Setup, SfmModel, folder_of

_PACKAGES = ("handeye-fg", "gtsam", "pycolmap", "numpy", "scipy", "opencv-python-headless")

# An arm that is worse than this, per axis, is broken; wrong conventions give ten times as much.
_WORST_ARM_DEG, _WORST_ARM_MM = 2.0, 30.0
_HELD_OUT = "its robot pose was kept out of X, as --holdout asks for, and predicted by it"
_LEFT_OUT = "the robot pose disagrees with the others and was left out; check its row"


def require_agreement(final: Refinement) -> None:
    """Refuse an answer in which robot and images contradict each other.

    Raises:
        ConvergenceError: the robot poses are off by more than any arm is.
    """
    degrees = np.rad2deg(final.noise.robot_rotation)
    millimetres = 1e3 * final.noise.robot_translation
    worse = degrees > _WORST_ARM_DEG or millimetres > _WORST_ARM_MM
    if final.noise.estimated and worse:
        raise ConvergenceError(
            f"robot poses and images contradict each other: they fit only with {degrees:.2g} deg and "
            f"{millimetres:.2g} mm of robot noise, but no arm has more than {_WORST_ARM_DEG:g} deg "
            f"or {_WORST_ARM_MM:g} mm; check the convention and unit of the poses, that rows belong "
            "to their images, and that the scene did not move"
        )


def assemble(
    scene: Scene,
    inputs: Inputs,
    linear: LinearStart,
    view: View,
    options: Options,
    timing_s: Mapping[str, float],
    proof: HoldoutReport | None = None,
) -> Result:
    """Put the result together.

    Args:
        scene: camera poses and points, before the refinement.
        inputs: the inputs.
        linear: the linear start.
        view: the refinement and its intrinsics.
        options: as used.
        timing_s: seconds by stage.
        proof: how X predicts new images; None: how it predicts poses that were kept out of it, if any were.
    """
    final, model, first = view.refinement, scene.model, view.intrinsics[0]
    if proof is None and final.held_out is not None:
        poses = final.state.rig.pose.tolist()
        proof = report_of(final.held_out, zip(poses, model.names, strict=True))
    result = Result(
        status="partial" if any(one.free_directions for one in final.observabilities) else "ok",
        setup=options.setup,
        message=message(scene, inputs, view, proof, options.setup),
        matrix=final.state.gripper_T_camera,
        covariance=final.observability.covariance,
        free_directions=final.observability.free_directions,
        metres_per_world_unit=final.metres_per_world_unit,
        metres_per_world_unit_std=final.metres_per_world_unit_std,
        base_T_world=final.base_T_world,
        noise=final.noise,
        initial=linear,
        images=_images(model, inputs, final, options.setup),
        camera=first.camera,
        intrinsics_refined=first.refined,
        intrinsics_std=first.std,
        intrinsics_note=first.note,
        intrinsics_correlation=_correlation(final, 0),
        other_intrinsics=first.other,
        focal_offset=first.focal_offset,
        sfm=SfmSummary(
            n_images=len(inputs.names) + len(inputs.unusable),
            n_registered=len(model.names),
            n_points=len(model.tracks.points_world),
            n_observations=len(model.tracks.pixels),
            mean_reprojection_px=model.mean_reprojection_px,
        ),
        target=_target(scene, view),
        second_start=final.second_start,
        holdout=proof,
        cameras=_cameras(model, view)
        if len(model.cameras) > 1 or missing_cameras(inputs, model)
        else (),
        accuracy=_accuracy(final, options.task),
        repeatability=None
        if options.task.repeatability_mm is None
        else 1e-3 * options.task.repeatability_mm,
        scene=refined_scene(
            final,
            model.names,
            linear.gripper_T_camera,
            0 if scene.known is None else len(scene.known.points_world),
            None if inputs.images == Path() else inputs.images,
        ),
        observability={
            "weakest_std_over_limit": final.observability.weakest_std,
            "observations_used": float(len(final.tracks.pixels)),
            "points_used": float(len(final.tracks.points_world)),
            "degrees_of_freedom": final.degrees_of_freedom,
            **{
                f"{name}_degrees_of_freedom": level.degrees_of_freedom
                for name, level in final.level_certainties.items()
            },
            "iterations": float(final.iterations),
        },
        poses_read_as={} if inputs.read_as is None else {"robot": inputs.read_as},
        timing_s=timing_s,
        provenance={
            **{name: version(name) for name in _PACKAGES},
            "options_digest": options_digest(options),
            "input_digest": inputs.digest,
            "convention": ",".join(filter(None, (options.poses.convention, inputs.convention)))
            or "as given",
            "seed": options.seed,
        },
    )
    return replace(result, certainty=_certainty(result, final))


def _accuracy(final: Refinement, task: TaskOptions) -> Accuracy | None:
    """The error that X causes at the work; None where X has free directions."""
    found, given = final.observability, task.distance_mm
    if found.free_directions:
        return None
    return accuracy(
        final.state.gripper_T_camera,
        found.covariance,
        final.degrees_of_freedom,
        median_depth(final) if given is None else 1e-3 * given,
        None if task.tolerance_mm is None else 1e-3 * task.tolerance_mm,
    )


def _certainty(result: Result, final: Refinement) -> CertaintyReport:
    """Intervals, and what they rest on."""
    scale_is_free = any(direction.kind == "scale" for direction in result.free_directions)
    free = [std is None for std in (*std_rotation_deg(result), *std_translation_mm(result))]
    variances = np.append(
        np.diag(final.observability.covariance), final.observability.log_scale_std**2
    )
    half_widths = final.interval_factors[0] * np.sqrt(np.maximum(variances, 0.0))
    return CertaintyReport(
        half_widths=np.where([*free, scale_is_free], np.nan, half_widths),
        degrees_of_freedom=final.freedoms[0],
        levels=final.level_certainties,
        robot=final.arm.found,
    )


def _images(
    model: SfmModel, inputs: Inputs, final: Refinement, setup: Setup
) -> tuple[ImageReport, ...]:
    """One report for each image and each pose of the input, by name."""
    base_T_camera, moving = final.base_T_camera, setup == "eye-to-hand"
    if moving:  # the cameras stand still: X is the pose in every image
        base_T_camera = final.state.gripper_T_cameras[final.state.rig.camera]
    held = ~(final.used | final.outliers)
    reports = [
        ImageReport(
            name=name,
            registered=True,
            base_T_camera=base_T_camera[i],
            residual_rotation=float(np.linalg.norm(final.residuals[pose, :3])),
            residual_translation=float(np.linalg.norm(final.residuals[pose, 3:])),
            reprojection_rms=float(final.reprojection_rms[i]),
            outlier=bool(final.outliers[pose]),
            w_test=_known(final.w_test[pose]),
            influence_rotation=_known(np.linalg.norm(final.influence[pose, :3])),
            influence_translation=_known(np.linalg.norm(final.influence[pose, 3:])),
            std_growth=_known(final.growth[pose]),
            reason=_LEFT_OUT if final.outliers[pose] else _HELD_OUT if held[pose] else "",
            gripper_T_camera=final.base_T_camera[i] if moving else None,
        )
        for i, (name, pose) in enumerate(zip(model.names, final.state.rig.pose, strict=True))
    ]
    without = (*model.unregistered, *inputs.unusable, *inputs.left_out)
    reports += [ImageReport(name=name, registered=False, reason=reason) for name, reason in without]
    return tuple(sorted(reports, key=lambda report: report.name))


def _known(value: float | np.floating[Any]) -> float | None:
    """A figure, or None where there is none."""
    return float(value) if np.isfinite(value) else None


def _correlation(final: Refinement, camera: int) -> Array | None:
    """Of a camera's intrinsics (k) with its X: (k, 6); None where they are fixed."""
    joint = final.x_and_intrinsics[camera]
    stds = np.sqrt(np.diag(joint))
    divisor = np.where(stds > 0.0, stds, 1.0)
    found = (joint / np.outer(divisor, divisor))[6:, :6]
    return np.clip(found, -1.0, 1.0) if found.any() else None


def _cameras(model: SfmModel, view: View) -> tuple[CameraReport, ...]:
    """What is known of each camera."""
    final = view.refinement
    taken_by = final.state.rig.camera[final.tracks.image_index]
    _, first_image = np.unique(model.image_camera, return_index=True)
    return tuple(
        CameraReport(
            name=folder_of(model.names[i]),
            matrix=final.state.gripper_T_cameras[k],
            covariance=final.observabilities[k].covariance,
            free_directions=final.observabilities[k].free_directions,
            camera=intrinsics.camera,
            intrinsics_refined=intrinsics.refined,
            intrinsics_std=intrinsics.std,
            intrinsics_note=intrinsics.note,
            intrinsics_correlation=_correlation(final, k),
            pixel=final.noise.pixel
            * float(np.sqrt(np.mean(final.sigma_scale[taken_by == k] ** 2))),
            other_intrinsics=intrinsics.other,
            focal_offset=intrinsics.focal_offset,
            first_T_camera=final.first_T_cameras[k],
            first_T_camera_covariance=final.first_T_camera_covariances[k],
        )
        for k, (i, intrinsics) in enumerate(zip(first_image, view.intrinsics, strict=True))
    )


def _target(scene: Scene, view: View) -> TargetSummary | None:
    """What the target gave."""
    if scene.board is None or scene.known is None:
        return None
    final = view.refinement
    corners, rms_px = corner_fit(final, len(scene.known.points_world))
    return TargetSummary(
        kind=scene.kind,
        n_images=len(scene.board.names),
        n_corners=corners,
        rms_px=rms_px,
        corner_px=final.noise.corner or rms_px,
        base_T_target=final.state.base_T_world,
        note=view.scale_note or "The lengths of the target file were kept.",
    )
