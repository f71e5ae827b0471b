"""Reprojections as GTSAM's own factors, one for each observation: what the package is held against."""

import gtsam
import pytest

from handeye_fg.graph.variables import calibration, camera_key, intrinsics_key, point_key


def graph_of(tracks, sigmas, opencv_params, *, with_intrinsics):
    graph = gtsam.NonlinearFactorGraph()
    fixed = calibration(opencv_params[0])
    observations = zip(
        tracks.image_index.tolist(), tracks.point_index.tolist(), tracks.pixels, sigmas, strict=True
    )
    for i, j, pixel, sigma in observations:
        noise, camera, point = (
            gtsam.noiseModel.Isotropic.Sigma(2, sigma),
            camera_key(i),
            point_key(j),
        )
        graph.push_back(
            gtsam.GeneralSFMFactor2Cal3DS2(pixel, noise, camera, point, intrinsics_key(0))
            if with_intrinsics
            else gtsam.GenericProjectionFactorCal3DS2(pixel, noise, camera, point, fixed)
        )
    return graph


@pytest.fixture
def reprojection_graph():
    return graph_of
