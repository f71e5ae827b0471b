"""Right turns of the camera told from wrong ones by the robot's, and one setup from the other."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from handeye_fg.frames import pose
from handeye_fg.simulate import simulate_poses
from handeye_fg.turns import RobotTurns, agreement, pose_agreement


def random_turns(rng: np.random.Generator, n: int) -> np.ndarray:
    return Rotation.random(n, random_state=rng).as_matrix()


@pytest.mark.parametrize("seed", range(5))
def test_a_fifth_of_right_turns_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R_X, robot = random_turns(rng, 1)[0], random_turns(rng, 150)
    noise = Rotation.from_rotvec(np.deg2rad(0.5) * rng.normal(size=(150, 3))).as_matrix()
    camera = R_X.T @ robot @ R_X @ noise
    right = rng.permutation(150) < 30
    camera[~right] = random_turns(rng, 120)
    found = agreement(robot, camera)
    assert found.significant
    assert found.agrees[right].sum() >= 28
    assert found.agrees[~right].sum() <= 3


def test_chance_is_not_significant() -> None:
    """Neither where nothing fits nor where the angles do: the worst case, as with inverted poses."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        robot = random_turns(rng, 120)
        assert not agreement(robot, random_turns(rng, 120)).significant
        angle = Rotation.from_matrix(robot).magnitude()[:, None]
        axis = rng.normal(size=(120, 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        assert not agreement(robot, Rotation.from_rotvec(angle * axis).as_matrix()).significant


def test_too_few_turns_say_nothing() -> None:
    found = agreement(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)))
    assert len(found.agrees) == 0
    assert not found.significant


def test_the_right_setup_agrees_and_the_other_does_not() -> None:
    reported, camera, _ = simulate_poses(np.random.default_rng(1), n_poses=10)
    right = RobotTurns(rotations=reported[:, :3, :3], setup="eye-in-hand")
    assert pose_agreement(right, [(np.arange(10), camera)]) == pytest.approx(1.0)
    wrong = right.inverted()
    assert wrong.setup == "eye-to-hand"
    assert pose_agreement(wrong, [(np.arange(10), camera)]) < 0.3


def test_wrong_rows_agree_with_none() -> None:
    reported, camera, _ = simulate_poses(np.random.default_rng(3), n_poses=20)
    reported[:6] = reported[[1, 2, 3, 4, 5, 0]]
    turns = RobotTurns(rotations=reported[:, :3, :3], setup="eye-in-hand")
    assert 0.4 < pose_agreement(turns, [(np.arange(20), camera)]) < 0.6  # (14 / 20)^2


def test_worlds_of_their_own_turn_with_one_mounting() -> None:
    reported, camera, _ = simulate_poses(np.random.default_rng(6), n_poses=12)
    turns = RobotTurns(rotations=reported[:, :3, :3], setup="eye-in-hand")
    halves = np.arange(5), np.arange(5, 12)
    elsewhere = pose(random_turns(np.random.default_rng(7), 1)[0], np.zeros(3))
    moved = elsewhere @ camera[halves[1]]
    apart = [(halves[0], camera[halves[0]]), (halves[1], moved)]
    assert pose_agreement(turns, apart) == pytest.approx(1.0)
    falsely_one = np.concatenate([camera[halves[0]], moved])
    # 31 of 66 pairs are within a half.
    assert pose_agreement(turns, [(np.arange(12), falsely_one)]) == pytest.approx(31 / 66, abs=0.1)
