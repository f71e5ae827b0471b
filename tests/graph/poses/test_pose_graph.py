"""What the pose graph finds, and what it does not depend on."""

import tracemalloc

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from handeye_fg.findings import LinearStart
from handeye_fg.frames import exp, inverse, pose, scaled
from handeye_fg.graph.poses import estimator, fit, pose_graph
from handeye_fg.graph.poses.measurements import Columns, NoiseModel, graph_of
from handeye_fg.graph.variables import GRIPPER_T_CAMERA
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.options import NoiseOptions
from handeye_fg.solvers import METHODS, start_of
from pose_graphs import assert_same, error, moved_start, solved


@pytest.fixture
def all_given(monkeypatch):
    """The user gives every noise level."""

    def give(levels):
        monkeypatch.setattr(estimator, "_given", lambda noise: dict(levels))

    return give


@pytest.mark.parametrize("scale_known", [True, False])
@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("camera", ["independent", "odometry"])
def test_without_noise_it_is_exact(simulated, no_noise, camera, inverted, scale_known):
    truth = simulated(1, 6, camera=camera, scale_known=scale_known, inverted=inverted, **no_noise)
    found = solved(truth, camera_noise=camera)
    # Rounding of poses about a metre from the origin, enlarged by inaccurate normal equations.
    assert np.abs(error(found, truth)).max() < 1e-9
    assert found.metres_per_world_unit == pytest.approx(truth.unit, rel=1e-9)
    np.testing.assert_allclose(found.base_T_world, truth.base_T_world, atol=1e-8)
    assert np.abs(found.residuals).max() < 1e-8
    assert not found.outliers.any()
    assert found.model.camera == camera


def test_motions_without_noise_are_exact(simulated, no_noise):
    truth = simulated(2, 8, scale_known=False, **no_noise)
    robot, camera = truth.data.base_T_gripper, truth.data.world_T_camera
    i, j = np.arange(0, 8, 2), np.arange(1, 8, 2)
    data = MotionPairs(
        i=i, j=j, gi_T_gj=inverse(robot[i]) @ robot[j], ci_T_cj=inverse(camera[i]) @ camera[j]
    )
    found = pose_graph(data, start_of(data, METHODS["andreff_scale"].solve(data), "andreff_scale"))
    assert np.abs(error(found, truth)).max() < 1e-9
    np.testing.assert_allclose(found.base_T_world, found.gripper_T_camera, atol=1e-9)
    assert found.metres_per_world_unit == pytest.approx(truth.unit, rel=1e-9)


def test_it_does_not_depend_on_the_world_frame_and_its_unit(simulated):
    truth = simulated(3, 15, scale_known=False)
    start = truth.start()
    found = solved(truth, start, camera_noise="independent")
    turn = pose(exp(np.array([0.5, -1.0, 0.3, 0, 0, 0]))[:3, :3], np.zeros(3))
    camera = scaled(turn @ truth.data.world_T_camera, 1000.0)
    other = pose_graph(
        PosePairs(base_T_gripper=truth.data.base_T_gripper, world_T_camera=camera),
        LinearStart(
            method="test",
            gripper_T_camera=start.gripper_T_camera,
            base_T_world=start.base_T_world @ inverse(turn),
            metres_per_world_unit=start.metres_per_world_unit / 1000.0,
            residual_rotation=start.residual_rotation,
            residual_translation=start.residual_translation,
        ),
        camera_noise="independent",
    )
    # The same computation but for rounding.
    assert_same(found, other, tolerance=1e-4)
    assert other.metres_per_world_unit == pytest.approx(found.metres_per_world_unit / 1e3, rel=1e-6)
    for name, sigma in found.noise.items():
        unit = 1e3 if name in ("camera_across", "camera_along") else 1.0
        assert other.noise[name] == pytest.approx(unit * sigma, rel=1e-4)


def test_it_does_not_depend_on_the_start(simulated):
    truth = simulated(4, 15, scale_known=False)
    far = moved_start(truth, [0.05, -0.04, 0.03, 0.02, -0.02, 0.01])
    # Rounds end when X would move by another 0.02 standard deviations; the first guess of the noise
    # levels has a little weight and comes from where the first round ends.
    assert_same(solved(truth), solved(truth, far), tolerance=0.1)


def test_a_row_of_weight_zero_is_left_out(simulated):
    truth = simulated(5, 12)
    robot, camera = truth.data.base_T_gripper, truth.data.world_T_camera
    weights = np.ones(12)
    weights[[3, 7]] = 0.0
    wrong = np.array(robot)
    wrong[3] = np.eye(4)
    start = truth.start()
    found = solved(truth.with_data(base_T_gripper=wrong, weights=weights), start)
    rest = np.flatnonzero(weights)
    fewer = solved(
        truth.with_data(
            base_T_gripper=robot[rest], world_T_camera=camera[rest], weights=np.ones(10)
        ),
        start,
    )
    assert_same(found, fewer, tolerance=1e-6)
    assert not found.outliers.any()
    assert len(found.residuals) == 12


def test_a_row_of_weight_two_is_two_rows(simulated, all_given):
    levels = {
        "robot_rotation": 2e-3,
        "robot_translation": 5e-4,
        "camera_rotation": 3e-3,
        "camera_across": 4e-4,
        "camera_along": 1e-3,
    }
    all_given(levels)
    truth = simulated(6, 8)
    start, rows = truth.start(), [*range(8), 2]
    weights = np.ones(8)
    weights[2] = 2.0
    heavy = solved(truth.with_data(weights=weights), start, camera_noise="independent")
    twice = solved(
        truth.with_data(
            base_T_gripper=truth.data.base_T_gripper[rows],
            world_T_camera=truth.data.world_T_camera[rows],
            weights=np.ones(9),
        ),
        start,
        camera_noise="independent",
    )
    # Two poses at one place differ from one by second order, and the optimiser by 1e-4; the feigned
    # information counts poses.
    assert_same(heavy, twice, tolerance=5e-3)
    assert heavy.degrees_of_freedom == np.inf
    assert heavy.noise == pytest.approx(levels)


def test_levels_that_the_user_gives_stay(simulated):
    truth = simulated(7, 15)
    noise = NoiseOptions(robot_rotation_deg=0.1, robot_translation_mm=0.5)
    free = solved(truth, camera_noise="independent")
    given = solved(truth, camera_noise="independent", noise=noise)
    assert given.noise["robot_rotation"] == pytest.approx(np.deg2rad(0.1), rel=1e-12)
    assert given.noise["robot_translation"] == pytest.approx(5e-4, rel=1e-12)
    assert given.noise["camera_along"] != pytest.approx(free.noise["camera_along"], rel=1e-6)


@pytest.mark.parametrize("scale", ["known", "free", "drifting"])
@pytest.mark.parametrize("camera", ["independent", "odometry"])
def test_the_covariance_is_that_of_the_final_graph(simulated, camera, scale):
    truth = simulated(13, 8, camera=camera, scale_known=scale == "known", scale_drift=2e-3)
    start = truth.start()
    problem = fit.Problem(
        base_T_gripper=truth.data.base_T_gripper,
        world_T_camera=scaled(truth.data.world_T_camera, start.metres_per_world_unit),
        weights=np.linspace(0.5, 2.0, 8),
        are_motions=False,
        inverted=False,
        scale_known=scale == "known",
        priors=estimator._wide_prior(start.gripper_T_camera),
        held=gtsam.NonlinearFactorGraph(),
        given={},
    )
    first = fit.State(
        world_T_camera=problem.world_T_camera,
        gripper_T_camera=start.gripper_T_camera,
        base_T_world=start.base_T_world,
        log_scale=np.zeros(8),
    )
    rows, model = np.ones(8, dtype=bool), NoiseModel(camera=camera, scale=scale)
    found = fit.fitted(problem, first, rows, model)
    graph = graph_of(problem.measurements(model), problem.priors, found.sigmas)
    values = fit._values(found.state, model)
    for i, value in enumerate(
        found.state.log_scale if scale == "drifting" else [found.state.log_scale[0]]
    ):
        values.update(L(i), float(value))
    marginals = gtsam.Marginals(graph, values)
    keys = gtsam.KeyVector([GRIPPER_T_CAMERA, L(0)])
    joint = marginals.jointMarginalCovariance(keys)
    blocks = [[joint.at(a, b) for b in keys] for a in keys]
    # Factorisations of matrices of condition 1e10 (ties): six digits are left.
    np.testing.assert_allclose(found.estimate.covariance, np.block(blocks), rtol=1e-4, atol=1e-12)
    assert Columns(n_poses=8, scale=scale).total == values.dim()


@pytest.mark.slow
def test_memory_grows_linearly(simulated):
    def peak(n):
        truth = simulated(16, n)
        start = truth.start()
        tracemalloc.start()
        solved(truth, start, camera_noise="independent")
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(20)  # what is made once
    # Linear: factor 2; quadratic: 4.
    assert peak(200) < 2.5 * peak(100)
