"""Which poses to take next; entry points ``plan`` and ``plan_first``."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from handeye_fg import sfm
from handeye_fg.errors import InputDataError
from handeye_fg.findings import NoiseLevels
from handeye_fg.frames import Array
from handeye_fg.graph.forecast import forecast
from handeye_fg.io.config import read_config
from handeye_fg.io.result_reader import load_result
from handeye_fg.io.results import Result
from handeye_fg.observability import Observability
from handeye_fg.planning.candidates import Candidates, candidates
from handeye_fg.planning.design import best, pose_information, prior_information
from handeye_fg.planning.expected import Expected, corrected, of_model, of_result
from handeye_fg.planning.reach import Reach, Workspace
from handeye_fg.planning.sight import gripper_pose
from handeye_fg.planning.situation import Situation, assumed_situation, situation_of
from handeye_fg.priors import AnyPrior, PosePrior, Prior
from handeye_fg.types import CameraModel, Indices, SfmModel, frozen_array

_CANDIDATES = 400
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Poses to take, the one that helps most first.

    Attributes:
        names: names (k,) for their images.
        base_T_gripper: the poses (k, 4, 4), metres.
        visible: part (k,) of the scene's points that an image there is expected to see.
        present: how certain X is now; None before the first images.
        expected: how certain X is going to be with the first, the first two, ... of the poses.
        message: what comes of it, in words.
    """

    names: tuple[str, ...]
    base_T_gripper: Array
    visible: Array
    present: Expected | None
    expected: tuple[Expected, ...]
    message: str

    def __post_init__(self) -> None:
        n = len(self.names)
        for name, shape in (("base_T_gripper", (n, 4, 4)), ("visible", (n,))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))


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
    taken = gripper_pose(there.scene_T_camera, there.X, static=there.static)
    options, chosen = _chosen(rng, there, count, reach or Workspace.around(taken), taken)
    now = of_model(there.X, _forecast(there, options, chosen[:0]))
    expected = tuple(
        corrected(result, now, of_model(there.X, _forecast(there, options, chosen[: k + 1])))
        for k in range(len(chosen))
    )
    return _plan(options, chosen, of_result(result), expected, f"next_{{:03d}}{suffix}")


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
    options, chosen = _chosen(rng, there, count, reach, np.zeros((0, 4, 4)))
    expected = of_model(mount, _forecast(there, options, chosen))
    return _plan(options, chosen, None, (expected,), "first_{:03d}.jpg")


def _chosen(
    rng: np.random.Generator, there: Situation, count: int, reach: Reach, taken: Array
) -> tuple[Candidates, Indices]:
    """Poses that may be taken, and which of them are best.

    Raises:
        InputDataError: none may be taken.
        ValueError: the count is not positive.
    """
    if count < 1:
        raise ValueError(f"{count=} but expected 1 or more")
    sight, noise = there.sight, there.noise
    seen = (
        np.bincount(there.image_index, minlength=len(taken)) if len(taken) else [len(sight.points)]
    )
    fewest = max(_FEWEST_POINTS, int(_LEAST_VIEW * np.median(seen) / there.matched))
    options = candidates(rng, sight, there.X, reach, fewest, _CANDIDATES, static=there.static)
    centre, sigma = sight.centre, noise.image_sigma
    known = prior_information(there.priors, there.X, sight.standoff)
    if len(taken):
        saw = np.zeros((len(taken), len(sight.points)), dtype=bool)
        saw[there.image_index, there.point_index] = True
        used = there.trusted & (saw.sum(axis=1) >= _FEWEST_POINTS // 2)
        own = sigma / np.sqrt(there.sample)
        images = np.array(
            [
                sight.pose_information(camera, which, own)
                for camera, which in zip(there.scene_T_camera[used], saw[used], strict=True)
            ]
        )
        known = known + pose_information(
            there.scene_T_camera[used], images, there.X, centre, noise, static=there.static
        ).sum(axis=0)
    own = sigma / np.sqrt(there.sample * there.matched)
    images = np.array(
        [
            sight.pose_information(camera, which, own)
            for camera, which in zip(options.scene_T_camera, options.visible, strict=True)
        ]
    )
    gains = pose_information(
        options.scene_T_camera, images, there.X, centre, noise, static=there.static
    )
    chosen = best(known, gains, options.base_T_gripper, taken, count, sight.standoff)
    if len(chosen) == 0:
        raise InputDataError(
            "every pose within reach that sees the scene has been taken already; give a larger workspace"
        )
    return options, chosen


def _forecast(there: Situation, options: Candidates, chosen: Indices) -> Observability:
    """X with the images that are there and those of the chosen poses."""
    n = len(there.scene_T_camera)
    image, point = np.nonzero(options.visible[chosen])
    image_index = np.concatenate([there.image_index, n + image])
    point_index = np.concatenate([there.point_index, point])
    sigma_scale = np.concatenate(
        [
            np.full(len(there.image_index), there.sample**-0.5),
            np.full(len(image), (there.sample * there.matched) ** -0.5),
        ]
    )
    # Points that one image alone sees say nothing.
    twice = np.bincount(point_index, minlength=len(there.sight.points)) >= 2
    used = twice[point_index]
    number = np.cumsum(twice) - 1
    return forecast(
        np.concatenate([there.scene_T_camera, options.scene_T_camera[chosen]]),
        there.sight.points[twice],
        image_index[used],
        number[point_index[used]],
        sigma_scale[used],
        there.X,
        there.sight.camera,
        there.noise,
        there.known,
        trusted=np.concatenate([there.trusted, np.ones(len(chosen), dtype=bool)]),
        refine_intrinsics=there.refine_intrinsics,
        priors=there.priors,
        frame=there.frame,
        inverted=there.static,
    )


def _plan(
    options: Candidates,
    chosen: Indices,
    present: Expected | None,
    expected: tuple[Expected, ...],
    name: str,
) -> Plan:
    return Plan(
        names=tuple(name.format(k + 1) for k in range(len(chosen))),
        base_T_gripper=options.base_T_gripper[chosen],
        visible=options.visible[chosen].mean(axis=1),
        present=present,
        expected=expected,
        message=_message(len(chosen), present, expected),
    )


def _message(count: int, present: Expected | None, expected: Sequence[Expected]) -> str:
    """What comes of it, in words."""
    last = expected[-1]
    parts = [
        f"With {'these' if present is None else 'the'} {count} {'poses' if count > 1 else 'pose'} the largest "
        f"standard deviations are expected to be {_worst(last)}"
        + (f"; they are {_worst(present)} now." if present is not None else ".")
    ]
    if present is not None and present.free_directions:
        parts += [direction.description for direction in present.free_directions]
        complete = [k for k, one in enumerate(expected, 1) if not one.free_directions]
        if complete:
            first = (
                "the first of the poses"
                if complete[0] == 1
                else f"the first {complete[0]} of the poses"
            )
            parts.append(f"With {first} nothing is left undetermined.")
    if last.free_directions:
        parts.append("Even with all of them:")
        parts += [direction.description for direction in last.free_directions]
    return " ".join(parts)


def _worst(expected: Expected) -> str:
    degrees, millimetres = expected.worst
    rotation = "undetermined in rotation" if degrees is None else f"{degrees:.2g} deg"
    translation = "undetermined in position" if millimetres is None else f"{millimetres:.2g} mm"
    return f"{rotation} and {translation}"
