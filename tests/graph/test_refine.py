"""The joint refinement against simulated truth."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.errors import ConvergenceError, ReconstructionError
from handeye_fg.graph import IntrinsicsPrior, start_state
from handeye_fg.graph import measurements as m
from handeye_fg.graph import noise as noise_module
from handeye_fg.graph.mismatches import without_mismatches
from handeye_fg.graph.noise import cost, estimate_noise, relative_change
from handeye_fg.graph.problem import Problem, make_problem
from handeye_fg.graph.refine import _stepped as stepped
from handeye_fg.graph.variables import GRIPPER_T_CAMERA, to_values
from handeye_fg.options import GraphOptions, NoiseOptions
from handeye_fg.simulate import simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import Tracks
from refinements import refined_from


def fit(scene, *, camera=None, intrinsics=(), noise=None, gauge="base", iterations=100, **changes):
    linear = linear_start(scene.robot_poses.base_T_gripper, scene.model.world_T_camera)
    start = start_state(scene.model, [camera or scene.camera], linear)
    return refined_from(
        replace(start, **changes),
        scene.model,
        scene.robot_poses.base_T_gripper,
        intrinsics=intrinsics,
        noise=noise or NoiseOptions(),
        options=GraphOptions(max_iterations=iterations),
        gauge=gauge,
    )


def error(result, scene):
    return frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)


def nees(result, scene):
    e = error(result, scene)
    return float(e @ np.linalg.solve(result.observability.covariance, e))


def true_scale(scene):
    """Metres in a unit of the SfM model as the result defines it."""

    def spread(cameras):
        return np.sqrt(np.mean(np.var(cameras[:, :3, 3], axis=0).sum()))

    true_metric = scene.metres_per_world_unit * spread(scene.world_T_camera)
    return true_metric / spread(scene.model.world_T_camera)


def test_without_noise_the_truth_is_found():
    scene = simulate_scene(
        np.random.default_rng(0),
        n_images=6,
        n_points=60,
        pixel_sigma=0.0,
        robot_rotation_sigma=0.0,
        robot_translation_sigma=0.0,
    )
    result = fit(scene)
    e = error(result, scene)
    assert np.rad2deg(np.linalg.norm(e[:3])) < 1e-7
    assert 1e3 * np.linalg.norm(e[3:]) < 1e-6
    assert result.metres_per_world_unit == pytest.approx(true_scale(scene), rel=1e-9)
    assert result.converged


def test_nothing_reported_depends_on_the_gauge():
    scene = simulate_scene(np.random.default_rng(1), n_images=8, n_points=80)
    base, camera = fit(scene, gauge="base"), fit(scene, gauge="first camera")
    np.testing.assert_allclose(
        frames.log(frames.inverse(base.state.gripper_T_camera) @ camera.state.gripper_T_camera),
        0.0,
        atol=1e-8,  # the optimiser stops within a thousandth of a standard deviation, 1e-5
    )
    np.testing.assert_allclose(
        base.observability.covariance, camera.observability.covariance, rtol=1e-4, atol=1e-14
    )
    assert base.metres_per_world_unit == pytest.approx(camera.metres_per_world_unit, rel=1e-7)
    assert base.metres_per_world_unit_std == pytest.approx(
        camera.metres_per_world_unit_std, rel=1e-4
    )
    # The gauge leaves ln(scale) uncertain by 1; only the freedom that is measured may be reported.
    assert base.metres_per_world_unit_std < 1e-3 * base.metres_per_world_unit
    np.testing.assert_allclose(base.base_T_camera, camera.base_T_camera, atol=1e-7)


def test_covariance_agrees_with_the_dense_information_matrix(reprojection_graph):
    """Independent of the elimination: the whole Jacobian by GTSAM, inverted at once."""
    scene = simulate_scene(np.random.default_rng(2), n_images=5, n_points=30)
    levels = NoiseOptions(pixel_px=0.3, robot_rotation_deg=0.01, robot_translation_mm=0.05)
    result = fit(scene, noise=levels)
    state, noise = result.state, result.noise
    assert result.arm.found.white
    graph = m.joined(
        [
            reprojection_graph(
                result.tracks,
                np.full(len(result.tracks.pixels), noise.pixel),
                state.cameras,
                with_intrinsics=False,
            ),
            m.robot_graph(
                scene.robot_poses.base_T_gripper,
                m.pose_sigmas(noise.robot_rotation, noise.robot_translation),
            ),
            m.gauge_graph(state, "base"),
        ]
    )
    values = to_values(state)
    order = gtsam.Ordering()
    for key in [GRIPPER_T_CAMERA, *(k for k in values.keys() if k != GRIPPER_T_CAMERA)]:
        order.push_back(key)
    jacobian = np.asarray(graph.linearize(values).jacobian(order)[0])
    scale = np.linalg.norm(jacobian, axis=0)
    expected = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))[:6, :6]
    expected /= np.outer(scale[:6], scale[:6])
    np.testing.assert_allclose(result.observability.covariance, expected, rtol=1e-3, atol=1e-13)


def test_known_noise_levels_are_kept():
    scene = simulate_scene(np.random.default_rng(3), n_images=6, n_points=60)
    known = NoiseOptions(pixel_px=0.5, robot_rotation_deg=0.1, robot_translation_mm=2.0)
    noise = fit(scene, noise=known).noise
    assert not noise.estimated
    assert noise.pixel == 0.5
    assert noise.robot_rotation == pytest.approx(np.deg2rad(0.1))
    assert noise.robot_translation == pytest.approx(2e-3)


def test_mismatches_are_left_out():
    rng = np.random.default_rng(4)
    scene = simulate_scene(rng, n_images=8, n_points=100)
    tracks = scene.model.tracks
    pixels = np.array(tracks.pixels)
    bad = rng.choice(len(pixels), 40, replace=False)
    pixels[bad] += rng.choice([-1, 1], (40, 2)) * rng.uniform(8, 60, (40, 2))
    spoilt = replace(scene, model=replace(scene.model, tracks=replace(tracks, pixels=pixels)))
    result = fit(spoilt)
    assert nees(result, scene) < stats.chi2.isf(1e-3, 6)
    assert result.noise.pixel == pytest.approx(0.3, rel=0.1)
    assert len(result.tracks.pixels) <= len(pixels) - 40


def test_a_wrong_robot_pose_is_named():
    scene = simulate_scene(np.random.default_rng(5), n_images=15, n_points=80)
    poses = np.array(scene.robot_poses.base_T_gripper)
    poses[4, :3, 3] += [0.0, 0.004, 0.0]
    result = fit(replace(scene, robot_poses=replace(scene.robot_poses, base_T_gripper=poses)))
    assert np.flatnonzero(result.outliers).tolist() == [4]
    assert nees(result, scene) < stats.chi2.isf(1e-3, 6)
    assert np.linalg.norm(result.residuals[4, 3:]) == pytest.approx(4e-3, rel=0.1)
    assert not fit(scene).outliers.any()


def test_intrinsics_are_refined_with_honest_deviations():
    scene = simulate_scene(np.random.default_rng(7), n_images=12, n_points=200)
    truth = scene.camera.params
    sigmas = np.array([20.0, 20.0, 15.0, 15.0, 0.1, 0.1, 0.01, 0.01])
    start = truth + np.array([8.0, 9.0, -6.0, 5.0, 0.02, -0.02, 1e-3, -1e-3])
    # Known levels: those found would differ a little between the two refinements.
    levels = NoiseOptions(pixel_px=0.3, robot_rotation_deg=0.01, robot_translation_mm=0.05)
    result = fit(
        scene,
        noise=levels,
        camera=replace(scene.camera, params=start),
        intrinsics=[IntrinsicsPrior(params=start, sigmas=sigmas)],
    )
    e = result.state.cameras[0].params - truth
    assert e @ np.linalg.solve(result.intrinsics_covariances[0], e) < stats.chi2.isf(1e-3, 8)
    assert nees(result, scene) < stats.chi2.isf(1e-3, 6)
    fixed = fit(scene, noise=levels)
    grown = np.diag(result.observability.covariance) - np.diag(fixed.observability.covariance)
    # The factor for correlated features is found anew: it differs by some per cent.
    assert (grown > -0.15 * np.diag(fixed.observability.covariance)).all()


def test_too_few_observations():
    scene = simulate_scene(np.random.default_rng(7), n_images=6, n_points=12)
    tracks = scene.model.tracks
    few = Tracks(
        points_world=tracks.points_world,
        image_index=tracks.image_index[:30],
        point_index=tracks.point_index[:30],
        pixels=tracks.pixels[:30],
    )
    with pytest.raises(ReconstructionError, match="too few to refine"):
        fit(replace(scene, model=replace(scene.model, tracks=few)))


def test_a_start_that_is_not_finite():
    scene = simulate_scene(np.random.default_rng(8), n_images=6, n_points=40)
    with pytest.raises(ConvergenceError, match="not finite"):
        fit(scene, log_scale=np.inf)


def test_the_limit_of_iterations_is_reported():
    scene = simulate_scene(np.random.default_rng(9), n_images=6, n_points=40, start_sigma=0.06)
    assert not fit(scene, iterations=1).converged


def test_one_axis_leaves_the_height_free():
    scene = simulate_scene(np.random.default_rng(10), n_images=10, n_points=80, motion="one_axis")
    result = fit(scene)
    (free,) = result.observability.free_directions
    assert free.kind == "translation"
    assert "not determined" in free.description
    base_axis_in_gripper = scene.base_T_gripper[0, 2, :3]
    assert abs(free.vector @ base_axis_in_gripper) > 0.999
    offset = result.state.gripper_T_camera[:3, 3] - scene.gripper_T_camera[:3, 3]
    assert np.linalg.norm(offset - free.vector * (free.vector @ offset)) < 2e-3
    assert np.linalg.matrix_rank(result.observability.covariance, tol=1e-12) == 5


def test_gtsams_own_optimiser_stays_at_the_optimum(reprojection_graph):
    """Independent of the elimination and of the steps: every measurement as a factor."""
    scene = simulate_scene(np.random.default_rng(11), n_images=8, n_points=60)
    result = fit(scene)
    state, noise = result.state, result.noise
    sigmas = np.full(len(result.tracks.pixels), noise.pixel)
    graph = m.joined(
        [
            reprojection_graph(result.tracks, sigmas, state.cameras, with_intrinsics=False),
            m.robot_graph(
                scene.robot_poses.base_T_gripper,
                m.pose_sigmas(noise.robot_rotation, noise.robot_translation),
            ),
            m.gauge_graph(state, "base"),
        ]
    )
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-12)
    params.setAbsoluteErrorTol(1e-12)
    values = to_values(state)
    X = (
        gtsam.LevenbergMarquardtOptimizer(graph, values, params)
        .optimize()
        .atPose3(GRIPPER_T_CAMERA)
    )
    moved = frames.log(frames.inverse(state.gripper_T_camera) @ X.matrix())
    std = np.sqrt(np.diag(result.observability.covariance))
    assert np.abs(moved / std).max() < 1e-3


def test_a_start_that_is_far_off_is_reached():
    scene = simulate_scene(np.random.default_rng(12), n_images=8, n_points=100)
    linear = linear_start(scene.robot_poses.base_T_gripper, scene.model.world_T_camera)
    off = frames.exp(np.array([0.0, 0.0, 0.0, 0.09, -0.06, 0.12]))
    far = fit(scene, gripper_T_cameras=linear.gripper_T_camera[None] @ off)
    assert far.converged
    X = fit(scene).state.gripper_T_camera
    np.testing.assert_allclose(
        frames.log(frames.inverse(X) @ far.state.gripper_T_camera), 0.0, atol=1e-7
    )


@pytest.fixture
def linearised():
    """A problem, its start, and its solution there."""
    scene = simulate_scene(np.random.default_rng(13), n_images=6, n_points=60)
    reported = scene.robot_poses.base_T_gripper
    linear = linear_start(reported, scene.model.world_T_camera)
    state = start_state(scene.model, [scene.camera], linear)
    tracks = scene.model.tracks
    kept = without_mismatches(state, tracks, np.ones(len(tracks.pixels)))
    problem = make_problem(kept, reported, "base", (), None, ())
    start = problem.linearised(kept.state)
    return problem, kept.state, start, estimate_noise(start, scene.noise, NoiseOptions())


def test_a_step_that_is_too_long_is_shortened(linearised):
    problem, state, start, solution = linearised
    levels = solution.noise
    before, at_best = problem.cost(state, levels), cost(start, levels)
    # With no step of the others, the points alone go where the linearised problem has them.
    points_moved = problem.moved(state, start, np.zeros(start.layout.dim))
    assert problem.cost(points_moved, levels) == pytest.approx(at_best, rel=0.01)
    expected = at_best - solution.decrease
    _, found = stepped(problem, state, start, solution, expected, 0.0)
    assert found == pytest.approx(expected, rel=0.2)
    # The cost of a step three times as long is that of none.
    long = replace(solution, step=3.0 * solution.step)
    _, shortened = stepped(problem, state, start, long, expected, 0.0)
    assert shortened < 0.5 * before


def test_no_step_that_lowers_the_cost(linearised, monkeypatch):
    problem, state, start, solution = linearised
    monkeypatch.setattr(Problem, "cost", lambda *_: np.nan)
    with pytest.raises(ConvergenceError, match="no step lowers its cost"):
        stepped(problem, state, start, solution, 1.0, 0.0)


@pytest.mark.parametrize("factor", [1.0, 30.0])
def test_noise_levels_reproduce_themselves_after_few_solutions(linearised, monkeypatch, factor):
    _, _, start, expected = linearised
    calls = []
    counted = noise_module.solve
    monkeypatch.setattr(noise_module, "solve", lambda *a: calls.append(1) or counted(*a))
    levels = replace(
        expected.noise,
        pixel=factor * expected.noise.pixel,
        robot_rotation=factor * expected.noise.robot_rotation,
        robot_translation=expected.noise.robot_translation / factor,
    )
    found = estimate_noise(start, levels, NoiseOptions())
    assert relative_change(found.noise, expected.noise) < 1e-4
    assert len(calls) <= (2 if factor == 1.0 else 15)
