"""The refinement's problem of a simulated scene, with all observations."""

import numpy as np

from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.problem import Problem, make_problem
from handeye_fg.graph.variables import State
from handeye_fg.simulate import Scene


def problem_of(scene: Scene, state: State) -> Problem:
    """Around a state, with the sigma of the pixels that the scene was made with."""
    tracks = scene.model.tracks
    kept = Kept(
        state=state,
        tracks=tracks,
        sigma_scale=np.ones(len(tracks.pixels)),
        pixel=scene.noise.pixel,
        corner=1.0,
    )
    return make_problem(kept, scene.robot_poses.base_T_gripper, "base", (), None, ())
