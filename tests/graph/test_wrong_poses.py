"""Wrong robot poses among right ones: all are named, none of the right ones, and X does not suffer."""

import numpy as np
import pytest
from scipy import stats
from scipy.linalg import eigvalsh

from handeye_fg import frames
from handeye_fg.graph import start_state
from handeye_fg.graph.deletion import deletions
from handeye_fg.graph.mismatches import Kept, without_mismatches
from handeye_fg.graph.noise import estimate_noise, solve
from handeye_fg.graph.problem import make_problem
from handeye_fg.graph.refine import _fitted as fitted
from handeye_fg.options import NoiseOptions
from handeye_fg.progress import silent
from handeye_fg.simulate import simulate_scene
from handeye_fg.solvers import linear_start

SIGMAS = np.array([np.deg2rad(0.1), 1e-3])


def simulated(seed, n_images):
    return simulate_scene(
        np.random.default_rng(seed),
        n_images=n_images,
        n_points=80,
        robot_rotation_sigma=SIGMAS[0],
        robot_translation_sigma=SIGMAS[1],
        start_sigma=1e-4,
    )


@pytest.fixture
def fit(refined):
    def of_poses(scene, poses, *, noise=None, **how):
        return refined(scene, reported=poses, noise=noise, believed=True, **how)

    return of_poses


def nees(result, scene):
    e = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    return float(e @ np.linalg.solve(result.observability.covariance, e))


def swapped(poses):
    poses[[2, 9]] = poses[[9, 2]]
    return [2, 9]


def stale(poses):
    poses[[4, 8, 12]] = poses[[3, 7, 11]]
    return [4, 8, 12]


def unsettled(poses):
    """15 sigma: nearer than what the linear start tells apart, and hiding each other."""
    rows, shift = [1, 6, 13], 15.0 * np.repeat(SIGMAS, 3) * np.eye(6)[[0, 4, 2]]
    poses[rows] = poses[rows] @ frames.exp(shift + np.roll(shift, 3, axis=0))
    return rows


@pytest.mark.parametrize("spoilt", [swapped, stale, unsettled])
@pytest.mark.parametrize("known", [False, True])
def test_wrong_poses_are_named_and_cost_little(fit, spoilt, known):
    scene = simulated(1, 15)
    poses = np.array(scene.robot_poses.base_T_gripper)
    rows = spoilt(poses)
    noise = NoiseOptions(robot_rotation_deg=0.1, robot_translation_mm=1.0) if known else None
    result = fit(scene, poses, noise=noise)
    assert np.flatnonzero(result.outliers).tolist() == rows
    assert nees(result, scene) < stats.chi2.isf(1e-3, 6)
    assert (result.w_test[rows] > 6.0).all()
    assert np.delete(result.w_test, rows).max() < 5.0
    assert np.isnan(result.influence[rows]).all()
    if not known:
        assert result.noise.robot_translation == pytest.approx(1e-3, rel=0.35)


@pytest.mark.parametrize("seed", range(3))
def test_wrong_poses_that_hide_each_other(fit, seed):
    """Without a linear start's judgement the core alone finds a fifth of poses off by 12 sigma."""
    scene = simulated(seed, 20)
    poses = np.array(scene.robot_poses.base_T_gripper)
    rng, rows = np.random.default_rng(seed), [3, 5, 8, 17]
    parts = rng.standard_normal((4, 2, 3))
    parts *= 12.0 * SIGMAS[:, None] / np.linalg.norm(parts, axis=2, keepdims=True)
    poses[rows] = poses[rows] @ frames.exp(parts.reshape(4, 6))
    result = fit(scene, poses, trusted=np.ones(20, dtype=bool))
    assert np.flatnonzero(result.outliers).tolist() == rows


def test_right_poses_that_were_not_believed_are_taken_in(fit):
    scene = simulated(3, 12)
    poses = np.array(scene.robot_poses.base_T_gripper)
    poses[4, :3, 3] += 0.02
    doubted = ~np.isin(np.arange(12), [0, 4, 7])
    result = fit(scene, poses, trusted=doubted)
    assert np.flatnonzero(result.outliers).tolist() == [4]


def test_a_deletion_is_the_solution_without_the_pose():
    scene = simulated(4, 8)
    reported, tracks = scene.robot_poses.base_T_gripper, scene.model.tracks
    linear = linear_start(reported, scene.model.world_T_camera)
    state = start_state(scene.model, [scene.camera], linear)
    kept = without_mismatches(state, tracks, np.ones(len(tracks.pixels)))
    problem = make_problem(kept, reported, "base", (), None, ())
    everything = np.ones(8, dtype=bool)
    linearised = problem.linearised(kept.state)
    solution = estimate_noise(linearised, scene.noise, NoiseOptions())
    found = deletions(linearised, solution, everything)
    for i in range(8):
        rest = np.arange(8) != i
        less = linearised.using(rest)
        without = solve(less, solution.noise)
        columns = linearised.layout.x_columns()
        np.testing.assert_allclose(
            found.x_step[i], without.step[columns] - solution.step[columns], rtol=1e-6, atol=1e-12
        )
        # In units of X's own uncertainty, the growth is that of the longest axis.
        ratios = eigvalsh(
            without.covariance[np.ix_(columns, columns)],
            solution.covariance[np.ix_(columns, columns)],
        )
        np.testing.assert_allclose(found.growth[i], np.sqrt(ratios[-1]) - 1.0, rtol=1e-5)
        alone = deletions(less, without, rest)
        np.testing.assert_allclose(found.lengths[i], alone.lengths[i], rtol=1e-6)
        assert np.isnan(alone.x_step[i]).all()


def test_influence_is_how_far_x_moves_when_the_refinement_is_made_without_the_pose(fit):
    scene = simulated(6, 10)
    reported = scene.robot_poses.base_T_gripper
    known = NoiseOptions(pixel_px=0.3, robot_rotation_deg=0.1, robot_translation_mm=1.0)
    result = fit(scene, reported, noise=known)
    observed = Kept(
        state=result.state,
        tracks=result.tracks,
        sigma_scale=result.sigma_scale,
        pixel=result.noise.pixel,
        corner=1.0,
    )
    for i in range(10):
        rest = np.arange(10) != i
        problem = make_problem(observed, reported, "base", (), None, (), rest)
        again = fitted(problem, result.state, result.noise, known, 1e-9, 100, silent).state
        moved = frames.log(frames.inverse(result.state.gripper_T_camera) @ again.gripper_T_camera)
        np.testing.assert_allclose(
            result.influence[i], moved, atol=0.03 * np.linalg.norm(moved[3:])
        )


def test_the_rest_does_not_determine_what_a_pose_says(fit):
    """With three poses and any one left out, X is free: nothing can be said of the one."""
    scene = simulated(5, 3)
    assert not fit(scene, scene.robot_poses.base_T_gripper).outliers.any()
