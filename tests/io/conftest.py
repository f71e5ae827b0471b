from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from handeye_fg.findings import (
    FocalOffset,
    FreeDirection,
    LinearStart,
    NoiseLevels,
    OtherIntrinsics,
)
from handeye_fg.frames import exp
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result, SfmSummary
from handeye_fg.types import CameraModel

X = exp(np.array([0.3, -0.2, 1.4, 0.03, -0.05, 0.09]))


def make_result(**changes: Any) -> Result:
    fields: dict[str, Any] = {
        "status": "ok",
        "setup": "eye-in-hand",
        "message": "All six components of X are determined.",
        "matrix": X,
        "covariance": np.diag([1e-8, 4e-8, 9e-8, 1e-6, 4e-6, 9e-6]),
        "free_directions": (),
        "metres_per_world_unit": 0.25,
        "metres_per_world_unit_std": 0.001,
        "base_T_world": exp(np.array([1.0, 2.0, 0.5, 0.4, 0.1, -0.3])),
        "noise": NoiseLevels(
            pixel=0.5, robot_rotation=5e-4, robot_translation=3e-4, estimated=True
        ),
        "initial": LinearStart(
            method="andreff_scale",
            gripper_T_camera=X,
            base_T_world=np.eye(4),
            metres_per_world_unit=0.24,
            residual_rotation=2e-3,
            residual_translation=1.2e-3,
        ),
        "images": (
            ImageReport(
                name="<b>a</b>.png",
                registered=True,
                base_T_camera=np.eye(4),
                residual_rotation=1e-3,
                residual_translation=2e-3,
                reprojection_rms=0.4,
                outlier=True,
                w_test=58.2,
                std_growth=0.25,
                reason="31 mm from where the images put it",
            ),
            ImageReport(name="frame_\udcff\u2603.png", registered=False, reason="no matches"),
        ),
        "camera": CameraModel(
            model="PINHOLE", width=640, height=480, params=np.array([600.1, 600.2, 320.5, 240.5])
        ),
        "intrinsics_refined": True,
        "intrinsics_std": np.array([0.1, 0.2, 0.3, 0.0]),
        "intrinsics_note": "Refined near the file's values.",
        "intrinsics_correlation": np.vstack(
            [np.linspace(-0.9, 0.9, 18).reshape(3, 6), np.zeros(6)]
        ),
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
            n_images=2,
            n_registered=1,
            n_points=100,
            n_observations=300,
            mean_reprojection_px=0.4,
        ),
        "observability": {"smallest_singular_value": 0.1, "condition": float("inf")},
        "timing_s": {"sfm": 40.0},
        "provenance": {"handeye_fg": "0.1.0", "options_digest": "1f0c", "seed": 0},
    }
    return Result(**(fields | changes))


def free(kind: Any, vector: Any, frame: str = "gripper") -> FreeDirection:
    return FreeDirection(
        kind=kind, vector=np.array(vector), frame=frame, description="Turn about another axis."
    )


@pytest.fixture
def result() -> Result:
    return make_result()


@pytest.fixture
def partial() -> Result:
    """Rotation free about the camera's z, translation along its x and y, and the scale."""
    return make_result(
        status="partial",
        free_directions=(
            free("rotation", X[:3, 2]),
            free("translation", (X[:3, 0] + X[:3, 1]) / np.sqrt(2.0)),
            free("scale", np.zeros(3)),
        ),
    )


@pytest.fixture
def changed() -> Callable[..., Result]:
    """The result with other values for some fields."""
    return make_result
