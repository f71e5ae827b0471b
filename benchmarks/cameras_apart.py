"""Two cameras on one arm that look at different things: joined through the robot alone.

    python benchmarks/cameras_apart.py SET

SET is a rendered set of two cameras (``images/cam0``, ``images/cam1``, ``truth.json``). Masks leave the first camera's images
one half of the desk and the second's the other, 80 mm apart, so that they share nothing; look-alikes on both sides may
still match. Prints a Markdown table: what is placed, and the error of X of each camera.
"""

import argparse
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
from bad_images import GAP_M, on_desk

import handeye_fg as hf
from handeye_fg import frames


def masks_of_halves(data, truth, folder):
    """White where the desk is on one side of its middle, for the second camera on the other."""
    base_T_gripper = np.array(truth["base_T_gripper"])
    X = gripper_T_cameras(truth)
    aims = on_desk(np.concatenate(base_T_gripper @ X[:, None]), np.array([[0.0, 0.0, 1.0]]))[:, 0]
    axis = int(np.argmax(np.var(aims[:, :2], axis=0)))
    for k, pose in enumerate(X):
        paths = sorted((data / "images" / f"cam{k}").iterdir())
        height, width = cv2.imread(str(paths[0])).shape[:2]
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2)
        seen = cv2.undistortPoints(
            pixels.astype(np.float64), np.array(truth["K"]), np.array(truth["dist"])
        )
        rays = np.insert(seen[:, 0], 2, 1.0, axis=1)
        (folder / f"cam{k}").mkdir(parents=True)
        for path, gripper in zip(paths, base_T_gripper, strict=True):
            beyond = on_desk((gripper @ pose)[None], rays)[0, :, axis] - np.median(aims[:, axis])
            white = (-beyond if k else beyond) > GAP_M
            mask = (255 * white).astype(np.uint8).reshape(height, width)
            cv2.imwrite(str(folder / f"cam{k}" / f"{path.name}.png"), mask)
    return folder


def gripper_T_cameras(truth):
    """X of each camera (2, 4, 4)."""
    found = truth["gripper_T_cameras"]
    return np.array([found[name] for name in sorted(found)] if isinstance(found, dict) else found)


def main():
    """Calibrate and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("--preset", default="fast")
    arguments = parser.parse_args()
    data = arguments.set
    truth = json.loads((data / "truth.json").read_text())
    with tempfile.TemporaryDirectory() as folder:
        result = hf.calibrate(
            data / "images",
            data / "poses.csv",
            data / "camera.yaml",
            masks_of_halves(data, truth, Path(folder) / "masks"),
            hf.Options(sfm=hf.SfmOptions(preset=arguments.preset)),
        )
    print(
        f"{result.message}\n\n| camera | images | error, deg / mm | NEES of 6 |\n|---|---|---|---|"
    )
    for camera, X in zip(result.cameras, gripper_T_cameras(truth), strict=True):
        error = frames.log(frames.inverse(camera.matrix) @ X)
        degrees, mm = np.rad2deg(np.linalg.norm(error[:3])), 1e3 * np.linalg.norm(error[3:])
        nees = error @ np.linalg.solve(camera.covariance, error)
        used = sum(
            image.registered and image.name.startswith(f"{camera.name}/") for image in result.images
        )
        print(f"| {camera.name} | {used} | {degrees:.4f} / {mm:.3f} | {nees:.1f} |")


if __name__ == "__main__":
    main()
