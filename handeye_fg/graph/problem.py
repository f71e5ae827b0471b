"""The graph of one choice of observations, and its linearised form; entry point ``make_problem``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from numpy.typing import NDArray

from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph import measurements as m
from handeye_fg.graph.elimination import (
    Batch,
    batches,
    corner_batch,
    corners_quadratic,
    eliminate,
    squares,
)
from handeye_fg.graph.known import Known
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.reduced import Layout, Linearised, Quadratic, robot_rows, summed
from handeye_fg.graph.rig import carried, is_plain, to_images
from handeye_fg.graph.variables import State, moved, to_values
from handeye_fg.types import KnownPoints


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntrinsicsPrior:
    """Intrinsics of a camera as unknowns with a prior.

    Attributes:
        params: centre (k,) of the prior, in the model of the state's camera.
        sigmas: standard deviations (k,); where zero, the parameter stays as it is in the state.
    """

    params: Array
    sigmas: Array

    @property
    def unknown(self) -> tuple[int, ...]:
        """Which of the parameters are unknowns."""
        return tuple(np.flatnonzero(self.sigmas).tolist())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One choice of observations, and everything that does not change while it is optimised.

    The sigmas of the observations of unknown points have the unit ``pixel_unit_px``, those of corners
    of a target, which have a level of their own, are relative.
    """

    scene: tuple[Batch, ...]
    corners: Batch
    gauge: gtsam.NonlinearFactorGraph
    base_T_gripper: Array
    trusted: NDArray[np.bool_]
    intrinsics: Sequence[IntrinsicsPrior]
    known: KnownPoints | None
    priors: Sequence[Known]
    pixel_unit_px: float
    layout: Layout
    inverted: bool
    held: gtsam.NonlinearFactorGraph | None = None

    def linearised(self, state: State) -> Linearised:
        """The problem around a state.

        Args:
            state: the values.

        Raises:
            ConvergenceError: derivatives are not finite.
        """
        values = self._values(state)
        images = replace(self.layout, n_poses=len(state.rig.pose))
        eliminated = eliminate(self.scene, state, images)
        reprojections = eliminated.quadratic
        corners = corners_quadratic(self.corners, state, images)
        point_steps = eliminated.point_steps
        if not is_plain(state.rig):
            to = to_images(state, self.layout)
            reprojections, corners = carried(reprojections, to), carried(corners, to)

            def point_steps(step: Array) -> Array:
                return eliminated.point_steps(to @ step)

        graph = m.robot_graph(self.base_T_gripper, np.ones(6), inverted=self.inverted)
        reported = robot_rows(graph.linearize(values), self.layout)
        n_unknown = len(state.points_world) - self.layout.n_known
        return Linearised(
            reprojections=reprojections,
            corners=corners,
            robot=reported.only(self.trusted),
            reported=reported,
            prior=summed(self._priors().linearize(values), self.layout),
            pixel_unit_px=self.pixel_unit_px,
            pixel_redundancy=2 * sum(len(part.sigmas) for part in self.scene) - 3 * n_unknown,
            corner_rows=2 * len(self.corners.sigmas),
            layout=self.layout,
            inverted=self.inverted,
            point_steps=point_steps,
            held=self.held_at(state),
        )

    def cost(self, state: State, noise: NoiseLevels) -> float:
        """Half the sum of squared whitened residuals."""
        unit = noise.image_sigma / self.pixel_unit_px
        images = squares(self.scene, state) / unit**2
        images += squares([self.corners], state) / noise.corner_image_sigma**2
        sigmas = m.pose_sigmas(noise.robot_rotation, noise.robot_translation)
        robot = m.robot_graph(self.base_T_gripper, sigmas, self.trusted, inverted=self.inverted)
        graphs = [robot, self._priors()]
        graphs += [] if self.held is None else [self.held]
        return 0.5 * images + float(m.joined(graphs).error(self._values(state)))

    def holding(self, gripper_T_camera: Array, free: Array) -> "Problem":
        """The problem with the first X held along free directions, columns (6, d) in units of the limits."""
        held = m.held_graph(gripper_T_camera, free) if free.size else None
        return replace(self, held=held)

    def held_at(self, state: State) -> Quadratic | None:
        """What holds X, around a state; None: nothing does."""
        if self.held is None:
            return None
        return summed(self.held.linearize(self._values(state)), self.layout)

    def moved(self, state: State, linearised: Linearised, step: Array, part: float = 1.0) -> State:
        """The state after a part of a step (d,) of the shared unknowns and of the points with it."""
        layout = self.layout
        steps = gtsam.VectorValues()
        for key in layout.keys:
            steps.insert(key, part * step[layout.columns(key)])
        return moved(state, steps, part * linearised.point_steps(step), layout.intrinsics)

    def _values(self, state: State) -> gtsam.Values:
        """The shared unknowns for GTSAM."""
        layout = self.layout
        return to_values(state, intrinsics=layout.intrinsics, n_points=layout.n_known)

    def _priors(self) -> gtsam.NonlinearFactorGraph:
        graphs = [self.gauge, m.known_graph(self.priors)]
        for k, prior in enumerate(self.intrinsics):
            if unknown := list(prior.unknown):
                graphs.append(m.intrinsics_graph(k, prior.params[unknown], prior.sigmas[unknown]))
        if self.known is not None:
            graphs.append(m.known_points_graph(self.known))
        return m.joined(graphs)


def make_problem(
    kept: Kept,
    base_T_gripper: Array,
    gauge: m.Gauge,
    intrinsics: Sequence[IntrinsicsPrior],
    known: KnownPoints | None,
    priors: Sequence[Known],
    trusted: NDArray[np.bool_] | None = None,
    *,
    inverted: bool = False,
) -> Problem:
    """The problem of the observations that were kept.

    Args:
        kept: values of the unknowns, and observations with their sigmas.
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        gauge: what holds the world where there are no known points.
        intrinsics: prior of each camera's intrinsics; empty to keep all fixed.
        known: known points; None where there are none.
        priors: what else is known beforehand.
        trusted: (n,) which of the robot poses are used; None: all.
        inverted: the robot poses are gripper_T_base.
    """
    state, tracks = kept.state, kept.tracks
    n_known = 0 if known is None else len(known.points_world)
    n_images = len(state.rig.pose)
    held = m.wide_prior_graph(state)
    return Problem(
        scene=batches(tracks, kept.pixel * kept.sigma_scale, n_images, n_known),
        corners=corner_batch(tracks, kept.sigma_scale, n_images, n_known),
        gauge=m.joined([m.gauge_graph(state, gauge), held]) if known is None else held,
        base_T_gripper=base_T_gripper,
        trusted=np.ones(len(base_T_gripper), dtype=bool) if trusted is None else trusted,
        intrinsics=intrinsics,
        known=known,
        priors=priors,
        pixel_unit_px=kept.pixel,
        layout=Layout(
            n_poses=len(state.world_T_camera),
            n_cameras=len(state.gripper_T_cameras),
            intrinsics=tuple(prior.unknown for prior in intrinsics),
            n_known=n_known,
        ),
        inverted=inverted,
    )
