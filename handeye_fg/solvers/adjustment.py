"""Least squares over absolute poses: X and the scale, the noise, and the covariance; entry ``settle``.

Each instant gives ``Log(base_T_gripper^-1 Z scaled(world_T_camera) X^-1)``. Turned into the base frame,
with R_i and t_i the gripper's orientation and position, a = R_X xi_r and b = R_X xi_t for the tangent
xi of X, zeta the left tangent of Z, c_i the camera's position against Z's, and l = ln scale, its rows
change by

    rotation      zeta_r - R_i a
    translation   zeta_t - t_i x zeta_r - R_i (t_X x a + b) + c_i l

What the noise of R_i and t_i feigns of information is taken off, so that directions which only noise
supports come out free.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.known import OfXAndScale, rows
from handeye_fg.observability import (
    LIMITS,
    WIDE,
    feigned_information,
    free_basis,
    without_feigned,
)
from handeye_fg.solvers.groups import PoseGroups

# A tenth of an observation of each sigma: a single motion has nothing to estimate them from, and
# without noise they would vanish. Usual for an industrial arm; radians and metres.
_PRIOR_WEIGHT = 0.1
_PRIOR_SIGMAS = np.array([np.deg2rad(0.02), 1e-4])
# Finer than any arm; keeps the information matrix within what float64 can tell from zero.
_FINEST = 1e-6
_MAX_STEPS = 60
_SETTLED_STEP = 1e-10  # in units of the limits; the next step is a hundred times smaller
_STEADY_LEVEL = 0.2  # logarithm of a ratio
_SETTLED_LEVEL = 0.01  # relative; the levels' own uncertainty is larger


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Values of the unknowns, and how well they are known.

    Attributes:
        gripper_T_camera: X (4, 4), metres.
        log_scale: ln(metres_per_world_unit).
        base_T_world: Z (g, 4, 4) of each group, metres.
        sigmas: noise (2,) of a pose, radians and metres.
        covariance: (7, 7) of (X, ln scale), with a wide prior.
    """

    gripper_T_camera: Array
    log_scale: float
    base_T_world: Array
    sigmas: Array
    covariance: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Rows:
    """Residuals (n, 6) and their derivatives by (X, ln scale) (n, 6, 7) and by Z (n, 6, 6)."""

    residual: Array
    by_x: Array
    by_z: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Reduced:
    """The rows with Z eliminated.

    Attributes:
        residual, by_x: what Z cannot explain: (n, 6), (n, 6, 7).
        z_residual, z_by_x: the step of Z is ``-(z_residual + z_by_x u)``: (g, 6), (g, 6, 7).
        z_leverage: what Z uses up (2,) of the rotation and the translation rows.
        weights: (n, 6).
    """

    residual: Array
    by_x: Array
    z_residual: Array
    z_by_x: Array
    z_leverage: Array
    weights: Array


def settle(
    poses: PoseGroups,
    gripper_T_camera: Array,
    metres_per_world_unit: float,
    *,
    scale_known: bool,
    priors: Sequence[OfXAndScale],
    move: bool,
) -> State:
    """Find the noise and the covariance and, with ``move``, the optimum of X and the scale.

    X and the scale move in the determined directions only: along the others they stay.

    Args:
        poses: the data.
        gripper_T_camera: X (4, 4) to start from, metres.
        metres_per_world_unit: the scale to start from.
        scale_known: whether the scale is a constant.
        priors: what else is known of X and the scale.
        move: whether X and the scale may move.
    """
    state = State(
        gripper_T_camera=gripper_T_camera,
        log_scale=float(np.log(metres_per_world_unit)),
        base_T_world=_mean_z(poses, gripper_T_camera, metres_per_world_unit),
        sigmas=_PRIOR_SIGMAS,
        covariance=np.diag(WIDE**2),
    )
    dims = 6 if scale_known else 7
    for _ in range(_MAX_STEPS):
        reduced = _reduced(poses, _linearised(poses, state), state.sigmas)
        covariance = _covariance(poses, reduced, state, priors, dims)
        within, step = _determined(reduced, covariance, state, priors, dims)
        sigmas = _levels(poses, reduced, within)
        change = float(np.max(np.abs(np.log(sigmas / state.sigmas))))
        # What is free is known once the noise is: no step before.
        step *= move and change < _STEADY_LEVEL
        state = _moved(state, step, reduced, sigmas, covariance)
        if np.max(np.abs(step) / LIMITS) < _SETTLED_STEP and change < _SETTLED_LEVEL:
            break
    return state


def _mean_z(poses: PoseGroups, X: Array, scale: float) -> Array:
    """Z (g, 4, 4): chordal mean of the rotations, translation through the centroids."""
    gripper = poses.base_T_gripper @ X
    camera = frames.scaled(poses.world_T_camera, scale)
    w = poses.weights[:, None]
    products = gripper[:, :3, :3] @ np.swapaxes(camera[:, :3, :3], 1, 2)
    rotation = np.array([frames.orthonormalised(R) for R in poses.total(w[:, :, None] * products)])
    total = poses.total(w)
    centre_base = poses.total(w * gripper[:, :3, 3]) / total
    centre_world = poses.total(w * camera[:, :3, 3]) / total
    return frames.pose(rotation, centre_base - np.einsum("gij,gj->gi", rotation, centre_world))


def _linearised(poses: PoseGroups, state: State) -> _Rows:
    """Residuals and derivatives, in the base frame."""
    X, G, Z = state.gripper_T_camera, poses.base_T_gripper, state.base_T_world[poses.group]
    metric = Z @ frames.scaled(poses.world_T_camera, float(np.exp(state.log_scale)))
    difference = frames.log(frames.inverse(G) @ metric @ frames.inverse(X))
    R, t = G[:, :3, :3], G[:, :3, 3]
    residual = np.einsum("nij,nkj->nki", R, difference.reshape(-1, 2, 3)).reshape(-1, 6)
    n = len(G)
    by_x = np.zeros((n, 6, 7))
    by_x[:, :3, :3] = by_x[:, 3:, 3:6] = -R @ X[:3, :3]
    by_x[:, 3:, :3] = -R @ _cross(X[:3, 3]) @ X[:3, :3]
    by_x[:, 3:, 6] = metric[:, :3, 3] - Z[:, :3, 3]
    by_z = np.zeros((n, 6, 6))
    by_z[:, :3, :3] = by_z[:, 3:, 3:] = np.eye(3)
    by_z[:, 3:, :3] = -_cross(t)
    return _Rows(residual=residual, by_x=by_x, by_z=by_z)


def _reduced(poses: PoseGroups, rows: _Rows, sigmas: Array) -> _Reduced:
    """The rows with each group's Z eliminated."""
    weights = poses.weights[:, None] * np.repeat(sigmas, 3) ** -2.0
    B = rows.by_z
    BW = np.swapaxes(B, 1, 2) * weights[:, None, :]
    inverse = np.linalg.inv(poses.total(BW @ B))
    z_residual = np.einsum(
        "gij,gj->gi", inverse, poses.total((BW @ rows.residual[:, :, None])[..., 0])
    )
    z_by_x = inverse @ poses.total(BW @ rows.by_x)
    leverage = np.einsum("nij,njr,nri->nr", inverse[poses.group], BW, B)
    return _Reduced(
        residual=rows.residual - np.einsum("nij,nj->ni", B, z_residual[poses.group]),
        by_x=rows.by_x - B @ z_by_x[poses.group],
        z_residual=z_residual,
        z_by_x=z_by_x,
        z_leverage=leverage.sum(axis=0).reshape(2, 3).sum(axis=1),
        weights=weights,
    )


def _covariance(
    poses: PoseGroups, reduced: _Reduced, state: State, priors: Sequence[OfXAndScale], dims: int
) -> Array:
    """Covariance (7, 7) from the information, less what noise feigns, and the priors."""
    information = np.einsum("nri,nr,nrj->ij", reduced.by_x, reduced.weights, reduced.by_x)
    information += np.diag(WIDE**-2.0)
    for prior in priors:
        _, by_x = rows(prior, state.gripper_T_camera, state.log_scale)
        information += by_x.T @ by_x
    values, vectors = np.linalg.eigh((information * np.outer(LIMITS, LIMITS))[:dims, :dims])
    independent = len(poses.group) - poses.count
    feigned = feigned_information(state.gripper_T_camera, independent, state.sigmas, state.sigmas)
    covariance = np.zeros((7, 7))
    covariance[:dims, :dims] = without_feigned(values, vectors, feigned)
    return covariance


def _levels(poses: PoseGroups, reduced: _Reduced, covariance: Array) -> Array:
    """Noise (2,) of a pose: sums of squares over redundancies; ``covariance`` of what is fitted."""
    squares = poses.weights[:, None] * reduced.residual**2
    used = np.einsum("nri,ij,nrj->nr", reduced.by_x, covariance, reduced.by_x) * reduced.weights
    redundancy = 3.0 * len(squares) - reduced.z_leverage - _by_kind(used)
    variance = (_by_kind(squares) + _PRIOR_WEIGHT * _PRIOR_SIGMAS**2) / (
        np.maximum(redundancy, 0.0) + _PRIOR_WEIGHT
    )
    return np.maximum(np.sqrt(variance), _FINEST)


def _by_kind(values: Array) -> Array:
    """Sums (2,) of values (n, 6) over the rotation and the translation rows."""
    return np.asarray(values.sum(axis=0).reshape(2, 3).sum(axis=1))


def _determined(
    reduced: _Reduced, covariance: Array, state: State, priors: Sequence[OfXAndScale], dims: int
) -> tuple[Array, Array]:
    """Covariance (7, 7) within the determined directions, and the Gauss-Newton step (7,) there."""
    information = np.einsum("nri,nr,nrj->ij", reduced.by_x, reduced.weights, reduced.by_x)
    gradient = -np.einsum("nri,nr,nr->i", reduced.by_x, reduced.weights, reduced.residual)
    for prior in priors:
        residual, by_x = rows(prior, state.gripper_T_camera, state.log_scale)
        information += by_x.T @ by_x
        gradient -= by_x.T @ residual
    free = free_basis(covariance[:dims, :dims])
    kept = np.zeros((7, dims - free.shape[1]))
    kept[:dims] = np.linalg.svd(free, full_matrices=True)[0][:, free.shape[1] :]
    kept *= LIMITS[:, None]
    within = kept @ np.linalg.inv(kept.T @ information @ kept) @ kept.T
    return within, within @ gradient


def _moved(state: State, step: Array, reduced: _Reduced, sigmas: Array, covariance: Array) -> State:
    """The state after a step of X and the scale, and the step of Z that goes with it."""
    z_step = -(reduced.z_residual + reduced.z_by_x @ step)
    rotation = frames.exp(np.concatenate([z_step[:, :3], np.zeros((len(z_step), 3))], axis=1))
    base_T_world = rotation @ state.base_T_world
    base_T_world[:, :3, 3] += z_step[:, 3:]
    X = state.gripper_T_camera @ frames.exp(step[:6])
    return State(
        gripper_T_camera=frames.pose(frames.orthonormalised(X[:3, :3]), X[:3, 3]),
        log_scale=state.log_scale + float(step[6]),
        base_T_world=base_T_world,
        sigmas=sigmas,
        covariance=covariance,
    )


def _cross(vectors: Array) -> Array:
    """Matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vectors), -1, 0)
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*x.shape, 3, 3)
