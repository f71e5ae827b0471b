"""Planned poses against random ones, and predicted standard deviations against those that were reached.

    python benchmarks/planning.py [--runs 40] [--points 80] [--jobs 2] [--seed 0]

Prints Markdown tables. In each run a camera of 0.3 px noise is calibrated from a few random poses, poses are
planned and taken, and all images are calibrated together; beside it, random poses instead of planned ones. Random is
what a user does who knows the rules: from anywhere over the scene, views spread evenly over directions up to 50 degrees
from the vertical, 0.3 to 0.6 m away, turned anyhow about the view. They span the workspace that plans are made for.

- position, rotation: the largest standard deviation of X's three, as reported, median over the runs: from the
  first poses, as the plan predicts it, as it is reached, and with twice as many random poses in all.
- reached / predicted: median over the runs, position and rotation; of first sets the plan knows the noise for this.
- error / predicted: root mean square of the error of X from the truth over the predicted standard deviation,
  all six components.
- random / planned: medians over the runs of a standard deviation with random poses over that with planned ones: of the
  uncertainty at the working distance (a rotation counts by how far it moves a point there), of position, and of
  rotation. 1 or more means that planned poses need at most half as many images. "twice in all": twice as many images
  as the first ones and the planned ones together; "twice added": twice as many images added to the first ones.

The second table is of first sets: as many poses as planned without any image against twice as many random ones.
"""

import argparse
import functools
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from handeye_fg import frames
from handeye_fg.findings import NoiseLevels
from handeye_fg.inputs import read_model_inputs
from handeye_fg.io.results import Result
from handeye_fg.options import GraphOptions, Options
from handeye_fg.pipeline import solve_scene
from handeye_fg.planning import Plan, Workspace, plan, plan_first
from handeye_fg.progress import Stopwatch, silent
from handeye_fg.scene import Scene
from handeye_fg.simulate.scenes import SCENE_CENTRE, Truth, default_camera, scene_of, truth_of
from handeye_fg.types import SfmModel

STANDOFF = 0.45
PIXEL = 0.3


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is simulated; rotations in degrees, translations in millimetres. ``start`` 0: a first set."""

    start: int
    planned: int
    rotation: float
    translation: float
    points: int

    @property
    def noise(self) -> NoiseLevels:
        """What a plan may expect."""
        return NoiseLevels(
            pixel=PIXEL,
            robot_rotation=np.deg2rad(self.rotation),
            robot_translation=1e-3 * self.translation,
            estimated=True,
        )


@dataclass(frozen=True, kw_only=True)
class Draw:
    """One run: largest standard deviations (rotation, position) and ratios.

    ``twice`` and ``added``: of rotation, position, and at the working distance, random over planned.
    """

    start: np.ndarray
    predicted: np.ndarray
    reached: np.ndarray
    random: np.ndarray
    error: float
    twice: np.ndarray
    added: np.ndarray


def calibrated(case: Case, truth: Truth, seed: int) -> tuple[Result, SfmModel]:
    """The result of a calibration of simulated images and robot poses, and the reconstruction."""
    scene = scene_of(
        np.random.default_rng([1, seed]),
        truth,
        default_camera(),
        n_points=case.points,
        pixel_sigma=PIXEL,
        robot_rotation_sigma=np.deg2rad(case.rotation),
        robot_translation_sigma=1e-3 * case.translation,
        visibility=1.0,
        start_sigma=1e-4,
    )
    options = Options(graph=GraphOptions(intrinsics="fixed"))
    reported = dict(zip(scene.robot_poses.names, scene.robot_poses.base_T_gripper, strict=True))
    inputs, model = read_model_inputs(scene.model, reported, options)
    return solve_scene(Scene(model=model), inputs, options, Stopwatch(), silent), model


def at(truth: Truth, base_T_gripper: np.ndarray) -> Truth:
    """The same arm and scene with other poses of the gripper."""
    base_T_camera = base_T_gripper @ truth.gripper_T_camera
    world_T_camera = frames.inverse(truth.base_T_world) @ base_T_camera
    return replace(
        truth,
        base_T_gripper=base_T_gripper,
        world_T_camera=frames.scaled(world_T_camera, 1.0 / truth.metres_per_world_unit),
    )


def largest(result: Result) -> np.ndarray:
    """The largest standard deviations of X, degrees and millimetres."""
    std = np.sqrt(np.diag(result.covariance))
    return np.array([np.rad2deg(std[:3].max()), 1e3 * std[3:].max()])


def at_distance(result: Result) -> float:
    """The largest standard deviation of X, a rotation counted at the working distance, metres."""
    scale = np.repeat([STANDOFF, 1.0], 3)
    return float(np.sqrt(np.linalg.eigvalsh(result.covariance * np.outer(scale, scale))[-1]))


def in_all(result: Result) -> np.ndarray:
    """Largest standard deviations of rotation and position, and at the working distance."""
    return np.array([*largest(result), at_distance(result)])


def normalised(result: Result, truth: Truth, predicted: Plan) -> float:
    """Mean square of the errors of X in predicted standard deviations."""
    error = frames.log(frames.inverse(truth.gripper_T_camera) @ result.matrix)
    last = predicted.expected[-1]
    std = [*np.deg2rad(last.std_rotation_deg), *(1e-3 * np.array(last.std_translation_mm))]
    return float(np.mean((error / std) ** 2))


def draw(case: Case, seed: int) -> Draw:
    """One run."""
    wide = truth_of(np.random.default_rng([case.start, seed]), 200, "general")
    reach = Workspace.around(wide.base_T_gripper)
    total = case.start + case.planned

    def taken(base_T_gripper: np.ndarray) -> Result:
        return calibrated(case, at(wide, base_T_gripper), seed)[0]

    first = wide.base_T_gripper[: case.start]
    if case.start:
        result, model = calibrated(case, at(wide, first), seed)
        start = largest(result)
        made = plan(result, model, case.planned, reach=reach, seed=seed)
        expected = made
    else:
        start = np.full(2, np.nan)
        place = functools.partial(
            plan_first,
            SCENE_CENTRE,
            STANDOFF,
            reach,
            case.planned,
            X=wide.gripper_T_camera,
            camera=default_camera(),
            seed=seed,
        )
        made, expected = place(), place(noise=case.noise)
    reached = taken(np.concatenate([first, made.base_T_gripper]))
    informed = reached if case.start else taken(expected.base_T_gripper)
    twice = taken(wide.base_T_gripper[: 2 * total])
    added = taken(wide.base_T_gripper[: case.start + 2 * case.planned])
    worst = np.array(expected.expected[-1].worst, dtype=float)
    return Draw(
        start=start,
        predicted=worst,
        reached=largest(informed),
        random=largest(twice),
        error=normalised(informed, wide, expected),
        twice=in_all(twice) / in_all(reached),
        added=in_all(added) / in_all(reached),
    )


def draws(case: Case, runs: int, jobs: int, first: int) -> list[Draw]:
    """All runs of a case; ``first``: the seed of the first."""
    seeds = range(first, first + runs)
    if jobs == 1:
        return [draw(case, seed) for seed in seeds]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(functools.partial(draw, case), seeds, chunksize=5))


def row(case: Case, found: list[Draw]) -> str:
    """A line of the table."""
    start, predicted, reached, random = (
        np.array([getattr(one, name) for one in found])
        for name in ("start", "predicted", "reached", "random")
    )
    total = case.start + case.planned
    cells = [
        f"{case.start} + {case.planned}",
        str(2 * total),
        f"{case.rotation} / {case.translation}",
    ]
    shown = (start, predicted, reached, random) if case.start else (predicted, reached, random)
    for k, digits in ((1, 3), (0, 4)):
        cells.append(" / ".join(f"{np.median(part[:, k]):.{digits}f}" for part in shown))
    ratios = np.median(reached / predicted, axis=0)
    cells.append(f"{ratios[1]:.2f} / {ratios[0]:.2f}")
    cells.append(f"{np.sqrt(np.mean([one.error for one in found])):.2f}")
    for name in ("twice", "added") if case.start else ("twice",):
        rotation, position, distance = np.median([getattr(one, name) for one in found], axis=0)
        cells.append(f"{distance:.2f} / {position:.2f} / {rotation:.2f}")
    return f"| {' | '.join(cells)} |"


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """Both tables, line by line."""
    noises = ((0.01, 0.05), (0.1, 1.0))
    yield (
        "| images, random + planned | random | noise, deg / mm | position, mm: start / predicted / reached / random "
        "| rotation, deg: the same | reached / predicted | error / predicted "
        "| random / planned, twice in all: at the distance / position / rotation | twice added: the same |\n"
        "|---|---|---|---|---|---|---|---|---|"
    )
    for start, planned in ((6, 6), (10, 6), (0, 10)):
        if start == 0:
            yield (
                "\n| images, planned | random | noise, deg / mm | position, mm: predicted / reached / random "
                "| rotation, deg: the same | reached / predicted | error / predicted "
                "| random / planned: at the distance / position / rotation |\n"
                "|---|---|---|---|---|---|---|---|"
            )
        for rotation, translation in noises:
            case = Case(
                start=start,
                planned=planned,
                rotation=rotation,
                translation=translation,
                points=arguments.points,
            )
            yield row(case, draws(case, arguments.runs, arguments.jobs, arguments.seed))


def main() -> None:
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=40)
    parser.add_argument("--points", type=int, default=80)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    for line in table(parser.parse_args()):
        print(line, flush=True)


if __name__ == "__main__":
    main()
