"""The joint refinement beside COLMAP's bundle adjustment (Ceres) of the same tracks.

    python benchmarks/refinement.py [--sizes 20x60000 100x140000 300x600000] [--runs 5]
                                    [--growth 100x35000 ...] [--largest 1000x2000000]

A size is images x observations, about. Prints Markdown tables. Every run is a process of its own, so
that its peak memory is its own; the two programs take turns, and medians count. Both start from the
same poses and points, 1 mrad and a thousandth of the distance off, with the intrinsics fixed, and end
at the same relative tolerance of the cost. The refinement is the whole of it: rejection of
mismatches, noise levels, X, scale and covariance; the adjustment is COLMAP's with its defaults, of
cameras and points. Building what the solver needs is included in both. The covariance's part is
one solution of the last linearised problem, and all that is made of it.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

TOLERANCE = 1e-7
N_PROBE = 500  # points that tell which part of the images sees a point
FIELDS = ("points_world", "image_index", "point_index", "pixels")


def write_scene(n_images, n_observations, path):
    """Simulate a scene of that size; its arrays go to a file."""
    from handeye_fg.simulate import simulate_scene  # noqa: PLC0415  # not for COLMAP's processes
    from handeye_fg.solvers import linear_start  # noqa: PLC0415  # likewise

    # Tracks become longer with more images: 6 observations a point with 20 images, 15 with 300.
    n_points = int(n_observations / (2.2 * n_images**0.34))
    probe = simulate_scene(np.random.default_rng(0), n_images=n_images, n_points=N_PROBE)
    seen = len(probe.model.tracks.pixels) / N_PROBE
    scene = simulate_scene(
        np.random.default_rng(0),
        n_images=n_images,
        n_points=n_points,
        visibility=min(1.0, n_observations / n_points / seen),
    )
    reported, model = scene.robot_poses.base_T_gripper, scene.model
    linear = linear_start(reported, model.world_T_camera)
    np.savez(
        path,
        base_T_gripper=reported,
        world_T_camera=model.world_T_camera,
        params=scene.camera.params,
        size=[scene.camera.width, scene.camera.height],
        X=linear.gripper_T_camera,
        Z=linear.base_T_world,
        log_scale=np.log(linear.metres_per_world_unit),
        **{field: getattr(model.tracks, field) for field in FIELDS},
    )


def ours(scene):
    """Refine; seconds, those of the covariance, and the iterations."""
    from handeye_fg.graph.noise import solve  # noqa: PLC0415  # likewise
    from handeye_fg.graph.refine import refine  # noqa: PLC0415  # likewise
    from handeye_fg.graph.variables import State  # noqa: PLC0415  # likewise
    from handeye_fg.options import GraphOptions, NoiseOptions  # noqa: PLC0415  # likewise
    from handeye_fg.progress import silent  # noqa: PLC0415  # likewise
    from handeye_fg.types import CameraModel, Rig, SfmModel, Tracks  # noqa: PLC0415  # likewise

    module = sys.modules["handeye_fg.graph.refine"]
    summarise, covariance = module.summarise, []

    def timed(model, tracks, scales, state, linearised, solution, *rest, **named):
        begin = time.perf_counter()
        solution = solve(linearised, solution.noise)
        result = summarise(model, tracks, scales, state, linearised, solution, *rest, **named)
        covariance.append(time.perf_counter() - begin)
        return result

    module.summarise = timed
    n = len(scene["world_T_camera"])
    width, height = scene["size"].tolist()
    model = SfmModel(
        names=tuple(f"{i:04d}" for i in range(n)),
        world_T_camera=scene["world_T_camera"],
        cameras=(CameraModel(model="OPENCV", width=width, height=height, params=scene["params"]),),
        image_camera=np.zeros(n, dtype=np.int64),
        tracks=Tracks(**{field: scene[field] for field in FIELDS}),
        mean_reprojection_px=1.0,
        unregistered=(),
    )
    start = State(
        world_T_camera=model.world_T_camera,
        points_world=model.tracks.points_world,
        gripper_T_cameras=scene["X"][None],
        base_T_world=scene["Z"],
        log_scale=float(scene["log_scale"]),
        cameras=(model.camera,),
        rig=Rig.of_one_camera(n),
    )
    begin = time.perf_counter()
    result = refine(
        model,
        scene["base_T_gripper"],
        start,
        intrinsics=(),
        noise=NoiseOptions(),
        options=GraphOptions(),
        progress=silent,
    )
    return time.perf_counter() - begin, covariance[0], result.iterations


def reconstruction(scene):
    """The scene as COLMAP has it."""
    import pycolmap  # noqa: PLC0415  # not for our processes

    result = pycolmap.Reconstruction()
    width, height = scene["size"].tolist()
    camera = pycolmap.Camera(
        camera_id=1, model="OPENCV", width=width, height=height, params=scene["params"]
    )
    result.add_camera_with_trivial_rig(camera)
    image_index, point_index = scene["image_index"], scene["point_index"]
    place = np.empty(len(image_index), dtype=int)
    for i, world_T_camera in enumerate(scene["world_T_camera"]):
        rows = np.flatnonzero(image_index == i)
        place[rows] = np.arange(len(rows))
        image = pycolmap.Image(
            name=f"{i:04d}", camera_id=1, image_id=i + 1, keypoints=scene["pixels"][rows]
        )
        pose = pycolmap.Rigid3d(np.linalg.inv(world_T_camera)[:3])
        result.add_image_with_trivial_frame(image, pose)
    order = np.argsort(point_index, kind="stable")
    starts = np.searchsorted(point_index[order], np.arange(len(scene["points_world"]) + 1))
    for j, point in enumerate(scene["points_world"]):
        track = pycolmap.Track()
        for row in order[starts[j] : starts[j + 1]].tolist():
            track.add_element(int(image_index[row]) + 1, int(place[row]))
        result.add_point3D(point, track)
    return result


def ceres(scene):
    """Adjust; seconds, no covariance, and the iterations."""
    import pycolmap  # noqa: PLC0415  # likewise

    adjusted = reconstruction(scene)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = False
    options.print_summary = False
    options.ceres.solver_options.function_tolerance = TOLERANCE
    config = pycolmap.BundleAdjustmentConfig()
    for image_id in adjusted.reg_image_ids():
        config.add_image(image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    begin = time.perf_counter()
    report = pycolmap.create_default_bundle_adjuster(options, config, adjusted).solve()
    seconds = time.perf_counter() - begin
    return seconds, 0.0, int(report.brief_report().split("Iterations: ")[1].split(",")[0])


PROGRAMS = {"ours": ours, "ceres": ceres}


def run(program, path):
    """One run in a process of its own: seconds, those of the covariance, iterations, peak MB."""
    command = [sys.executable, __file__, "--program", program, "--scene", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def one(program, path):
    """The child's part of ``run``."""
    with np.load(path) as file:
        scene = dict(file)
    figures = PROGRAMS[program](scene)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps([*figures, peak]))


def cells(*values):
    """One row of a table."""
    return f"| {' | '.join(str(value) for value in values)} |"


def size(text):
    """Images and observations."""
    n_images, n_observations = text.split("x")
    return int(n_images), int(n_observations)


def scene_of(wanted, folder):
    """A new scene's file, and how large it is in words."""
    path = folder / "scene.npz"
    subprocess.run([sys.executable, __file__, "--scene", str(path), "--write", wanted], check=True)
    with np.load(path) as file:
        count = [len(file[field]) for field in ("world_T_camera", "points_world", "pixels")]
    return path, count


def compare(sizes, runs, folder):
    """Both programs, in turns."""
    print(
        "| images | points | observations | ours, s | Ceres, s | ratio | covariance, part of ours "
        "| ours, MB | Ceres, MB | ratio | iterations |"
    )
    print(cells(*["---"] * 11))
    for wanted in sizes:
        path, count = scene_of(wanted, folder)
        results = [[run(program, path) for program in PROGRAMS] for _ in range(runs)]
        figures = np.median(results, axis=0)
        (our_time, covariance, our_steps, our_peak), (time_, _, steps, peak) = figures
        print(
            cells(
                *count,
                f"{our_time:.2f}",
                f"{time_:.2f}",
                f"{our_time / time_:.2f}",
                f"{covariance / our_time:.2f}",
                f"{our_peak:.0f}",
                f"{peak:.0f}",
                f"{our_peak / peak:.2f}",
                f"{our_steps:.0f}, {steps:.0f}",
            ),
            flush=True,
        )


def growth(sizes, runs, folder):
    """The refinement alone with more and more observations, and the exponent of its time."""
    print()
    print(cells("images", "points", "observations", "ours, s", "ours, MB"))
    print(cells(*["---"] * 5))
    logarithms = []
    for wanted in sizes:
        path, count = scene_of(wanted, folder)
        seconds, *_, peak = np.median([run("ours", path) for _ in range(runs)], axis=0)
        logarithms.append(np.log([count[-1], seconds]))
        print(cells(*count, f"{seconds:.2f}", f"{peak:.0f}"), flush=True)
    if len(sizes) > 1:
        exponent = np.polyfit(*np.transpose(logarithms), 1)[0]
        print(f"\nTime grows with the observations to the power {exponent:.2f}.")


def main():
    """Print the tables, or do one part."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--sizes", nargs="*", default=["20x60000", "100x140000", "300x600000"])
    parser.add_argument(
        "--growth", nargs="*", default=["100x140000", "100x280000", "100x560000", "100x1120000"]
    )
    parser.add_argument("--largest", nargs="*", default=["1000x2000000"])
    parser.add_argument("--runs", type=int, default=5)
    for hidden in ("--program", "--scene", "--write"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.program:
        one(options.program, Path(options.scene))
        return
    if options.write:
        write_scene(*size(options.write), Path(options.scene))
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if options.sizes:
            compare(options.sizes, options.runs, folder)
        if options.growth:
            growth(options.growth, options.runs, folder)
        if options.largest:
            growth(options.largest, 1, folder)


if __name__ == "__main__":
    main()
