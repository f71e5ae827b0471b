"""Which kind of camera file it is; entry points ``read_camera`` and ``read_cameras``."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.io.cameras.colmap import binary_cameras, is_text_of_cameras, text_cameras
from handeye_fg.io.cameras.documents import is_nerfstudio, nerfstudio_camera, our_camera
from handeye_fg.io.cameras.kalibr import is_kalibr, kalibr_cameras
from handeye_fg.io.cameras.matrices import of_focal_lengths, of_matrix
from handeye_fg.io.files import read_text
from handeye_fg.io.json_files import read_json
from handeye_fg.io.yaml_files import read_yaml
from handeye_fg.types import CameraModel

_REMEDY = "correct the camera file"
_KIND = "camera file"
_WANTED = (
    "a camera file of ROS (camera_info), OpenCV, Kalibr, COLMAP (cameras.txt or .bin) or nerfstudio "
    "(transforms.json)"
)


def read_camera(path: str | Path) -> CameraModel:
    """Read the intrinsics of one camera from a file of ROS, OpenCV, Kalibr, COLMAP or nerfstudio, or from JSON.

    The kind is told from the content. Distortion is mapped without loss or refused. Files of ROS, OpenCV and Kalibr
    have the centre of the first pixel at (0, 0), those of COLMAP and nerfstudio at (0.5, 0.5), as the returned model.

    Args:
        path: the file, or a folder of COLMAP with cameras.bin or cameras.txt.

    Returns:
        The intrinsics in pixels, in COLMAP's order.

    Raises:
        InputDataError: the file is missing, damaged or of another kind, has several cameras, or has a model that
            cannot be represented.

    Examples:
        >>> from pathlib import Path
        >>> from tempfile import TemporaryDirectory
        >>> import handeye_fg as hf
        >>> with TemporaryDirectory() as folder:
        ...     path = Path(folder) / "cameras.txt"
        ...     _ = path.write_text("1 SIMPLE_RADIAL 640 480 500 320 240 -0.1")
        ...     camera = hf.read_camera(path)
        >>> camera.model, camera.params.tolist()
        ('SIMPLE_RADIAL', [500.0, 320.0, 240.0, -0.1])
    """
    cameras = read_cameras(path)
    first, *others = cameras.values()
    if any(not _same(first, other) for other in others):
        raise InputDataError(
            f"{_KIND} {path}: has {len(cameras)} cameras ({', '.join(list(cameras)[:8])}), but one was wanted; "
            "give a file with that camera alone"
        )
    return first


def read_cameras(path: str | Path) -> Mapping[str, CameraModel]:
    """Read all cameras of a file under their names there: cam0, cam1 of Kalibr, the numbers of COLMAP; else "".

    Raises:
        InputDataError: as for ``read_camera``.
    """
    path = _file_of(Path(path))
    where = f"{_KIND} {path}"
    if path.suffix == ".bin":
        return binary_cameras(path, where)
    text = read_text(path, _KIND)
    if is_text_of_cameras(text):
        return text_cameras(text, where)
    if path.suffix == ".json" or text.lstrip().startswith("{"):
        fields = read_json(path, _KIND, _WANTED, _REMEDY)
        if is_nerfstudio(fields):
            return {"": nerfstudio_camera(fields)}
        if (ours := our_camera(fields)) is not None:
            return {"": ours}
    else:
        fields = read_yaml(path, _KIND, _WANTED, _REMEDY)
    if is_kalibr(fields):
        return kalibr_cameras(fields)
    return {"": of_focal_lengths(fields) if "fx" in fields.values else of_matrix(fields)}


def _file_of(path: Path) -> Path:
    """The file itself; of a folder of COLMAP that of its cameras."""
    if not path.is_dir():
        return path
    files = [path / name for name in ("cameras.bin", "cameras.txt") if (path / name).is_file()]
    if not files:
        raise InputDataError(
            f"{_KIND} {path}: is a folder, but not that of a COLMAP model, and there is one camera; give its file"
        )
    return files[0]


def _same(one: CameraModel, other: CameraModel) -> bool:
    return (one.model, one.width, one.height) == (
        other.model,
        other.width,
        other.height,
    ) and np.array_equal(one.params, other.params)
