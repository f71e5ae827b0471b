"""Camera files of other programs as COLMAP camera models; entry points ``read_camera`` and ``read_cameras``.

``matrices``: ROS, OpenCV and plain numbers; ``kalibr``; ``colmap``; ``documents``: nerfstudio and our own JSON.
Pixels are converted here: inside, the centre of the first pixel is at (0.5, 0.5).
"""

from handeye_fg.io.cameras.documents import nerfstudio_camera
from handeye_fg.io.cameras.reader import read_camera, read_cameras

__all__ = ["nerfstudio_camera", "read_camera", "read_cameras"]
