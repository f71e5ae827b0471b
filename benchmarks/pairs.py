"""Pairs of images chosen by the robot's poses beside all pairs: what it costs X on a hundred images.

    python benchmarks/pairs.py [--images 100] [--cameras 2] [--preset fast] [--seeds 0 1] [--output OUT]

Renders a desk of a square metre with boxes of several heights on it, from textures in ``data/tabletop``, as a camera on an arm
sees it that looks all over it (640x480, 2x supersampling, sensor noise of 2 grey levels), with robot noise of 0.01 deg and
0.05 mm an axis. With ``--cameras 2`` half of the images are of a second camera on the same arm, which looks the other way, at
a ceiling with boxes: the two share nothing. Each calibration is a whole one, from images to X. Prints a Markdown table, with
a row for each camera; the last column is how far X of the chosen pairs is from that of all, in standard deviations of the
latter (root mean square of the six).
"""

import argparse
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from handeye_fg import frames

TABLETOP = Path(__file__).parents[1] / "data" / "tabletop" / "images"
SIZE, FOCAL, FINER = np.array([640, 480]), 560.0, 2
DESK_M, BOX_M, TALLEST_M, BOXES = 0.5, (0.05, 0.12), 0.12, 14
# Where the camera aims (half the side), from how far, and how obliquely.
AIM_M, DISTANCE_M, TILT = 0.33, (0.35, 0.6), np.deg2rad(40.0)
ROTATION, TRANSLATION = np.deg2rad(0.01), 5e-5
GREY_LEVELS = 2.0
# The second camera looks at the ceiling where the first one looks at the desk.
OVER = frames.pose(Rotation.from_euler("X", np.pi).as_matrix(), [0.01, -0.03, 0.0])
X = frames.pose(
    Rotation.from_euler("ZYX", [150.0, 8.0, -12.0], degrees=True).as_matrix(), [-0.02, 0.05, 0.06]
) @ np.array([np.eye(4), OVER])
BASE_T_CEILING, LARGER = frames.pose(np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 1.4]), 2.5


def intrinsics(finer=1):
    """K with the centre of the first pixel at the origin."""
    centre = finer * SIZE / 2.0 - 0.5
    return np.array([[finer * FOCAL, 0.0, centre[0]], [0.0, finer * FOCAL, centre[1]], [0, 0, 1.0]])


def surfaces(rng, larger=1.0, *, mirrored=False):
    """(texture, corner x, y, height, metres per texture pixel) of level rectangles, the lowest first."""
    textures = [cv2.imread(str(path)) for path in sorted(TABLETOP.iterdir())]
    textures = [cv2.flip(texture, 1) for texture in textures] if mirrored else textures
    tiles, half = [], larger * DESK_M
    for k in range(4):  # the desk
        texture = textures[k][:960, :960]
        x, y = half * np.array([k % 2 - 1, k // 2 - 1])
        tiles.append((texture, x, y, 0.0, half / 960))
    for k in range(BOXES):
        side, height = larger * rng.uniform(*BOX_M), larger * rng.uniform(0.01, TALLEST_M)
        texture = textures[4 + k][200:600, 300:700]
        x, y = rng.uniform(-half, half - side, 2)
        tiles.append((texture, x, y, height, side / 400))
    return sorted(tiles, key=lambda tile: tile[3])


def rendered(tiles, base_T_camera, rng):
    """What the camera sees; the boxes have no sides."""
    camera_T_base = frames.inverse(base_T_camera)
    K, size = intrinsics(FINER), tuple((FINER * SIZE).tolist())
    image = np.full((size[1], size[0], 3), 90, np.uint8)
    for texture, x, y, height, unit in tiles:
        # Texture pixel (u, v) is at (x + unit (u + 1/2), y + unit (v + 1/2), height).
        base_T_texture = np.array(
            [[unit, 0.0, x + unit / 2], [0.0, unit, y + unit / 2], [0.0, 0.0, height], [0, 0, 1.0]]
        )
        H = K @ (camera_T_base @ base_T_texture)[:3]
        whole = np.full(texture.shape[:2], 255, np.uint8)
        covers = cv2.warpPerspective(whole, H, size, flags=cv2.INTER_NEAREST)
        seen = cv2.warpPerspective(texture, H, size, borderMode=cv2.BORDER_REPLICATE)
        image[covers > 0] = seen[covers > 0]
    small = cv2.resize(image, tuple(SIZE.tolist()), interpolation=cv2.INTER_AREA)
    noisy = small + rng.normal(0.0, GREY_LEVELS, small.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def cameras(n, rng):
    """base_T_camera (n, 4, 4) that look down at places all over the desk."""
    angles = np.column_stack(
        [
            rng.uniform(-np.pi, np.pi, n),
            TILT * np.sqrt(rng.uniform(0.0, 1.0, n)),
            rng.uniform(-np.pi, np.pi, n),
        ]
    )
    down = np.diag([1.0, -1.0, -1.0])
    R = Rotation.from_euler("ZYZ", angles).as_matrix() @ down
    aim = np.append(rng.uniform(-AIM_M, AIM_M, (n, 2)), np.full((n, 1), TALLEST_M / 2), axis=1)
    return frames.pose(R, aim - rng.uniform(*DISTANCE_M, n)[:, None] * R[:, :, 2])


def simulated(n, n_cameras, seed, folder):
    """Write the images; the reported poses by name."""
    rng = np.random.default_rng(seed)
    tiles = [surfaces(rng)]
    base_T_camera = cameras(n // n_cameras, rng)
    noise = rng.normal(size=(len(base_T_camera), 6)) * np.repeat([ROTATION, TRANSLATION], 3)
    reported = base_T_camera @ frames.inverse(X[0]) @ frames.exp(noise)
    seen = [base_T_camera]
    if n_cameras == 2:
        tiles.append(surfaces(rng, LARGER, mirrored=True))
        seen.append(frames.inverse(BASE_T_CEILING) @ base_T_camera @ OVER)
    names = [f"{i:04d}.jpg" for i in range(len(base_T_camera))]
    for k, poses in enumerate(seen):
        inside = folder / f"cam{k}" if n_cameras == 2 else folder
        inside.mkdir(parents=True, exist_ok=True)
        for name, pose in zip(names, poses, strict=True):
            image = rendered(tiles[k], pose, rng)
            cv2.imwrite(str(inside / name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return dict(zip(names, reported, strict=True))


def calibrated(images, poses, pairs, preset, out):
    """The result, the number of pairs that were matched, and the seconds of computing."""
    centre = SIZE / 2.0
    camera = hf.CameraModel(
        model="PINHOLE", width=640, height=480, params=np.array([FOCAL, FOCAL, *centre])
    )
    begin = time.process_time()
    options = hf.Options(sfm=hf.SfmOptions(pairs=pairs, preset=preset))
    result = hf.calibrate(images, poses, camera, options=options, output=out)
    with pycolmap.Database.open(out / "sfm" / "database.db") as db:
        n_pairs = db.num_matched_image_pairs()
    return result, n_pairs, time.process_time() - begin


def found_by(result):
    """X and its covariance, of each camera."""
    return [(one.matrix, one.covariance) for one in result.cameras or [result]]


def main():
    """Render and calibrate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=100)
    parser.add_argument("--cameras", type=int, choices=[1, 2], default=1)
    parser.add_argument("--preset", default="fast")
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--output", type=Path)
    arguments = parser.parse_args()
    cells = [
        "seed",
        "pairs",
        "matched",
        "images placed",
        "observations",
        "X, deg / mm",
        "NEES of 6",
    ]
    cells += ["computing, s", "from X of all pairs, sigma"]
    print(f"| {' | '.join(cells)} |\n|{'---|' * len(cells)}")
    for seed in arguments.seeds:
        with tempfile.TemporaryDirectory() as scratch:
            out = (arguments.output or Path(scratch)) / str(seed)
            poses = simulated(arguments.images, arguments.cameras, seed, out / "images")
            found = {}
            for pairs in ("robot", "all"):
                try:
                    found[pairs] = calibrated(
                        out / "images", poses, pairs, arguments.preset, out / pairs
                    )
                except hf.HandEyeError as error:
                    print(f"| {seed} | {pairs} | refused: {error} |{' |' * (len(cells) - 3)}")
        reference = found_by(found["all"][0]) if "all" in found else None
        for pairs, (result, n_pairs, seconds) in found.items():
            for k, (X_k, covariance) in enumerate(found_by(result)):
                error = frames.log(frames.inverse(X_k) @ X[k])
                degrees, mm = np.rad2deg(np.linalg.norm(error[:3])), 1e3 * np.linalg.norm(error[3:])
                nees = error @ np.linalg.solve(covariance, error)
                row = [seed, pairs, n_pairs, f"{result.sfm.n_registered} of {arguments.images}"]
                row += [result.sfm.n_observations, f"{degrees:.4f} / {mm:.3f}", f"{nees:.1f}"]
                row += [f"{seconds:.0f}", apart(X_k, reference and reference[k])]
                print(f"| {' | '.join(map(str, row))} |", flush=True)


def apart(matrix, reference):
    """How far an X is from another one, in the other's standard deviations; empty without the other."""
    if reference is None:
        return ""
    other, covariance = reference
    difference = frames.log(frames.inverse(other) @ matrix)
    return f"{np.sqrt(difference @ np.linalg.solve(covariance, difference) / 6.0):.2f}"


if __name__ == "__main__":
    main()
