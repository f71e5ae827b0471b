"""A batch of 50 small data sets, 3 of them broken: throughput, equality, kill and resume, a cluster.

    python benchmarks/batch.py [PART ...] [--sets 50] [--source data/tabletop] [--output DIR]

Each data set has 8 of the images of the source, reduced to 480x360, with its poses and camera file; of three, one has
a garbled poses file, one has no images, and the images of one show noise. Every calibration uses one thread. Parts,
all by default:

- ``throughput``: with one worker, then with two; the processor's time; peak memory of all processes together, of the first fifth of
  the batch and of the whole of it;
- ``single``: each result of the two workers against the same calibration by itself (``hf.calibrate``);
- ``resume``: two workers, killed (SIGKILL) once a third is done, then begun again;
- ``cluster``: the same by a Dask scheduler with two workers, processes of their own on loopback; it and its client
  are killed in the middle as well.
"""

import argparse
import json
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import cv2
import numpy as np
import psutil
import yaml

import handeye_fg as hf
from handeye_fg.io.images import list_cameras

WIDTH, HEIGHT, IMAGES = 480, 360, 8
PARTS = ("throughput", "single", "resume", "cluster")
CONFIG = "[sfm]\nthreads = 1\n"


def make_sets(source, folder, n_sets):
    """The data sets, as folders; the names of the broken ones."""
    if folder.exists():
        shutil.rmtree(folder)
    names = list_cameras(source / "images")
    reduced = {}
    for name in names:
        image = cv2.imread(str(source / "images" / name))
        scale = WIDTH / image.shape[1]
        reduced[name] = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    camera = yaml.safe_load((source / "camera.yaml").read_text().split("\n", 1)[1])
    fx, _, cx, _, fy, cy, *_ = camera["camera_matrix"]["data"]
    camera["camera_matrix"]["data"] = [
        *(fx * scale, 0.0, (cx + 0.5) * scale - 0.5),
        *(0.0, fy * scale, (cy + 0.5) * scale - 0.5),
        *(0.0, 0.0, 1.0),
    ]
    camera |= {"image_width": WIDTH, "image_height": HEIGHT}
    header, *rows = (source / "poses.csv").read_text().strip().split("\n")
    row_of = {row.split(",")[0]: row for row in rows}
    rng = np.random.default_rng(0)
    broken = {3 * n_sets // 10: "poses", 5 * n_sets // 10: "missing", 8 * n_sets // 10: "noise"}
    for k in range(n_sets):
        images = folder / f"set_{k:03d}" / "images"
        images.mkdir(parents=True)
        chosen = sorted(rng.choice(names, IMAGES, replace=False))
        for name in chosen:
            image = reduced[name]
            if broken.get(k) == "noise":
                image = rng.integers(0, 256, image.shape, dtype=np.uint8)
            cv2.imwrite(str(images / name), image, [cv2.IMWRITE_JPEG_QUALITY, 95])
        text = "\n".join([header, *(row_of[name] for name in chosen)])
        if broken.get(k) == "poses":
            text += "?"
        if broken.get(k) == "missing":
            shutil.rmtree(images)
        (images.parent / "poses.csv").write_text(text + "\n")
        (images.parent / "camera.yaml").write_text(yaml.safe_dump(camera))
    return [f"set_{k:03d}" for k in broken]


def require(condition, what):
    """Stop where something is not as it must be."""
    if not condition:
        sys.exit(what)


def program(sets, output, *arguments):
    """The batch as users start it."""
    config = sets.parent / "run.toml"
    config.write_text(CONFIG)
    return subprocess.Popen(
        [
            *(sys.executable, "-m", "handeye_fg", "batch", str(sets), "--output", str(output)),
            *("--config", str(config), "--quiet", *arguments),
        ],
        stderr=subprocess.DEVNULL,
    )


def finished(output):
    """Contents of the records of the data sets that are calibrated, and their times."""
    found = {}
    for path in output.glob("*/batch.json"):
        record = json.loads(path.read_text())
        if record["status"] != "failed":
            found[path.parent.name] = (record, path.stat().st_mtime_ns)
    return found


class Memory(threading.Thread):
    """Samples of the memory of a process and of all under it, MB, beside the number of records."""

    def __init__(self, process, output):
        super().__init__(daemon=True)
        self.process, self.output, self.samples = psutil.Process(process.pid), output, []

    def run(self):
        """Until the process ends."""
        while self.process.is_running() and self.process.status() != psutil.STATUS_ZOMBIE:
            total = 0
            try:
                for one in (self.process, *self.process.children(recursive=True)):
                    total += one.memory_info().rss
            except psutil.NoSuchProcess:
                continue
            done = len(list(self.output.glob("*/batch.json")))
            self.samples.append((done, total / 1e6))
            time.sleep(0.2)

    def peak(self, until):
        """The largest, while no more than so many were done."""
        return max(memory for done, memory in self.samples if done <= until)


def throughput(sets, output, n_sets, broken):
    """One worker against two."""
    print(
        "| workers | s | CPU s | data sets a minute | peak memory of the first fifth, MB | of all, MB |\n"
        "|---|---|---|---|---|---|"
    )
    seconds = {}
    for jobs in (1, 2):
        folder = output / f"jobs{jobs}"
        shutil.rmtree(folder, ignore_errors=True)
        begin, before = time.perf_counter(), processor_seconds()
        process = program(sets, folder, "--jobs", str(jobs))
        memory = Memory(process, folder)
        memory.start()
        code = process.wait()
        seconds[jobs] = time.perf_counter() - begin
        print(
            f"| {jobs} | {seconds[jobs]:.0f} | {processor_seconds() - before:.0f} | {60 * n_sets / seconds[jobs]:.1f} "
            f"| {memory.peak(n_sets // 5):.0f} | {memory.peak(n_sets):.0f} |"
        )
        require(code == 1, f"the exit code is {code}")
        check_failures(folder, n_sets, broken)
    print(f"\nTwo workers do {seconds[1] / seconds[2]:.2f} x as much as one.")


def processor_seconds():
    """Of all processes that have ended under this one."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def check_failures(output, n_sets, broken):
    """All are calibrated but the broken ones, which say why."""
    done = finished(output)
    wanted = {f"set_{k:03d}" for k in range(n_sets)} - set(broken)
    require(set(done) == wanted, f"calibrated otherwise: {sorted(wanted ^ set(done))}")


def tell_failures(output, broken):
    """What the broken ones say."""
    for name in broken:
        message = json.loads((output / name / "batch.json").read_text())["message"]
        print(f"- {name}: {message}")


def single(sets, output, n_sets, broken):
    """Each result against the same calibration by itself."""
    options = hf.Options(sfm=hf.SfmOptions(threads=1))
    equal, largest = 0, 0.0
    for folder in sorted(sets.iterdir()):
        if folder.name in broken:
            continue
        alone = hf.calibrate(
            folder / "images",
            folder / "poses.csv",
            camera=folder / "camera.yaml",
            options=options,
        )
        result = hf.load_result(output / "jobs2" / folder.name)
        same = np.array_equal(alone.matrix, result.matrix)
        same &= np.array_equal(alone.covariance, result.covariance)
        equal += same
        largest = max(largest, np.abs(alone.matrix - result.matrix).max())
    print(
        f"{equal} of {n_sets - len(broken)} results equal those of single runs to the last bit "
        f"(largest difference of an entry of X: {largest:.1g})."
    )
    tell_failures(output / "jobs2", broken)


def killed(process, output, n_sets):
    """Kill the batch once a third is done; the records at that time."""
    while len(finished(output)) < n_sets // 3:
        time.sleep(0.05)
    process.kill()
    process.wait()
    return finished(output)


def check_resumed(before, output, n_sets, broken):
    """Nothing was lost, nothing was done twice."""
    after = finished(output)
    twice = [name for name, record in before.items() if after.get(name) != record]
    check_failures(output, n_sets, broken)
    print(
        f"{len(before)} were done when it was killed, {len(after)} in the end; lost: "
        f"{len(set(before) - set(after))}, done twice: {len(twice)}."
    )
    require(not twice, f"done twice: {twice}")


def resume(sets, output, n_sets, broken):
    """Kill and begin again."""
    folder = output / "resumed"
    shutil.rmtree(folder, ignore_errors=True)
    before = killed(program(sets, folder, "--jobs", "2"), folder, n_sets)
    require(program(sets, folder, "--jobs", "2").wait() == 1, "the exit code is not 1")
    check_resumed(before, folder, n_sets, broken)


def cluster(sets, output, n_sets, broken):
    """By a scheduler and workers in processes of their own."""
    folder, file = output / "cluster", output / "scheduler.json"
    shutil.rmtree(folder, ignore_errors=True)
    file.unlink(missing_ok=True)
    where = ("--host", "127.0.0.1", "--no-dashboard")
    dask = [sys.executable, "-m", "dask"]
    started = [
        subprocess.Popen(
            [*dask, "scheduler", "--port", "0", "--scheduler-file", str(file), *where],
            stderr=subprocess.DEVNULL,
        )
    ]
    try:
        while not file.exists():
            time.sleep(0.1)
        worker = [*dask, "worker", "--scheduler-file", str(file), *where, "--nthreads", "1"]
        worker += ["--local-directory", str(output / "dask")]
        started += [subprocess.Popen(worker, stderr=subprocess.DEVNULL) for _ in range(2)]
        address = ("--scheduler", json.loads(file.read_text())["address"])
        begin = time.perf_counter()
        before = killed(program(sets, folder, *address), folder, n_sets)
        require(program(sets, folder, *address).wait() == 1, "the exit code is not 1")
        seconds = time.perf_counter() - begin
        check_resumed(before, folder, n_sets, broken)
        equal = sum(
            np.array_equal(
                hf.load_result(folder / name).matrix,
                hf.load_result(output / "jobs2" / name).matrix,
            )
            for name in finished(folder)
        )
        print(f"{seconds:.0f} s with both runs; {equal} equal the results of the local batch.")
    finally:
        for process in reversed(started):
            process.send_signal(signal.SIGTERM)
            process.wait()


def main():
    """Make the data sets and run the parts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--sets", type=int, default=50)
    parser.add_argument("--source", type=Path, default=Path("data/tabletop"))
    parser.add_argument("--output", type=Path, default=Path("out/batch"))
    arguments = parser.parse_args()
    sets = arguments.output / "sets"
    broken = make_sets(arguments.source, sets, arguments.sets)
    for part in arguments.parts or PARTS:
        print(f"\n{part}\n")
        globals()[part](sets, arguments.output, arguments.sets, broken)


if __name__ == "__main__":
    main()
