import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from example_results import make_result
from handeye_fg import frames
from handeye_fg.findings import FocalOffset
from handeye_fg.io.camera_results import CameraReport
from handeye_fg.io.results import Result


@pytest.fixture
def result() -> Result:
    return make_result()


@pytest.fixture
def renamed(result: Result) -> Callable[[str], Result]:
    """The result with another name for its first and its last image."""

    def rename(name: str) -> Result:
        first, *middle, last = result.images
        images = (
            dataclasses.replace(first, name=name),
            *middle,
            dataclasses.replace(last, name=name, reason=name),
        )
        return dataclasses.replace(result, images=images)

    return rename


@pytest.fixture
def two_cameras(result: Result) -> Result:
    """The result as that of two cameras, each of which took an image at each pose; the second is more uncertain."""
    assert result.camera is not None
    assert result.covariance is not None
    assert result.intrinsics_std is not None
    second_T_first = frames.exp(np.array([0.1, -0.2, 0.3, 0.06, 0.01, -0.02]))
    first_T_second = frames.inverse(second_T_first)
    stds = np.sqrt(np.diag(result.covariance))
    tied = np.eye(6)
    tied[0, 4] = tied[4, 0] = -0.93
    cameras = tuple(
        CameraReport(
            name=name,
            matrix=result.matrix @ relative,
            covariance=covariance,
            free_directions=(),
            camera=result.camera,
            intrinsics_refined=True,
            intrinsics_std=result.intrinsics_std,
            intrinsics_note="Refined.",
            intrinsics_correlation=correlation,
            pixel=0.4,
            other_intrinsics=None,
            focal_offset=offset,
            first_T_camera=relative,
            first_T_camera_covariance=known * np.eye(6),
        )
        for name, relative, covariance, correlation, offset, known in (
            ("left", np.eye(4), result.covariance, None, None, 0.0),
            (
                "right",
                first_T_second,
                4.0 * tied * np.outer(stds, stds),
                result.intrinsics_correlation,
                FocalOffset(
                    correlation=0.88, std_factor=2.0, metres_per_percent=1e-3, confounded=True
                ),
                1e-8,
            ),
        )
    )
    images = tuple(
        dataclasses.replace(
            image,
            name=f"{camera.name}/{image.name}",
            base_T_camera=None
            if image.base_T_camera is None
            else image.base_T_camera @ camera.first_T_camera,
        )
        for camera in cameras
        for image in result.images
    )
    return dataclasses.replace(
        result,
        images=images,
        cameras=cameras,
        intrinsics_correlation=None,
        focal_offset=None,
    )
