"""Closed forms beside OpenCV's of the same name: time of one call, and errors with noise.

    python benchmarks/solvers.py [--sizes 20 100 300] [--draws 200 50 10] [--runs 9]

Prints a Markdown table. The call is the whole of it: ``solve(PosePairs(...))``, with validation and
pairing, beside ``calibrateHandEye`` or ``calibrateRobotWorldHandEye`` on the same matrices. Times are
medians of runs in which both take turns; errors are medians over draws of simulated poses with noise
(robot 0.06 deg and 0.5 mm an axis, camera 0.03 deg and 0.3 mm). Where OpenCV's Python module lacks
the functions, as that of 5.0.0 does, its columns stay empty.
"""

import argparse
import math
import time

import cv2
import numpy as np

from handeye_fg.frames import inverse, pose, scaled
from handeye_fg.motions import PosePairs
from handeye_fg.simulate import simulate_poses
from handeye_fg.solvers import METHODS

FLAGS = {
    "tsai_lenz": "HAND_EYE_TSAI",
    "park_martin": "HAND_EYE_PARK",
    "horaud_dornaika": "HAND_EYE_HORAUD",
    "andreff": "HAND_EYE_ANDREFF",
    "daniilidis": "HAND_EYE_DANIILIDIS",
    "shah": "ROBOT_WORLD_HAND_EYE_SHAH",
    "li": "ROBOT_WORLD_HAND_EYE_LI",
}


def draw(seed, n_poses):
    """Robot and camera poses with noise, metres, and X."""
    robot, camera, truth = simulate_poses(
        np.random.default_rng(seed),
        n_poses=n_poses,
        robot_rotation_sigma=1e-3,
        robot_translation_sigma=5e-4,
        camera_rotation_sigma=5e-4,
        camera_translation_sigma=3e-4,
    )
    return robot, scaled(camera, truth.metres_per_world_unit), truth.gripper_T_camera


def ours(method, robot, camera):
    """X by handeye_fg."""
    data = PosePairs(base_T_gripper=robot, world_T_camera=camera)
    return METHODS[method].solve(data).gripper_T_camera


def opencvs(method, robot, camera_T_world):
    """X by OpenCV, which takes the camera's poses inverted."""
    flag = getattr(cv2, f"CALIB_{FLAGS[method]}")
    R_B, t_B = camera_T_world[:, :3, :3], camera_T_world[:, :3, 3]
    if FLAGS[method].startswith("ROBOT"):
        gripper_T_base = inverse(robot)
        *_, R, t = cv2.calibrateRobotWorldHandEye(
            R_B, t_B, gripper_T_base[:, :3, :3], gripper_T_base[:, :3, 3], method=flag
        )
        return inverse(pose(R, t.ravel()))
    R, t = cv2.calibrateHandEye(robot[:, :3, :3], robot[:, :3, 3], R_B, t_B, method=flag)
    return pose(R, t.ravel())


def error(found, X):
    """Degrees and millimetres."""
    difference = found - X
    degrees = math.degrees(np.linalg.norm(difference[:3, :3]) / math.sqrt(2.0))
    return degrees, 1e3 * np.linalg.norm(difference[:3, 3])


def milliseconds(function, *arguments):
    """Time of one call."""
    start = time.perf_counter()
    function(*arguments)
    return 1e3 * (time.perf_counter() - start)


def line(method, n_poses, draws, runs):
    """One row of the table."""
    available = hasattr(cv2, "calibrateHandEye") and method in FLAGS
    robot, camera, _ = draw(0, n_poses)
    inverted = inverse(camera)
    # The first calls allocate and load.
    ours(method, robot, camera)
    times = []
    for _ in range(runs):
        one = milliseconds(ours, method, robot, camera)
        other = milliseconds(opencvs, method, robot, inverted) if available else math.nan
        times.append((one, other))
    our_time, their_time = np.median(times, axis=0)
    errors = []
    for seed in range(draws):
        robot, camera, X = draw(seed, n_poses)
        theirs = error(opencvs(method, robot, inverse(camera)), X) if available else (math.nan,) * 2
        errors.append((*error(ours(method, robot, camera), X), *theirs))
    degrees, millimetres, their_degrees, their_millimetres = np.median(errors, axis=0)
    cells = [method, str(n_poses), f"{our_time:.2f}"]
    if available:
        ratio = f"{their_time / our_time:.1f}"
        cells += [f"{their_time:.2f}", ratio, f"{degrees:.4f} / {millimetres:.3f}"]
        cells += [f"{their_degrees:.4f} / {their_millimetres:.3f}"]
    else:
        cells += ["", "", f"{degrees:.4f} / {millimetres:.3f}", ""]
    return f"| {' | '.join(cells)} |"


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--sizes", type=int, nargs="+", default=[20, 100, 300])
    parser.add_argument("--draws", type=int, nargs="+", default=[200, 50, 10])
    parser.add_argument("--runs", type=int, default=9)
    options = parser.parse_args()
    print(f"OpenCV {cv2.__version__}, draws {options.draws}")
    print()
    print("| method | poses | ours, ms | OpenCV, ms | ratio | ours, deg / mm | OpenCV, deg / mm |")
    print("|---|---|---|---|---|---|---|")
    for n_poses, draws in zip(options.sizes, options.draws, strict=True):
        for method in [*FLAGS, "andreff_scale"]:
            print(line(method, n_poses, draws, options.runs), flush=True)


if __name__ == "__main__":
    main()
