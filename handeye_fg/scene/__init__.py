"""Camera poses and points from images, in agreement with the robot; entry point ``find_scene``.

``claims`` asks whether the robot poses are as they are said to be, ``expected`` says where the robot has the
cameras, ``joining`` places images that structure from motion left apart, ``together`` refuses cameras that stay so.
"""

from handeye_fg.scene.claims import Checked, agreed, check_poses
from handeye_fg.scene.search import Scene, find_scene, reconstructed
from handeye_fg.scene.together import require_one_world

__all__ = [
    "Checked",
    "Scene",
    "agreed",
    "check_poses",
    "find_scene",
    "reconstructed",
    "require_one_world",
]
