"""What the pose graph finds, and what it does not depend on."""

import tracemalloc

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from handeye_fg.errors import ConvergenceError, InputDataError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import exp, inverse, log, pose, scaled
from handeye_fg.graph.poses import estimator, fit, pose_graph
from handeye_fg.graph.poses.measurements import Columns, NoiseModel, graph_of
from handeye_fg.graph.variables import GRIPPER_T_CAMERA
from handeye_fg.motions import MotionPairs, PosePairs
from handeye_fg.observability import LIMITS, USELESS_TRANSLATION, analyse
from handeye_fg.options import NoiseOptions
from handeye_fg.priors import Prior
from handeye_fg.solvers import METHODS, only, partial, start_of, trusted_rows


def solved(truth, start=None, **options):
    return pose_graph(
        truth.data,
        truth.start() if start is None else start,
        scale_known=truth.scale_known,
        inverted=truth.inverted,
        **options,
    )


def error(found, truth):
    """Twist (6,) from X to the true X."""
    return log(inverse(found.gripper_T_camera) @ truth.gripper_T_camera)


def stds(found):
    return np.sqrt(np.diag(found.covariance))


def assert_same(found, other, tolerance=0.05):
    """X and the scale agree to a part of a standard deviation, covariances to as much."""
    step = log(inverse(found.gripper_T_camera) @ other.gripper_T_camera) / stds(found)[:6]
    assert np.abs(step).max() < tolerance
    np.testing.assert_allclose(stds(found), stds(other), rtol=tolerance)


def moved_start(truth, twist):
    """The true X moved by a twist, with the Z and the scale of the truth."""
    return LinearStart(
        method="test",
        gripper_T_camera=truth.gripper_T_camera @ exp(np.array(twist)),
        base_T_world=truth.base_T_world,
        metres_per_world_unit=truth.unit,
        residual_rotation=0.0,
        residual_translation=0.0,
    )


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
    all_given(LEVELS := {
        "robot_rotation": 2e-3,
        "robot_translation": 5e-4,
        "camera_rotation": 3e-3,
        "camera_across": 4e-4,
        "camera_along": 1e-3,
    })  # fmt: skip
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
    assert heavy.noise == pytest.approx(LEVELS)


def test_levels_that_the_user_gives_stay(simulated):
    truth = simulated(7, 15)
    noise = NoiseOptions(robot_rotation_deg=0.1, robot_translation_mm=0.5)
    free = solved(truth, camera_noise="independent")
    given = solved(truth, camera_noise="independent", noise=noise)
    assert given.noise["robot_rotation"] == pytest.approx(np.deg2rad(0.1), rel=1e-12)
    assert given.noise["robot_translation"] == pytest.approx(5e-4, rel=1e-12)
    assert given.noise["camera_along"] != pytest.approx(free.noise["camera_along"], rel=1e-6)


def test_a_prior_completes_motion_about_one_axis(simulated):
    truth = simulated(8, 15, motion="one_axis")
    motion = log(inverse(truth.data.base_T_gripper[:-1]) @ truth.data.base_T_gripper[1:])[:, :3]
    axis = np.linalg.svd(motion)[2][0]
    value = axis @ truth.gripper_T_camera[:3, 3] + 1e-3
    start = start_of(truth.data, partial(truth.data, scale_known=True), "partial")
    prior = Prior(kind="translation-along", axis=tuple(axis), value=float(value), std=2e-3)
    found = solved(truth, start, priors=[prior])
    rotation, position = found.gripper_T_camera[:3, :3], found.gripper_T_camera[:3, 3]
    in_gripper = rotation @ found.covariance[3:6, 3:6] @ rotation.T
    # The axis is known to a few tenths of a degree: millimetres of position along it count little;
    # the t distribution of the noise does not widen what the prior says.
    assert axis @ position == pytest.approx(value, abs=2e-4)
    assert np.sqrt(axis @ in_gripper @ axis) == pytest.approx(2e-3, rel=0.02)
    assert not analyse(found.covariance, found.gripper_T_camera, "gripper").free_directions
    without = solved(truth, start)
    in_gripper = rotation @ without.covariance[3:6, 3:6] @ rotation.T
    assert np.sqrt(axis @ in_gripper @ axis) > USELESS_TRANSLATION


def test_free_directions_keep_the_start(simulated):
    truth = simulated(9, 15, motion="one_axis")
    motion = log(inverse(truth.data.base_T_gripper[:-1]) @ truth.data.base_T_gripper[1:])[:, :3]
    axis = np.linalg.svd(motion)[2][0]
    along = truth.gripper_T_camera[:3, :3].T @ axis
    start = moved_start(truth, [0, 0, 0, *(0.03 * along)])
    free = np.concatenate([np.zeros(3), along, [0.0]])[:, None]
    found = solved(truth, start, free=free)
    moved = found.gripper_T_camera[:3, 3] - start.gripper_T_camera[:3, 3]
    # Held to 0.5 mm; noise feigns information of a standard deviation of many centimetres.
    assert abs(axis @ moved) < 1e-4
    # The covariance does not know of it.
    in_camera = found.covariance[3:6, 3:6]
    assert np.sqrt(along @ in_camera @ along) > USELESS_TRANSLATION


def test_a_free_scale_keeps_the_start(simulated):
    # A gripper that rests but for turning leaves the scale and the position along which it moves.
    truth = simulated(10, 12, scale_known=False, motion="pure_rotation")
    start = moved_start(truth, np.zeros(6))
    free = np.eye(7)[:, [3, 4, 5, 6]]
    found = solved(truth, start, free=free, camera_noise="independent")
    # Held to a thousandth, and X to 0.5 mm.
    assert found.metres_per_world_unit == pytest.approx(truth.unit, rel=3e-3)
    assert np.abs(error(found, truth)[3:]).max() < 1e-3
    # Where X is not concerned, the scale of poses about a resting camera is held alone.
    alone = solved(truth, start, free=np.eye(7)[:, 6:], camera_noise="independent")
    assert alone.metres_per_world_unit == pytest.approx(truth.unit, rel=3e-3)


def outliers(truth, seed, n_wrong):
    """Robot poses of which some are anywhere, and which."""
    rng = np.random.default_rng(seed)
    n = len(truth.data)
    wrong = rng.permutation(n)[:n_wrong]
    robot = np.array(truth.data.base_T_gripper)
    turn = rng.standard_normal((n_wrong, 3))
    turn *= (rng.uniform(0.0, np.pi, n_wrong) / np.linalg.norm(turn, axis=1))[:, None]
    place = rng.uniform(-0.4, 0.4, (n_wrong, 3))
    robot[wrong] = robot[wrong] @ exp(np.hstack([turn, place]))
    return truth.with_data(base_T_gripper=robot), np.isin(np.arange(n), wrong)


@pytest.mark.simulation
def test_wrong_poses_are_named_and_do_no_harm(simulated):
    runs, named, innocent, with_wrong, without = 15, 0, 0, [], []
    for seed in range(runs):
        clean = simulated(100 + seed, 30)
        truth, wrong = outliers(clean, seed, 6)
        trusted = trusted_rows(truth.data, scale_known=True, seed=0)
        agreeing = only(truth.data, trusted)
        start = start_of(agreeing, METHODS["li"].solve(agreeing), "li")
        found = solved(truth, start, trusted=trusted)
        named += np.count_nonzero(found.outliers & wrong)
        innocent += np.count_nonzero(found.outliers & ~wrong)
        rest = only(clean.data, ~wrong)
        best = pose_graph(rest, clean.start(), scale_known=True, camera_noise="independent")
        with_wrong.append(error(found, truth) / stds(best)[:6])
        without.append(error(best, clean) / stds(best)[:6])
    # A pose anywhere within half a turn and 0.4 m looks like one with noise (0.2 degrees and 1 mm)
    # with probability below 1e-6. Each set has a false alarm with probability 0.01.
    assert named >= 0.95 * 6 * runs
    assert innocent <= 0.02 * 24 * runs
    assert np.sqrt(np.mean(np.square(with_wrong))) < 1.15 * np.sqrt(np.mean(np.square(without)))


def test_rows_that_were_not_trusted_come_back(simulated):
    truth = simulated(11, 15)
    trusted = np.ones(15, dtype=bool)
    trusted[[0, 4, 9]] = False
    found = solved(truth, trusted=trusted, camera_noise="independent")
    assert not found.outliers.any()
    assert_same(found, solved(truth, camera_noise="independent"), tolerance=0.01)


def test_half_of_the_poses_may_be_wrong_and_no_more(simulated):
    truth, wrong = outliers(simulated(12, 20), 3, 14)
    start = moved_start(truth, np.zeros(6))
    found = solved(truth, start, trusted=~wrong, camera_noise="independent")
    assert np.count_nonzero(found.outliers) <= 10


@pytest.mark.simulation
def test_heavy_tails_do_no_harm(simulated):
    # Student's t of 3 degrees of freedom has three times the variance of its scale parameter. A
    # normal noise of that variance, the same number of runs: the ratio of two rms of 25 x 6 numbers
    # has a standard error of 1 / sqrt(150) = 0.08 and more for heavy tails; bound of 1.2.
    runs, tails, normal = 25, [], []
    root = np.sqrt(3.0)
    names = ["robot_rotation", "robot_translation", "camera_rotation"]
    levels = {
        "robot_rotation": np.deg2rad(0.05),
        "robot_translation": 2.5e-4,
        "camera_rotation": np.deg2rad(0.1),
        "camera_across": 2e-4,
        "camera_along": 6e-4,
    }
    assert set(names) < set(levels)
    inside = []
    for seed in range(runs):
        heavy = simulated(200 + seed, 20, tails=3.0, **levels)
        light = simulated(200 + seed, 20, **{k: root * v for k, v in levels.items()})
        found = solved(heavy, camera_noise="independent")
        plain = solved(light, camera_noise="independent")
        tails.append(error(found, heavy) / stds(plain)[:6])
        normal.append(error(plain, light) / stds(plain)[:6])
        inside.append(np.abs(error(found, heavy) / stds(found)[:6]) < 2.0)
    assert np.sqrt(np.mean(np.square(tails))) < 1.2 * np.sqrt(np.mean(np.square(normal)))
    # 95 % within two standard deviations, 25 x 6 numbers (worst: 25 independent ones: 4 %, twice).
    assert np.mean(inside) > 0.87


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


@pytest.mark.parametrize("motion", ["general", "one_axis", "pure_translation", "pure_rotation"])
@pytest.mark.parametrize("scale_known", [True, False])
def test_exact_poses_of_every_motion_have_a_finite_answer(simulated, no_noise, motion, scale_known):
    truth = simulated(17, 8, motion=motion, scale_known=scale_known, **no_noise)
    found = solved(truth, moved_start(truth, np.zeros(6)))
    # The truth fits, whatever is free.
    assert np.abs(error(found, truth)).max() < 1e-6
    assert np.isfinite(found.covariance).all()
    free = analyse(found.covariance, found.gripper_T_camera, "gripper").free_directions
    expected = {"general": 0, "one_axis": 1, "pure_translation": 3, "pure_rotation": None}[motion]
    assert expected is None or len(free) == expected


@pytest.mark.parametrize("seed", range(3))
def test_hopeless_poses_have_a_covariance(simulated, levels, seed):
    # Degrees and centimetres of noise on a gripper at rest: the scale goes to zero.
    wild = {name: 50.0 * sigma for name, sigma in levels.items()}
    truth = simulated(seed, 6, motion="pure_rotation", scale_known=False, **wild)
    found = solved(truth, moved_start(truth, np.zeros(6)))
    variances = np.linalg.eigvalsh(found.covariance / np.outer(LIMITS, LIMITS))
    assert np.isfinite(variances).all()
    assert variances[0] > -1e-12 * variances[-1]


def test_no_noise_model_with_an_optimum_is_an_error(simulated, monkeypatch):
    def fails(*_arguments):
        raise ConvergenceError("no optimum")

    monkeypatch.setattr(estimator, "fitted", fails)
    with pytest.raises(ConvergenceError, match="do not determine"):
        solved(simulated(18, 8, scale_known=False), moved_start(simulated(18, 8), np.zeros(6)))


def test_rounds_without_end_are_told(simulated, monkeypatch):
    monkeypatch.setattr(fit, "_MAX_ROUNDS", 1)
    truth = simulated(14, 8)
    start = moved_start(truth, [0.2, 0.1, -0.2, 0.05, 0.03, -0.02])
    assert not solved(truth, start).converged


def test_too_little_is_refused(simulated):
    truth = simulated(15, 8)
    two = truth.with_data(
        base_T_gripper=truth.data.base_T_gripper[:2],
        world_T_camera=truth.data.world_T_camera[:2],
        weights=np.ones(2),
    )
    start = truth.start()
    with pytest.raises(InputDataError, match="2 poses are too few"):
        solved(two, start)
    motion = MotionPairs(
        i=np.array([0]),
        j=np.array([1]),
        gi_T_gj=truth.data.base_T_gripper[:1],
        ci_T_cj=truth.data.world_T_camera[:1],
    )
    with pytest.raises(InputDataError, match="1 motions are too few"):
        pose_graph(motion, start, scale_known=True)
    nowhere = LinearStart(
        method="test",
        gripper_T_camera=np.eye(4),
        base_T_world=None,
        metres_per_world_unit=1.0,
        residual_rotation=0.0,
        residual_translation=0.0,
    )
    with pytest.raises(ValueError, match="base_T_world"):
        solved(truth, nowhere)


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
