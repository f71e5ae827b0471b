"""A simulated scene as files, with its truth; entry point ``write_scene``."""

import json
import math
from pathlib import Path

import yaml

from handeye_fg import sfm
from handeye_fg.frames import quaternion_xyzw
from handeye_fg.io.files import write_atomic
from handeye_fg.simulate import Scene
from handeye_fg.types import CameraModel, RobotPoses


def write_scene(scene: Scene, folder: str | Path) -> Path:
    """Write what a calibration gets of a scene, and what it should find.

    ``model/`` (a COLMAP model with its tracks), ``poses.csv`` (the reported robot poses), ``camera.yaml`` and
    ``truth.json``: ``gripper_T_camera``, ``base_T_gripper`` by image, the scale and the noise.

    Args:
        scene: of ``handeye_fg.simulate``, with an OPENCV camera.
        folder: where; made if missing.

    Returns:
        The folder.

    Raises:
        InputDataError: the folder cannot be written.
        ValueError: the scene has another camera.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from tempfile import TemporaryDirectory
        >>> from handeye_fg.simulate import simulate_scene
        >>> scene = simulate_scene(np.random.default_rng(0), n_images=8, n_points=60)
        >>> with TemporaryDirectory() as folder:
        ...     path = hf.write_scene(scene, folder)
        ...     result = hf.refine(path / "model", path / "poses.csv")
        >>> result.status
        'ok'
    """
    folder = Path(folder)
    write_atomic(folder / "camera.yaml", _camera_file(scene.camera))
    sfm.write_model(scene.model, folder / "model")
    write_atomic(folder / "poses.csv", _poses_file(scene.robot_poses))
    write_atomic(folder / "truth.json", json.dumps(_truth(scene), indent=1) + "\n")
    return folder


def _poses_file(poses: RobotPoses) -> str:
    rows = [
        ",".join(
            [name, *map(repr, [*pose[:3, 3].tolist(), *quaternion_xyzw(pose[:3, :3]).tolist()])]
        )
        for name, pose in zip(poses.names, poses.base_T_gripper, strict=True)
    ]
    return "\n".join(["image,x,y,z,qx,qy,qz,qw", *rows]) + "\n"


def _camera_file(camera: CameraModel) -> str:
    if camera.model != "OPENCV":
        raise ValueError(f"the camera is {camera.model}, but must be OPENCV")
    fx, fy, cx, cy, *distortion = camera.params.tolist()
    # In the file the first pixel's centre is at (0, 0), in the scene at (0.5, 0.5).
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": {
            "rows": 3,
            "cols": 3,
            "data": [fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0],
        },
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 4, "data": distortion},
    }
    return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None))


def _truth(scene: Scene) -> dict[str, object]:
    return {
        "gripper_T_camera": scene.gripper_T_camera.tolist(),
        "base_T_world": scene.base_T_world.tolist(),
        "metres_per_world_unit": scene.metres_per_world_unit,
        "base_T_gripper": dict(zip(scene.model.names, scene.base_T_gripper.tolist(), strict=True)),
        "pixel_px": scene.noise.pixel,
        "rep_deg": math.degrees(scene.noise.robot_rotation),
        "rep_mm": 1e3 * scene.noise.robot_translation,
    }
