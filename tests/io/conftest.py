from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from example_results import make_result
from handeye_fg.findings import FreeDirection
from handeye_fg.frames import exp
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result
from handeye_fg.types import CameraModel

X = exp(np.array([0.3, -0.2, 1.4, 0.03, -0.05, 0.09]))


def small_result(**changes: Any) -> Result:
    """A result of two images with hostile names, one of them not registered, and round numbers."""
    fields: dict[str, Any] = {
        "matrix": X,
        "covariance": np.diag([1e-8, 4e-8, 9e-8, 1e-6, 4e-6, 9e-6]),
        "metres_per_world_unit": 0.25,
        "metres_per_world_unit_std": 0.001,
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
        "intrinsics_std": np.array([0.1, 0.2, 0.3, 0.0]),
        "intrinsics_correlation": np.vstack(
            [np.linspace(-0.9, 0.9, 18).reshape(3, 6), np.zeros(6)]
        ),
        "observability": {"smallest_singular_value": 0.1, "condition": float("inf")},
        "accuracy": None,
        "certainty": None,
    }
    return make_result(**(fields | changes))


def free(kind: Any, vector: Any, frame: str = "gripper") -> FreeDirection:
    return FreeDirection(
        kind=kind, vector=np.array(vector), frame=frame, description="Turn about another axis."
    )


@pytest.fixture
def result() -> Result:
    return small_result()


@pytest.fixture
def partial() -> Result:
    """Rotation free about the camera's z, translation along its x and y, and the scale."""
    return small_result(
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
    return small_result
