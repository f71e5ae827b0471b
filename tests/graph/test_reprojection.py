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
    camera_key,
    intrinsics_key,
    moved,
    point_key,
    to_values,
)
from handeye_fg.simulate import simulate_scene
from handeye_fg.types import CameraModel, Rig, Tracks

N_IMAGES = 4
ALL = (tuple(range(8)),)  # the unknown parameters of an OPENCV camera
SKEW = 11  # column of GTSAM's Jacobian by pose, point and calibration


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
        cameras=(CameraModel(model="OPENCV", width=1280, height=960, params=params),),
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
def test_errors_and_derivatives_are_gtsams(
    state_and_tracks, reprojection_graph, reprojection_values, with_intrinsics
):
    state, tracks = state_and_tracks
    ones = np.ones(len(tracks.pixels))
    graph = reprojection_graph(tracks, ones, state.cameras, with_intrinsics=with_intrinsics)
    values = reprojection_values(state, with_intrinsics=with_intrinsics)
    where = (tracks.image_index, tracks.point_index, tracks.pixels)
    found = derivatives(state, *where, ALL if with_intrinsics else ())
    jacobians = np.concatenate([found.by_pose, found.by_point, found.by_intrinsics], axis=2)
    last = graph.size() - 1
    for k in range(graph.size()):
        expected, right = graph.at(k).linearize(values).jacobian()
        if with_intrinsics:
            expected = np.delete(expected, SKEW, axis=1)
        np.testing.assert_allclose(jacobians[k], expected, rtol=1e-9, atol=1e-7)
        if k < last or not with_intrinsics:  # with intrinsics, GTSAM lets points behind go free
            np.testing.assert_allclose(found.errors[k], -right.ravel(), atol=1e-8)
    assert np.isnan(reprojection_errors(state, tracks)[last]).all()
    np.testing.assert_array_equal(found.errors[last], 2.0 * state.cameras[0].params[0])
    np.testing.assert_array_equal(jacobians[last], 0.0)


@pytest.mark.parametrize(
    ("model", "params", "unknown"),
    [
        ("SIMPLE_RADIAL", [1100.0, 645.0, 475.0, -0.2], (0, 1, 2, 3)),
        ("RADIAL", [1100.0, 645.0, 475.0, -0.2, 0.1], (0, 1, 2, 3, 4)),
        (
            "FULL_OPENCV",
            [1100.0, 1050.0, 645.0, 475.0, -0.2, 0.1, 0.004, -0.003, 0.05, 0.1, -0.02, 0.03],
            (0, 1, 2, 3, 4, 5, 6, 7, 8),
        ),
        (
            "OPENCV_FISHEYE",
            [1100.0, 1050.0, 645.0, 475.0, -0.02, 0.01, 0.004, -0.003],
            (0, 2, 4, 5, 6, 7),
        ),
    ],
)
def test_derivatives_by_differences_and_slope(state_and_tracks, model, params, unknown):
    state, tracks = state_and_tracks
    pixel, params = tracks.pixels[:1], np.array(params)
    size = len(unknown)

    def residual(world_T_camera, point, intrinsics, *, jacobian):
        at = params.copy()
        at[list(unknown)] = intrinsics
        here = replace(
            state,
            world_T_camera=world_T_camera.matrix()[None],
            points_world=np.asarray(point)[None],
            cameras=(CameraModel(model=model, width=1280, height=960, params=at),),
        )
        zero = np.zeros(1, dtype=int)
        found = derivatives(here, zero, zero, pixel, [unknown])
        blocks = (found.by_pose[0], found.by_point[0], found.by_intrinsics[0])
        return found.errors[0], blocks if jacobian else ()

    point = Kind(lambda v, key: v.atPoint3(key), 3)
    vector = Kind(lambda v, key: v.atVector(key), size)
    camera, where = tracks.image_index[0], tracks.point_index[0]
    keys = (
        pose_key(camera_key(camera)),
        Key(point_key(where), point),
        Key(intrinsics_key(0), vector),
    )
    factor = checked_factor(keys, gtsam.noiseModel.Isotropic.Sigma(2, 1.0), residual)
    at = replace(state, cameras=(CameraModel(model=model, width=1280, height=960, params=params),))
    values = to_values(at, intrinsics=[unknown])
    # Derivatives by the distortion are in the thousands, so are those by the pose.
    assert_jacobians_match(factor, values, [6, 3, size])
    rng = np.random.default_rng(1)
    distance = np.linalg.norm(state.points_world[where] - state.world_T_camera[camera, :3, 3])
    steps = np.concatenate(
        [np.repeat([1.0, distance], [3, 6]), np.where(params[list(unknown)] > 1.0, 1.0, 0.1)]
    )
    slope = taylor_slope(factor, values, [6, 3, size], steps * rng.uniform(0.2, 0.5, 9 + size))
    assert slope == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("with_intrinsics", [False, True])
@pytest.mark.parametrize("n_known", [0, 5])
def test_the_elimination_is_gtsams(
    state_and_tracks, reprojection_graph, reprojection_values, with_intrinsics, n_known
):
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
    unknown = ALL if with_intrinsics else ()
    layout = Layout(n_poses=N_IMAGES, intrinsics=unknown, n_known=n_known)
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
    graph = reprojection_graph(seen, sigmas[scene], state.cameras, with_intrinsics=with_intrinsics)
    values = reprojection_values(state, with_intrinsics=with_intrinsics)
    linear = graph.linearize(values)
    points = gtsam.Ordering()
    for j in range(n_known, len(tracks.points_world)):
        points.push_back(point_key(j))
    bayes_tree, rest = linear.eliminatePartialMultifrontal(points)
    shared = gtsam.Ordering()
    columns, skew = [], []
    for key in layout.keys:
        if key in set(rest.keyVector()):
            shared.push_back(key)
            skew = [len(columns) + 2] if key == intrinsics_key(0) else skew
            columns.extend(layout.columns(key))
    # Without the skew that GTSAM's camera has.
    expected = np.asarray(rest.augmentedHessian(shared))
    expected = np.delete(np.delete(expected, skew, axis=0), skew, axis=1)
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
    by_points = jacobian[:, :n_rows]
    by_shared = np.delete(jacobian[:, n_rows:], skew, axis=1)
    best = np.linalg.lstsq(by_points, right.ravel() - by_shared @ step[columns])[0]
    np.testing.assert_allclose(found.point_steps(step).ravel(), best, rtol=1e-6, atol=1e-9)
    assert bayes_tree.size() > 0


def points_keys(n_known, tracks):
    return [point_key(j) for j in range(n_known, len(tracks.points_world))]


def shared_of(ordering):
    return [ordering.at(i) for i in range(ordering.size())]


@pytest.mark.parametrize(("image", "along"), [(0, -0.3), (1, 0.3)], ids=["behind", "one way"])
def test_a_point_that_no_camera_determines_says_nothing(state_and_tracks, image, along):
    """It is behind the only camera that observed it, twice, or before it."""
    state, tracks = state_and_tracks
    pose = state.world_T_camera[image]
    point = pose[:3, 3] + along * pose[:3, 2]
    points = np.vstack([state.points_world[:-1], point])
    lost = replace(state, points_world=points)
    tracks = Tracks(
        points_world=points,
        image_index=np.append(tracks.image_index[:-1], [image, image]),
        point_index=np.append(tracks.point_index, len(points) - 1),
        pixels=np.vstack([tracks.pixels, [600.0, 500.0]]),
    )
    layout = Layout(n_poses=N_IMAGES, intrinsics=ALL)
    parts = batches(tracks, np.ones(len(tracks.pixels)), N_IMAGES, 0)
    found = eliminate(parts, lost, layout)
    kept = in_front(in_front(replace(tracks, points_world=np.vstack([points, point]))))
    without = batches(kept, np.ones(len(kept.pixels)), N_IMAGES, 0)
    wanted = eliminate(without, replace(state, points_world=kept.points_world), layout)
    scale = np.abs(wanted.quadratic.hessian).max()
    np.testing.assert_allclose(
        found.quadratic.hessian, wanted.quadratic.hessian, atol=1e-12 * scale
    )
    np.testing.assert_allclose(
        found.quadratic.gradient, wanted.quadratic.gradient, atol=1e-12 * scale
    )
    # That it does not fit still counts.
    assert found.quadratic.constant > wanted.quadratic.constant + 100.0
    steps = found.point_steps(np.full(layout.dim, 1e-3))
    assert not steps[-1].any()
    np.testing.assert_allclose(steps[:-1], wanted.point_steps(np.full(layout.dim, 1e-3)), atol=1e-9)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_derivatives_that_are_not_finite_are_refused(state_and_tracks):
    """A point in the plane of its camera."""
    state, tracks = state_and_tracks
    poses, points = np.array(state.world_T_camera), np.array(state.points_world)
    poses[0], points[-1] = np.eye(4), [1.0, 1.0, 1e-200]
    state = replace(state, world_T_camera=poses, points_world=points)
    parts = batches(tracks, np.ones(len(tracks.pixels)), N_IMAGES, 0)
    with pytest.raises(ConvergenceError, match="derivatives are not finite"):
        eliminate(parts, state, Layout(n_poses=N_IMAGES))


def test_a_step_moves_every_unknown(state_and_tracks):
    state, _ = state_and_tracks
    layout = Layout(n_poses=N_IMAGES, intrinsics=((0, 5),), n_known=2)
    steps = gtsam.VectorValues()
    for key in layout.keys:
        kind = chr(gtsam.symbolChr(key))
        steps.insert(key, np.full({"l": 1, "k": 2, "p": 3}.get(kind, 6), 0.01))
    n_unknown = len(state.points_world) - 2
    found = moved(state, steps, np.full((n_unknown, 3), 0.02), layout.intrinsics)
    assert found.log_scale == 0.01
    np.testing.assert_allclose(found.points_world[:2], state.points_world[:2] + 0.01)
    np.testing.assert_allclose(found.points_world[2:], state.points_world[2:] + 0.02)
    expected = state.cameras[0].params + np.array([0.01, 0, 0, 0, 0, 0.01, 0, 0])
    np.testing.assert_allclose(found.cameras[0].params, expected)
    expected = gtsam.Pose3(state.world_T_camera[1]).retract(np.full(6, 0.01)).matrix()
    np.testing.assert_allclose(found.world_T_camera[1], expected, atol=1e-12)
