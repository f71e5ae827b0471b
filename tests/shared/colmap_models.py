"""Reconstructions made by COLMAP without images."""

import pycolmap

PARAMS = [800.0, 805.0, 511.5, 390.25, -0.06, 0.03, 4e-4, -3e-4]


def synthetic(n_images: int = 6, n_cameras: int = 1, n_points: int = 60) -> pycolmap.Reconstruction:
    """Exact observations of random points."""
    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs = n_cameras
    options.num_cameras_per_rig = 1
    options.num_frames_per_rig = n_images // n_cameras
    options.num_points3D = n_points
    options.camera_model_id = pycolmap.CameraModelId.OPENCV
    options.camera_width, options.camera_height = 1024, 768
    options.camera_params = PARAMS
    return pycolmap.synthesize_dataset(options)
