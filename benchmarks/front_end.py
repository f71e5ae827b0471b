"""Whole calibrations beside plain structure from motion, in wall time and in the error of X.

    python benchmarks/front_end.py beside SET [SET ...]
    python benchmarks/front_end.py growth SET [--sizes 20 40 60]
    python benchmarks/front_end.py presets SET [SET ...]

A SET is a folder with ``images/``, ``poses.csv``, ``camera.yaml`` and ``truth.json``, eye-in-hand. Prints
Markdown tables. Every run is a process of its own, with its own start and its imports in its time.
``beside``: plain SfM is pycolmap with its defaults (extraction, exhaustive matching, incremental mapping)
and nothing else; ours is everything, from the files to ``result.json``, with defaults, and with all
pairs matched. ``growth``: images spread evenly over the set; the exponent is that of the seconds
between the smallest and the largest size. ``presets``: X error against seconds.
"""

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np


def plain(data, _options, _size, work):
    """COLMAP's defaults."""
    import pycolmap  # noqa: PLC0415  # each process imports what it needs only

    pycolmap.logging.minloglevel = 2
    database, images = work / "database.db", data / "images"
    pycolmap.extract_features(database, images)
    pycolmap.match_exhaustive(database)
    models = pycolmap.incremental_mapping(database, images, work)
    best = max(models.values(), key=lambda model: model.num_reg_images())
    return {"placed": best.num_reg_images(), "observations": best.compute_num_observations()}


def calibrated(data, options, size, work):
    """A whole calibration."""
    import handeye_fg as hf  # noqa: PLC0415  # likewise
    from handeye_fg.io.poses import read_poses  # noqa: PLC0415  # likewise

    poses = read_poses(data / "poses.csv")
    chosen = np.unique(np.linspace(0, len(poses.names) - 1, size or len(poses.names)).astype(int))
    result = hf.calibrate(
        data / "images",
        {poses.names[i]: poses.base_T_gripper[i] for i in chosen},
        camera=data / "camera.yaml",
        options=hf.Options(sfm=hf.SfmOptions(**options)),
        output=work,
    )
    result.save(work)
    X = np.array(json.loads((data / "truth.json").read_text())["gripper_T_camera"])
    turned = X[:3, :3].T @ result.matrix[:3, :3]
    cosine = min(1.0, max(-1.0, 0.5 * (np.trace(turned) - 1.0)))
    return {
        "placed": result.sfm.n_registered,
        "observations": result.sfm.n_observations,
        "deg": math.degrees(math.acos(cosine)),
        "mm": 1e3 * float(np.linalg.norm(result.matrix[:3, 3] - X[:3, 3])),
    }


PROGRAMS = {"plain": plain, "calibrated": calibrated}


def measured(program, data, options=None, size=0):
    """Figures of a run in a process of its own, with its seconds of wall time and of computing."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as work:
        task = [program, str(data), json.dumps(options or {}), str(size), work]
        command = [sys.executable, __file__, "run", *task]
        output = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return json.loads(output.splitlines()[-1]) | {
        "wall": time.perf_counter() - begin,
        "cpu": after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime,
    }


def row(name, run, *more):
    """A line of a table."""
    error = f"{run['deg']:.4f} / {run['mm']:.3f}" if "deg" in run else ""
    cells = [
        name,
        str(run["placed"]),
        str(run["observations"]),
        error,
        f"{run['wall']:.0f}",
        f"{run['cpu']:.0f}",
        *more,
    ]
    print(f"| {' | '.join(cells)} |", flush=True)


def header(*more):
    """The head of a table."""
    cells = [
        "run",
        "images placed",
        "observations",
        "X, deg / mm",
        "wall, s",
        "computing, s",
        *more,
    ]
    print(f"| {' | '.join(cells)} |\n|{'---|' * len(cells)}")


def beside(sets):
    """Ours beside plain structure from motion, and beside ours with all pairs."""
    header("wall beside plain", "X error beside all pairs")
    for data in sets:
        reference = measured("plain", data)
        row(f"{data.name}, plain SfM", reference, "1", "")
        ours = measured("calibrated", data)
        everything = measured("calibrated", data, {"pairs": "all"})
        for name, run in (("whole calibration", ours), ("all pairs", everything)):
            row(
                f"{data.name}, {name}",
                run,
                f"{run['wall'] / reference['wall']:.2f}",
                f"{run['deg'] / everything['deg']:.2f} / {run['mm'] / everything['mm']:.2f}",
            )


def growth(data, sizes):
    """Seconds against the number of images."""
    header("wall grows as images to the power")
    runs = []
    for size in sizes:
        runs.append(measured("calibrated", data, size=size))
        power = ""
        if size > sizes[0]:
            ratio = runs[-1]["wall"] / runs[0]["wall"]
            power = f"{math.log(ratio) / math.log(size / sizes[0]):.2f}"
        row(f"{data.name}, {size} images", runs[-1], power)


def presets(sets):
    """X error against seconds."""
    header()
    for data in sets:
        for preset in ("fast", "normal", "thorough"):
            row(f"{data.name}, {preset}", measured("calibrated", data, {"preset": preset}))


def main():
    """Run what the command line names."""
    if sys.argv[1:2] == ["run"]:
        program, data, options, size, work = sys.argv[2:]
        done = PROGRAMS[program](Path(data), json.loads(options), int(size), Path(work))
        print("\n" + json.dumps(done))
        return
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("beside", "growth", "presets"))
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--sizes", nargs="+", type=int, default=[20, 40, 60])
    arguments = parser.parse_args()
    if arguments.what == "growth":
        growth(arguments.sets[0], arguments.sizes)
    else:
        {"beside": beside, "presets": presets}[arguments.what](arguments.sets)


if __name__ == "__main__":
    main()
