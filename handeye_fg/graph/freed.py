"""X with the intrinsics fixed and free: one from the other by a linear step; entry point ``freed``.

With X and the intrinsics t of its camera as unknowns, S their covariance and ``K = S_xt S_tt^-1``, the
answer for other intrinsics is ``X Exp(K dt)``: no second refinement is needed. Under the hypothesis that
the given intrinsics are right, t is off by noise alone, with the covariance ``S_tt - S_tt P S_tt`` where
P is the information of the prior, and the change of X has that covariance carried over by K.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from handeye_fg import frames
from handeye_fg.findings import FocalOffset, OtherIntrinsics
from handeye_fg.frames import Array
from handeye_fg.graph.determined import determined
from handeye_fg.graph.known import Known
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.noise import estimate_noise
from handeye_fg.graph.problem import IntrinsicsPrior, make_problem
from handeye_fg.graph.summary import Refinement
from handeye_fg.graph.threads import one_blas_thread
from handeye_fg.graph.variables import State, intrinsics_key
from handeye_fg.lens import embedding
from handeye_fg.observability import free_lean
from handeye_fg.options import NoiseOptions
from handeye_fg.types import KnownPoints

_DEPTH = 5  # of X's tangent: the camera's position along its optical axis
# A direction in which the change's standard deviation is a smaller part of X's own does not count.
_NOTICEABLE = 0.01
# Focal length and position along the axis are confounded where knowing one makes the other so many
# times as certain: with points at several depths and tilts of 25 degrees it is 1.1.
_CONFOUNDED = 2.0
_LEANS = 0.1  # of a free direction on the optical axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Freed:
    """X of a camera together with its intrinsics.

    Attributes:
        covariance: (6 + k, 6 + k) of X's tangent and the k unknown intrinsics.
        precision: (k, k) of the prior that is part of it.
        offset: the intrinsics at the optimum less the given ones (k,).
    """

    covariance: Array
    precision: Array
    offset: Array

    @property
    def by_intrinsics(self) -> Array:
        """K: derivative (6, k) of X by the intrinsics, everything else at its best."""
        return self.covariance[:6, 6:] @ self._information

    @property
    def pull(self) -> float:
        """Square of the offset against its covariance: chi-square of k if the given ones are right."""
        return float(self.offset @ self._information @ self.offset)

    @property
    def _information(self) -> Array:
        """Inverse (k, k) of the intrinsics' covariance, by way of scaled units."""
        covariance = self.covariance[6:, 6:]
        scale = 1.0 / np.sqrt(np.diag(covariance))
        scaled = np.linalg.inv(covariance * np.outer(scale, scale))
        return np.asarray(scaled * np.outer(scale, scale))

    @property
    def change(self) -> tuple[Array, Array]:
        """How X changes (6,) from given to free intrinsics, and its covariance if the given are right."""
        K, covariance = self.by_intrinsics, self.covariance[6:, 6:]
        random = covariance - covariance @ self.precision @ covariance
        return K @ self.offset, K @ random @ K.T

    @property
    def lost(self) -> Array:
        """What free intrinsics add (6, 6) to the covariance of X."""
        K = self.by_intrinsics
        return np.asarray(K @ self.covariance[6:, 6:] @ K.T)

    def within(self, into: Array) -> "Freed":
        """The same with fewer unknowns (m), of which the present ones are a linear function (k, m)."""
        information, K = self._information, self.by_intrinsics
        covariance = np.linalg.inv(into.T @ information @ into)
        cross = K @ into @ covariance
        x = self.covariance[:6, :6] - self.lost + cross @ (K @ into).T
        return Freed(
            covariance=np.block([[x, cross], [cross.T, covariance]]),
            precision=into.T @ self.precision @ into,
            offset=covariance @ into.T @ information @ self.offset,
        )


@one_blas_thread()
def freed(
    base_T_gripper: Array,
    kept: Refinement,
    state: State,
    priors: Sequence[IntrinsicsPrior],
    noise: NoiseOptions,
    known: KnownPoints | None = None,
    others: Sequence[Known] = (),
    *,
    inverted: bool = False,
) -> tuple[Freed, ...]:
    """Set the intrinsics of a refinement free, by one linear step.

    Args:
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        kept: the optimum with the intrinsics at the centre of ``priors``.
        state: the same state; the models of its cameras may be more general.
        priors: of each camera's intrinsics, wide.
        noise: the levels that the user knows.
        known: known points, as in the refinement.
        others: what else is known beforehand, likewise.
        inverted: the robot poses are gripper_T_base.
    """
    observed = Kept(
        state=state,
        tracks=kept.tracks,
        sigma_scale=kept.sigma_scale,
        pixel=kept.noise.pixel,
        corner=kept.noise.corner or 1.0,
    )
    problem = make_problem(
        observed,
        base_T_gripper,
        "base",
        priors,
        known,
        others,
        kept.used,
        inverted=inverted,
    )
    linearised = problem.linearised(state)
    solution = estimate_noise(linearised, kept.noise, noise)
    inflation = determined(state, linearised, solution, noise).inflation
    result = []
    for k, prior in enumerate(priors):
        own = problem.layout.columns(intrinsics_key(k))
        columns = np.concatenate([problem.layout.x_columns(k), own])
        result.append(
            Freed(
                covariance=inflation * solution.covariance[np.ix_(columns, columns)],
                precision=_precision(prior) / inflation,
                offset=solution.step[own],
            )
        )
    return tuple(result)


def refined(final: Refinement, prior: IntrinsicsPrior, camera: int = 0) -> Freed:
    """X and the intrinsics of a refinement that had the latter as unknowns."""
    used = np.append(np.arange(6), 6 + np.array(prior.unknown))
    inflation = final.inflation
    return Freed(
        covariance=final.x_and_intrinsics[camera][np.ix_(used, used)],
        precision=_precision(prior) / inflation,
        offset=(final.state.cameras[camera].params - prior.params)[list(prior.unknown)],
    )


def _precision(prior: IntrinsicsPrior) -> Array:
    return np.diag(prior.sigmas[list(prior.unknown)] ** -2.0)


def other(final: Refinement, freed_: Freed, camera: int = 0, *, kept: bool) -> OtherIntrinsics:
    """X of a camera with free intrinsics where they were kept, and with the given ones otherwise."""
    X, covariance = final.state.gripper_T_cameras[camera], final.observabilities[camera].covariance
    # Only on the subspace that is determined: along free directions X is arbitrary.
    variances, vectors = np.linalg.eigh(covariance)
    found = vectors[:, variances > 1e-12 * variances[-1]]
    inside = found @ found.T
    sign = 1.0 if kept else -1.0
    change, random = freed_.change
    change, random = sign * inside @ change, inside @ random @ inside
    lost = inside @ freed_.lost @ inside
    largest = covariance + lost if kept else covariance
    # In units of X's own standard deviations.
    values, axes = np.linalg.eigh(largest)
    usable = values > 1e-12 * values[-1]
    root = axes[:, usable] / np.sqrt(values[usable])
    scaled, own_axes = np.linalg.eigh(root.T @ random @ root)
    noticeable = scaled > _NOTICEABLE**2
    along = (own_axes.T @ root.T @ change)[noticeable] / np.sqrt(scaled[noticeable])
    return OtherIntrinsics(
        kind="free" if kept else "fixed",
        gripper_T_camera=X @ frames.exp(change),
        covariance=covariance + sign * lost,
        shift_rotation=float(np.linalg.norm(change[:3])),
        shift_translation=float(np.linalg.norm(change[3:])),
        shift_sigma=float(np.sqrt(np.mean(along**2))) if noticeable.any() else 0.0,
    )


def focal_offset(
    final: Refinement, freed_: Freed, unknown: Sequence[int], camera: int = 0
) -> FocalOffset | None:
    """How focal length and a camera's position along its axis are tied; None where the latter is free.

    Args:
        final: the optimum.
        freed_: X and the intrinsics.
        unknown: which parameters the unknowns are.
        camera: which camera.
    """
    if free_lean(final.observabilities[camera].covariance)[_DEPTH] > _LEANS:
        return None
    model = final.state.cameras[camera]
    into = embedding(model.model)[:, list(unknown)]
    params = model.params[list(unknown)]
    is_focal = into[:2].any(axis=0)
    mean = np.where(is_focal, 1.0 / np.where(is_focal, params, 1.0), 0.0) / is_focal.sum()
    variance = mean @ freed_.covariance[6:, 6:] @ mean
    deviation = np.sqrt(variance * freed_.covariance[_DEPTH, _DEPTH])
    correlation = float(freed_.covariance[_DEPTH, 6:] @ mean / deviation)
    by_focal = freed_.by_intrinsics[_DEPTH] @ np.where(is_focal, params, 0.0)
    factor = 1.0 / np.sqrt(max(1.0 - correlation**2, np.finfo(float).eps))
    return FocalOffset(
        correlation=correlation,
        std_factor=float(factor),
        metres_per_percent=float(0.01 * by_focal),
        confounded=bool(factor > _CONFOUNDED),
    )
