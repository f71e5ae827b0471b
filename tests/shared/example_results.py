"""A result made by hand, for tests of what is done with results."""

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg import frames
from handeye_fg.findings import (
    FocalOffset,
    LevelCertainty,
    LinearStart,
    NoiseLevels,
    OtherIntrinsics,
    RobotErrors,
)
from handeye_fg.io.certainty import CertaintyReport
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result, SfmSummary
from handeye_fg.point_errors import accuracy
from handeye_fg.types import CameraModel


def make_result(**changes: Any) -> Result:
    """A complete result of 18 images: one not registered, one rejected robot pose."""
    rng = np.random.default_rng(7)
    X = frames.pose(
        Rotation.from_euler("xyz", [3.0, -4.0, 88.0], degrees=True).as_matrix(),
        np.array([0.031, -0.052, 0.094]),
    )
    images = []
    for i in range(17):
        angle = 0.45 * i
        centre = np.array([0.5 + 0.2 * np.cos(angle), 0.25 * np.sin(angle), 0.5 + 0.02 * (i % 5)])
        z = np.array([0.5, 0.0, 0.0]) - centre
        z /= np.linalg.norm(z)
        x = np.cross(z, [0.2, 0.1, 1.0])
        x /= np.linalg.norm(x)
        rejected = i == 5
        images.append(
            ImageReport(
                name=f"frame_{i:04d}.jpg",
                registered=True,
                base_T_camera=frames.pose(np.stack([x, np.cross(z, x), z], axis=1), centre),
                residual_rotation=np.radians(abs(rng.normal(0.0, 0.03))) + 0.1 * rejected,
                residual_translation=0.0004 * abs(rng.normal()) + 0.03 * rejected,
                reprojection_rms=0.4 + 0.1 * rng.random(),
                outlier=rejected,
                w_test=62.0 if rejected else 3.0 * rng.random(),
                influence_rotation=None if rejected else 1e-4 * rng.random(),
                influence_translation=None if rejected else 1e-4 * (1.0 + i % 7),
                std_growth=None if rejected else 0.02 * (1.0 + i % 5),
                reason="its reported pose is 31 mm from where the images put it"
                if rejected
                else "",
            )
        )
    images.append(
        ImageReport(
            name="frame_0017.jpg", registered=False, reason="too few matches with other images"
        )
    )
    mixing = rng.normal(size=(6, 6))
    sigmas = np.array([4e-4, 5e-4, 2e-4, 3e-4, 2.5e-4, 4.1e-4])
    shape = mixing @ mixing.T + 3.0 * np.eye(6)
    correlation = shape / np.sqrt(np.outer(np.diag(shape), np.diag(shape)))
    fields: dict[str, Any] = {
        "status": "ok",
        "setup": "eye-in-hand",
        "message": "All six components of X are determined.",
        "matrix": X,
        "covariance": correlation * np.outer(sigmas, sigmas),
        "free_directions": (),
        "metres_per_world_unit": 0.23456789,
        "metres_per_world_unit_std": 0.000123,
        "base_T_world": frames.pose(np.eye(3), np.array([0.4, 0.1, 0.0])),
        "noise": NoiseLevels(
            pixel=0.43, robot_rotation=5e-4, robot_translation=3e-4, estimated=True
        ),
        "initial": LinearStart(
            method="andreff_scale",
            gripper_T_camera=X @ frames.exp(np.array([2e-3, 1e-3, -2e-3, 1e-3, 2e-3, -1e-3])),
            base_T_world=np.eye(4),
            metres_per_world_unit=0.23312,
            residual_rotation=2e-3,
            residual_translation=1.2e-3,
        ),
        "images": tuple(images),
        "camera": CameraModel(
            model="OPENCV",
            width=1280,
            height=960,
            params=np.array([1090.2, 1089.7, 640.3, 479.8, -0.06, 0.03, 4e-4, -3e-4]),
        ),
        "intrinsics_refined": True,
        "intrinsics_std": np.array([0.6, 0.6, 0.4, 0.4, 5e-4, 1e-3, 6e-5, 0.0]),
        "intrinsics_note": "Refined near the values of the file, which the images contradict.",
        "intrinsics_correlation": np.array([[0.1, 0.0, 0.0, 0.2, 0.1, -0.91], *[[0.0] * 6] * 7]),
        "other_intrinsics": OtherIntrinsics(
            kind="fixed",
            gripper_T_camera=np.eye(4),
            covariance=1e-6 * np.eye(6),
            shift_rotation=2e-4,
            shift_translation=3.1e-4,
            shift_sigma=1.25,
        ),
        "focal_offset": FocalOffset(
            correlation=-0.43, std_factor=1.1, metres_per_percent=-1.5e-3, confounded=False
        ),
        "sfm": SfmSummary(
            n_images=18,
            n_registered=17,
            n_points=4210,
            n_observations=23118,
            mean_reprojection_px=0.412,
        ),
        "certainty": CertaintyReport(
            half_widths=np.array([1.1e-3, 1.2e-3, 0.5e-3, 7e-4, 6e-4, 9e-4, 1e-3]),
            degrees_of_freedom=np.array([12.0, 12.5, 13.0, 14.0, 15.0, 16.0, np.inf]),
            levels={
                "pixel": LevelCertainty(
                    degrees_of_freedom=900.0, low=0.95, high=1.05, source="data"
                ),
                "robot_rotation": LevelCertainty(
                    degrees_of_freedom=0.7, low=0.4, high=7.0, source="prior"
                ),
                "robot_translation": LevelCertainty(
                    degrees_of_freedom=np.inf,
                    low=1.0,
                    high=1.0,
                    source="user",
                    found=(1.8, 1.5, 2.2),
                ),
            },
            robot=RobotErrors(
                white=False,
                probability=0.002,
                resampled_ratio=1.4,
                hidden_rotation=5e-4,
                hidden_translation=3e-4,
                reason="The robot's errors are not independent noise (p = 0.002).",
            ),
        ),
        "observability": {"smallest_singular_value": 0.123, "axis_diversity": 0.71},
        "timing_s": {"sfm": 41.2, "start": 0.1, "refinement": 6.4},
        "provenance": {"handeye_fg": "0.1.0", "options_digest": "1f0c", "seed": 0},
    }
    if changes.get("status", "ok") == "ok" and changes.get("covariance", X) is not None:
        fields["accuracy"] = accuracy(X, fields["covariance"], 12.0, 0.4)
    return Result(**(fields | changes))
