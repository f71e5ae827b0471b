"""The pose graph: X, Z, scale and true poses from poses alone, both noises modelled."""

from handeye_fg.graph.poses.estimator import PoseGraph, pose_graph
from handeye_fg.graph.poses.measurements import CameraNoise, Component, NoiseModel

__all__ = ["CameraNoise", "Component", "NoiseModel", "PoseGraph", "pose_graph"]
