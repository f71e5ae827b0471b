"""The vectorised reprojections and the elimination of points, against GTSAM's own."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factors._adapter import Key, Kind, checked_factor, pose_key
from factors.testing import assert_jacobians_match, taylor_slope
from handeye_fg.errors import ConvergenceError
from handeye_fg.graph.elimination import batches, eliminate, squares
from handeye_fg.graph.reduced import Layout
from handeye_fg.graph.reprojection import derivatives, reprojection_errors
from handeye_fg.graph.variables import (
    State,
    calibration,
    camera_key,
    intrinsics_key,
    moved,
    point_key,
    shared_keys,
    to_values,
)
from handeye_fg.simulate import simulate_scene
from handeye_fg.types import Rig, Tracks

N_IMAGES = 4


@pytest.fixture
def state_and_tracks():
    """A scene; its last observation has its point behind the camera."""
    scene = simulate_scene(np.random.default_rng(0), n_images=N_IMAGES, n_points=25)
    tracks, cameras = scene.model.tracks, scene.model.world_T_camera
    behind = cameras[0, :3, 3] - 0.3 * cameras[0, :3, 2]
    n_points = len(tracks.points_world)
    tracks = Tracks(
        points_world=np.vstack([tracks.points_world, behind]),
        image_index=np.append(tracks.image_index, 0),
        point_index=np.append(tracks.point_index, n_points),
        pixels=np.vstack([tracks.pixels, [600.0, 500.0]]),
    )
    params = np.array([1100.0, 1050.0, 645.0, 475.0, -0.2, 0.1, 0.004, -0.003])
    return State(
        world_T_camera=cameras,
        points_world=tracks.points_world,
        gripper_T_cameras=np.eye(4)[None],
        base_T_world=np.eye(4),
        log_scale=0.0,
        opencv_params=params[None],
        rig=Rig.of_one_camera(len(cameras)),
    ), tracks


def in_front(tracks):
    """Without the observation behind the camera."""
    return Tracks(
        points_world=tracks.points_world[:-1],
        image_index=tracks.image_index[:-1],
        point_index=tracks.point_index[:-1],
        pixels=tracks.pixels[:-1],
    )


@pytest.mark.parametrize("with_intrinsics", [False, True])
def test_errors_and_derivatives_are_gtsams(state_and_tracks, reprojection_graph, with_intrinsics):
    state, tracks = state_and_tracks
    ones = np.ones(len(tracks.pixels))
    graph = reprojection_graph(tracks, ones, state.opencv_params, with_intrinsics=with_intrinsics)
    values = to_values(state, with_intrinsics=with_intrinsics)
    found = derivatives(
        state,
        tracks.image_index,
        tracks.point_index,
        tracks.pixels,
        with_intrinsics=with_intrinsics,
    )
    blocks = [found.by_pose, found.by_point]
    if with_intrinsics:
        blocks.append(found.by_calibration)
    jacobians = np.concatenate(blocks, axis=2)
    last = graph.size() - 1
    for k in range(graph.size()):
        expected, right = graph.at(k).linearize(values).jacobian()
        np.testing.assert_allclose(jacobians[k], expected, rtol=1e-9, atol=1e-7)
        if k < last or not with_intrinsics:  # with intrinsics, GTSAM lets points behind go free
            np.testing.assert_allclose(found.errors[k], -right.ravel(), atol=1e-8)
    assert np.isnan(reprojection_errors(state, tracks)[last]).all()
    np.testing.assert_array_equal(found.errors[last], 2.0 * state.opencv_params[0, 0])
    np.testing.assert_array_equal(jacobians[last], 0.0)


def test_derivatives_by_differences_and_slope(state_and_tracks):
    state, tracks = state_and_tracks
    pixel = tracks.pixels[:1]

    def residual(world_T_camera, point, cal, *, jacobian):
        here = replace(
            state,
            world_T_camera=world_T_camera.matrix()[None],
            points_world=np.asarray(point)[None],
            opencv_params=np.delete(np.asarray(cal.vector()), 2)[None],
        )
        zero = np.zeros(1, dtype=int)
        found = derivatives(here, zero, zero, pixel, with_intrinsics=True)
        # GTSAM's skew, which is left out of the parameters, moves u by v.
        skew = np.array([cal.skew() * found.by_calibration[0, 0, 2], 0.0])
        blocks = (found.by_pose[0], found.by_point[0], found.by_calibration[0])
        return found.errors[0] + skew, blocks if jacobian else ()

    point, cal = Kind(lambda v, key: v.atPoint3(key), 3), Kind(lambda v, key: v.atCal3DS2(key), 9)
    camera, where = tracks.image_index[0], tracks.point_index[0]
    keys = (pose_key(camera_key(camera)), Key(point_key(where), point), Key(intrinsics_key(0), cal))
    factor = checked_factor(keys, gtsam.noiseModel.Isotropic.Sigma(2, 1.0), residual)
    values = to_values(state, with_intrinsics=True)
    # Derivatives by the distortion are in the thousands, so are those by the pose.
    assert_jacobians_match(factor, values, [6, 3, 9])
    rng = np.random.default_rng(1)
    distance = np.linalg.norm(state.points_world[where] - state.world_T_camera[camera, :3, 3])
    size = np.repeat([1.0, distance, 1.0, 0.0, 0.1], [3, 6, 2, 1, 6])
    slope = taylor_slope(factor, values, [6, 3, 9], size * rng.uniform(0.2, 0.5, 18))
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("with_intrinsics", [False, True])
@pytest.mark.parametrize("n_known", [0, 5])
def test_the_elimination_is_gtsams(state_and_tracks, reprojection_graph, with_intrinsics, n_known):
    state, tracks = state_and_tracks
    tracks = in_front(tracks)
    state = replace(state, points_world=tracks.points_world)
    # One point is seen twice in the same image.
    again = np.append(np.arange(len(tracks.pixels)), len(tracks.pixels) - 1)
    tracks = replace(
        tracks,
        image_index=tracks.image_index[again],
        point_index=tracks.point_index[again],
        pixels=tracks.pixels[again] + 0.1,
    )
    sigmas = np.random.default_rng(2).uniform(0.5, 2.0, len(tracks.pixels))
    layout = Layout(n_poses=N_IMAGES, with_intrinsics=with_intrinsics, n_known=n_known)
    parts = batches(tracks, sigmas, N_IMAGES, n_known)
    assert len(parts) > 1
    found = eliminate(parts, state, layout)

    scene = tracks.point_index >= n_known
    seen = replace(
        tracks,
        image_index=tracks.image_index[scene],
        point_index=tracks.point_index[scene],
        pixels=tracks.pixels[scene],
    )
    graph = reprojection_graph(
        seen, sigmas[scene], state.opencv_params, with_intrinsics=with_intrinsics
    )
    values = to_values(state, with_intrinsics=with_intrinsics)
    linear = graph.linearize(values)
    points = gtsam.Ordering()
    for j in range(n_known, len(tracks.points_world)):
        points.push_back(point_key(j))
    bayes_tree, rest = linear.eliminatePartialMultifrontal(points)
    shared = gtsam.Ordering()
    columns = []
    for key in shared_keys(N_IMAGES, with_intrinsics=with_intrinsics):
        if key in set(rest.keyVector()):
            shared.push_back(key)
            columns.extend(layout.columns(key))
    expected = np.asarray(rest.augmentedHessian(shared))
    hessian = found.quadratic.hessian
    scale = np.abs(expected).max()
    np.testing.assert_allclose(
        hessian[np.ix_(columns, columns)], expected[:-1, :-1], atol=1e-12 * scale
    )
    np.testing.assert_allclose(
        found.quadratic.gradient[columns], expected[:-1, -1], atol=1e-12 * scale
    )
    assert found.quadratic.constant == pytest.approx(expected[-1, -1], rel=1e-9)
    others = np.setdiff1d(np.arange(layout.dim), columns)
    assert not hessian[others].any()
    assert not hessian[:, others].any()
    assert squares(parts, state) == pytest.approx(2.0 * graph.error(values), rel=1e-12)

    # Back to the points: with the shared step s, they minimise |J_p p + J_s s - b|.
    step = np.random.default_rng(3).normal(0.0, 1e-3, layout.dim)
    order = gtsam.Ordering()
    for key in [*points_keys(n_known, tracks), *shared_of(shared)]:
        order.push_back(key)
    jacobian, right = linear.jacobian(order)
    n_rows = 3 * (len(tracks.points_world) - n_known)
    by_points, by_shared = jacobian[:, :n_rows], jacobian[:, n_rows:]
    best = np.linalg.lstsq(by_points, right.ravel() - by_shared @ step[columns])[0]
    np.testing.assert_allclose(found.point_steps(step).ravel(), best, rtol=1e-6, atol=1e-9)
    assert bayes_tree.size() > 0


def points_keys(n_known, tracks):
    return [point_key(j) for j in range(n_known, len(tracks.points_world))]


def shared_of(ordering):
    return [ordering.at(i) for i in range(ordering.size())]


def test_a_point_that_no_camera_determines_is_refused(state_and_tracks):
    state, tracks = state_and_tracks
    parts = batches(tracks, np.ones(len(tracks.pixels)), N_IMAGES, 0)
    layout = Layout(n_poses=N_IMAGES, with_intrinsics=False)
    with pytest.raises(ConvergenceError, match="a scene point is not determined"):
        eliminate(parts, state, layout)


def test_a_step_moves_every_unknown(state_and_tracks):
    state, _ = state_and_tracks
    steps = gtsam.VectorValues()
    for key in shared_keys(N_IMAGES, with_intrinsics=True, n_known=2):
        kind = chr(gtsam.symbolChr(key))
        steps.insert(key, np.full({"l": 1, "k": 9, "p": 3}.get(kind, 6), 0.01))
    n_unknown = len(state.points_world) - 2
    found = moved(state, steps, np.full((n_unknown, 3), 0.02))
    assert found.log_scale == 0.01
    np.testing.assert_allclose(found.points_world[:2], state.points_world[:2] + 0.01)
    np.testing.assert_allclose(found.points_world[2:], state.points_world[2:] + 0.02)
    np.testing.assert_allclose(found.opencv_params, state.opencv_params + 0.01)
    expected = gtsam.Pose3(state.world_T_camera[1]).retract(np.full(6, 0.01)).matrix()
    np.testing.assert_allclose(found.world_T_camera[1], expected, atol=1e-12)
    assert calibration(found.opencv_params[0]).skew() == 0.0
