"""The graph of one choice of observations, and its linearised form; entry point ``make_problem``."""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.graph import measurements as m
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.reduced import Layout, Linearised, eliminate_points, robot_rows, summed
from handeye_fg.options import Prior
from handeye_fg.types import Indices, KnownPoints, NoiseLevels, Tracks


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IntrinsicsPrior:
    """Intrinsics as unknowns with a prior.

    Attributes:
        params: OPENCV parameters (8,), centre of the prior.
        sigmas: standard deviations (8,).
    """

    params: Array
    sigmas: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Problem:
    """One choice of observations, their part of the graph (built once), and what does not change.

    The sigmas of the observations have the unit ``pixel_unit_px``. When the noise levels change, the
    graph is not built again: only the ratios of the levels matter to the optimum, so the metric
    measurements are scaled instead. Corners of a target, which are few, have their own level.
    """

    tracks: Tracks
    sigma_scale: Array
    reprojections: gtsam.NonlinearFactorGraph
    corners: Indices
    opencv_params: Array
    gauge: gtsam.NonlinearFactorGraph
    base_T_gripper: Array
    trusted: NDArray[np.bool_]
    intrinsics: IntrinsicsPrior | None
    known: KnownPoints | None
    known_x: Sequence[Prior]
    pixel_unit_px: float
    layout: Layout
    held: gtsam.NonlinearFactorGraph | None = None

    def graph(self, noise: NoiseLevels) -> gtsam.NonlinearFactorGraph:
        """All measurements; their sigmas have the unit that makes a pixel's ``pixel_unit_px``."""
        unit = self.pixel_unit_px / noise.pixel
        corners = self._seen_corners(unit * (noise.corner or 1.0))
        graphs = [self.reprojections, corners, self._robot(noise, unit), self._priors(unit)]
        return m.joined(graphs if self.held is None else [*graphs, self.held])

    def linearised(self, values: gtsam.Values, noise: NoiseLevels) -> Linearised:
        """The problem around an estimate."""
        points = len(self.tracks.points_world)
        sigmas = m.pose_sigmas(noise.robot_rotation, noise.robot_translation)
        scene_rows = 2 * (len(self.tracks.pixels) - len(self.corners))
        return Linearised(
            reprojections=eliminate_points(
                self.reprojections.linearize(values), points, self.layout
            ),
            corners=summed(self._seen_corners(1.0).linearize(values), self.layout),
            robot=robot_rows(self._robot(noise).linearize(values), sigmas, self.layout),
            prior=summed(self._priors().linearize(values), self.layout),
            pixel_unit_px=self.pixel_unit_px,
            pixel_redundancy=scene_rows - 3 * (points - self.layout.n_known),
            corner_rows=2 * len(self.corners),
            layout=self.layout,
            held=None if self.held is None else summed(self.held.linearize(values), self.layout),
        )

    def _robot(self, noise: NoiseLevels, unit: float = 1.0) -> gtsam.NonlinearFactorGraph:
        sigmas = m.pose_sigmas(noise.robot_rotation, noise.robot_translation)
        return m.robot_graph(self.base_T_gripper, unit * sigmas, self.trusted)

    def _seen_corners(self, sigma: float) -> gtsam.NonlinearFactorGraph:
        return m.reprojection_graph(
            self.tracks,
            sigma * self.sigma_scale,
            self.opencv_params,
            with_intrinsics=self.layout.with_intrinsics,
            rows=self.corners,
        )

    def _priors(self, unit: float = 1.0) -> gtsam.NonlinearFactorGraph:
        graphs = [self.gauge, m.known_x_graph(self.known_x, unit)]
        if self.intrinsics is not None:
            prior = self.intrinsics
            graphs.append(m.intrinsics_graph(prior.params, unit * prior.sigmas))
        if self.known is not None:
            graphs.append(m.known_points_graph(self.known, unit))
        return m.joined(graphs)


def make_problem(
    kept: Kept,
    base_T_gripper: Array,
    gauge: m.Gauge,
    intrinsics: IntrinsicsPrior | None,
    known: KnownPoints | None,
    known_x: Sequence[Prior],
    trusted: NDArray[np.bool_] | None = None,
) -> Problem:
    """The problem of the observations that were kept.

    Args:
        kept: values of the unknowns, and observations with their sigmas.
        base_T_gripper: reported robot poses (n, 4, 4), metres.
        gauge: what holds the world where there are no known points.
        intrinsics: prior of the intrinsics; None to keep them fixed.
        known: known points; None where there are none.
        known_x: what is known of X beforehand.
        trusted: (n,) which of the robot poses are used; None: all.
    """
    state, tracks, with_intrinsics = kept.state, kept.tracks, intrinsics is not None
    n_known = 0 if known is None else len(known.points_world)
    corners = tracks.point_index < n_known
    held = m.wide_prior_graph(state)
    return Problem(
        tracks=tracks,
        sigma_scale=kept.sigma_scale,
        reprojections=m.reprojection_graph(
            tracks,
            kept.pixel * kept.sigma_scale,
            state.opencv_params,
            with_intrinsics=with_intrinsics,
            rows=np.flatnonzero(~corners),
        ),
        corners=np.flatnonzero(corners),
        opencv_params=state.opencv_params,
        gauge=m.joined([m.gauge_graph(state, gauge), held]) if known is None else held,
        base_T_gripper=base_T_gripper,
        trusted=np.ones(len(base_T_gripper), dtype=bool) if trusted is None else trusted,
        intrinsics=intrinsics,
        known=known,
        known_x=known_x,
        pixel_unit_px=kept.pixel,
        layout=Layout(
            n_cameras=len(state.world_T_camera), with_intrinsics=with_intrinsics, n_known=n_known
        ),
    )
