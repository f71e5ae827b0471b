"""Robot poses in every format and convention, right and wrong, against reconstructions made once.

    python benchmarks/conventions.py SET=SFM [SET=SFM ...] [--no-estimator]

A SET is a folder with ``poses.csv`` and ``truth.json`` or ``reference.json``; SFM is the folder ``sfm/`` of a
calibration of it. The poses are

- written in every format that is written and read back: right if the poses are the same, to what the format's
  digits allow, and judged right;
- spoilt in every way of ``handeye_fg.simulate.careless``: named if the verdict is wrong with the right
  diagnosis first, refused if it is wrong with another or none; passed if the poses are taken for right. Then X is
  estimated, and counts as wrong where it is 1 degree or 10 mm from X of the right poses and complete;
- written with one convention and read with another, from the numbers of a file (angles in the other unit, axes in
  another order, rotation vectors for angles), in the same way.

Prints a Markdown table.
"""

import argparse
import tempfile
from dataclasses import replace
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
    return verdict.kind == "wrong" and (
        found.startswith(expected) if expected.endswith("-") else found == expected
    )


class Bench:
    """A set with its reconstruction."""

    def __init__(self, folder: Path, sfm: Path, scratch: Path, *, estimate: bool) -> None:
        self.model = read_model(sfm)
        known = folder / "truth.json"
        text = (known if known.exists() else folder / "reference.json").read_text()
        self.setup = "eye-to-hand" if '"base_T_camera"' in text else "eye-in-hand"
        self.poses = read_poses(folder / "poses.csv")
        self.scratch, self.estimate = scratch, estimate
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

    def verdict(self, poses: RobotPoses, others=()) -> Verdict:
        """What the poses are found to be."""
        return judge(
            poses, self.rows, self.camera, setup=self.setup, others=others, depth=self.depth
        )

    def formats(self) -> tuple[int, int]:
        """How many formats give the poses back, and are judged right."""
        right = 0
        for name, form in FORMATS.items():
            path = self.scratch / (name + (".yaml" if form.container == "index" else ""))
            try:
                write_poses(self.poses, path, hf.PoseFileOptions(format=name))
                pairing = "auto" if form.key == "image" else "order"
                back = read_poses(path, name, images=self.poses.names, pair_by=pairing)
            except (hf.InputDataError, ValueError) as error:
                print(f"{name}: {error}")
                continue
            same = np.allclose(back.base_T_gripper, self.poses.base_T_gripper, atol=1e-5)
            right += same and self.verdict(back).kind in ("right", "undecided")
        return right, len(FORMATS)

    def spoilt(self):
        """(name, verdict, expected, poses) of each wrong way."""
        for way, (convert, expected) in WAYS.items():
            poses = replace(self.poses, base_T_gripper=convert(self.poses.base_T_gripper))
            yield way, self.verdict(poses), expected, poses
        for way, (written, read, expected) in MISREAD.items():
            path = self.scratch / "misread.csv"
            write_angles(self.poses, path, *written)
            rotation, angles = read
            file = open_poses(
                path,
                hf.PoseFileOptions(format="kuka", units="m", rotation=rotation, angles=angles),
            )
            poses = file.poses()
            yield way, self.verdict(poses, file_readings(file)), expected, poses

    def silently_wrong(self, poses: RobotPoses, right) -> bool:
        """Whether poses that passed give a complete X that is wrong."""
        try:
            result = self.calibrated(poses)
        except hf.HandEyeError:
            return False
        error = frames.log(frames.inverse(result.matrix) @ right.matrix)
        far = np.rad2deg(np.linalg.norm(error[:3])) > 1.0 or np.linalg.norm(error[3:]) > 0.01
        return result.status == "ok" and bool(far)

    def calibrated(self, poses: RobotPoses):
        """X from the reconstruction and poses, checked like any others."""
        return hf.refine(self.model, poses, hf.Options(setup=self.setup))

    def line(self, name: str) -> str:
        """One row of the table."""
        right, formats = self.formats()
        counts = {"named": 0, "refused": 0, "passed": 0, "wrong": 0}
        others = []
        truth = None
        for way, verdict, expected, poses in self.spoilt():
            if named(verdict, expected):
                counts["named"] += 1
                continue
            others.append(f"{way}: {verdict.kind} {verdict.convention}".strip())
            if verdict.kind in ("wrong", "contradiction") or verdict.doubtful:
                counts["refused"] += 1
                continue
            counts["passed"] += 1
            if self.estimate:
                truth = truth or self.calibrated(self.poses)
                counts["wrong"] += self.silently_wrong(poses, truth)
        total = len(WAYS) + len(MISREAD)
        return (
            f"| {name} | {len(self.rows)} | {right}/{formats} | {counts['named']}/{total} | "
            f"{counts['refused']} | {counts['passed']} | {counts['wrong'] if self.estimate else '-'} | "
            f"{'; '.join(others)} |"
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sets", nargs="+", metavar="SET=SFM")
    parser.add_argument("--no-estimator", action="store_true")
    arguments = parser.parse_args()
    print(
        "| set | images | right formats | wrong, named first | refused | passed | confident and wrong | "
        "not named |\n|---|---|---|---|---|---|---|---|"
    )
    for pair in arguments.sets:
        folder, sfm = map(Path, pair.split("=", 1))
        with tempfile.TemporaryDirectory() as scratch:
            bench = Bench(folder, sfm, Path(scratch), estimate=not arguments.no_estimator)
            print(bench.line(folder.name), flush=True)


if __name__ == "__main__":
    main()
