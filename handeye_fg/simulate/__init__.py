"""Synthetic hand-eye data with a known truth; ships: tests, benchmarks and notebooks use it.

``scenes``: robots, cameras and what a calibration gets of them, under additive noise. ``series``: the
random motions of Andreff, Horaud and Espiau's simulations, under proportional noise. ``published``:
the methods that they compared, as their papers state them. ``rig``: several cameras on one arm.
``arms``: an arm whose links are not as its controller believes. ``careless``: poses in other conventions
than they are said to be. ``wrong_tracks``: observations that are not of their point.
"""

from handeye_fg.simulate.arms import LinkErrors, simulate_arm_scene
from handeye_fg.simulate.rig import RigScene, simulate_rig
from handeye_fg.simulate.scenes import (
    ROBOT_ROTATION_SIGMA,
    ROBOT_TRANSLATION_SIGMA,
    Motion,
    Scene,
    Truth,
    default_camera,
    disturbed,
    project,
    simulate_poses,
    simulate_scene,
)

__all__ = [
    "ROBOT_ROTATION_SIGMA",
    "ROBOT_TRANSLATION_SIGMA",
    "LinkErrors",
    "Motion",
    "RigScene",
    "Scene",
    "Truth",
    "default_camera",
    "disturbed",
    "project",
    "simulate_arm_scene",
    "simulate_poses",
    "simulate_rig",
    "simulate_scene",
]
