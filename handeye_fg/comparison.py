"""Whether two calibrations differ by more than their uncertainties explain; entry point ``compare``.

With X_1 and X_2 the estimates, xi = Log(X_1^-1 X_2) has, to first order and in the frame of the second
camera, the covariance ``Ad C_1 Ad' + C_2`` with Ad the adjoint of X_2^-1 X_1, if the two share no data.
The covariances come from estimated noise levels: with p components the square of Mahalanobis over p is
F distributed with p and nu degrees of freedom, where the weights of the two parts, ``R_k = C^-1/2 C_k
C^-1/2``, give ``nu = p / sum tr(R_k^2) / nu_k`` (F. E. Satterthwaite, "An approximate distribution of
estimates of variance components", Biometrics Bulletin 2, 1946, in p dimensions).

Only directions that both calibrations determine are compared.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg, special

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Calibrated
from handeye_fg.io.results import Result
from handeye_fg.observability import free_space
from handeye_fg.types import frozen_array

SIGNIFICANCE = 0.01
"""Differences less probable than this by chance are called significant."""

_FEWEST = 3.0  # degrees of freedom, as in the covariance of a result
_AXES = ("x", "y", "z")

Verdict = Literal["agree", "differ", "unknown"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Difference:
    """How the second pose of one camera differs from the first, on the directions that both determine.

    Attributes:
        camera: the camera's name; "" where there is but one.
        first_T_second: the camera of the second calibration in that of the first (4, 4), metres.
        xi: (6,) its logarithm (rotation, translation) in the camera's axes, radians and metres, without
            what is free in either calibration.
        covariance: of ``xi`` (6, 6) where the two do not differ, from their covariances; None where one
            of them has none.
        directions: number of directions that are compared, 6 where both are complete.
        distance: Mahalanobis distance; None without covariance.
        probability: of a distance as large or larger by chance alone.
        probability_rotation, probability_translation: likewise of the rotation and the translation, each
            by itself.
    """

    camera: str
    first_T_second: Array
    xi: Array
    covariance: Array | None = None
    directions: int = 6
    distance: float | None = None
    probability: float | None = None
    probability_rotation: float | None = None
    probability_translation: float | None = None

    def __post_init__(self) -> None:
        shapes = {"first_T_second": (4, 4), "xi": (6,), "covariance": (6, 6)}
        for name, shape in shapes.items():
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))

    @property
    def rotation_deg(self) -> float:
        """Angle between the two."""
        return math.degrees(float(np.linalg.norm(self.xi[:3])))

    @property
    def translation_mm(self) -> float:
        """Distance between the two."""
        return 1e3 * float(np.linalg.norm(self.xi[3:]))

    @property
    def expected_rotation_deg(self) -> float | None:
        """Root mean square angle by chance alone."""
        return (
            None if self.covariance is None else math.degrees(_root_trace(self.covariance[:3, :3]))
        )

    @property
    def expected_translation_mm(self) -> float | None:
        """Root mean square distance by chance alone."""
        return None if self.covariance is None else 1e3 * _root_trace(self.covariance[3:, 3:])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """Two calibrations side by side.

    Attributes:
        differences: one for each camera that both have.
        significance: the probability below which a difference is called significant.
        message: what came out, in words.
    """

    differences: tuple[Difference, ...]
    significance: float
    message: str

    @property
    def probability(self) -> float | None:
        """Of differences as large by chance: the least of the cameras, times their number."""
        return _least([item.probability for item in self.differences])

    @property
    def verdict(self) -> Verdict:
        """Whether the two agree; "unknown" where a covariance is missing."""
        if self.probability is None:
            return "unknown"
        return "differ" if self.probability < self.significance else "agree"

    @property
    def complete(self) -> bool:
        """Whether every direction of every camera was compared."""
        return self.probability is not None and all(
            item.directions == 6 for item in self.differences
        )


def compare(first: Result, second: Result, *, significance: float = SIGNIFICANCE) -> Comparison:
    """Hold two calibrations of one camera, or of several on one arm, against each other.

    The two must come from different images: results that share data differ by less than is expected here.

    Args:
        first: the earlier calibration.
        second: the later one.
        significance: the probability below which a difference is called significant.

    Raises:
        InputDataError: they have different setups, or no camera in common.
        ValueError: the significance is no probability.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> rng = np.random.default_rng(0)
        >>> robot, camera, truth = simulate_poses(rng, n_poses=16)
        >>> monday, friday = hf.solve(robot[:8], camera[:8]), hf.solve(robot[8:], camera[8:])
        >>> hf.compare(monday, friday).verdict
        'agree'
    """
    if not 0.0 < significance < 1.0:
        raise ValueError(f"{significance=} but expected a probability")
    if first.setup != second.setup:
        raise InputDataError(
            f"the first result is {first.setup} and the second {second.setup}: their X are poses in "
            "different frames; compare results of one setup"
        )
    freedoms = np.array([_freedom(first), _freedom(second)])
    differences = tuple(
        difference(name, a, b, freedoms) for name, a, b in _common_cameras(first, second)
    )
    message = " ".join(_sentences(differences, significance))
    if (digest := first.provenance.get("input_digest")) is not None and (
        digest == second.provenance.get("input_digest")
    ):
        message += (
            " Both were computed from the same input: they are not independent, and differences by chance "
            "are smaller than is assumed here."
        )
    return Comparison(differences=differences, significance=significance, message=message)


def difference(name: str, first: Calibrated, second: Calibrated, freedoms: Array) -> Difference:
    """One camera's two poses side by side.

    Args:
        name: of the camera.
        first: the earlier pose.
        second: the later one.
        freedoms: degrees of freedom (2,) of their covariances; infinite where these are known.
    """
    first_T_second = frames.inverse(first.matrix) @ second.matrix
    xi = frames.log(first_T_second)
    if first.covariance is None or second.covariance is None:
        return Difference(camera=name, first_T_second=first_T_second, xi=xi)
    to_second = frames.adjoint(frames.inverse(first_T_second))
    free = np.hstack([to_second @ free_space(first.covariance), free_space(second.covariance)])
    kept = _orthogonal(free, slice(0, 6))
    inside = kept @ kept.T
    moved = to_second @ first.covariance @ to_second.T
    parts = inside @ np.array([moved, second.covariance]) @ inside
    distance, probability = _test(kept, xi, parts, freedoms)
    return Difference(
        camera=name,
        first_T_second=first_T_second,
        xi=inside @ xi,
        covariance=parts.sum(axis=0),
        directions=kept.shape[1],
        distance=distance,
        probability=probability,
        probability_rotation=_test(_orthogonal(free, slice(0, 3)), xi, parts, freedoms)[1],
        probability_translation=_test(_orthogonal(free, slice(3, 6)), xi, parts, freedoms)[1],
    )


def _orthogonal(free: Array, part: slice) -> Array:
    """Orthonormal columns (6, k) within some of the components, orthogonal to the free directions."""
    inside = linalg.null_space(free[part].T) if free.shape[1] else np.eye(len(free[part]))
    result = np.zeros((6, inside.shape[1]))
    result[part] = inside
    return result


def _test(
    directions: Array, xi: Array, parts: Array, freedoms: Array
) -> tuple[float | None, float | None]:
    """Mahalanobis distance of a difference on some directions, and its probability by chance.

    Args:
        directions: orthonormal columns (6, p).
        xi: the difference (6,).
        parts: the covariances (2, 6, 6) of the two, those of t distributions.
        freedoms: their degrees of freedom (2,).
    """
    p = directions.shape[1]
    if p == 0:
        return None, None
    seen = directions.T @ xi
    inside = directions.T @ parts @ directions
    distance = _mahalanobis(seen, inside.sum(axis=0))
    # The covariance of a t distribution is larger than its scale matrix, on which the F rests.
    scales = 1.0 - 2.0 / np.maximum(freedoms, _FEWEST)
    weighted = scales[:, None, None] * inside
    shares = np.linalg.solve(weighted.sum(axis=0), weighted)
    spread = np.einsum("kij,kji->k", shares, shares) @ (1.0 / freedoms)
    square = _mahalanobis(seen, weighted.sum(axis=0)) ** 2 / p
    return distance, float(special.fdtrc(p, p / max(spread, 1e-9), square))


def _mahalanobis(vector: Array, covariance: Array) -> float:
    return float(np.sqrt(vector @ np.linalg.solve(covariance, vector)))


def _freedom(result: Result) -> float:
    """Degrees of freedom of X's covariance; infinite where it rests on no estimate, or is not told."""
    found = result.observability.get("degrees_of_freedom", math.inf)
    return math.inf if math.isnan(found) else found


def _common_cameras(first: Result, second: Result) -> Iterator[tuple[str, Calibrated, Calibrated]]:
    """The cameras that both results have, by name.

    Raises:
        InputDataError: there is none.
    """
    if not first.cameras and not second.cameras:
        yield "", first, second
        return
    ours = {camera.name: camera for camera in first.cameras}
    theirs = {camera.name: camera for camera in second.cameras}
    if not ours.keys() & theirs.keys():
        raise InputDataError(
            f"the first result has {_names(list(ours))} and the second {_names(list(theirs))}: there is no "
            "camera in both; compare results whose images are in folders of the same names"
        )
    for name in sorted(ours.keys() & theirs.keys()):
        yield name, ours[name], theirs[name]


def _names(cameras: Sequence[str]) -> str:
    return f"the cameras {', '.join(cameras)}" if cameras else "one camera without a name"


def _least(probabilities: Sequence[float | None]) -> float | None:
    known = [value for value in probabilities if value is not None]
    return min(1.0, len(known) * min(known)) if len(known) == len(probabilities) else None


def _root_trace(covariance: Array) -> float:
    return math.sqrt(float(np.trace(covariance)))


def _sentences(differences: Sequence[Difference], significance: float) -> Iterator[str]:
    """What came out, in words; of several cameras a sentence for each."""
    for item in differences:
        whose = f"X of {item.camera}" if item.camera else "X"
        found = f"{item.rotation_deg:.2g} deg and {item.translation_mm:.2g} mm"
        if item.directions == 0:
            yield f"No direction of {whose} is determined by both calibrations."
            continue
        if item.probability is None:
            yield (
                f"{whose} differs by {found}; whether that is more than chance cannot be told, since one of "
                "the two has no covariance."
            )
            continue
        expected = (
            f"{item.expected_rotation_deg:.2g} deg and {item.expected_translation_mm:.2g} mm "
            f"are to be expected by chance ({_chance(item.probability)})"
        )
        if item.probability * len(differences) >= significance:
            yield f"The calibrations agree: {whose} differs by {found}, and {expected}."
        else:
            yield (
                f"The calibrations differ: {whose} differs by {found}, but {expected}; most significant is "
                f"{_largest(item)}. The camera was moved on its mount, the TCP was changed, or one of the "
                "two is wrong."
            )
        if item.directions < 6:
            yield (
                f"Only {item.directions} of the 6 directions were compared: the others are free in one of "
                "the two."
            )


def _largest(item: Difference) -> str:
    """The component that differs most in standard deviations."""
    std = np.sqrt(np.diag(np.asarray(item.covariance)))
    ratios = np.divide(np.abs(item.xi), std, out=np.zeros(6), where=std > 1e-12)
    k = int(np.argmax(ratios))
    if k < 3:
        what = f"the rotation about the camera's {_AXES[k]} axis, {np.rad2deg(item.xi[k]):.2g} deg"
    else:
        what = f"the position along the camera's {_AXES[k - 3]} axis, {1e3 * item.xi[k]:.2g} mm"
    return f"{what}, {ratios[k]:.1f} standard deviations"


def _chance(probability: float) -> str:
    return f"p = {probability:.2g}" if probability > 1e-9 else "p < 1e-9"
