"""Wrong robot poses and wrong tracks among right ones: which are found, and what they cost.

    python benchmarks/robustness.py [--images 10 15 20 40] [--draws 100]
                                    [--cases swapped stale unsettled] [--tracks scattered misled nearly]

Simulated calibrations with sigmas that the estimator does not know. A fifth of the rows is spoilt:

- swapped: rows hold each other's poses;
- stale: rows repeat the pose before;
- unsettled: poses off by 10 to 20 sigma in rotation and in translation.

A row counts as bad if its pose is off by more than 10 sigma, as good if it is as it was. Recall is the
part of the bad rows that are named, false alarms that of the good rows. The error of X (root mean square
over the draws, rotation and translation) is held against that of the calibration without the
spoilt images.

Of the tracks' observations a tenth or a fifth is wrong:

- scattered: anywhere in the image;
- misled: half of a track's images see another point, 10 to 50 mm away, and the model has the point half-way;
- nearly: the same with 0.3 to 3 mm, a few pixels.

NEES of X (6 degrees of freedom) and the estimated sigmas, in units of the true ones, say whether X and
its covariance are still right; 0.02 deg and 0.1 mm of robot noise, 12 images. Prints Markdown tables.
"""

import argparse
import time
from dataclasses import replace

import numpy as np

from handeye_fg import frames
from handeye_fg.graph import refine, start_state
from handeye_fg.options import GraphOptions, NoiseOptions
from handeye_fg.progress import silent
from handeye_fg.simulate import simulate_scene
from handeye_fg.simulate.wrong_tracks import astray, scattered
from handeye_fg.solvers import linear_start
from handeye_fg.types import Tracks

NOISE = {"0.01 deg, 0.05 mm": (np.deg2rad(0.01), 5e-5), "0.1 deg, 1 mm": (np.deg2rad(0.1), 1e-3)}
BAD_SIGMAS = 10.0


def swapped(_rng, poses, rows, _sigmas):
    """Pairs of rows exchanged; of an odd number, three go round."""
    order = list(rows)
    while order:
        group = order[: 3 if len(order) == 3 else 2]
        poses[group] = poses[np.roll(group, 1)]
        order = order[len(group) :]


def stale(_rng, poses, rows, _sigmas):
    """Rows that repeat the one before, as the controller had it."""
    before = poses.copy()
    for row in rows:
        poses[row] = before[row - 1]


def unsettled(rng, poses, rows, sigmas):
    """Poses that are off by 10 to 20 sigma in both parts."""
    for row in rows:
        parts = rng.standard_normal((2, 3))
        parts /= np.linalg.norm(parts, axis=1, keepdims=True)
        lengths = rng.uniform(BAD_SIGMAS, 2.0 * BAD_SIGMAS, 2) * sigmas
        poses[row] = poses[row] @ frames.exp((parts * lengths[:, None]).ravel())


CASES = {"swapped": swapped, "stale": stale, "unsettled": unsettled}


def calibrated(model, reported, camera):
    """The linear start and the refinement, as a calibration from images has them."""
    linear = linear_start(reported, model.world_T_camera)
    return refine(
        model,
        reported,
        start_state(model, [camera], linear),
        intrinsics=(),
        noise=NoiseOptions(),
        options=GraphOptions(),
        progress=silent,
        trusted=linear.trusted,
    )


def without(model, rows):
    """The model without some of its images, and without the points that are then seen once."""
    tracks = model.tracks
    kept = ~np.isin(tracks.image_index, rows)
    kept &= (np.bincount(tracks.point_index[kept], minlength=len(tracks.points_world)) >= 2)[
        tracks.point_index
    ]
    used, point_index = np.unique(tracks.point_index[kept], return_inverse=True)
    left = np.setdiff1d(np.arange(len(model.names)), rows)
    return replace(
        model,
        names=tuple(model.names[i] for i in left),
        world_T_camera=model.world_T_camera[left],
        image_camera=model.image_camera[left],
        tracks=Tracks(
            points_world=tracks.points_world[used],
            image_index=np.searchsorted(left, tracks.image_index[kept]),
            point_index=point_index,
            pixels=tracks.pixels[kept],
        ),
    )


def error(result, scene):
    """Radians and metres."""
    e = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    return np.linalg.norm(e[:3]), np.linalg.norm(e[3:])


def draw(case, n_images, sigmas, seed, part=0.2):
    """One calibration with spoilt rows, and one without their images."""
    rng = np.random.default_rng([seed, n_images])
    scene = simulate_scene(
        rng,
        n_images=n_images,
        n_points=300,
        robot_rotation_sigma=sigmas[0],
        robot_translation_sigma=sigmas[1],
        start_sigma=1e-4,
    )
    reported = scene.robot_poses.base_T_gripper
    rows = 1 + rng.choice(n_images - 1, max(1, int(part * n_images)), replace=False)
    poses = np.array(reported)
    CASES[case](rng, poses, rows, np.array(sigmas))
    off = frames.log(frames.inverse(reported) @ poses).reshape(-1, 2, 3)
    off = (np.linalg.norm(off, axis=2) / sigmas).max(axis=1)
    begin = time.perf_counter()
    result = calibrated(scene.model, poses, scene.camera)
    seconds = time.perf_counter() - begin
    begin = time.perf_counter()
    left = np.setdiff1d(np.arange(n_images), rows)
    clean = calibrated(without(scene.model, rows), reported[left], scene.camera)
    seconds /= time.perf_counter() - begin
    good = np.ones(n_images, dtype=bool)
    good[rows] = False
    bad = off > BAD_SIGMAS
    return {
        "named": np.count_nonzero(result.outliers & bad),
        "bad": np.count_nonzero(bad),
        "alarms": np.count_nonzero(result.outliers & good),
        "good": np.count_nonzero(good),
        "error": error(result, scene),
        "clean": error(clean, scene),
        "time": seconds,
    }


def table(cases, images, draws):
    """One row a case, number of images and noise."""
    print(
        "| case | images | robot noise | recall | false alarms | error, deg / mm | clean, deg / mm "
        "| ratio | time, ratio |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for case in cases:
        for n_images in images:
            for name, sigmas in NOISE.items():
                found = [draw(case, n_images, sigmas, seed) for seed in range(draws)]
                total = {key: np.sum([one[key] for one in found], axis=0) for key in found[0]}
                rms, clean = (
                    np.sqrt(np.mean([np.square(one[key]) for one in found], axis=0))
                    for key in ("error", "clean")
                )
                ratio = rms / clean
                print(
                    f"| {case} | {n_images} | {name} | {100 * total['named'] / total['bad']:.1f} % "
                    f"| {100 * total['alarms'] / total['good']:.2f} % "
                    f"| {np.rad2deg(rms[0]):.4f} / {1e3 * rms[1]:.3f} "
                    f"| {np.rad2deg(clean[0]):.4f} / {1e3 * clean[1]:.3f} "
                    f"| {ratio[0]:.2f} / {ratio[1]:.2f} "
                    f"| {np.median([one['time'] for one in found]):.2f} |",
                    flush=True,
                )


def misled(scene, rng, part):
    """Tracks that see another point."""
    return astray(scene, rng, part, (0.01, 0.05))


def nearly(scene, rng, part):
    """Tracks that see another point near by."""
    return astray(scene, rng, part, (3e-4, 3e-3))


TRACKS = {"scattered": scattered, "misled": misled, "nearly": nearly}


def track_draw(case, part, seed):
    """NEES, sigmas in units of the true ones, error in radians and metres, part of observations kept."""
    rng = np.random.default_rng(seed)
    sigmas = np.deg2rad(0.02), 1e-4
    scene = simulate_scene(
        rng,
        n_images=12,
        n_points=80,
        robot_rotation_sigma=sigmas[0],
        robot_translation_sigma=sigmas[1],
        start_sigma=1e-4,
    )
    model = replace(scene.model, tracks=TRACKS[case](scene, rng, part))
    result = calibrated(model, scene.robot_poses.base_T_gripper, scene.camera)
    e = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    noise = result.noise
    return [
        e @ np.linalg.solve(result.observability.covariance, e),
        noise.pixel / scene.noise.pixel,
        noise.robot_rotation / sigmas[0],
        noise.robot_translation / sigmas[1],
        e[:3] @ e[:3],
        e[3:] @ e[3:],
        len(result.tracks.pixels) / len(model.tracks.pixels),
    ]


def track_table(cases, draws):
    """One row a case and part."""
    print(
        "| case | wrong | NEES (6) | pixel, rotation, translation sigma | error, deg / mm | kept |\n"
        "|---|---|---|---|---|---|"
    )
    for case, part in [("scattered", 0.0), *((c, p) for c in cases for p in (0.1, 0.2))]:
        found = np.mean([track_draw(case, part, seed) for seed in range(draws)], axis=0)
        print(
            f"| {case if part else 'none'} | {100 * part:.0f} % | {found[0]:.1f} "
            f"| {found[1]:.2f}, {found[2]:.2f}, {found[3]:.2f} "
            f"| {np.rad2deg(np.sqrt(found[4])):.4f} / {1e3 * np.sqrt(found[5]):.3f} "
            f"| {100 * found[6]:.0f} % |",
            flush=True,
        )


def main():
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--images", nargs="*", type=int, default=[10, 15, 20, 40])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--tracks", nargs="*", default=list(TRACKS), choices=list(TRACKS))
    options = parser.parse_args()
    if options.cases:
        table(options.cases, options.images, options.draws)
        print()
    if options.tracks:
        track_table(options.tracks, options.draws)


if __name__ == "__main__":
    main()
