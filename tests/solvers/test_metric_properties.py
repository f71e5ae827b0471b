"""Properties of the solvers that take metres, on random poses that Hypothesis can shrink."""

from collections.abc import Iterator

import numpy as np
from hypothesis import assume, given
from hypothesis import strategies as st

from exact_poses import pose_lists, twists
from handeye_fg.errors import UnobservableError
from handeye_fg.frames import Array, exp, inverse, scaled
from handeye_fg.motions import PosePairs, as_motions, axis_spread
from handeye_fg.simulate import disturbed
from handeye_fg.solvers import METHODS, Solution, li
from handeye_fg.solvers.solution import Solver

METRIC = [method.solve for method in METHODS.values() if method.scale_known]

seeds = st.integers(0, 2**32 - 1)


def solvable(robot: Array, camera: Array) -> PosePairs:
    """The poses, if they turn about two clear axes and move, which Hypothesis may not draw."""
    data = PosePairs(base_T_gripper=robot, world_T_camera=camera)
    for one, other in ((robot, camera), (camera, robot)):
        pairs = as_motions(PosePairs(base_T_gripper=one, world_T_camera=other))
        R = pairs.gi_T_gj[:, :3, :3]
        assume(axis_spread(pairs).rms_rotation[1] > 0.2)
        # Half turns alone leave several rotations.
        K = np.einsum("kij,kab->iajb", R, pairs.ci_T_cj[:, :3, :3]).reshape(9, 9) / len(pairs)
        assume(np.diff(np.linalg.eigvalsh(K + K.T)[-2:]) > 0.02)
        # li finds the size of its rotations from the positions.
        assume(np.std(one[:, :3, 3], axis=0).max() > 0.05)
    return data


def answers(data: PosePairs) -> Iterator[tuple[Solver, Solution]]:
    """Solvers and what they find; li may refuse positions that its linear system cannot use."""
    for solve in METRIC:
        try:
            yield solve, solve(data)
        except UnobservableError:
            assert solve is li


@given(pose_lists, twists, twists)
def test_all_agree_without_noise(robot: Array, xi: Array, world: Array) -> None:
    X, Z = exp(xi), exp(world)
    data = solvable(robot, inverse(Z) @ robot @ X)
    for solve, found in answers(data):
        np.testing.assert_allclose(found.gripper_T_camera, X, atol=1e-8, err_msg=str(solve))
        if found.base_T_world is not None:
            np.testing.assert_allclose(found.base_T_world, Z, atol=1e-8, err_msg=str(solve))


@given(pose_lists, twists)
def test_exchanging_robot_and_camera_inverts_x(robot: Array, xi: Array) -> None:
    camera = robot @ exp(xi)
    data = solvable(robot, camera)
    exchanged = PosePairs(base_T_gripper=camera, world_T_camera=robot)
    backwards = dict(answers(exchanged))
    for solve, found in answers(data):
        if solve not in backwards:
            continue
        product = found.gripper_T_camera @ backwards[solve].gripper_T_camera
        np.testing.assert_allclose(product, np.eye(4), atol=1e-8, err_msg=str(solve))


@given(pose_lists, twists, twists, twists, seeds)
def test_other_base_and_world_frames_leave_x(
    robot: Array, xi: Array, base_change: Array, world_change: Array, seed: int
) -> None:
    noisy = disturbed(np.random.default_rng(seed), robot, 1e-3, 1e-3)
    data = solvable(noisy, robot @ exp(xi))
    other_T_base, other_T_world = exp(base_change), exp(world_change)
    moved = PosePairs(
        base_T_gripper=other_T_base @ data.base_T_gripper,
        world_T_camera=other_T_world @ data.world_T_camera,
    )
    for solve, plain in answers(data):
        other = solve(moved)
        np.testing.assert_allclose(
            other.gripper_T_camera, plain.gripper_T_camera, atol=1e-7, err_msg=str(solve)
        )
        if plain.base_T_world is not None:
            expected = other_T_base @ plain.base_T_world @ inverse(other_T_world)
            np.testing.assert_allclose(other.base_T_world, expected, atol=1e-7)


@given(pose_lists, twists, st.floats(-3.0, 2.0), seeds)
def test_the_unit_of_length_does_not_matter(
    robot: Array, xi: Array, exponent: float, seed: int
) -> None:
    unit = 10.0**exponent
    noisy = disturbed(np.random.default_rng(seed), robot, 1e-3, 1e-3)
    data = solvable(noisy, robot @ exp(xi))
    other = PosePairs(
        base_T_gripper=scaled(data.base_T_gripper, unit),
        world_T_camera=scaled(data.world_T_camera, unit),
    )
    for solve, plain in answers(data):
        expected = scaled(plain.gripper_T_camera, unit)
        np.testing.assert_allclose(
            solve(other).gripper_T_camera,
            expected,
            rtol=1e-7,
            atol=1e-7 * max(1.0, unit),
            err_msg=str(solve),
        )
