"""Refinements of simulated scenes, and reprojections as GTSAM's own factors to hold the package against."""

import gtsam
import pytest

from handeye_fg.graph import start_state
from handeye_fg.graph.variables import camera_key, intrinsics_key, point_key, to_values
from handeye_fg.options import NoiseOptions
from handeye_fg.solvers import linear_start
from refinements import refined_from


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


def refined_scene(
    scene, *, model=None, reported=None, noise=None, believed=False, priors=(), **how
):
    """A simulated scene refined from its linear start, its intrinsics fixed.

    Another model or other reported robot poses may take the place of the scene's; ``believed``: only the
    poses that the linear start trusts are used at first.
    """
    model = model or scene.model
    reported = scene.robot_poses.base_T_gripper if reported is None else reported
    linear = linear_start(reported, model.world_T_camera, priors=priors)
    if believed:
        how.setdefault("trusted", linear.trusted)
    start = start_state(model, [scene.camera], linear)
    return refined_from(start, model, reported, noise=noise or NoiseOptions(), priors=priors, **how)


@pytest.fixture
def refined():
    return refined_scene


@pytest.fixture
def reprojection_graph():
    return graph_of


@pytest.fixture
def reprojection_values():
    return values_of
