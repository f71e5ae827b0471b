"""Cameras of each model, and one of a few pixels."""

import numpy as np

from handeye_fg.types import CameraModel

# Its images are written and read in no time.
SMALL = CameraModel(
    model="OPENCV",
    width=64,
    height=48,
    params=np.array([55.0, 55.0, 32.2, 24.1, -0.05, 0.02, 1e-3, -1e-3]),
)
PINHOLE = (820.0, 825.0, 483.0, 352.0)
PARAMS = {
    "SIMPLE_PINHOLE": (820.0, 483.0, 352.0),
    "PINHOLE": PINHOLE,
    "SIMPLE_RADIAL": (820.0, 483.0, 352.0, -0.1),
    "RADIAL": (820.0, 483.0, 352.0, -0.1, 0.05),
    "OPENCV": (*PINHOLE, -0.06, 0.03, 4e-3, -3e-3),
    "FULL_OPENCV": (*PINHOLE, -0.2, 0.05, 1e-3, -2e-3, 0.08, 0.1, 0.05, -0.02),
    "SIMPLE_FISHEYE": (420.0, 483.0, 352.0),
    "FISHEYE": PINHOLE,
    "SIMPLE_RADIAL_FISHEYE": (420.0, 483.0, 352.0, -0.04),
    "RADIAL_FISHEYE": (420.0, 483.0, 352.0, -0.04, 0.01),
    "OPENCV_FISHEYE": (*PINHOLE, 0.02, -0.01, 0.004, -0.001),
}


def camera_of(model: str, params: tuple[float, ...] | None = None) -> CameraModel:
    """A camera of 960x720 pixels of a model, with its parameters above unless others are given."""
    values = PARAMS[model] if params is None else params
    return CameraModel(model=model, width=960, height=720, params=np.array(values))
