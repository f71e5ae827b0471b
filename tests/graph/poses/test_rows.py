"""Measurements of poses: noise of the size and in the axes that they claim, columns where they belong."""

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L

from handeye_fg.frames import exp, inverse, log, pose
from handeye_fg.graph.poses import NoiseModel
from handeye_fg.graph.poses.measurements import (
    Columns,
    camera_measurements,
    odometry_measurements,
    robot_measurements,
    rows_of,
    scale_measurements,
    tie,
)
from handeye_fg.graph.variables import BASE_T_WORLD, GRIPPER_T_CAMERA, camera_key

N = 2000
SIGMAS = {
    "robot_rotation": 2e-3,
    "robot_translation": 1e-3,
    "camera_rotation": 3e-3,
    "camera_across": 4e-4,
    "camera_along": 5e-3,
    "odometry_rotation": 1e-3,
    "odometry_translation": 2e-3,
    "scale_drift": 0.01,
}
# Relative standard error of a sample (co)variance: sqrt(2 / N) and sqrt(1 / N). There are 21 of them;
# second order in sigmas of 5e-3 is 1e-2 at most.
TOLERANCE = 4.0 * np.sqrt(2.0 / N) + 0.01


def random_pose(rng):
    return exp(np.concatenate([rng.uniform(-1.5, 1.5, 3), rng.uniform(-1.0, 1.0, 3)]))


def truth(rng):
    """A camera pose, X, Z, ln scale and the robot's pose that belongs to them."""
    c, X, Z, scale = random_pose(rng), random_pose(rng), random_pose(rng), 0.3
    metric = np.array(c)
    metric[:3, 3] *= np.exp(scale)
    return c, X, Z, scale, Z @ metric @ inverse(X)


def values_of(cameras, X, Z, scales):
    values = gtsam.Values()
    for i, c in enumerate(cameras):
        values.insert(camera_key(i), gtsam.Pose3(c))
    values.insert(GRIPPER_T_CAMERA, gtsam.Pose3(X))
    values.insert(BASE_T_WORLD, gtsam.Pose3(Z))
    for i, scale in enumerate(scales):
        values.insert(L(i), float(scale))
    return values


def whitened(measurement, values):
    """The factor's residual in standard deviations."""
    return -measurement.with_noise(SIGMAS).linearize(values).jacobian()[1].ravel()


def assert_standard(samples):
    """Samples (N, d) are independent, of mean zero and variance one."""
    d = samples.shape[1]
    np.testing.assert_allclose(samples.T @ samples / len(samples), np.eye(d), atol=TOLERANCE)
    assert np.abs(samples.mean(axis=0)).max() < 4.0 / np.sqrt(N) + 0.01


def assert_covariance(measurement, errors):
    """The covariance that the measurement says is that of samples (N, 6), in units of its roots."""
    root = np.linalg.cholesky(measurement.covariance(SIGMAS))
    assert_standard(np.linalg.solve(root, errors.T).T)


@pytest.mark.parametrize("inverted", [False, True])
def test_a_robot_errs_in_the_gripper_frame(inverted):
    rng = np.random.default_rng(1)
    c, X, Z, scale, robot = truth(rng)
    base_T_gripper = inverse(robot) if inverted else robot
    noise = exp(rng.standard_normal((N, 6)) * np.repeat([2e-3, 1e-3], 3))
    reported = base_T_gripper @ noise
    measured = inverse(reported) if inverted else reported
    values = values_of([c] * N, X, Z, [scale])
    found = robot_measurements(measured, np.ones(N), "free", inverted=inverted)
    assert_standard(np.array([whitened(m, values) for m in found]))
    assert_covariance(found[0], log(inverse(measured) @ robot))


def test_a_camera_errs_in_the_orientation_of_what_it_sees_across_and_along():
    rng = np.random.default_rng(2)
    world_T_camera = random_pose(rng)
    camera_T_world = inverse(world_T_camera)
    # The target at the world's origin seems turned, and shifted in the camera's axes.
    turn = exp(rng.standard_normal((N, 6)) * [3e-3, 3e-3, 3e-3, 0, 0, 0])[:, :3, :3]
    shift = rng.standard_normal((N, 3)) * [4e-4, 4e-4, 5e-3]
    seen = inverse(pose(camera_T_world[:3, :3] @ turn, camera_T_world[:3, 3] + shift))
    values = values_of([world_T_camera] * N, np.eye(4), np.eye(4), [0.0])
    found = camera_measurements(seen, np.ones(N))
    assert_standard(np.array([whitened(m, values) for m in found]))
    assert_covariance(found[0], log(inverse(seen) @ world_T_camera))


def test_odometry_errs_from_pose_to_pose():
    rng = np.random.default_rng(3)
    cameras = np.array([random_pose(rng) for _ in range(N)])
    step = inverse(cameras[:-1]) @ cameras[1:]
    step = step @ exp(rng.standard_normal((N - 1, 6)) * np.repeat([1e-3, 2e-3], 3))
    seen = [cameras[0]]
    for motion in step:
        seen.append(seen[-1] @ motion)
    values = values_of(cameras, np.eye(4), np.eye(4), [0.0])
    first, *found = odometry_measurements(np.array(seen))
    assert_standard(np.array([whitened(m, values) for m in found]))
    # The first pose is exact.
    np.testing.assert_allclose(whitened(first, values), 0.0, atol=1e-6)
    shifted = values_of([cameras[0] @ exp(np.full(6, 1e-6))], np.eye(4), np.eye(4), [0.0])
    np.testing.assert_allclose(whitened(first, shifted), 1.0, rtol=1e-3)


def test_a_scale_walks():
    rng = np.random.default_rng(4)
    scales = np.cumsum(0.01 * rng.standard_normal(N))
    values = values_of([], np.eye(4), np.eye(4), scales)
    found = scale_measurements(N, "drifting")
    assert_standard(np.array([whitened(m, values) for m in found]))


def test_a_known_scale_is_one_and_a_free_one_is_not_measured():
    (known,) = scale_measurements(5, "known")
    values = values_of([], np.eye(4), np.eye(4), [1e-6])
    assert whitened(known, values)[0] == pytest.approx(1.0, rel=1e-6)
    assert scale_measurements(5, "free") == []


def test_motions_tie_world_and_gripper():
    rng = np.random.default_rng(5)
    X = random_pose(rng)
    tied = whitened(tie(), values_of([], X, X @ exp(np.full(6, 1e-6)), []))
    np.testing.assert_allclose(tied, 1.0, rtol=1e-3)


@pytest.mark.parametrize("make", [robot_measurements, camera_measurements])
def test_a_weight_divides_the_variances(make):
    rng = np.random.default_rng(6)
    c, X, Z, scale, robot = truth(rng)
    extra = ("free",) if make is robot_measurements else ()
    keywords = {"inverted": False} if extra else {}
    plain = make(robot[None], np.ones(1), *extra, **keywords)[0]
    heavy = make(robot[None], np.array([4.0]), *extra, **keywords)[0]
    np.testing.assert_allclose(heavy.covariance(SIGMAS), plain.covariance(SIGMAS) / 4.0, rtol=1e-9)
    values = values_of([c @ exp(np.full(6, 0.01))], X, Z, [scale])
    np.testing.assert_allclose(whitened(heavy, values), 2.0 * whitened(plain, values), rtol=1e-9)


@pytest.mark.parametrize("camera", ["independent", "odometry"])
@pytest.mark.parametrize("scale", ["known", "free", "drifting"])
def test_each_unknown_has_its_columns(camera, scale):
    rng = np.random.default_rng(7)
    n = 4
    model, columns = NoiseModel(camera=camera, scale=scale), Columns(n_poses=n, scale=scale)
    robot = np.array([random_pose(rng) for _ in range(n)])
    cameras = np.array([random_pose(rng) for _ in range(n)])
    weights = rng.uniform(0.5, 2.0, n)
    measurements = [
        *robot_measurements(robot, weights, scale, inverted=True),
        *(
            camera_measurements(cameras, weights)
            if camera == "independent"
            else odometry_measurements(cameras)
        ),
        *scale_measurements(n, scale),
    ]
    priors = gtsam.NonlinearFactorGraph()
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.linspace(1.0, 2.0, 6))
    priors.addPriorPose3(GRIPPER_T_CAMERA, gtsam.Pose3(random_pose(rng)), noise)
    n_scales = n if scale == "drifting" else 1
    near = cameras @ exp(0.01 * rng.standard_normal((n, 6)))
    # Near the robot's poses, so that no logarithm comes close to a half turn.
    values = values_of(
        near, random_pose(rng), random_pose(rng), 0.01 * rng.standard_normal(n_scales)
    )

    def rows(at):
        return rows_of(measurements, priors, at, columns, model.components)

    found = rows(values)
    jacobian, step = found.jacobian.toarray(), 1e-6
    used = []
    for key in values.keys():
        where = columns.of(key)
        used += where
        for axis, column in enumerate(where):
            moved = gtsam.VectorValues()
            delta = np.zeros(len(where))
            delta[axis] = step
            moved.insert(key, delta)
            change = rows(values.retract(moved)).residual - found.residual
            # Ties have rows of 1e6 per unit: relative to each column, first order in 1e-6.
            size = np.abs(jacobian[:, column]).max()
            np.testing.assert_allclose(change / step, jacobian[:, column], atol=2e-5 * size)
    assert sorted(used) == list(range(columns.total))
    # Chain first, X and the (first) scale wanted; neighbours only.
    assert columns.wanted[:6] == list(columns.of(GRIPPER_T_CAMERA))
    assert columns.wanted[6] == columns.of(L(0))[0]
    chain = [key for key in values.keys() if columns.of(key).start < columns.n_chain]
    assert {chr(gtsam.symbolChr(key)) for key in chain} <= {"c", "l"}
    assert found.block == columns.stride
    assert columns.ordering.size() == values.size()
    # The first rows are the prior's.
    assert set(found.component[:6]) == {-1}
    kinds = {model.components[k] for k in found.component if k >= 0}
    assert kinds == set(model.components)
