"""Reprojections as GTSAM's own factors, one for each observation: what the package is held against."""

import gtsam
import pytest

from handeye_fg.graph.variables import camera_key, intrinsics_key, point_key, to_values


def calibration(camera):
    """COLMAP's OPENCV camera as GTSAM's model, which is the same but for a skew."""
    fx, fy, cx, cy, *distortion = camera.params.tolist()
    return gtsam.Cal3DS2(fx, fy, 0.0, cx, cy, *distortion)


def graph_of(tracks, sigmas, cameras, *, with_intrinsics):
    graph = gtsam.NonlinearFactorGraph()
    fixed = calibration(*cameras)
    observations = zip(
        tracks.image_index.tolist(), tracks.point_index.tolist(), tracks.pixels, sigmas, strict=True
    )
    for i, j, pixel, sigma in observations:
        noise, pose, point = (
            gtsam.noiseModel.Isotropic.Sigma(2, sigma),
            camera_key(i),
            point_key(j),
        )
        graph.push_back(
            gtsam.GeneralSFMFactor2Cal3DS2(pixel, noise, pose, point, intrinsics_key(0))
            if with_intrinsics
            else gtsam.GenericProjectionFactorCal3DS2(pixel, noise, pose, point, fixed)
        )
    return graph


def values_of(state, *, with_intrinsics):
    values = to_values(state)
    if with_intrinsics:
        values.insert(intrinsics_key(0), calibration(*state.cameras))
    return values


@pytest.fixture
def reprojection_graph():
    return graph_of


@pytest.fixture
def reprojection_values():
    return values_of
