"""Poses that determine little, or too little, in the pose graph; with a prior and without."""

import numpy as np
import pytest

from handeye_fg.errors import ConvergenceError, InputDataError
from handeye_fg.findings import LinearStart
from handeye_fg.frames import inverse, log
from handeye_fg.graph.poses import estimator, fit, pose_graph
from handeye_fg.motions import MotionPairs
from handeye_fg.observability import LIMITS, USELESS_TRANSLATION, analyse
from handeye_fg.priors import Prior
from handeye_fg.solvers import partial, start_of
from pose_graphs import error, moved_start, solved


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
