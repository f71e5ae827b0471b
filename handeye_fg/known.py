"""What users know beforehand of X and the scale, as residuals; ``whitened``, ``in_world_units``."""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.priors import AnyPrior, CameraPrior, DistancePrior, PosePrior, Prior, ScalePrior

OfXAndScale = Prior | PosePrior | ScalePrior
"""The kinds that X and the scale alone decide."""


def pose_of(prior: PosePrior) -> Array:
    """The pose (4, 4) that is known, metres."""
    rotation = Rotation.from_quat(prior.quaternion_xyzw).as_matrix()
    return frames.pose(rotation, np.array(prior.position))


def whitened(prior: OfXAndScale, X: Array, log_scale: Array) -> Array:
    """Found less known, in standard deviations: rows (m, r) for X (m, 4, 4) and ln scales (m,)."""
    match prior:
        case Prior():
            along = X[:, :3, 3] @ np.asarray(prior.axis)
            return np.asarray((along - prior.value) / prior.std)[:, None]
        case ScalePrior():
            off = (log_scale - np.log(prior.value)) * prior.value / prior.std
            return np.asarray(off)[:, None]
        case PosePrior():
            known, parts = pose_of(prior), []
            if prior.std_rotation_deg is not None:
                turn = Rotation.from_matrix(known[:3, :3].T @ X[:, :3, :3]).as_rotvec()
                parts.append(turn / np.deg2rad(prior.std_rotation_deg))
            if prior.std_translation_mm is not None:
                parts.append((X[:, :3, 3] - known[:3, 3]) / (1e-3 * prior.std_translation_mm))
            return np.concatenate(parts, axis=1)


def rows(prior: OfXAndScale, X: Array, log_scale: float) -> tuple[Array, Array]:
    """``whitened`` at one X (4, 4): values (r,) and derivatives (r, 7) by X's tangent and ln scale.

    The derivative of a rotation is that at the known one, from which X is not far.
    """
    values = whitened(prior, X[None], np.array([log_scale]))[0]
    derivatives = np.zeros((len(values), 7))
    match prior:
        case Prior():
            derivatives[0, 3:6] = np.asarray(prior.axis) @ X[:3, :3] / prior.std
        case ScalePrior():
            derivatives[0, 6] = prior.value / prior.std
        case PosePrior():
            if prior.std_rotation_deg is not None:
                derivatives[:3, :3] = np.eye(3) / np.deg2rad(prior.std_rotation_deg)
            if prior.std_translation_mm is not None:
                derivatives[-3:, 3:6] = X[:3, :3] / (1e-3 * prior.std_translation_mm)
    return values, derivatives


def in_world_units(
    priors: Sequence[AnyPrior], names: Sequence[str], world_T_camera: Array
) -> tuple[OfXAndScale, ...]:
    """The priors of X and the scale, a known distance as the scale that it gives with the cameras as they are.

    Args:
        priors: what is known.
        names: names (n,) of the images or rows.
        world_T_camera: their camera poses (n, 4, 4), world units.

    Raises:
        InputDataError: a distance names an image without pose, or cameras at one place.
    """
    result: list[OfXAndScale] = []
    for prior in priors:
        if isinstance(prior, CameraPrior):
            continue
        if not isinstance(prior, DistancePrior):
            result.append(prior)
            continue
        one, other = (index_of(name, prior, names) for name in prior.images)
        units = float(np.linalg.norm(world_T_camera[one, :3, 3] - world_T_camera[other, :3, 3]))
        if units <= 0.0:
            raise InputDataError(
                f"the prior on the distance of {' and '.join(prior.images)} says {prior.value:g} m, but "
                "the camera did not move between them; name two others"
            )
        result.append(ScalePrior(prior.value / units, prior.std / units))
    return tuple(result)


def require_known_unit(priors: Sequence[AnyPrior]) -> None:
    """Refuse a scale for a world that is not there yet: only with the reconstruction its unit is.

    Raises:
        InputDataError: there is one.
    """
    if any(isinstance(prior, ScalePrior) for prior in priors):
        raise InputDataError(
            "a prior of kind scale is for a world that exists already, a COLMAP model or camera poses, "
            "but here the images are reconstructed first; give a prior of kind distance instead"
        )


def index_of(name: str, prior: DistancePrior, names: Sequence[str]) -> int:
    """Where a name of a distance is among those that have poses.

    Raises:
        InputDataError: nowhere.
    """
    if name not in names:
        raise InputDataError(
            f"the prior on the distance of {' and '.join(prior.images)}: {name} has no camera pose; "
            "name two images that have one"
        )
    return list(names).index(name)
