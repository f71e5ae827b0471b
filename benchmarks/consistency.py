"""Whether the reported uncertainty is that of the errors: simulated calibrations with a known truth.

    python benchmarks/consistency.py [--runs 400] [--images 8 15 40] [--points 100] [--jobs 2]

Prints Markdown tables. In each run a camera of 0.3 px noise looks at a desk from poses of an arm, the
linear start and the joint refinement find X, and all noise levels are estimated with it.

White noise: the reported poses have independent errors.

- NEES: mean of ``e' C^-1 e``, e the error of X and C its reported covariance. With estimated noise levels
  e has a t distribution and C is its covariance, so that the expectation is 6 as with known levels. The
  band is ``6 +- 3.29 s``, s the standard error of the mean from the spread of the runs (99.9 %).
- coverage: part of the runs in which the truth is within the reported interval of 95 %, smallest and
  largest of X's six components and the scale. The interval is ``t(0.975, nu)`` times the expected
  standard deviation, nu the component's own degrees of freedom. A perfect estimator has a standard error
  of 1.1 % in 400 runs, so that of seven figures one or two are more than two such errors off in every
  third set.
- sigmas: mean of the estimated over the true levels: pixel, robot rotation, robot translation; and the
  part of their intervals of 95 % that have the truth.
- RMSE / bound: root mean square of ``e' B^-1 e / 6``, B the Cramer-Rao bound: the inverse of the
  information of all measurements, with Jacobians at the truth, its block of X. The refinement is given
  the true noise levels here.
- not white: part of the runs in which the test takes the robot's noise for structured: 5 % by design.

Link errors: the arm's links are off by 0.3 mm and 0.03 deg (every Denavit-Hartenberg parameter), beside
noise of 0.01 deg and 0.05 mm, so that the model of white noise is wrong. X and the scale are those of the
true gripper. With "one" configuration shoulder, elbow and wrist stay on the same side in all poses, with
"any" each pose is reached by any of eight solutions, so that neighbours need not have similar errors.
"""

import argparse
import functools
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy import stats

from handeye_fg import frames
from handeye_fg.graph import refine, start_state
from handeye_fg.graph.determined import spread
from handeye_fg.graph.mismatches import Kept
from handeye_fg.graph.noise import solve
from handeye_fg.graph.problem import make_problem
from handeye_fg.graph.variables import State
from handeye_fg.options import GraphOptions, NoiseOptions
from handeye_fg.progress import silent
from handeye_fg.simulate import LinkErrors, Scene, simulate_arm_scene, simulate_scene
from handeye_fg.solvers import linear_start
from handeye_fg.types import Rig

LENGTH, ANGLE = 3e-4, np.deg2rad(0.03)
LEVELS = ("pixel", "robot_rotation", "robot_translation")


@dataclass(frozen=True, kw_only=True)
class Case:
    """What is simulated; rotations in degrees, translations in millimetres."""

    images: int
    rotation: float
    translation: float
    points: int
    links: str = ""


@dataclass(frozen=True, kw_only=True)
class Draw:
    """One run: X's NEES, coverage (7,), levels over their truth and whether covered, and the bound's."""

    nees: float
    covered: np.ndarray
    levels: np.ndarray
    levels_covered: np.ndarray
    bound: float
    white: bool


def simulated(case: Case, seed: int) -> Scene:
    """The scene of a run."""
    rng = np.random.default_rng([case.images, seed])
    common = {
        "n_images": case.images,
        "n_points": case.points,
        "robot_rotation_sigma": np.deg2rad(case.rotation),
        "robot_translation_sigma": 1e-3 * case.translation,
        "start_sigma": 1e-4,
    }
    if not case.links:
        return simulate_scene(rng, **common)
    errors = LinkErrors(length=LENGTH, angle=ANGLE, one_configuration=case.links == "one")
    return simulate_arm_scene(rng, errors, **common)


def refined(scene: Scene, noise: NoiseOptions):
    """X as the pipeline finds it from a reconstruction."""
    reported = scene.robot_poses.base_T_gripper
    linear = linear_start(reported, scene.model.world_T_camera)
    return refine(
        scene.model,
        reported,
        start_state(scene.model, [scene.camera], linear),
        intrinsics=(),
        noise=noise,
        options=GraphOptions(),
        progress=silent,
    )


def bound(scene: Scene) -> np.ndarray:
    """The Cramer-Rao bound of X (6, 6)."""
    state = State(
        world_T_camera=scene.world_T_camera,
        points_world=scene.points_world,
        gripper_T_cameras=scene.gripper_T_camera[None],
        base_T_world=scene.base_T_world,
        log_scale=float(np.log(scene.metres_per_world_unit)),
        cameras=(scene.camera,),
        rig=Rig.of_one_camera(len(scene.world_T_camera)),
    )
    tracks = scene.model.tracks
    kept = Kept(
        state=state,
        tracks=tracks,
        sigma_scale=np.ones(len(tracks.pixels)),
        pixel=scene.noise.pixel,
        corner=1.0,
    )
    problem = make_problem(kept, scene.base_T_gripper, "base", (), None, ())
    columns = problem.layout.x_columns()
    return solve(problem.linearised(state), scene.noise).covariance[np.ix_(columns, columns)]


def error(result, scene: Scene) -> np.ndarray:
    """Error (7,) of X and of the logarithm of the scale."""
    of_x = frames.log(frames.inverse(result.state.gripper_T_camera) @ scene.gripper_T_camera)
    scale = scene.metres_per_world_unit * spread(scene.world_T_camera)
    scale /= spread(scene.model.world_T_camera)
    return np.append(of_x, np.log(scale / result.metres_per_world_unit))


def draw(case: Case, seed: int) -> Draw:
    """One run."""
    scene = simulated(case, seed)
    result = refined(scene, NoiseOptions())
    e = error(result, scene)
    covariance = result.observability.covariance
    std = np.append(np.sqrt(np.diag(covariance)), result.observability.log_scale_std)
    levels = np.array([getattr(result.noise, n) / getattr(scene.noise, n) for n in LEVELS])
    ends = np.array([(c.low, c.high) for c in map(result.level_certainties.get, LEVELS)])
    square = np.nan
    if not case.links:
        given = NoiseOptions(
            pixel_px=scene.noise.pixel,
            robot_rotation_deg=case.rotation,
            robot_translation_mm=case.translation,
        )
        of_known = error(refined(scene, given), scene)[:6]
        square = of_known @ np.linalg.solve(bound(scene), of_known)
    return Draw(
        nees=float(e[:6] @ np.linalg.solve(covariance, e[:6])),
        covered=np.abs(e) < result.interval_factors[0] * std,
        levels=levels,
        levels_covered=(levels * ends[:, 0] < 1.0) & (levels * ends[:, 1] > 1.0),
        bound=float(square),
        white=result.arm.found.white,
    )


def draws(case: Case, runs: int, jobs: int) -> list[Draw]:
    """All runs of a case."""
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(functools.partial(draw, case), range(runs), chunksize=5))


def row(case: Case, found: list[Draw]) -> str:
    """A line of the table."""
    nees = np.array([one.nees for one in found])
    band = stats.norm.ppf(0.9995) * nees.std() / np.sqrt(len(nees))
    covered = 100.0 * np.mean([one.covered for one in found], axis=0)
    white = np.mean([one.white for one in found])
    start = f"| {case.images} | "
    if case.links:
        return (
            f"{start}{case.links} | {nees.mean():.2f} | {covered[:6].min():.1f} - "
            f"{covered[:6].max():.1f} | {covered[6]:.1f} | {100.0 * (1.0 - white):.0f} % |"
        )
    levels = " / ".join(f"{v:.3f}" for v in np.mean([one.levels for one in found], axis=0))
    parts = 100.0 * np.mean([one.levels_covered for one in found], axis=0)
    ratio = np.sqrt(np.mean([one.bound for one in found]) / 6.0)
    return (
        f"{start}{case.rotation} / {case.translation} | {nees.mean():.2f} | {6 - band:.2f} - "
        f"{6 + band:.2f} | {covered.min():.1f} - {covered.max():.1f} | {levels} | "
        f"{' / '.join(f'{v:.1f}' for v in parts)} | {ratio:.3f} | {100.0 * (1.0 - white):.1f} % |"
    )


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """Both tables, line by line."""
    yield (
        "| images | noise, deg / mm | NEES | band | coverage, % | sigmas found over true | covered, % "
        "| RMSE / bound | not white |\n|---|---|---|---|---|---|---|---|---|"
    )
    points, runs, jobs = arguments.points, arguments.runs, arguments.jobs
    for images in arguments.images:
        for rotation, translation in ((0.01, 0.05), (0.1, 1.0)):
            case = Case(images=images, rotation=rotation, translation=translation, points=points)
            yield row(case, draws(case, runs, jobs))
    yield (
        "\n| images | configuration | NEES | coverage of X, % | of the scale, % | not white |\n"
        "|---|---|---|---|---|---|"
    )
    for images in arguments.images:
        for links in ("one", "any"):
            case = Case(images=images, rotation=0.01, translation=0.05, points=points, links=links)
            yield row(case, draws(case, runs, jobs))


def main() -> None:
    """Run the cases that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--images", type=int, nargs="+", default=[8, 15, 40])
    parser.add_argument("--points", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    for line in table(parser.parse_args()):
        print(line, flush=True)


if __name__ == "__main__":
    main()
