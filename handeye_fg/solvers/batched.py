"""X and the scale of many small sets of motions at once, for sampling; entry ``solved``.

The same two steps as ``andreff_scale``, without its tests of what can be told from noise: a set that
determines little gives an X that fits nothing else.
"""

from typing import Literal, assert_never

import numpy as np

from handeye_fg.frames import Array, pose, quaternions, rotation_vectors
from handeye_fg.motions import MotionPairs
from handeye_fg.solvers.andreff_scale import NO_ROTATION, ONE_AXIS

Turning = Literal["general", "one_axis", "never"]


def rotation_spread(pairs: MotionPairs) -> Array:
    """Root mean square (3,) of the rotation vectors along their principal axes, strongest first.

    Of robot or camera, whichever turns less about each: errors of poses only add axes.
    """
    rms = np.full(3, np.inf)
    for motions in (pairs.gi_T_gj, pairs.ci_T_cj):
        vectors = rotation_vectors(quaternions(motions[:, :3, :3]))
        moment = np.linalg.eigvalsh(vectors.T @ vectors / len(vectors))[::-1]
        rms = np.minimum(rms, np.sqrt(moment.clip(0.0)))
    return rms


def turning_of(pairs: MotionPairs) -> Turning:
    """How many axes the motions turn about."""
    rms = rotation_spread(pairs)
    if rms[0] < NO_ROTATION:
        return "never"
    return "one_axis" if rms[1] < ONE_AXIS * rms[0] else "general"


def solved(A: Array, B: Array, turning: Turning, *, scale_known: bool) -> tuple[Array, Array]:
    """X (s, 4, 4) and scales (s,) of s sets of k motions A, B (s, k, 4, 4), all sets at once.

    R_X takes the camera's rotation vectors to the robot's (of a robot that never turns: the
    translations). What remains of A X = X B is linear: ``(R_A - I) t_X - lambda R_X u_B = -t_A``.
    """
    R_A, t_A, u_B = A[..., :3, :3], A[..., :3, 3], B[..., :3, 3]
    if turning == "never":
        a, b = t_A, u_B
    else:
        a, b = (rotation_vectors(quaternions(motion[..., :3, :3])) for motion in (A, B))
    axes, _, camera_axes = np.linalg.svd(np.swapaxes(a, 1, 2) @ b)
    axes[:, :, 2] *= np.linalg.det(axes @ camera_axes)[:, None]
    R_X = axes @ camera_axes
    match turning:
        case "general":
            found = np.broadcast_to(np.eye(3), R_X.shape)
        case "one_axis":
            found = axes[:, :, 1:]
            R_X = _turned(R_A, t_A, u_B, R_X, axes)
        case "never":
            found = np.zeros((len(R_X), 3, 0))
        case _:
            assert_never(turning)
    sets, motions = A.shape[:2]
    columns = (R_A - np.eye(3)) @ found[:, None]
    v = np.einsum("sij,skj->ski", R_X, u_B)
    if not scale_known:
        columns = np.concatenate([columns, -v[..., None]], axis=3)
    right = (v if scale_known else 0.0) - t_A
    unknowns = np.linalg.pinv(columns.reshape(sets, 3 * motions, -1))
    solution = np.einsum("sui,si->su", unknowns, right.reshape(sets, 3 * motions))
    scales = np.ones(sets) if scale_known else solution[:, -1]
    t_X = np.einsum("sij,sj->si", found, solution[:, : found.shape[2]])
    return pose(R_X, t_X), scales


def _turned(R_A: Array, t_A: Array, u_B: Array, R_0: Array, axes: Array) -> Array:
    """R_X (s, 3, 3) of rotations about one axis: R_0, which maps the axes, turned about the axis.

    Across the axis n: ``(R_A - I) t_X - a v - b (n x v) = -t_A`` with v = R_0 u_B and
    (a, b) = lambda (cos, sin)(turn), as in ``andreff_scale``.
    """
    n, plane = axes[:, :, 0], axes[:, :, 1:]
    v = np.einsum("sij,skj->ski", R_0, u_B)
    columns = np.concatenate(
        [
            (R_A - np.eye(3)) @ plane[:, None],
            -v[..., None],
            -np.cross(n[:, None], v)[..., None],
        ],
        axis=3,
    )
    across = np.einsum("sxp,skxc->skpc", plane, columns).reshape(len(R_0), -1, 4)
    right = -np.einsum("sxp,skx->skp", plane, t_A).reshape(len(R_0), -1)
    solution = np.einsum("sui,si->su", np.linalg.pinv(across), right)
    turn = np.arctan2(solution[:, 3], solution[:, 2])[:, None, None]
    # Rodrigues' formula.
    cross = np.cross(n[:, None], np.eye(3)).swapaxes(1, 2)
    rotation = np.eye(3) + np.sin(turn) * cross + (1.0 - np.cos(turn)) * cross @ cross
    return np.asarray(rotation @ R_0)
