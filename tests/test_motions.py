"""Pairs satisfy A X = X B, are chosen as documented, and tell their axes."""

import tracemalloc

import numpy as np
import pytest

from exact_poses import motions_between
from handeye_fg.errors import InputDataError
from handeye_fg.frames import exp, inverse, pose, rotation_angle, scaled
from handeye_fg.motions import (
    MAX_PAIRS,
    MotionPairs,
    PosePairs,
    as_motions,
    as_poses,
    axis_spread,
)
from handeye_fg.simulate import simulate_poses


def test_pairs_close_in_metres() -> None:
    robot, camera, truth = simulate_poses(np.random.default_rng(0))
    pairs = motions_between(robot, camera)
    X = truth.gripper_T_camera
    np.testing.assert_allclose(
        pairs.gi_T_gj @ X,
        X @ scaled(pairs.ci_T_cj, truth.metres_per_world_unit),
        atol=1e-14,
    )


def test_few_poses_give_all_pairs_in_order() -> None:
    robot, camera, _ = simulate_poses(np.random.default_rng(1), n_poses=6)
    pairs = motions_between(robot, camera)
    assert len(pairs) == 15
    assert pairs.n_poses == 6
    assert np.all(pairs.i < pairs.j)
    np.testing.assert_allclose(pairs.gi_T_gj[0], inverse(robot[0]) @ robot[1])
    np.testing.assert_allclose(pairs.ci_T_cj[-1], inverse(camera[4]) @ camera[5])


@pytest.mark.parametrize(("n", "max_pairs"), [(64, MAX_PAIRS), (200, 500), (50, 10), (300, 2000)])
def test_many_poses_give_distant_pairs_of_every_pose(n: int, max_pairs: int) -> None:
    robot, camera, _ = simulate_poses(np.random.default_rng(2), n_poses=n)
    pairs = motions_between(robot, camera, max_pairs=max_pairs)
    assert len(pairs) == max_pairs
    assert np.all(pairs.i < pairs.j)
    assert len({(i, j) for i, j in zip(pairs.i, pairs.j, strict=True)}) == len(pairs)
    if max_pairs >= 2 * n:
        assert pairs.n_poses == n
        everything = motions_between(robot, camera, max_pairs=n * n)
        assert baseline(pairs) > baseline(everything)
        assert turn(pairs) > turn(everything)


def baseline(pairs: MotionPairs) -> float:
    return float(np.linalg.norm(pairs.ci_T_cj[:, :3, 3], axis=1).mean())


def turn(pairs: MotionPairs) -> float:
    return float(rotation_angle(pairs.gi_T_gj[:, :3, :3]).mean())


def test_selection_keeps_a_weak_second_axis() -> None:
    # Half turns about the vertical everywhere, and tilts of at most ten degrees.
    rng = np.random.default_rng(3)
    n = 150
    vertical = np.zeros((n, 6))
    vertical[:, 2] = rng.uniform(-np.pi, np.pi, n)
    tilt = np.zeros((n, 6))
    tilt[:, 0] = rng.uniform(-0.17, 0.17, n)
    robot = exp(vertical) @ exp(tilt)
    robot[:, :3, 3] = rng.uniform(-0.3, 0.3, (n, 3))
    few, everything = (
        motions_between(robot, robot, max_pairs=300),
        motions_between(robot, robot, max_pairs=n * n),
    )
    assert axis_spread(few).relative[1] > 0.7 * axis_spread(everything).relative[1]


def test_memory_follows_the_pairs_not_the_square_of_the_poses() -> None:
    n = 2000
    poses = exp(np.random.default_rng(4).uniform(-1.0, 1.0, (n, 6)))
    tracemalloc.start()
    try:
        motions_between(poses, poses, max_pairs=2000)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # All 2 million pairs would take 256 MB a list of matrices; 2000 poses and pairs take 0.25 MB.
    assert peak < 16e6


@pytest.mark.parametrize(
    ("motion", "n_axes"), [("general", 3), ("one_axis", 1), ("pure_translation", 0)]
)
def test_axis_spread_counts_axes(motion, n_axes: int) -> None:
    robot, camera, _ = simulate_poses(np.random.default_rng(7), motion=motion)
    spread = axis_spread(motions_between(robot, camera))
    assert int(np.sum(spread.rms_rotation > 1e-6)) == n_axes
    np.testing.assert_allclose(spread.axes.T @ spread.axes, np.eye(3), atol=1e-12)
    assert np.all(np.diff(spread.relative) <= 0.0)


def test_axis_spread_names_the_axis_and_its_size() -> None:
    # 0, 90 and 180 degrees about the gripper's y: pairs of 90, 180 and 90 degrees.
    xi = np.zeros((3, 6))
    xi[:, 1] = [0.0, np.pi / 2, np.pi]
    poses = exp(xi)
    spread = axis_spread(motions_between(poses, poses))
    np.testing.assert_allclose(np.abs(spread.axes[:, 0]), [0.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(spread.rms_rotation, [np.pi / 2 * np.sqrt(2.0), 0.0, 0.0], atol=1e-7)
    np.testing.assert_allclose(spread.relative, [1.0, 0.0, 0.0], atol=1e-7)


def test_axis_spread_of_identical_poses_and_of_one_pair() -> None:
    same = np.stack([np.eye(4)] * 3)
    np.testing.assert_array_equal(axis_spread(motions_between(same, same)).relative, np.zeros(3))
    one = MotionPairs(
        i=np.array([0]),
        j=np.array([1]),
        gi_T_gj=exp(np.array([[0.0, 0.0, 0.3, 0.0, 0.0, 0.0]])),
        ci_T_cj=np.eye(4)[None],
    )
    spread = axis_spread(one)
    np.testing.assert_allclose(spread.rms_rotation, [0.3, 0.0, 0.0])
    assert spread.axes.shape == (3, 3)


def test_wrong_input_is_refused_with_its_place() -> None:
    good = exp(np.random.default_rng(8).uniform(-1.0, 1.0, (4, 6)))
    with pytest.raises(InputDataError, match=r"1 pose\(s\) say nothing"):
        motions_between(good[:1], good[:1])
    with pytest.raises(InputDataError, match="4 robot poses but 3 camera poses"):
        motions_between(good, good[:3])
    with pytest.raises(InputDataError, match="robot poses have the shape"):
        motions_between(good[:, :3], good)
    broken = good.copy()
    broken[2, 1, 3] = np.nan
    with pytest.raises(InputDataError, match="camera pose 2 holds a value that is not a finite"):
        motions_between(good, broken)
    mirrored = good.copy()
    mirrored[1, :3, 0] *= -1.0
    with pytest.raises(InputDataError, match="robot pose 1 does not hold a rotation"):
        motions_between(mirrored, good)
    in_degrees = pose(57.3 * good[:, :3, :3], good[:, :3, 3])
    with pytest.raises(InputDataError, match="does not hold a rotation"):
        motions_between(good, in_degrees)


def test_pairs_check_their_shapes_and_are_read_only() -> None:
    one = np.eye(4)[None]
    with pytest.raises(ValueError, match="gi_T_gj"):
        MotionPairs(i=np.array([0, 1]), j=np.array([1, 2]), gi_T_gj=one, ci_T_cj=one)
    with pytest.raises(ValueError, match=r"self\.j\.shape"):
        MotionPairs(i=np.array([0]), j=np.array([1, 2]), gi_T_gj=one, ci_T_cj=one)
    pairs = MotionPairs(i=np.array([0]), j=np.array([1]), gi_T_gj=one, ci_T_cj=one)
    with pytest.raises(ValueError, match="read-only"):
        pairs.gi_T_gj[0, 0, 0] = 2.0


def test_poses_become_motions_with_the_product_of_their_weights() -> None:
    poses, _, _ = simulate_poses(np.random.default_rng(8), n_poses=5)
    data = PosePairs(
        base_T_gripper=poses, world_T_camera=poses, weights=np.array([1.0, 2.0, 3.0, 4.0, 0.0])
    )
    pairs = as_motions(data)
    assert as_motions(pairs) is pairs
    np.testing.assert_array_equal(
        pairs.weights, np.outer(data.weights, data.weights)[pairs.i, pairs.j]
    )
    back = as_poses(pairs)
    assert as_poses(data) is data
    np.testing.assert_array_equal(back.base_T_gripper[len(pairs) :], pairs.gi_T_gj)
    np.testing.assert_array_equal(back.base_T_gripper[0], np.eye(4))
    np.testing.assert_array_equal(back.weights, np.tile(pairs.weights, 2))


def test_weights_are_checked() -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    for weights in (np.ones(2), np.array([1.0, -1.0, 1.0]), np.array([1.0, np.nan, 1.0])):
        with pytest.raises(InputDataError, match="weights"):
            PosePairs(base_T_gripper=poses, world_T_camera=poses, weights=weights)
