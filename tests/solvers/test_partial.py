"""What motions of every kind determine: the table of the paper's summary, row by row."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from exact_poses import X_RANDOM
from handeye_fg.errors import InputDataError, UnobservableError
from handeye_fg.frames import Array, exp, pose, scaled
from handeye_fg.motions import PosePairs
from handeye_fg.observability import LIMITS
from handeye_fg.solvers import partial
from kinds_of_motion import (
    FIRST,
    SCALE,
    TABLE,
    TILTED,
    Z_AXIS,
    T,
    answer,
    as_poses,
    kinds,
    many_poses,
    misfit,
    seen,
    separate,
)

FEW = settings(max_examples=25)


@pytest.mark.parametrize("row", TABLE)
@pytest.mark.parametrize("form", ["poses", "motions"])
def test_table_without_noise(row: str, form: str) -> None:
    motions, free = TABLE[row]
    data = (
        as_poses(motions, X_RANDOM, SCALE, np.random.default_rng(0))
        if form == "poses"
        else separate(motions, X_RANDOM, SCALE)
    )
    found, _, observed = answer(data)
    assert kinds(observed) == free
    assert observed.free_basis.shape[1] == len(free)
    # Whatever was chosen along the free directions, it closes A X = X B: the rest is exact.
    assert misfit(data, found) < 1e-12
    X = np.asarray(found.gripper_T_camera)
    if "r" not in free:
        np.testing.assert_allclose(X[:3, :3], X_RANDOM[:3, :3], atol=1e-9)
    if "s" not in free:
        assert found.metres_per_world_unit == pytest.approx(SCALE, rel=1e-9)
    else:
        assert observed.log_scale_std == np.inf
    if free == "s":
        ratio = X[:3, 3] / found.metres_per_world_unit
        np.testing.assert_allclose(ratio, X_RANDOM[:3, 3] / SCALE, atol=1e-9)
    if free in ("", "t"):
        axis = observed.free_directions[0].vector if free else np.zeros(3)
        missing = X[:3, 3] - X_RANDOM[:3, 3]
        np.testing.assert_allclose(missing, axis * (axis @ missing), atol=1e-9)


def test_free_directions_are_those_of_the_table() -> None:
    def vectors(row: str) -> list[Array]:
        data = separate(TABLE[row][0], X_RANDOM, SCALE)
        return [direction.vector for direction in answer(data)[2].free_directions]

    np.testing.assert_allclose(vectors("T + T"), np.eye(3))
    turns = vectors("one T")[3]
    np.testing.assert_allclose(np.abs(turns @ FIRST), np.linalg.norm(FIRST), atol=1e-9)
    for row in ("one R", "one P", "one S", "R + R, one axis"):
        directions = vectors(row)
        np.testing.assert_allclose(np.abs(directions[0] @ TILTED), 1.0, atol=1e-9)
        np.testing.assert_allclose(np.abs(directions[-1] @ TILTED), 1.0, atol=1e-6)
    (along,) = vectors("R + R")
    t_X = X_RANDOM[:3, 3]
    np.testing.assert_allclose(np.abs(along @ t_X), np.linalg.norm(t_X), atol=1e-9)


def test_a_known_scale_leaves_less_free() -> None:
    free = {"one R": "tr", "one P": "tr", "R + R": "", "R + R, one axis": "tr", "T + T": "ttt"}
    for row, wanted in free.items():
        data = separate(TABLE[row][0], X_RANDOM, 1.0)
        found, covariance, observed = answer(data, scale_known=True)
        assert kinds(observed) == wanted
        assert found.metres_per_world_unit == 1.0
        assert misfit(data, found) < 1e-12
        np.testing.assert_array_equal(covariance[6], 0.0)


twists = arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)).map(
    lambda xi: xi * [1.7, 1.7, 1.7, 0.1, 0.1, 0.1]
)
rows = st.sampled_from(sorted(TABLE))
scales = st.floats(-3.0, 3.0).map(np.exp)


@FEW
@given(rows, twists, scales)
def test_any_mounting_closes_the_chain(row: str, xi: Array, scale: float) -> None:
    data = separate(TABLE[row][0], exp(xi), scale)
    found, covariance, _ = answer(data)
    assert misfit(data, found) < 1e-9
    assert np.isfinite(covariance).all()
    assert np.linalg.eigvalsh(covariance / np.outer(LIMITS, LIMITS))[0] > 0.0


@FEW
@given(rows, twists, twists)
def test_the_frames_do_not_matter(row: str, base: Array, world: Array) -> None:
    data = as_poses(TABLE[row][0], X_RANDOM, SCALE, np.random.default_rng(1))
    moved = PosePairs(
        base_T_gripper=exp(base) @ data.base_T_gripper,
        world_T_camera=exp(world) @ data.world_T_camera,
    )
    found, again = (partial(poses, scale_known=False) for poses in (data, moved))
    np.testing.assert_allclose(again.gripper_T_camera, found.gripper_T_camera, atol=1e-7)
    assert again.metres_per_world_unit == pytest.approx(found.metres_per_world_unit, rel=1e-7)


@FEW
@given(st.floats(0.01, 100.0))
def test_the_unit_of_the_world_scales_the_scale_only(factor: float) -> None:
    rng = np.random.default_rng(6)
    data = seen(many_poses("scara", rng), X_RANDOM, SCALE, rng, 1.0)
    other = PosePairs(
        base_T_gripper=data.base_T_gripper, world_T_camera=scaled(data.world_T_camera, factor)
    )
    found, again = (partial(poses, scale_known=False) for poses in (data, other))
    np.testing.assert_allclose(again.gripper_T_camera, found.gripper_T_camera, atol=1e-8)
    assert again.metres_per_world_unit * factor == pytest.approx(
        found.metres_per_world_unit, rel=1e-7
    )


@pytest.mark.parametrize("who", ["robot", "camera"])
def test_nothing_moved(who: str) -> None:
    data = as_poses(TABLE["S + S"][0], X_RANDOM, SCALE, np.random.default_rng(2))
    still = np.stack([np.eye(4)] * 3)
    poses = {"base_T_gripper": data.base_T_gripper, "world_T_camera": data.world_T_camera}
    poses["base_T_gripper" if who == "robot" else "world_T_camera"] = still
    with pytest.raises(UnobservableError, match=f"the {who} did not move"):
        partial(PosePairs(**poses), scale_known=False)


def test_mirrored_motions_are_another_convention() -> None:
    rng = np.random.default_rng(8)
    for kind in ("general", "translations"):
        data = seen(many_poses(kind, rng), X_RANDOM, SCALE, rng, 0.1)
        mirrored = PosePairs(
            base_T_gripper=data.base_T_gripper, world_T_camera=scaled(data.world_T_camera, -1.0)
        )
        with pytest.raises(InputDataError, match="scale came out negative"):
            partial(mirrored, scale_known=False)


def test_opposite_axes_are_taken_to_each_other() -> None:
    """The smallest turn is half a turn, about any axis across them."""
    half = pose(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    data = separate([T(0.3 * Z_AXIS)], half, 1.0)
    found, _, observed = answer(data)
    assert misfit(data, found) < 1e-12
    assert kinds(observed) == "tttr"
