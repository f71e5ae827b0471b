"""A second optimisation from another start, which must reach the same optimum; entry ``second_start``.

The images alone hold the cameras within a fraction of a pixel; what may have several optima is how the
robot's poses go with them, a function of X, Z and the scale. It is minimised again from a start
that is far off, with the cameras where the refinement has them. Its optimum is there that of the whole
problem: with the cameras fixed, X, Z and the scale that are best in both are the same.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg, special
from scipy.optimize import least_squares

from handeye_fg import frames
from handeye_fg.findings import NoiseLevels, SecondStart
from handeye_fg.frames import Array
from handeye_fg.graph.determined import spread
from handeye_fg.graph.known import with_cameras
from handeye_fg.graph.problem import Problem
from handeye_fg.graph.rig import first_T_cameras
from handeye_fg.graph.summary import aligned, pose_residuals
from handeye_fg.graph.variables import State
from handeye_fg.known import whitened
from handeye_fg.observability import LIMITS, Observability

# How far off the start is: radians, parts of the gripper's motion, ln scale. From all starts up to 1.5
# radians off the optimum of simulated arms was reached.
_TURN, _SHIFT, _LOG_SCALE = 0.5, 0.2, 0.2
_AXIS = np.array([2.0, -1.0, 2.0]) / 3.0
_SAME = 0.1  # standard deviations of X; optimisers stop within a hundredth
_FALSE_ALARM = 1e-6  # probability that noise looks like a better optimum
_LEAST_SQUARES = 1e-2  # sums of squares, in units of the variance, that are as good as none
_RANK = 1e-9  # of a covariance whose free directions were projected away
_STEP = 1e-6  # of numerical derivatives: radians, metres
_MOST_EVALUATIONS = 50
_N_UNKNOWNS = 13  # X, Z, ln scale


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _RobotPart:
    """The robot's poses as a function of X, Z and the scale, the cameras fixed.

    The unknowns are the tangents of X and of Z and ln scale, from those of ``centre``.
    """

    problem: Problem
    centre: State
    sigmas: Array

    def residuals(self, unknowns: Array) -> Array:
        """Whitened residuals (m, rows) of the poses in use and of the priors, for unknowns (m, 13)."""
        problem, centre = self.problem, self.centre
        X = centre.gripper_T_camera @ frames.exp(unknowns[:, :6])
        Z = centre.base_T_world @ frames.exp(unknowns[:, 6:12])
        log_scale = centre.log_scale + unknowns[:, 12]
        cameras = np.repeat(centre.world_T_camera[None, problem.trusted], len(unknowns), axis=0)
        metric = frames.scaled(cameras, np.exp(log_scale)[:, None, None])
        base_T_gripper = Z[:, None] @ metric @ frames.inverse(X)[:, None]
        reported = problem.base_T_gripper[problem.trusted]
        rows = pose_residuals(base_T_gripper, reported, inverted=problem.inverted) / self.sigmas
        priors = [
            whitened(with_cameras(prior, centre.world_T_camera), X, log_scale)
            for prior in problem.priors
        ]
        if problem.known is not None:
            priors.append((log_scale / problem.known.log_scale_sigma)[:, None])
        return np.concatenate([rows.reshape(len(unknowns), -1), *priors], axis=1)

    def squares(self, unknowns: Array) -> Array:
        """Sums (2,) of the squared residuals of the poses, rotation and translation."""
        rows = self.residuals(unknowns[None])[0, : 6 * np.count_nonzero(self.problem.trusted)]
        return np.asarray(np.sum(rows.reshape(-1, 2, 3) ** 2, axis=(0, 2)))

    def minimised(self, start: Array, directions: Array) -> Array:
        """Unknowns (13,) at the optimum that is reached from a start (13,) along directions (13, d)."""

        def at(parts: Array) -> Array:
            return np.asarray(start + directions @ parts)

        def derivative(parts: Array) -> Array:
            here = at(parts)
            found = self.residuals(np.vstack([here, here + _STEP * directions.T]))
            return np.asarray((found[1:] - found[0]).T / _STEP)

        def residuals(parts: Array) -> Array:
            return np.asarray(self.residuals(at(parts)[None])[0])

        rows = self.residuals(start[None]).size
        found = least_squares(
            residuals,
            np.zeros(directions.shape[1]),
            derivative,
            method="lm" if rows >= directions.shape[1] else "trf",
            ftol=1e-10,
            xtol=1e-10,
            max_nfev=_MOST_EVALUATIONS,
        )
        return at(found.x)

    def camera(self, unknowns: Array) -> tuple[Array, float]:
        """X (4, 4) and ln scale of unknowns (13,)."""
        X = self.centre.gripper_T_camera @ frames.exp(unknowns[:6])
        return X, self.centre.log_scale + float(unknowns[12])

    def state(self, unknowns: Array) -> State:
        """The centre with X, Z and scale of unknowns (13,)."""
        X, log_scale = self.camera(unknowns)
        others = frames.scaled(first_T_cameras(self.centre), float(np.exp(log_scale)))
        return replace(
            self.centre,
            gripper_T_cameras=X @ others,
            base_T_world=self.centre.base_T_world @ frames.exp(unknowns[6:12]),
            log_scale=log_scale,
        )


def second_start(
    problem: Problem, state: State, noise: NoiseLevels, observability: Observability, first: State
) -> tuple[SecondStart, State | None]:
    """Whether another start leads to the same optimum; if to a better one, first values near that.

    Args:
        problem: the problem.
        state: its optimum.
        noise: the levels there.
        observability: of the first camera's X there.
        first: the first values with which the refinement began; the better ones have its points.
    """
    part = _robot_part(problem, state, noise)
    start = _far_off(part, observability)
    everything = np.eye(_N_UNKNOWNS)
    found = part.minimised(start, everything)
    better = None
    if _is_better(part, found, noise):
        X, log_scale = part.camera(found)
        smaller = spread(state.world_T_camera) / spread(first.world_T_camera)
        near = _robot_part(problem, _placed(problem, first, X, log_scale + np.log(smaller)), noise)
        better = near.state(near.minimised(np.zeros(_N_UNKNOWNS), everything))
    elif observability.free_basis.size:
        # What the data leave free is where the optimiser has it; all else must agree.
        found = part.minimised(start, _determined_directions(observability))
    apart = frames.log(frames.inverse(state.gripper_T_camera) @ part.camera(found)[0])
    scaled = observability.covariance / np.outer(LIMITS[:6], LIMITS[:6])
    information = np.linalg.pinv(scaled, rcond=_RANK, hermitian=True)
    in_units = apart / LIMITS[:6]
    verdict = SecondStart(
        agrees=bool(better is None and in_units @ information @ in_units < _SAME**2),
        restarted=False,
        rotation=float(np.linalg.norm(apart[:3])),
        translation=float(np.linalg.norm(apart[3:])),
    )
    return verdict, better


def _robot_part(problem: Problem, centre: State, noise: NoiseLevels) -> _RobotPart:
    sigmas = np.repeat([noise.robot_rotation, noise.robot_translation], 3)
    return _RobotPart(problem=problem, centre=centre, sigmas=sigmas)


def _placed(problem: Problem, state: State, X: Array, log_scale: float) -> State:
    """The state with another X and scale, and the world where the robot then has it."""
    used = problem.trusted
    metric = frames.scaled(state.world_T_camera[used], float(np.exp(log_scale)))
    base_T_world = aligned(problem.base_T_gripper[used] @ X, metric)
    others = frames.scaled(first_T_cameras(state), float(np.exp(log_scale)))
    return replace(
        state, gripper_T_cameras=X @ others, base_T_world=base_T_world, log_scale=log_scale
    )


def _far_off(part: _RobotPart, observability: Observability) -> Array:
    """Unknowns (13,) far from the centre, not along free directions."""
    problem, centre = part.problem, part.centre
    motion = spread(problem.base_T_gripper[problem.trusted])
    off = np.concatenate([_TURN * _AXIS, _SHIFT * motion * _AXIS[::-1], [_LOG_SCALE]]) / LIMITS
    free = observability.free_basis
    off = (off - free @ (free.T @ off)) * LIMITS
    X = centre.gripper_T_camera @ frames.exp(off[:6])
    Z = _placed(problem, centre, X, centre.log_scale + float(off[6])).base_T_world
    return np.concatenate([off[:6], frames.log(frames.inverse(centre.base_T_world) @ Z), off[6:]])


def _determined_directions(observability: Observability) -> Array:
    """Directions (13, d) of the unknowns without those that are free."""
    kept = LIMITS[:, None] * linalg.null_space(observability.free_basis.T)
    directions = np.zeros((_N_UNKNOWNS, 6 + kept.shape[1]))
    directions[:6, 6:], directions[12, 6:] = kept[:6], kept[6]
    directions[6:12, :6] = np.eye(6)
    return directions


def _is_better(part: _RobotPart, found: Array, noise: NoiseLevels) -> bool:
    """Whether unknowns (13,) fit better than the centre by more than noise makes them (likelihood ratio).

    Each noise level that was estimated has its best value for either.
    """
    there, here = (part.squares(unknowns) for unknowns in (found, np.zeros(_N_UNKNOWNS)))
    gain = here - there
    if noise.estimated:
        # Bartlett's correction: with few poses, unknowns that mean nothing fit noise.
        equations = 3.0 * np.count_nonzero(part.problem.trusted) - 0.5 * _N_UNKNOWNS
        gain = equations * np.log((here + _LEAST_SQUARES) / (there + _LEAST_SQUARES))
    return bool(gain.sum() > special.chdtri(_N_UNKNOWNS, _FALSE_ALARM))
