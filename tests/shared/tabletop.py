"""The set data/tabletop, and its images at half their size, of which a scene is soon reconstructed."""

import json
from pathlib import Path

import numpy as np
from PIL import Image

from handeye_fg.types import CameraModel

TABLETOP = Path(__file__).parents[2] / "data" / "tabletop"
TRUTH = {
    name: np.array(value)
    for name, value in json.loads((TABLETOP / "truth.json").read_text()).items()
    if "_T_" in name
}
NAMES = tuple(path.name for path in sorted((TABLETOP / "images").iterdir()))
HALF_SIZE = (640, 480)
# In pixels from the corner, everything halves.
HALF_CAMERA = CameraModel(
    model="OPENCV",
    width=640,
    height=480,
    params=np.array([550.0, 550.275, 326.3728, 232.583, -0.06, 0.03, 4e-4, -3e-4]),
)


def save_halves(folder: Path, n_images: int) -> None:
    """Write the first images of the set into a folder, at half their size."""
    for name in NAMES[:n_images]:
        with Image.open(TABLETOP / "images" / name) as image:
            image.resize(HALF_SIZE, Image.Resampling.BOX).save(folder / name, quality=95)
