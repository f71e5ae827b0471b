"""The conventions of ``handeye_fg.frames`` are those of GTSAM and of the convention page."""

import gtsam
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from handeye_fg.frames import (
    adjoint,
    exp,
    inverse,
    log,
    orthonormalised,
    pose,
    quaternion_xyzw,
    quaternions,
    rotation_angle,
    rotation_matrix,
    rotation_vectors,
    scaled,
)

# Each component at most 1.75: rotation angles stay below 3.04, clear of the jump of the logarithm
# at pi. Magnitudes below 1e-9 are covered by zero.
component = st.one_of(st.floats(-1.75, -1e-9), st.just(0.0), st.floats(1e-9, 1.75))
twists = arrays(np.float64, 6, elements=component)
points = arrays(np.float64, 3, elements=st.floats(-100.0, 100.0))


@given(twists)
def test_log_inverts_exp(xi: np.ndarray) -> None:
    # The logarithm divides by sin(angle / 2)-like terms: 1e-16 / (pi - 3.04) leaves 1e-14.
    np.testing.assert_allclose(log(exp(xi)), xi, atol=1e-12)


@given(twists)
def test_exp_and_log_are_those_of_gtsam(xi: np.ndarray) -> None:
    expected = gtsam.Pose3.Expmap(xi)
    np.testing.assert_allclose(exp(xi), expected.matrix(), atol=1e-9)
    np.testing.assert_allclose(log(exp(xi)), gtsam.Pose3.Logmap(expected), atol=1e-9)


def test_order_is_rotation_then_translation() -> None:
    np.testing.assert_allclose(
        exp(np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0]))[:3, 0], [0, 1, 0], atol=1e-15
    )
    np.testing.assert_array_equal(exp(np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0]))[:3, 3], [1, 2, 3])


@given(twists, twists)
def test_perturbations_are_on_the_right_as_in_gtsam(mean_xi: np.ndarray, xi: np.ndarray) -> None:
    mean = exp(mean_xi)
    gtsam_mean = gtsam.Pose3(mean)
    moved = mean @ exp(xi)
    np.testing.assert_allclose(moved, gtsam_mean.retract(xi).matrix(), atol=1e-9)
    np.testing.assert_allclose(
        log(inverse(mean) @ moved), gtsam_mean.localCoordinates(gtsam.Pose3(moved)), atol=1e-9
    )


@given(twists, twists)
def test_covariance_moves_to_the_parent_by_the_adjoint(mean_xi: np.ndarray, xi: np.ndarray) -> None:
    mean, small = exp(mean_xi), 0.1 * xi
    np.testing.assert_allclose(adjoint(mean), gtsam.Pose3(mean).AdjointMap(), atol=1e-12)
    np.testing.assert_allclose(mean @ exp(small), exp(adjoint(mean) @ small) @ mean, atol=1e-9)


@given(twists)
def test_inverse(xi: np.ndarray) -> None:
    a_T_b = exp(xi)
    np.testing.assert_allclose(a_T_b @ inverse(a_T_b), np.eye(4), atol=1e-14)
    np.testing.assert_allclose(inverse(inverse(a_T_b)), a_T_b, atol=1e-14)


@given(twists, points)
def test_pose_takes_points_of_the_child_to_the_parent(xi: np.ndarray, p_b: np.ndarray) -> None:
    R, t = exp(xi)[:3, :3], xi[3:]
    p_a = pose(R, t) @ np.append(p_b, 1.0)
    np.testing.assert_allclose(p_a[:3], gtsam.Pose3(gtsam.Rot3(R), t).transformFrom(p_b))


def test_stacks_of_poses() -> None:
    xi = np.random.default_rng(0).uniform(-1.0, 1.0, (7, 6))
    stack = exp(xi)
    assert stack.shape == (7, 4, 4)
    np.testing.assert_allclose(log(stack), xi, atol=1e-14)
    np.testing.assert_allclose(
        stack @ inverse(stack), np.broadcast_to(np.eye(4), (7, 4, 4)), atol=1e-15
    )
    np.testing.assert_allclose(rotation_angle(stack[:, :3, :3]), np.linalg.norm(xi[:, :3], axis=1))


def test_scaled_changes_a_copy_and_only_translations() -> None:
    world_T_camera = exp(np.random.default_rng(1).uniform(-1.0, 1.0, (3, 6)))
    before = world_T_camera.copy()
    result = scaled(world_T_camera, 2.5)
    np.testing.assert_array_equal(world_T_camera, before)
    np.testing.assert_array_equal(result[:, :3, :3], before[:, :3, :3])
    np.testing.assert_array_equal(result[:, :3, 3], 2.5 * before[:, :3, 3])


@given(twists)
def test_quaternion_is_canonical_and_names_its_order(xi: np.ndarray) -> None:
    R = exp(xi)[:3, :3]
    x, y, z, w = quaternion_xyzw(R)
    assert w >= 0.0
    np.testing.assert_allclose(gtsam.Rot3.Quaternion(w, x, y, z).matrix(), R, atol=1e-12)


def test_quaternion_of_a_half_turn() -> None:
    np.testing.assert_array_equal(quaternion_xyzw(np.diag([1.0, -1.0, -1.0])), [1.0, 0.0, 0.0, 0.0])


@given(twists, arrays(np.float64, (3, 3), elements=st.floats(-0.1, 0.1)))
def test_orthonormalised_is_the_nearest_rotation(xi: np.ndarray, error: np.ndarray) -> None:
    disturbed = exp(xi)[:3, :3] + error
    nearest = orthonormalised(disturbed)
    np.testing.assert_allclose(nearest.T @ nearest, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(np.linalg.det(nearest), 1.0)
    distance = np.linalg.norm(nearest - disturbed)
    for axis in np.eye(3):
        other = nearest @ Rotation.from_rotvec(1e-3 * axis).as_matrix()
        assert distance <= np.linalg.norm(other - disturbed) + 1e-12


def test_orthonormalised_of_a_reflection_is_a_rotation() -> None:
    assert np.linalg.det(orthonormalised(np.diag([1.0, 1.0, -0.5]))) > 0.0


def test_quaternions_are_exact_at_every_angle() -> None:
    """Against scipy; half turns about each axis among them, where the scalar vanishes."""
    rng = np.random.default_rng(0)
    half_turns = [np.diag(d) for d in ([1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0])]
    rotations = np.concatenate(
        [Rotation.random(200, rng=rng).as_matrix(), [np.eye(3), *half_turns]]
    )
    q = quaternions(rotations)
    expected = Rotation.from_matrix(rotations).as_quat(canonical=True)[:, [3, 0, 1, 2]]
    np.testing.assert_allclose(q, expected, atol=1e-15)
    np.testing.assert_allclose([rotation_matrix(3.0 * row) for row in q], rotations, atol=1e-14)
    np.testing.assert_array_equal(quaternions(rotations[:6].reshape(2, 3, 3, 3))[1, 2], q[5])


def test_rotation_vectors_go_on_beyond_half_turns() -> None:
    angles = np.array([0.0, 1e-9, 1.0, 3.0, 3.3])
    axis = np.array([0.6, 0.0, -0.8])
    q = np.column_stack([np.cos(angles / 2.0), np.sin(angles / 2.0)[:, None] * axis])
    np.testing.assert_allclose(rotation_vectors(q), angles[:, None] * axis, rtol=1e-14, atol=1e-24)
