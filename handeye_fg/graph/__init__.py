"""The factor graph: measurements, joint refinement, noise levels and covariance.

``refine_views`` is the entry point; ``refine`` does one refinement with intrinsics that are fixed or
have a prior.
"""

from handeye_fg.graph.cameras import View, refine_views
from handeye_fg.graph.holdout import HeldOut
from handeye_fg.graph.known import of_model
from handeye_fg.graph.new_images import NewImages, predicted
from handeye_fg.graph.problem import IntrinsicsPrior
from handeye_fg.graph.refine import refine, start_state
from handeye_fg.graph.reprojection import reprojection_errors
from handeye_fg.graph.summary import Refinement, corner_fit, median_depth

__all__ = [
    "HeldOut",
    "IntrinsicsPrior",
    "NewImages",
    "Refinement",
    "View",
    "corner_fit",
    "median_depth",
    "of_model",
    "predicted",
    "refine",
    "refine_views",
    "reprojection_errors",
    "start_state",
]
