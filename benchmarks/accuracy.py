"""Calibrate data sets and hold the answers against their truth or reference, and against each other.

    python benchmarks/accuracy.py SET [SET ...] [--no-camera] [--no-masks] [--target FILE|DIR] [--halves]
        [--output DIR]

A SET is a folder with ``images/``, ``poses.csv``, optionally ``camera.yaml`` and ``masks/``, and
``truth.json`` or ``reference.json`` (key ``gripper_T_camera``, or ``base_T_camera`` of a static camera:
eye-to-hand). Where the truth has
``gripper_T_cameras``, each camera has a row, and so has its pose in the first. ``--target`` gives a target file, or
a folder of them that are named like the sets. With ``--halves``, the even and the
odd images are calibrated separately as well: NEES of their difference has 6 degrees of freedom and
99.9 % limit 22.5. NEES against a reference (not a truth) says little: the reference has errors too.
Each half's X and the reference are then held against the other half's images, which neither half's X has
seen: how well A X = X B closes over all their pairs, with B from structure from motion of that half, in the
unit that suits each X best.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.io.images import list_cameras
from handeye_fg.io.poses import read_poses
from handeye_fg.motions import between
from handeye_fg.sfm import read_model


def difference(matrix, expected, covariance):
    """Degrees, millimetres and NEES between two poses."""
    error = frames.log(frames.inverse(matrix) @ expected)
    nees = float(error @ np.linalg.pinv(covariance, rcond=1e-9, hermitian=True) @ error)
    degrees = np.rad2deg(np.linalg.norm(error[:3]))
    return degrees, 1e3 * np.linalg.norm(matrix[:3, 3] - expected[:3, 3]), nees


def calibrated(folder, *, with_camera, with_masks, setup, output, target=None, every=slice(None)):
    """One calibration, of some of the images."""
    poses = read_poses(folder / "poses.csv")
    names = sorted({Path(name).name for name in list_cameras(folder / "images")})
    kept = set(names[every])
    mapping = {
        name: pose
        for name, pose in zip(poses.names, poses.base_T_gripper, strict=True)
        if name in kept
    }
    camera, masks = folder / "camera.yaml", folder / "masks"
    result = hf.calibrate(
        folder / "images",
        mapping,
        camera=camera if with_camera and camera.exists() else None,
        masks=masks if with_masks and masks.exists() else None,
        options=hf.Options(setup=setup),
        target=target,
        output=output,
    )
    result.save(output)
    return result


def line(name, result, seconds, expected):
    """One row of the table."""
    degrees, millimetres, nees = difference(result.matrix, expected, result.covariance)
    start = difference(result.initial.gripper_T_camera, expected, result.covariance)
    noise = result.noise
    std = np.sqrt(np.diag(result.covariance))
    return (
        f"| {name} | {result.sfm.n_registered}/{result.sfm.n_images} "
        f"| {start[0]:.4f} / {start[1]:.3f} | {degrees:.4f} / {millimetres:.3f} | {nees:.1f} "
        f"| {np.rad2deg(std[:3].max()):.4f} / {1e3 * std[3:].max():.3f} "
        f"| {noise.pixel:.2f} / {np.rad2deg(noise.robot_rotation):.3f} / "
        f"{1e3 * noise.robot_translation:.3f} | {'refined' if result.intrinsics_refined else 'kept'}"
        f" | {seconds:.0f} |"
    )


def camera_lines(name, result, expected):
    """A row for each of several cameras, and for its pose in the first."""
    first = expected[result.cameras[0].name]
    rows = []
    for camera in result.cameras:
        truth = expected[camera.name]
        rows.append((f"{name} {camera.name}", camera.matrix, truth, camera.covariance))
    for camera in result.cameras[1:]:
        truth = np.linalg.inv(first) @ expected[camera.name]
        label = f"{name} {result.cameras[0].name}_T_{camera.name}"
        rows.append((label, camera.first_T_camera, truth, camera.first_T_camera_covariance))
    for label, matrix, truth, covariance in rows:
        degrees, millimetres, nees = difference(matrix, truth, covariance)
        std = np.sqrt(np.diag(covariance))
        largest = f"{np.rad2deg(std[:3].max()):.4f} / {1e3 * std[3:].max():.3f}"
        yield f"| {label} | | | {degrees:.4f} / {millimetres:.3f} | {nees:.1f} | {largest} | | | |"


def closure(X, base_T_gripper, world_T_camera):
    """Root mean square of A X against X B over all pairs, degrees and millimetres."""
    i, j = np.triu_indices(len(base_T_gripper), 1)
    A = between(base_T_gripper, i, j)
    B = between(world_T_camera, i, j)
    turned = A[:, :3, :3] @ X[:3, :3] @ np.swapaxes(X[:3, :3] @ B[:, :3, :3], 1, 2)
    ours = A[:, :3, :3] @ X[:3, 3] + A[:, :3, 3] - X[:3, 3]
    theirs = B[:, :3, 3] @ X[:3, :3].T
    rest = ours - np.sum(ours * theirs) / np.sum(theirs**2) * theirs
    angles = Rotation.from_matrix(turned).magnitude()
    return np.rad2deg(np.sqrt(np.mean(angles**2))), 1e3 * np.sqrt(np.mean(np.sum(rest**2, axis=1)))


def closure_lines(folder, results, expected, output_of):
    """How well each half's X and the reference close on the images of the other half."""
    poses = read_poses(folder / "poses.csv")
    reported = dict(zip(poses.names, poses.base_T_gripper, strict=True))
    for part, other in (("even", "odd"), ("odd", "even")):
        model = read_model(output_of[other] / "sfm")
        gripper = np.array([reported[name] for name in model.names])
        ours = closure(results[part].matrix, gripper, model.world_T_camera)
        theirs = closure(expected, gripper, model.world_T_camera)
        yield (
            f"| {folder.name}, X of the {part} half on the {other} one: closes to {ours[0]:.3f} deg / "
            f"{ours[1]:.2f} mm, the reference to {theirs[0]:.3f} / {theirs[1]:.2f} | | | | | | | | |"
        )


def main():
    """Run the sets that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--no-camera", action="store_true")
    parser.add_argument("--no-masks", action="store_true")
    parser.add_argument("--target", type=Path)
    parser.add_argument("--halves", action="store_true")
    parser.add_argument("--output", type=Path, default=Path("out/accuracy"))
    arguments = parser.parse_args()
    print(
        "| set | registered | linear start, deg / mm | X, deg / mm | NEES (6) | largest std, deg / mm "
        "| noise found, px / deg / mm | intrinsics | s |\n|---|---|---|---|---|---|---|---|---|"
    )
    for folder in arguments.sets:
        source = next(folder / n for n in ("truth.json", "reference.json") if (folder / n).exists())
        truth = json.loads(source.read_text())
        static = "base_T_camera" in truth
        expected = np.array(truth["base_T_camera" if static else "gripper_T_camera"])
        of_cameras = {key: np.array(X) for key, X in truth.get("gripper_T_cameras", {}).items()}
        parts = {"all": slice(None)}
        if arguments.halves:
            parts |= {"even": slice(0, None, 2), "odd": slice(1, None, 2)}
        results, output_of = {}, {}
        for part, every in parts.items():
            name = f"{folder.name} {part}" + (", no camera file" if arguments.no_camera else "")
            name += ", no masks" if arguments.no_masks else ""
            target = arguments.target
            if target is not None:
                target = target / f"{folder.name}.yaml" if target.is_dir() else target
                name += ", target"
            output_of[part] = arguments.output / name.replace(" ", "_").replace(",", "")
            begin = time.perf_counter()
            results[part] = calibrated(
                folder,
                with_camera=not arguments.no_camera,
                with_masks=not arguments.no_masks,
                setup="eye-to-hand" if static else "eye-in-hand",
                target=target,
                output=output_of[part],
                every=every,
            )
            print(line(name, results[part], time.perf_counter() - begin, expected), flush=True)
            if results[part].cameras:
                print(*camera_lines(name, results[part], of_cameras), sep="\n", flush=True)
        if arguments.halves:
            even, odd = results["even"], results["odd"]
            degrees, millimetres, nees = difference(
                even.matrix, odd.matrix, even.covariance + odd.covariance
            )
            print(
                f"| {folder.name} even against odd | | | {degrees:.4f} / {millimetres:.3f} "
                f"| {nees:.1f} | | | | |",
                *closure_lines(folder, results, expected, output_of),
                sep="\n",
                flush=True,
            )


if __name__ == "__main__":
    main()
