"""Where images were taken, for pictures of the scene; entry point ``placed``."""

from dataclasses import dataclass

import numpy as np

from handeye_fg import frames
from handeye_fg.frames import Array
from handeye_fg.io.camera_results import Calibrated
from handeye_fg.io.image_results import ImageReport
from handeye_fg.io.results import Result
from handeye_fg.lens import MODELS, lens_of
from handeye_fg.types import folder_of

# Half of an image at unit depth where the lens is not known.
_USUAL_HALF = np.array([0.5, 0.4])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """An image that has a pose.

    Attributes:
        image: what is known of it.
        camera: what is known of the camera that took it.
        pose: its camera (4, 4), metres: in the base; where the camera stands still, in the gripper.
    """

    image: ImageReport
    camera: Calibrated
    pose: Array

    @property
    def centre(self) -> Array:
        """Of the camera (3,)."""
        return self.pose[:3, 3]

    @property
    def gripper(self) -> Array:
        """Origin (3,) of the gripper that carries the camera."""
        return (self.pose @ frames.inverse(self.camera.matrix))[:3, 3]

    def corners(self, size: float) -> Array:
        """Corners (4, 3) of the image as it is seen through the lens: top left, top right, bottom right, bottom left.

        Args:
            size: depth at which the image stands, metres; of a wide lens half its diagonal.
        """
        half, middle = _half_and_middle(self.camera)
        depth = size / max(1.0, float(np.hypot(*half)))
        flat = middle + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        rays = np.column_stack([flat, np.ones(4)])
        return depth * rays @ self.pose[:3, :3].T + self.centre


def placed(result: Result) -> tuple[Placed, ...]:
    """The images that have a pose, in the order of the result."""
    by_folder = {camera.name: camera for camera in result.cameras}
    found = []
    for image in result.images:
        pose = image.base_T_camera if image.gripper_T_camera is None else image.gripper_T_camera
        if pose is not None:
            camera: Calibrated = by_folder.get(folder_of(image.name), result)
            found.append(Placed(image=image, camera=camera, pose=np.asarray(pose)))
    return tuple(found)


def _half_and_middle(camera: Calibrated) -> tuple[Array, Array]:
    """Half of the image and its middle at unit depth, each (2,), without distortion."""
    model = camera.camera
    if model is None or model.model not in MODELS:
        return _USUAL_HALF, np.zeros(2)
    lens, half = lens_of(model), 0.5 * np.array([model.width, model.height])
    return half / lens.focal, (half - lens.centre) / lens.focal
