"""Monte-Carlo: the reported covariance is that of the errors, with noise levels found from the data."""

import numpy as np
import pytest
from scipy import stats

from handeye_fg import frames
from handeye_fg.simulate import disturbed, simulate_scene

RUNS = 100
N_IMAGES = 15
ROTATION, TRANSLATION = np.deg2rad(0.1), 1e-3


def spread(cameras):
    return np.sqrt(np.var(cameras[:, :3, 3], axis=0).sum())


def draw(refined, seed, *, inverted):
    rng = np.random.default_rng(seed)
    scene = simulate_scene(
        rng,
        n_images=N_IMAGES,
        n_points=60,
        robot_rotation_sigma=ROTATION,
        robot_translation_sigma=TRANSLATION,
        start_sigma=1e-4,
    )
    reported = scene.robot_poses.base_T_gripper
    if (
        inverted
    ):  # the scene's robot poses are those of a base in a gripper, a static camera's X is in it
        true = frames.inverse(scene.base_T_gripper)
        reported = frames.inverse(disturbed(rng, true, ROTATION, TRANSLATION))
    result = refined(scene, reported=reported, inverted=inverted)
    X = result.state.gripper_T_camera
    error = frames.log(frames.inverse(X) @ scene.gripper_T_camera)
    covariance = result.observability.covariance
    true_scale = scene.metres_per_world_unit * spread(scene.world_T_camera)
    true_scale /= spread(scene.model.world_T_camera)
    return {
        "nees": error @ np.linalg.solve(covariance, error),
        "covered": np.abs(np.append(error, np.log(true_scale / result.metres_per_world_unit)))
        < result.interval_factors[0]
        * np.append(np.sqrt(np.diag(covariance)), result.observability.log_scale_std),
        "z_scale": (result.metres_per_world_unit - true_scale) / result.metres_per_world_unit_std,
        "sigmas": [
            result.noise.pixel / scene.noise.pixel,
            result.noise.robot_rotation / ROTATION,
            result.noise.robot_translation / TRANSLATION,
        ],
        "outliers": result.outliers.sum(),
    }


@pytest.mark.slow
@pytest.mark.simulation
@pytest.mark.parametrize("inverted", [False, True], ids=["eye-in-hand", "eye-to-hand"])
def test_covariance_noise_levels_and_scale_are_consistent(refined, inverted):
    draws = [draw(refined, seed, inverted=inverted) for seed in range(RUNS)]
    # Sum of NEES: chi-square of 6 degrees of freedom a run. The estimated sigmas, with about 40
    # degrees of freedom each, spread it by 2 / 40 more; in one run of twenty the noise is taken for
    # structured, and the covariance is larger.
    nees = np.sum([d["nees"] for d in draws])
    dof = 6 * RUNS
    assert stats.chi2.ppf(0.0005, dof) < nees < 1.05 * stats.chi2.ppf(0.9995, dof)
    # 95 % intervals cover 95 %, component by component, within the binomial's 99.9 % band.
    covered = np.sum([d["covered"] for d in draws], axis=0)
    assert (covered >= stats.binom.ppf(0.0005, RUNS, 0.95)).all()
    # Nor is the scale's standard deviation too large.
    squares = np.sum([d["z_scale"] ** 2 for d in draws])
    assert stats.chi2.ppf(0.0005, RUNS) < squares < 1.05 * stats.chi2.ppf(0.9995, RUNS)
    # Estimated sigmas: unbiased within 3 standard errors of their mean (1 / sqrt(2 * 40 * RUNS)).
    ratios = np.mean([d["sigmas"] for d in draws], axis=0)
    assert np.abs(ratios - 1.0).max() < 0.035
    # No pose is called an outlier but one in a thousand sets.
    assert np.sum([d["outliers"] for d in draws]) <= 2
