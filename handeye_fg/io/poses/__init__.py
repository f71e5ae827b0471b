"""Robot poses in and out: files of many formats, and mappings of matrices.

``read_poses`` gives poses; ``open_poses`` gives a ``PoseFile``, whose numbers can be read under any
``Convention``. ``write_poses`` writes what they read. ``FORMATS`` says what is known of each format; a new one is a line there.
"""

from handeye_fg.io.poses.convention import Convention
from handeye_fg.io.poses.formats import FORMATS
from handeye_fg.io.poses.mapping import poses_from_mapping
from handeye_fg.io.poses.reader import open_poses, read_poses
from handeye_fg.io.poses.rows import PoseFile, PoseRows
from handeye_fg.io.poses.writer import write_poses

__all__ = [
    "FORMATS",
    "Convention",
    "PoseFile",
    "PoseRows",
    "open_poses",
    "poses_from_mapping",
    "read_poses",
    "write_poses",
]
