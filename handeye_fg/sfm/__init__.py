"""Structure from motion by COLMAP; the only package that touches pycolmap.

Entry points: ``reconstruct`` (images to a model), ``complete`` (images that it left out),
``find_in_scene`` (new images in it), ``from_tracks`` (given image points to a model),
``read_model`` (an existing COLMAP model), ``write_model`` (a model of ours as files) and ``write_metric`` (a model in metres for others).
"""

# zlib must find its own functions before COLMAP's library brings others of their name
import zlib

_compressor = zlib.compressobj()
_compressor.compress(b"")
_compressor.flush()

from handeye_fg.sfm.completion import complete
from handeye_fg.sfm.metric import write_metric
from handeye_fg.sfm.model import FEWEST_IMAGES, ModelSource, read_model, read_model_poses
from handeye_fg.sfm.model_files import model_folder
from handeye_fg.sfm.native import set_verbosity
from handeye_fg.sfm.new_images import Seen, find_in_scene, model_database
from handeye_fg.sfm.pairs import RobotGuide
from handeye_fg.sfm.reconstruct import reconstruct
from handeye_fg.sfm.tracks import from_tracks
from handeye_fg.sfm.writing import write_model

__all__ = [
    "FEWEST_IMAGES",
    "ModelSource",
    "RobotGuide",
    "Seen",
    "complete",
    "find_in_scene",
    "from_tracks",
    "model_database",
    "model_folder",
    "read_model",
    "read_model_poses",
    "reconstruct",
    "set_verbosity",
    "write_metric",
    "write_model",
]
