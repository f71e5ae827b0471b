"""Images that are bad, fingers in view, and halves that share nothing: what is left out, and X.

    python benchmarks/bad_images.py SET FOREIGN_IMAGE [--cases CASE ...]

SET is a rendered set of an eye-in-hand camera (``truth.json``), taken at half its size. Each case spoils it:

- clean: nothing;
- truncated, repeated (the image before once more), blurred (5 px), shaken (25 px), soft (1 px), dark,
  foreign (FOREIGN_IMAGE): one image;
- all: one image of each kind;
- fingers: two textured fingers in every image, in changing light, that shake by 0.4 px;
- halves: even images show one half of the scene, odd ones the other (masks), 80 mm apart;
- half: the even images of these alone.

Prints a Markdown table: images used, those left out with the first words of the reason, and the error of X.
"""

import argparse
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.types import CameraModel

# Half of what lies between the halves, and how high the scene is on average.
GAP_M, DESK_M = 0.04, 0.03


def blur(image, sigma):
    """Out of focus, by a standard deviation in pixels."""
    return cv2.GaussianBlur(image, (0, 0), sigma)


def truncated(path, _image, _before):
    """The first third of a file."""
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 3])


def repeated(path, _image, before):
    """The image before once more, as a stalled camera delivers it."""
    path.write_bytes(before.read_bytes())


def changed(change):
    """A change of the pixels."""
    return lambda path, image, _before: cv2.imwrite(str(path), change(image))


def dark(image):
    """Three per cent of the light, and noise."""
    noise = np.random.default_rng(0).normal(0.0, 1.5, image.shape)
    return np.clip(0.03 * image + noise, 0, 255).astype(np.uint8)


# What is done to which image.
SPOIL = {
    "truncated": (2, truncated),
    "blurred": (4, changed(lambda image: blur(image, 5.0))),
    "dark": (6, changed(dark)),
    "repeated": (9, repeated),
    "shaken": (10, changed(lambda image: cv2.blur(image, (25, 1)))),
    "foreign": (12, changed(lambda image: image)),
    "soft": (14, changed(lambda image: blur(image, 1.0))),
}


def fingers(paths):
    """Paint two fingers that move with the camera."""
    rng = np.random.default_rng(0)
    height, width = cv2.imread(str(paths[0])).shape[:2]
    outline = np.zeros((height, width), np.uint8)
    for polygon in (
        [(0.1, 1.0), (0.17, 0.5), (0.3, 0.5), (0.34, 1.0)],
        [(0.67, 1.0), (0.7, 0.5), (0.83, 0.5), (0.94, 1.0)],
    ):
        cv2.fillPoly(outline, [(np.array(polygon) * [width, height]).astype(int)], 255)
    coarse = rng.integers(0, 256, (height // 5, width // 5, 3)).astype(np.float32)
    texture = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for path in paths:
        across = np.sin(np.linspace(0.0, 4.0, width) + rng.uniform(0.0, 6.0))
        light = (rng.uniform(0.7, 1.1) * (1.0 + 0.3 * across))[None, :, None]
        shake = np.column_stack([np.eye(2), rng.normal(0.0, 0.4, 2)])
        layers = [
            cv2.warpAffine(layer, shake, (width, height))
            for layer in (texture * light, blur(outline, 0.7).astype(np.float32) / 255.0)
        ]
        share = layers[1][..., None]
        image = cv2.imread(str(path)) * (1.0 - share) + layers[0] * share
        cv2.imwrite(str(path), np.clip(image, 0, 255).astype(np.uint8))


def half_masks(paths, folder, truth):
    """White where the desk is on one side of its middle, for odd images on the other."""
    folder.mkdir()
    height, width = cv2.imread(str(paths[0])).shape[:2]
    base_T_camera = np.array(truth["base_T_gripper"]) @ np.array(truth["gripper_T_camera"])
    on_axis = on_desk(base_T_camera, np.array([[0.0, 0.0, 1.0]]))[:, 0]
    axis = int(np.argmax(np.var(base_T_camera[:, :2, 3], axis=0)))
    middle = np.median(on_axis[:, axis])
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(
        pixels.astype(np.float64), halved(truth["K"]), np.array(truth["dist"])
    )
    rays = np.insert(rays[:, 0], 2, 1.0, axis=1)
    for i, path in enumerate(paths):
        beyond = on_desk(base_T_camera[i : i + 1], rays)[0, :, axis] - middle
        white = (-beyond if i % 2 else beyond) > GAP_M
        mask = (255 * white).astype(np.uint8).reshape(height, width)
        cv2.imwrite(str(folder / f"{path.name}.png"), mask)
    return folder


def on_desk(base_T_camera, rays):
    """Where rays (k, 3) of cameras (n, 4, 4) meet the desk, (n, k, 3)."""
    turned = np.einsum("nij,kj->nki", base_T_camera[:, :3, :3], rays)
    centre = base_T_camera[:, None, :3, 3]
    return centre + turned * (DESK_M - centre[..., 2:]) / turned[..., 2:]


def halved(K):
    """Intrinsics at half the size, centres of pixels at integers."""
    K = np.array(K)
    K[:2] *= 0.5
    K[:2, 2] -= 0.25
    return K


def copied(data, folder):
    """The images of a set at half their size."""
    folder.mkdir(parents=True)
    for path in sorted((data / "images").iterdir()):
        image = cv2.imread(str(path))
        small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(folder / path.name), small, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return sorted(folder.iterdir())


def spoilt(case, paths, foreign_image):
    """Spoil images for a case."""
    for kind, (number, spoil) in SPOIL.items():
        if case in (kind, "all"):
            path = paths[number]
            image = cv2.imread(str(path))
            if kind == "foreign":
                image = cv2.resize(cv2.imread(str(foreign_image)), image.shape[1::-1])
            spoil(path, image, paths[number - 1])


def row(case, data, foreign_image, folder):
    """Calibrate one case; its row of the table."""
    paths = copied(data, folder / "images")
    truth = json.loads((data / "truth.json").read_text())
    spoilt(case, paths, foreign_image)
    masks = None
    if case == "fingers":
        fingers(paths)
    if case in ("halves", "half"):
        masks = half_masks(paths, folder / "masks", truth)
    if case == "half":
        for path in paths[1::2]:
            path.unlink()
    height, width = cv2.imread(str(paths[0])).shape[:2]
    K = halved(truth["K"])
    camera = CameraModel(
        model="OPENCV",
        width=width,
        height=height,
        params=np.array([K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5, *truth["dist"][:4]]),
    )
    result = hf.calibrate(
        folder / "images", data / "poses.csv", camera, masks, output=folder / "out"
    )
    error = frames.log(frames.inverse(result.matrix) @ np.array(truth["gripper_T_camera"]))
    degrees, mm = np.rad2deg(np.linalg.norm(error[:3])), 1e3 * np.linalg.norm(error[3:])
    nees = float(error @ np.linalg.solve(result.covariance, error))
    left_out = "; ".join(
        f"{Path(image.name).stem[-2:]}: {image.reason.split(' (')[0].split(':')[0]}"
        for image in result.images
        if not image.registered and image.reason != "no image has this name"
    )
    used = f"{result.sfm.n_registered} of {result.sfm.n_images}"
    return f"| {case} | {used} | {left_out} | {degrees:.4f} / {mm:.3f} | {nees:.1f} |"


def main():
    """Run the cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", type=Path)
    parser.add_argument("foreign", type=Path)
    every = ["clean", *SPOIL, "all", "fingers", "halves", "half"]
    parser.add_argument("--cases", nargs="+", choices=every, default=every)
    arguments = parser.parse_args()
    print("| case | images | left out | error, deg / mm | NEES of 6 |\n|---|---|---|---|---|")
    for case in arguments.cases:
        with tempfile.TemporaryDirectory() as folder:
            print(row(case, arguments.set, arguments.foreign, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
