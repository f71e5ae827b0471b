"""Known targets in images: corners, and camera poses from them; the only package that finds boards.

Entry points: ``find_target`` (corners in a set of images), ``place_on_board`` (camera poses from
them; ``board_poses`` does both), ``on_target`` (a reconstruction in the target's frame).
"""

from handeye_fg.targets.alignment import on_target
from handeye_fg.targets.detect import find_target
from handeye_fg.targets.poses import BoardPoses, board_poses, place_on_board

__all__ = ["BoardPoses", "board_poses", "find_target", "on_target", "place_on_board"]
