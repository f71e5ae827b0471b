"""Robot poses that disagree with the others: which poses belong together; entry ``agreeing``."""

import numpy as np
from numpy.typing import NDArray
from scipy import special

from handeye_fg.frames import Array
from handeye_fg.graph.deletion import deletions
from handeye_fg.graph.noise import Solution, estimate_noise
from handeye_fg.graph.reduced import Linearised
from handeye_fg.options import NoiseOptions

Poses = NDArray[np.bool_]

_FALSE_ALARM = 1e-3  # probability that any pose of a good set is left out
_MOST = 0.4  # part of the poses; beyond it there is no majority to trust
# Lengths of three standard normal components: the median, and what one in 200 exceeds.
_MEDIAN = float(np.sqrt(special.chdtri(3, 0.5)))
_TYPICAL = float(np.sqrt(special.chdtri(3, 0.005)))
_ROUNDS = 10  # of the search for a core; it settles in two or three
# The quick test with the noise levels of all poses is that of the others to a few percent.
_CLEAR = 0.5


def agreeing(
    linearised: Linearised,
    solution: Solution,
    trusted: Poses,
    options: NoiseOptions,
    held: Poses | None = None,
) -> tuple[Poses, Solution]:
    """Which of the poses (n,) agree, and the solution with these.

    Several wrong poses inflate the noise levels and hide each other. First, therefore, a core is
    found by the median of the residuals, which they do not move much. Then, one set after the other,
    each pose is compared with what the other trusted ones predict for it, noise levels included: one
    that agrees is taken in, the one that agrees least is left out if it fails, until nothing changes.

    Args:
        linearised: the problem around its optimum, with the trusted poses.
        solution: its solution.
        trusted: (n,) the poses that are used so far.
        options: the noise levels that the user knows.
        held: (n,) poses that are never used; None: there are none.
    """
    allowed_in = np.ones(len(trusted), dtype=bool) if held is None else ~held
    trusted, solution = _core(linearised, solution, trusted, options, allowed_in)
    level = _FALSE_ALARM / len(trusted)
    allowed = int(_MOST * np.count_nonzero(allowed_in))
    for _ in range(2 * len(trusted)):  # in case two sets follow each other for ever
        lengths = deletions(linearised, solution, trusted).lengths
        fits = ~_fails(lengths, solution, level) & allowed_in
        if (~trusted & fits).any():
            trusted = trusted | fits
            solution = estimate_noise(linearised.using(trusted), solution.noise, options)
            continue
        worst = _suspect(lengths, solution, trusted, level)
        if worst is None or np.count_nonzero(allowed_in & ~trusted) >= allowed:
            break
        rest = trusted.copy()
        rest[worst] = False
        without = estimate_noise(linearised.using(rest), solution.noise, options)
        if not _fails(deletions(linearised, without, rest).lengths, without, level)[worst]:
            break
        trusted, solution = rest, without
    return trusted, solution


def _core(
    linearised: Linearised,
    solution: Solution,
    trusted: Poses,
    options: NoiseOptions,
    allowed_in: Poses,
) -> tuple[Poses, Solution]:
    """Trusted poses whose residuals are typical of the majority of them."""
    n = np.count_nonzero(allowed_in)
    fewest = n - int(_MOST * n)
    for _ in range(_ROUNDS):
        lengths = deletions(linearised, solution, trusted).lengths
        typical = np.median(np.nan_to_num(lengths[trusted]), axis=0) / _MEDIAN
        # Known levels are not to be doubted because the residuals are smaller than they promise.
        unit = typical if solution.noise.estimated else np.maximum(typical, 1.0)
        core = trusted & ~(lengths > _TYPICAL * unit).any(axis=1)
        if np.array_equal(core, trusted) or np.count_nonzero(core) < fewest:
            break
        trusted = core
        solution = estimate_noise(linearised.using(trusted), solution.noise, options)
    return trusted, solution


def _limits(solution: Solution, level: float, redundancy: Array) -> Array:
    """Squares (2,) of lengths that good poses exceed with half the probability ``level``."""
    if solution.noise.estimated:
        return np.asarray(3.0 * special.fdtri(3, np.maximum(redundancy, 1.0), 1.0 - level / 2.0))
    return np.full(2, special.chdtri(3, level / 2.0))


def _fails(lengths: Array, solution: Solution, level: float) -> Poses:
    """Which poses (n,) the solution, if they are not part of it, makes too improbable.

    Rotation and translation are tested each with the degrees of freedom of its sigma (F), or with
    chi-square where the user gave the sigmas.
    """
    limits = _limits(solution, level, np.array(solution.redundancy[1:3]))
    return np.asarray(~(lengths**2 <= limits).all(axis=1))


def _suspect(lengths: Array, solution: Solution, trusted: Poses, level: float) -> int | None:
    """The trusted pose that agrees least, if the noise levels without it may make it fail."""
    redundancy = np.array(solution.redundancy[1:3])
    squares = np.where(trusted[:, None], np.nan_to_num(lengths) ** 2, 0.0)
    if solution.noise.estimated:
        # What remains of the sums of squares, in units of the variances.
        remaining = np.maximum(redundancy - squares, 1e-3 * np.maximum(redundancy, 1.0))
        squares = squares * np.maximum(redundancy - 3.0, 1.0) / remaining
    ratio = (squares / _limits(solution, level, redundancy - 3.0)).max(axis=1)
    worst = int(ratio.argmax())
    return worst if ratio[worst] > _CLEAR else None
