"""Refinements of simulated scenes, and the problems that they solve."""

from typing import Any

import numpy as np

from handeye_fg.frames import Array
from handeye_fg.graph import refine
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.problem import Problem, make_problem
from handeye_fg.graph.summary import Refinement
from handeye_fg.graph.variables import State
from handeye_fg.options import GraphOptions, NoiseOptions
from handeye_fg.progress import silent
from handeye_fg.simulate import Scene
from handeye_fg.types import SfmModel


def refined_from(start: State, model: SfmModel, reported: Array, **how: Any) -> Refinement:
    """The refinement from a start, with fixed intrinsics and levels from the data unless told otherwise."""
    usual = {"intrinsics": (), "noise": NoiseOptions(), "options": GraphOptions()}
    return refine(model, reported, start, progress=silent, **(usual | how))


def problem_of(scene: Scene, state: State) -> Problem:
    """All observations around a state, with the sigma of the pixels that the scene was made with."""
    tracks = scene.model.tracks
    kept = Kept(
        state=state,
        tracks=tracks,
        sigma_scale=np.ones(len(tracks.pixels)),
        pixel=scene.noise.pixel,
        corner=1.0,
    )
    return make_problem(kept, scene.robot_poses.base_T_gripper, "base", (), None, ())
