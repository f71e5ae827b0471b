"""Which poses to take next; entry points ``plan`` and ``plan_first``."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from handeye_fg import sfm
from handeye_fg.errors import InputDataError
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.forecast import forecast
from handeye_fg.io.config import read_config
from handeye_fg.io.result_reader import load_result
from handeye_fg.io.results import Result
from handeye_fg.planning.candidates import Candidates, candidates, joined, nearby
from handeye_fg.planning.design import best, pose_information, prior_information
from handeye_fg.planning.expected import Expected, corrected, of_model, of_result
from handeye_fg.planning.planned import KeptOut, Plan, planned
from handeye_fg.planning.reach import Reach, Workspace
from handeye_fg.planning.situation import Situation, assumed_situation, situation_of
from handeye_fg.priors import AnyPrior, PosePrior, Prior
from handeye_fg.types import CameraModel, Indices, Rig, SfmModel

_CANDIDATES = 800
# Then each chosen pose is exchanged for better ones near it, so many times among so many.
_ROUNDS, _NEARBY = 5, 20
# A planned image sees this part at least of the points that an earlier one sees.
_LEAST_VIEW = 0.3
_FEWEST_POINTS = 8
_FEWEST_IMAGES = 3

USUAL_NOISE = NoiseLevels(
    pixel=0.4,
    robot_rotation=float(np.deg2rad(0.02)),
    robot_translation=1e-4,
    estimated=True,
    image_inflation=2.0,
)
"""What to expect of a usual arm and camera."""


def plan(
    result: Result | str | Path,
    model: sfm.ModelSource | SfmModel | None = None,
    count: int = 5,
    *,
    reach: Reach | None = None,
    priors: Sequence[AnyPrior] | None = None,
    seed: int = 0,
) -> Plan:
    """The poses that make the X of a calibration most certain.

    Robot poses that were kept out of X for a proof of it count as poses to use: their images are there.

    Args:
        result: the calibration, or the folder of its output.
        model: the reconstruction that it was made from; may be left out where the folder holds it.
        count: how many poses.
        reach: what the arm reaches; None: the box of the gripper's positions so far.
        priors: what was known beforehand; None: what the folder's config.toml says.
        seed: of everything random.

    Raises:
        InputDataError: the result has no images, its reconstruction is missing, or no pose within reach sees
            the scene.
        ValueError: the count is not positive.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_scene
        >>> scene = simulate_scene(np.random.default_rng(3), n_images=8, n_points=60)
        >>> result = hf.refine(scene.model, scene.robot_poses)
        >>> found = hf.plan(result, scene.model, 2)
        >>> found.base_T_gripper.shape
        (2, 4, 4)
        >>> max(found.expected[1].std_translation_mm) < max(found.present.std_translation_mm)
        True
    """
    if not isinstance(result, Result):
        folder = Path(result)
        folder = folder if folder.is_dir() else folder.parent
        result = load_result(Path(result))
        model = folder / "sfm" if model is None else model
        config = folder / "config.toml"
        if priors is None and config.is_file():
            priors = read_config(config).priors
    if model is None:
        raise InputDataError(
            "a plan needs the reconstruction that the result was made from; give it too"
        )
    model = model if isinstance(model, SfmModel) else sfm.read_model(model)
    of_x = tuple(prior for prior in priors or () if isinstance(prior, Prior | PosePrior))
    suffix = PurePosixPath(model.names[0]).suffix
    rng = np.random.default_rng(seed)
    there = situation_of(rng, result, model, of_x)
    options, chosen = _chosen(rng, there, count, reach or Workspace.around(there.taken))
    reported = [of_result(one) for one in result.cameras or (result,)]
    white = result.certainty is None or result.certainty.robot.white
    seen = replace(there, trusted=there.trusted & ~there.kept_out)  # by the X that is reported
    now = _expected(seen, options, chosen[:0])

    def later(these: Indices, *, of: Situation = there) -> list[Expected]:
        found = _expected(of, options, these)
        return [corrected(*one, white=white) for one in zip(reported, now, found, strict=True)]

    expected = [later(chosen[: k + 1]) for k in range(len(chosen))]
    worst = _least_certain(expected[-1], there.sight.standoff)
    kept_out = None
    if there.kept_out.any():
        kept_out = KeptOut(
            count=int(np.count_nonzero(there.kept_out)),
            used=later(chosen[:0])[worst],
            unused=later(chosen, of=seen)[worst],
        )
    return planned(
        options,
        chosen,
        reported[worst],
        tuple(one[worst] for one in expected),
        f"next_{{:03d}}{suffix}",
        there.names[worst],
        kept_out,
    )


def plan_first(
    look_at: Array | Sequence[float],
    standoff: float,
    reach: Reach,
    count: int = 12,
    *,
    X: Array | None = None,
    camera: CameraModel | None = None,
    noise: NoiseLevels = USUAL_NOISE,
    seed: int = 0,
) -> Plan:
    """A first set of poses, before there are images, for a camera on the gripper.

    Args:
        look_at: the middle of the scene (3,) in the base, metres.
        standoff: distance of the camera from it, metres.
        reach: what the arm reaches.
        count: how many poses, three or more.
        X: about where the camera is on the gripper (4, 4), metres; None: at its origin, looking along z.
        camera: the intrinsics; None: 60 degrees wide.
        noise: the levels to expect.
        seed: of everything random.

    Raises:
        InputDataError: no pose within reach sees the scene.
        ValueError: the count or the standoff is too small.

    Examples:
        >>> import handeye_fg as hf
        >>> reach = hf.Workspace((0.1, -0.5, 0.2), (0.9, 0.5, 0.9))
        >>> found = hf.plan_first((0.5, 0.0, 0.0), 0.4, reach, count=6)
        >>> found.names[0], found.base_T_gripper.shape
        ('first_001.jpg', (6, 4, 4))
    """
    if count < _FEWEST_IMAGES or standoff <= 0.0:
        raise ValueError(f"{count=} and {standoff=} but expected 3 or more, and a length")
    rng = np.random.default_rng(seed)
    lens = camera or CameraModel(
        model="PINHOLE", width=1280, height=960, params=np.array([1108.0, 1108.0, 640.0, 480.0])
    )
    mount = np.eye(4) if X is None else X
    there = assumed_situation(rng, np.asarray(look_at), standoff, lens, mount, noise)
    options, chosen = _chosen(rng, there, count, reach)
    return planned(options, chosen, None, _expected(there, options, chosen), "first_{:03d}.jpg")


def _chosen(
    rng: np.random.Generator, there: Situation, count: int, reach: Reach
) -> tuple[Candidates, Indices]:
    """Poses that may be taken, and which of them are best.

    Raises:
        InputDataError: none may be taken.
        ValueError: the count is not positive.
    """
    if count < 1:
        raise ValueError(f"{count=} but expected 1 or more")
    cameras, taken, standoff = there.cameras, there.taken, there.sight.standoff
    n_images, n_points = len(there.scene_T_camera), len(there.sight.points)
    seen = np.bincount(there.image_index, minlength=n_images) if n_images else [n_points]
    fewest = max(_FEWEST_POINTS, int(_LEAST_VIEW * np.median(seen) / there.matched))
    known = prior_information(there.priors, cameras.gripper_T_cameras, standoff)
    if n_images:
        saw = np.zeros((len(taken), len(cameras.sights), n_points), dtype=bool)
        rows = there.rig.pose[there.image_index], there.rig.camera[there.image_index]
        saw[*rows, there.point_index] = True
        used = there.trusted & (saw.sum(axis=2).max(axis=1) >= _FEWEST_POINTS // 2)
        placed = cameras.in_scene(taken[used])
        known = known + _gains(there, placed, saw[used], there.sample).sum(axis=0)

    def gains(some: Candidates) -> Array:
        return _gains(there, some.scene_T_cameras, some.visible, there.sample * there.matched)

    options = candidates(rng, cameras, reach, fewest, _CANDIDATES)
    adds = gains(options)
    chosen = best(known, adds, options.base_T_gripper, taken, count, standoff)
    for _ in range(_ROUNDS if len(chosen) else 0):
        found = options.only(chosen)
        near = nearby(rng, found, cameras, reach, fewest, _NEARBY)
        adds, options = np.concatenate([adds[chosen], gains(near)]), joined([found, near])
        first = range(len(chosen))
        chosen = best(known, adds, options.base_T_gripper, taken, count, standoff, start=first)
    if len(chosen) == 0:
        raise InputDataError(
            "every pose within reach that sees the scene has been taken already; give a larger workspace"
        )
    return options, chosen


def _gains(there: Situation, scene_T_cameras: Array, saw: NDArray[np.bool_], each: float) -> Array:
    """What images say of the unknowns (n, u, u).

    Args:
        there: the scene and the cameras.
        scene_T_cameras: at each pose (n, k, 4, 4).
        saw: the points (n, k, p) that they see.
        each: how many observations each of them stands for.
    """
    sigmas = there.noise.image_sigma * there.levels / np.sqrt(each)
    images = np.zeros((*saw.shape[:2], 6, 6))
    for i, k in np.argwhere(saw.any(axis=2)).tolist():
        images[i, k] = there.cameras.sights[k].pose_information(
            scene_T_cameras[i, k], saw[i, k], float(sigmas[k])
        )
    cameras = there.cameras
    return pose_information(
        scene_T_cameras,
        images,
        cameras.gripper_T_cameras,
        there.sight.centre,
        there.noise,
        static=cameras.static,
    )


def _expected(there: Situation, options: Candidates, chosen: Indices) -> tuple[Expected, ...]:
    """How certain each camera's X is with the images that are there and those of the chosen poses."""
    n, n_poses = len(there.scene_T_camera), len(there.trusted)
    saw = options.visible[chosen]
    new_pose, new_camera = np.nonzero(saw.any(axis=2))
    image, point = np.nonzero(saw[new_pose, new_camera])
    rig = Rig(
        n_cameras=there.rig.n_cameras,
        camera=np.concatenate([there.rig.camera, new_camera]),
        pose=np.concatenate([there.rig.pose, n_poses + new_pose]),
    )
    image_index = np.concatenate([there.image_index, n + image])
    point_index = np.concatenate([there.point_index, point])
    each = np.repeat(
        [there.sample, there.sample * there.matched], [len(there.image_index), len(image)]
    )
    # Points that one image alone sees say nothing.
    twice = np.bincount(point_index, minlength=len(there.sight.points)) >= 2
    used = twice[point_index]
    number = np.cumsum(twice) - 1
    X = there.cameras.gripper_T_cameras
    found = forecast(
        np.concatenate(
            [there.scene_T_camera, options.scene_T_cameras[chosen][new_pose, new_camera]]
        ),
        rig,
        there.sight.points[twice],
        image_index[used],
        number[point_index[used]],
        (there.levels[rig.camera[image_index]] / np.sqrt(each))[used],
        X,
        [sight.camera for sight in there.cameras.sights],
        there.noise,
        there.known,
        trusted=np.append(there.trusted, np.ones(len(chosen), dtype=bool)),
        refine_intrinsics=there.refine_intrinsics,
        priors=there.priors,
        frame=there.frame,
        inverted=there.cameras.static,
    )
    return tuple(map(of_model, X, found))


def _least_certain(expected: Sequence[Expected], standoff: float) -> int:
    """The camera of which least is determined, or that moves a point at the standoff most."""

    def doubt(one: Expected) -> tuple[int, float]:
        degrees, millimetres = one.worst
        moved = standoff * np.deg2rad(degrees or 0.0) + 1e-3 * (millimetres or 0.0)
        return len(one.free_directions), float(moved)

    return max(range(len(expected)), key=lambda k: doubt(expected[k]))
