"""Robot poses in every format and convention, right and wrong, against reconstructions made once.

    python benchmarks/conventions.py SET=SFM [SET=SFM ...] [--commands]

A SET is a folder with ``poses.csv`` and ``truth.json`` or ``reference.json``; SFM is the folder ``sfm/`` of a
calibration of it. The poses are

- written in every format and read back, once with the format recognised and once with it named, and calibrated with the
  reconstruction: right if X is that of the set's own poses to a fifth of its standard deviation (the optimiser
  stops within a tenth of one). Where the format is not recognised, the refusal must name it among its choices;
- written in every format with the other unit, with inverse poses and with both, and read back: right if the poses are the
  same to 1e-9;
- spoilt in every way of ``handeye_fg.simulate.careless``: named if the verdict is wrong with the right
  diagnosis first, refused if it is wrong with another or none; passed if the poses are taken for right. Then X is
  estimated, and counts as wrong where it is 1 degree or 10 mm from X of the right poses and complete;
- written with one convention and read with another, from the numbers of a file (angles in the other unit, axes in
  another order, rotation vectors for angles), in the same way.

With ``--commands`` the spoilt files, and the right one, go through ``handeye-fg calibrate --model`` as well, each in a process of
its own: its exit code counts.

Prints Markdown tables.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

import handeye_fg as hf
from handeye_fg import frames
from handeye_fg.conventions import Verdict, file_readings, judge
from handeye_fg.io.poses import FORMATS, Convention, open_poses, read_poses, write_poses
from handeye_fg.io.poses.convention import from_poses
from handeye_fg.sfm import read_model
from handeye_fg.simulate.careless import WAYS
from handeye_fg.types import RobotPoses

# How angles are written, how they are read, and the diagnosis.
MISREAD = {
    "degrees as radians": (("ZYX", "deg"), ("ZYX", "rad"), "angles-deg"),
    "radians as degrees": (("ZYX", "rad"), ("ZYX", "deg"), "angles-rad"),
    "Fanuc as KUKA": (("xyz", "deg"), ("ZYX", "deg"), "rotation-xyz"),
    "Kawasaki as KUKA": (("ZYZ", "deg"), ("ZYX", "deg"), "rotation-ZYZ"),
    "rotation vector as angles": (
        ("rotation-vector", "deg"),
        ("xyz", "deg"),
        "rotation-rotation-vector",
    ),
    "angles as rotation vector": (("xyz", "deg"), ("rotation-vector", "deg"), "rotation-xyz"),
}
# Formats that are more than one kind of file.
SUFFIXES = {"ros": (".yaml", ".csv"), "matrix": (".txt", ".npy", ".json")}
SAME_X, SAME_POSES = 0.2, 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Spoilt:
    """Wrong poses.

    Attributes:
        way: what was done to them.
        path: the file that has them.
        options: how it is read.
        expected: the diagnosis.
    """

    way: str
    path: Path
    options: hf.PoseFileOptions
    expected: str


def write_angles(poses: RobotPoses, path: Path, rotation: str, angles: str) -> None:
    """A file of positions in metres and three angles, whose header does not say which."""
    numbers = from_poses(poses.base_T_gripper, Convention(rotation=rotation, angles=angles))
    rows = [
        ",".join([name, *(f"{number:.9f}" for number in (*position, *turns))])
        for name, position, turns in zip(poses.names, *numbers, strict=True)
    ]
    path.write_text("\n".join(["image,X,Y,Z,A,B,C", *rows]), encoding="utf-8")


def named(verdict: Verdict, expected: str) -> bool:
    """Whether the diagnosis is the expected one."""
    found = "parts" if verdict.parts is not None else verdict.convention
    found = found.replace("rotation-wxyz", "wxyz")  # the file tells it as well as the matrices
    return verdict.kind == "wrong" and (
        found.startswith(expected) if expected.endswith("-") else found == expected
    )


def known(options: hf.PoseFileOptions) -> dict:
    """The options that these files need."""
    return {name: getattr(options, name) for name in ("format", "units", "inverted", "pair_by")}


def far(X: np.ndarray, right: np.ndarray) -> bool:
    """Whether X is wrong."""
    error = frames.log(frames.inverse(X) @ right)
    return bool(np.rad2deg(np.linalg.norm(error[:3])) > 1.0 or np.linalg.norm(error[3:]) > 0.01)


class Bench:
    """A set with its reconstruction."""

    def __init__(self, folder: Path, sfm: Path, scratch: Path) -> None:
        self.model, self.sfm, self.scratch = read_model(sfm), sfm, scratch
        known = folder / "truth.json"
        text = (known if known.exists() else folder / "reference.json").read_text()
        self.setup = "eye-to-hand" if '"base_T_camera"' in text else "eye-in-hand"
        self.poses = read_poses(folder / "poses.csv")
        row = {name: i for i, name in enumerate(self.poses.names)}
        first = np.flatnonzero(self.model.image_camera == 0)
        rows = np.array([row[Path(self.model.names[k]).name] for k in first])
        order = np.argsort(rows)
        self.rows, self.camera = rows[order], self.model.world_T_camera[first[order]]
        tracks = self.model.tracks
        away = (
            tracks.points_world[tracks.point_index]
            - self.model.world_T_camera[tracks.image_index, :3, 3]
        )
        self.depth = float(np.median(np.linalg.norm(away, axis=1)))
        self.found: dict[bytes, np.ndarray] = {}
        self.right = self.calibrated(self.poses)

    def calibrated(self, poses, options: hf.PoseFileOptions | None = None) -> hf.Result:
        """X from the reconstruction and poses, checked like any others."""
        options = hf.Options(setup=self.setup, poses=options or hf.PoseFileOptions())
        return hf.refine(self.model, poses, options)

    def verdict(self, spoilt: Spoilt) -> Verdict:
        """What the poses of a file are found to be."""
        file = open_poses(spoilt.path, spoilt.options)
        return judge(
            file.poses(),
            self.rows,
            self.camera,
            setup=self.setup,
            others=file_readings(file),
            depth=self.depth,
        )

    def right_files(self, **how) -> Iterator[tuple[Path, hf.PoseFileOptions]]:
        """A file of every format, with the options that say what it does not; ``how``: more options."""
        for name, form in FORMATS.items():
            index = ".yaml" if form.container in ("index", "list") else ".txt"
            for suffix in SUFFIXES.get(name, (index,)):
                path = self.scratch / f"{name}-{'-'.join(map(str, how.values()))}{suffix}"
                options = hf.PoseFileOptions(format=name, **how)
                write_poses(self.poses, path, options)
                by_name = form.key == "image" and suffix != ".npy"
                by_name |= form.container in ("folder", "index")
                yield path, replace(options, pair_by="auto" if by_name else "order")

    def variants(self) -> tuple[int, int]:
        """How many files in other units and of inverse poses give the same poses."""
        same, files = 0, 0
        for how in product(("m", "mm"), (False, True)):
            for path, options in self.right_files(units=how[0], inverted=how[1]):
                poses = read_poses(path, images=self.poses.names, **known(options))
                apart = np.abs(poses.base_T_gripper - self.poses.base_T_gripper).max()
                same += bool(apart < SAME_POSES)
                files += 1
        return same, files

    def same_x(self) -> tuple[Counter[str], np.ndarray]:
        """How many right files give the same X, and the largest difference: standard deviations, radians or metres."""
        counts: Counter[str] = Counter()
        largest = np.zeros(2)
        for path, options in self.right_files():
            for how in ("named", "recognised"):
                told = options if how == "named" else replace(options, format="auto")
                counts[f"{how} files"] += 1
                try:
                    X = self._same(self._listed(path, told), told)
                except hf.InputDataError as error:
                    if how == "recognised" and f"--pose-format {options.format}" in str(error):
                        counts["asked"] += 1
                    else:
                        print(f"{path.name}, {how}: {error}", file=sys.stderr)
                    continue
                error = frames.log(frames.inverse(X) @ self.right.matrix)
                deviations = float(np.sqrt(error @ np.linalg.pinv(self.right.covariance) @ error))
                largest = np.maximum(largest, [deviations, np.abs(error).max()])
                counts[how] += deviations < SAME_X
        return counts, largest

    def _same(self, poses, options: hf.PoseFileOptions) -> np.ndarray:
        """X; of poses that are the same to the last bit it is estimated once."""
        read = read_poses(poses, **known(options)) if isinstance(poses, Path) else poses
        key = read.base_T_gripper.tobytes()
        if key not in self.found:
            self.found[key] = self.calibrated(poses, options).matrix
        return self.found[key]

    def _listed(self, path: Path, options: hf.PoseFileOptions):
        """The file; of several cameras, whose images share rows, its poses by the rows' names."""
        if options.pair_by == "auto" and len(self.model.cameras) == 1:
            return path
        return read_poses(path, images=self.poses.names, **known(options))

    def spoilt(self) -> Iterator[Spoilt]:
        """A file for each wrong way."""
        for way, (convert, expected) in WAYS.items():
            poses = replace(self.poses, base_T_gripper=convert(self.poses.base_T_gripper))
            path = write_poses(poses, self.scratch / "spoilt.csv")
            yield Spoilt(way=way, path=path, options=hf.PoseFileOptions(), expected=expected)
        for way, (written, (rotation, angles), expected) in MISREAD.items():
            path = self.scratch / "misread.csv"
            write_angles(self.poses, path, *written)
            options = hf.PoseFileOptions(format="kuka", units="m", rotation=rotation, angles=angles)
            yield Spoilt(way=way, path=path, options=options, expected=expected)

    def silently_wrong(self, spoilt: Spoilt) -> bool:
        """Whether poses that passed give a complete X that is wrong."""
        try:
            result = self.calibrated(spoilt.path, spoilt.options)
        except hf.HandEyeError:
            return False
        return result.status == "ok" and far(result.matrix, self.right.matrix)

    def line(self, name: str) -> str:
        """One row of the first table."""
        files, largest = self.same_x()
        same, variants = self.variants()
        counts: Counter[str] = Counter()
        others = []
        for one in self.spoilt():
            verdict = self.verdict(one)
            if named(verdict, one.expected):
                counts["named"] += 1
                continue
            others.append(f"{one.way}: {verdict.kind} {verdict.convention}".strip())
            if verdict.kind in ("wrong", "contradiction") or verdict.doubtful:
                counts["refused"] += 1
                continue
            counts["passed"] += 1
            counts["wrong"] += self.silently_wrong(one)
        total = len(WAYS) + len(MISREAD)
        recognised = files["recognised files"] - files["asked"]
        return (
            f"| {name} | {len(self.rows)} | {files['named']}/{files['named files']} | "
            f"{files['recognised']}/{recognised} + {files['asked']} | {largest[0]:.0e}, {largest[1]:.0e} | "
            f"{same}/{variants} | "
            f"{counts['named']}/{total} | {counts['refused']} | {counts['passed']} | {counts['wrong']} | "
            f"{'; '.join(others)} |"
        )

    def command(self, path: Path, options: hf.PoseFileOptions) -> tuple[int, dict]:
        """Exit code and JSON of the real command."""
        words = ["calibrate", "-", str(path), "--model", str(self.sfm), "--setup", self.setup]
        words += ["--output", str(self.scratch / "out"), "--json", "--quiet"]
        words += ["--pose-format", options.format, "--units", options.units]
        words += ["--rotation", options.rotation, "--angles", options.angles]
        program = "import sys; from handeye_fg.supervised import main; sys.exit(main())"
        done = subprocess.run(
            [sys.executable, "-c", program, *words], capture_output=True, text=True, check=False
        )
        return done.returncode, json.loads(done.stdout)

    def command_line(self, name: str) -> str:
        """One row of the second table."""
        path = write_poses(self.poses, self.scratch / "right.csv")
        right, found = self.command(path, hf.PoseFileOptions())
        X = np.array(found["calibration"]["matrix"])
        codes: Counter[int] = Counter()
        wrong = 0
        passed = []
        for one in self.spoilt():
            code, found = self.command(one.path, one.options)
            codes[code] += 1
            if code not in (1, 2):
                passed.append(f"{one.way}: {code}")
                wrong += code == 0 and far(np.array(found["calibration"]["matrix"]), X)
        texts = ", ".join(f"{code}: {codes[code]}" for code in sorted(codes))
        return f"| {name} | {right} | {texts} | {wrong} | {'; '.join(passed)} |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="+", metavar="SET=SFM")
    parser.add_argument("--commands", action="store_true", help="run the command instead")
    arguments = parser.parse_args()
    print(
        "| set | exit code, right | exit codes, wrong | 0 and X wrong | not refused |\n|---|---|---|---|---|"
        if arguments.commands
        else "| set | images | same X, format named | same X, recognised + asked for the format | largest difference, in its standard deviations and in rad or m | "
        "same poses, other units and inverse | "
        "wrong, named first | refused | passed | confident and wrong | not named |\n"
        "|---|---|---|---|---|---|---|---|---|---|---|"
    )
    for pair in arguments.sets:
        folder, sfm = map(Path, pair.split("=", 1))
        with tempfile.TemporaryDirectory() as scratch:
            bench = Bench(folder, sfm, Path(scratch))
            row = bench.command_line if arguments.commands else bench.line
            print(row(folder.name), flush=True)


if __name__ == "__main__":
    main()
