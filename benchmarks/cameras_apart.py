"""Two cameras on one arm that look at different things: joined through the robot alone.

    python benchmarks/cameras_apart.py SET [SET ...] [--preset auto] [--seed 0] [--flip]

SET is a rendered set (``truth.json``) of two cameras (``images/cam0``, ``images/cam1``), or of one, whose images are divided
at random between two cameras that it is said to be. Masks leave the first camera's images one half of the desk and the
second's the other (``--flip``: the other way round), 80 mm apart, so that they share nothing; look-alikes on both sides may
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


def divided(data, seed, folder):
    """Images in the folders of two cameras, each with the row of its pose: those of the set, or links to them."""
    paths = sorted((data / "images").iterdir())
    if paths[0].is_dir():
        return data / "images", [list(enumerate(sorted(path.iterdir()))) for path in paths]
    order = np.random.default_rng(seed).permutation(len(paths))
    taken = []
    for k, rows in enumerate(np.array_split(order, 2)):
        inside = folder / "images" / f"cam{k}"
        inside.mkdir(parents=True)
        taken.append([(i, inside / paths[i].name) for i in np.sort(rows).tolist()])
        for i, path in taken[-1]:
            path.symlink_to(paths[i].resolve())
    return folder / "images", taken


def masks_of_halves(taken, truth, folder, *, flip):
    """White where the desk is on one side of its middle, for the second camera on the other."""
    X = gripper_T_cameras(truth)
    base_T_camera = [
        np.array([truth["base_T_gripper"][i] for i, _ in rows]) @ pose
        for rows, pose in zip(taken, X, strict=True)
    ]
    aims = on_desk(np.concatenate(base_T_camera), np.array([[0.0, 0.0, 1.0]]))[:, 0]
    axis = int(np.argmax(np.var(aims[:, :2], axis=0)))
    for k, rows in enumerate(taken):
        height, width = cv2.imread(str(rows[0][1])).shape[:2]
        pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2)
        seen = cv2.undistortPoints(
            pixels.astype(np.float64), np.array(truth["K"]), np.array(truth["dist"])
        )
        rays = np.insert(seen[:, 0], 2, 1.0, axis=1)
        (folder / f"cam{k}").mkdir(parents=True)
        for (_, path), pose in zip(rows, base_T_camera[k], strict=True):
            beyond = on_desk(pose[None], rays)[0, :, axis] - np.median(aims[:, axis])
            white = (beyond if k == flip else -beyond) > GAP_M
            mask = (255 * white).astype(np.uint8).reshape(height, width)
            cv2.imwrite(str(folder / f"cam{k}" / f"{path.name}.png"), mask)
    return folder


def gripper_T_cameras(truth):
    """X of each camera (2, 4, 4)."""
    found = truth.get("gripper_T_cameras")
    return np.array([found[k] for k in sorted(found)] if found else [truth["gripper_T_camera"]] * 2)


def main():
    """Calibrate and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--preset", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flip", action="store_true")
    arguments = parser.parse_args()
    print("| set | camera | images | error, deg / mm | NEES of 6 |\n|---|---|---|---|---|")
    for data in arguments.sets:
        truth = json.loads((data / "truth.json").read_text())
        with tempfile.TemporaryDirectory() as scratch:
            images, taken = divided(data, arguments.seed, Path(scratch))
            masks = masks_of_halves(taken, truth, Path(scratch) / "masks", flip=arguments.flip)
            options = hf.Options(sfm=hf.SfmOptions(preset=arguments.preset))
            result = hf.calibrate(images, data / "poses.csv", data / "camera.yaml", masks, options)
        for k, (camera, X) in enumerate(zip(result.cameras, gripper_T_cameras(truth), strict=True)):
            error = frames.log(frames.inverse(camera.matrix) @ X)
            degrees, mm = np.rad2deg(np.linalg.norm(error[:3])), 1e3 * np.linalg.norm(error[3:])
            nees = error @ np.linalg.solve(camera.covariance, error)
            used = sum(
                one.registered and one.name.startswith(f"{camera.name}/") for one in result.images
            )
            print(
                f"| {data.name} | {camera.name} | {used} of {len(taken[k])} "
                f"| {degrees:.4f} / {mm:.3f} | {nees:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
