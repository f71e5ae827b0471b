"""Calibration from pose pairs alone: robot and camera poses, or motions, without images; entry point ``solve``.

``calibration`` is the flow, ``claims`` asks whether the poses are as they are said to be, ``solution`` has the closed
forms and the pose graph, ``answer`` what comes out of them.
"""

from handeye_fg.from_poses.calibration import solve

__all__ = ["solve"]
