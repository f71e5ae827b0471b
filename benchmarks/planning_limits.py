"""What planned poses could do at best beside random ones, and how near to that the planner comes.

    python benchmarks/planning_limits.py [--runs 10] [--points 80] [--seed 0]

Prints a Markdown table. The runs are those of planning.py; all standard deviations here are forecasts from the true
noise and the true scene, so that they do not scatter as those of calibrations do. Random is, as there, twice as many
images as the first and the planned ones together ("in all"), or the first ones and twice as many as the planned
ones ("added"). Ratios are random / planned, medians over the runs; 1 or more means half as many images.

- planned: position, rotation, and the smaller of the two.
- at best: what no choice of poses does better than, from the same first images and of the same number: for position
  alone, for rotation alone, and for the smaller of both at once, which is less than either.

The limit is that of weights on the planned poses and 1500 others (in the workspace, where the camera sees the scene, from
up to 90 degrees from where a random one does), any number of times each, with the points known. The variances of X are convex in the weights w: with Sigma = (known + sum w_i G_i)^-1 and any weights l_j >= 0 of the sum 1 of the
variances, each in units of that of random poses, F = sum l_j Sigma_jj is convex as well, the largest is no less than
F, and F nowhere less than F - (n max g - w'g), g = -dF/dw.

Why there is a limit to the rotation: X is turned by x, the scene by d, and C_i is how the i-th camera is turned in the
base. The reported rotation's error, seen from the camera, is C_i' d - x with the robot's noise and the image's, s in all:
with d left open, n poses say n (I - M'M) / s^2 of x, M the mean of the C_i. Views spread evenly over directions up
to 50 degrees from the vertical and turned anyhow leave 0.33 n of the turn about the optical axis, all of them at 50
degrees 0.59 n, at 70 degrees 0.88 n. Where the positions tell d, up to n is left, for all poses alike.
"""

import argparse
from collections.abc import Iterator

import numpy as np
from planning import PIXEL, STANDOFF, Case, at, calibrated

from handeye_fg.frames import Array
from handeye_fg.graph.forecast import forecast
from handeye_fg.options import NoiseOptions
from handeye_fg.planning import Workspace, plan, plan_first
from handeye_fg.planning.candidates import Cameras, candidates
from handeye_fg.planning.design import pose_information, prior_information
from handeye_fg.planning.sight import Sight
from handeye_fg.simulate.scenes import SCENE_CENTRE, Truth, default_camera, scene_of, truth_of
from handeye_fg.types import Rig

_CANDIDATES, _FEWEST_POINTS = 1500, 20
# The largest variance counts by this power; the bound holds for any.
_POWER, _STEPS, _PACE = 24, 300, 0.4
_ROTATION, _POSITION = slice(0, 3), slice(3, 6)


def seen(case: Case, wide: Truth, poses: Array, seed: int) -> Sight:
    """The scene in the base, and from where images at some poses of the gripper see it."""
    truth = at(wide, poses)
    scene = scene_of(
        np.random.default_rng([1, seed]),
        truth,
        default_camera(),
        n_points=case.points,
        pixel_sigma=0.0,
        robot_rotation_sigma=0.0,
        robot_translation_sigma=0.0,
        visibility=1.0,
        start_sigma=0.0,
    )
    tracks, base_T_world = scene.model.tracks, truth.base_T_world
    points = truth.metres_per_world_unit * tracks.points_world @ base_T_world[:3, :3].T
    points = points + base_T_world[:3, 3]
    order = np.argsort(tracks.point_index, kind="stable")
    image, point = tracks.image_index[order], tracks.point_index[order]
    rays = (poses @ truth.gripper_T_camera)[image, :3, 3] - points[point]
    distances = np.linalg.norm(rays, axis=1)
    return Sight(
        points=points,
        rays=rays / distances[:, None],
        distances=distances,
        point_index=point,
        camera=default_camera(),
        widest_angle=np.pi / 2,
    )


def variances(case: Case, wide: Truth, poses: Array, seed: int) -> Array:
    """Variances of X (6,) that a calibration from images at these poses would report."""
    sight, cameras = seen(case, wide, poses, seed), poses @ wide.gripper_T_camera
    visible = sight.visible(cameras)
    twice = np.count_nonzero(visible, axis=0) >= 2
    image, point = np.nonzero(visible[:, twice])
    (found,) = forecast(
        cameras,
        Rig.of_one_camera(len(poses)),
        sight.points[twice],
        image,
        point,
        np.ones(len(image)),
        wide.gripper_T_camera[None],
        [default_camera()],
        case.noise,
        NoiseOptions(),
    )
    return np.diag(found.covariance)


def gains(case: Case, wide: Truth, sight: Sight, cameras: Array) -> Array:
    """What images of cameras (n, 4, 4) say (n, 13, 13) with the points known."""
    images = [
        sight.pose_information(camera, which, PIXEL)
        for camera, which in zip(cameras, sight.visible(cameras), strict=True)
    ]
    return pose_information(
        cameras[:, None],
        np.reshape(images, (-1, 1, 6, 6)),
        wide.gripper_T_camera[None],
        sight.centre,
        case.noise,
        static=False,
    )


def least(known: Array, added: Array, count: int, units: Array) -> float:
    """Bound below the largest of some variances of X, in units (6,), with any ``count`` poses added."""
    weights, bound = np.full(len(added), count / len(added)), 0.0
    for _ in range(_STEPS):
        covariance = np.linalg.inv(known + np.tensordot(weights, added, 1))
        found = np.diag(covariance)[:6] / units
        shares = found ** (_POWER - 1) / np.sum(found ** (_POWER - 1))
        half = covariance[:, :6] * np.sqrt(shares / units)
        slope = np.einsum("nij,ij->n", added, half @ half.T)
        inner = weights @ slope
        bound = max(bound, shares @ found - (count * slope.max() - inner))
        weights = weights * (slope / (inner / count)) ** _PACE
        weights *= count / weights.sum()
    return float(bound)


def ratios(case: Case, seed: int) -> Array:
    """Of both kinds of random poses: planned (position, rotation), at best (position, rotation, both) (2, 5)."""
    wide = truth_of(np.random.default_rng([case.start, seed]), 200, "general")
    reach = Workspace.around(wide.base_T_gripper)
    first = wide.base_T_gripper[: case.start]
    if case.start:
        result, model = calibrated(case, at(wide, first), seed)
        made = plan(result, model, case.planned, reach=reach, seed=seed)
    else:
        X, camera = wide.gripper_T_camera, default_camera()
        given = {"X": X, "camera": camera, "noise": case.noise, "seed": seed}
        made = plan_first(SCENE_CENTRE, STANDOFF, reach, case.planned, **given)
    own = variances(case, wide, np.concatenate([first, made.base_T_gripper]), seed)

    in_all, added = 2 * (case.start + case.planned), case.start + 2 * case.planned
    sight = seen(case, wide, wide.base_T_gripper[:in_all], seed)
    cameras = Cameras(sights=(sight,), gripper_T_cameras=wide.gripper_T_camera[None], static=False)
    rng = np.random.default_rng(seed)
    others = candidates(rng, cameras, reach, _FEWEST_POINTS, _CANDIDATES).base_T_gripper
    known = prior_information((), wide.gripper_T_camera[None], STANDOFF)
    if case.start:
        known = known + gains(case, wide, sight, first @ wide.gripper_T_camera).sum(axis=0)
    every = np.concatenate([made.base_T_gripper, others])
    free = gains(case, wide, sight, every @ wide.gripper_T_camera)
    rows = []
    for count in (in_all, added):
        random = variances(case, wide, wide.base_T_gripper[:count], seed)
        worst = [random[kind].max() for kind in (_POSITION, _ROTATION)]
        reached = [
            one / own[kind].max() for one, kind in zip(worst, (_POSITION, _ROTATION), strict=True)
        ]
        limits = [
            least(known, free, case.planned, np.array([*[rotation] * 3, *[position] * 3]))
            for position, rotation in ((worst[0], np.inf), (np.inf, worst[1]), worst)
        ]
        rows.append(np.sqrt([*reached, *(1.0 / np.array(limits))]))
    return np.array(rows)


def table(arguments: argparse.Namespace) -> Iterator[str]:
    """The table, line by line."""
    yield (
        "| images, random + planned | noise, deg / mm | random | planned: position / rotation / smaller "
        "| at best: position / rotation / smaller of both |\n|---|---|---|---|---|"
    )
    for start, planned in ((6, 6), (10, 6), (0, 10)):
        for rotation, translation in ((0.01, 0.05), (0.1, 1.0)):
            case = Case(
                start=start,
                planned=planned,
                rotation=rotation,
                translation=translation,
                points=arguments.points,
            )
            seeds = range(arguments.seed, arguments.seed + arguments.runs)
            every = np.array([ratios(case, seed) for seed in seeds])
            kinds = (("in all", 0), ("added", 1)) if start else (("in all", 0),)
            for kind, k in kinds:
                position, rotation_, *limits = np.median(every[:, k], axis=0)
                smaller = np.median(every[:, k, :2].min(axis=1))
                yield (
                    f"| {start} + {planned} | {rotation} / {translation} | {(2 * (start + planned), start + 2 * planned)[k]}, {kind} "
                    f"| {position:.2f} / {rotation_:.2f} / {smaller:.2f} | {' / '.join(f'{one:.2f}' for one in limits)} |"
                )


def main() -> None:
    """Run all cases."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--points", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    for line in table(parser.parse_args()):
        print(line, flush=True)


if __name__ == "__main__":
    main()
