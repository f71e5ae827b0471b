"""Images and fragments that structure from motion left apart, joined through the robot; ``joined``.

X of a camera is common to all of them. From the fragments whose motions agree with the robot's it is found in
closed form; it says where each fragment lies in the robot's base, and where the images were that hang together
with none. What the matches say against that stays apart. Several cameras on one arm are joined in the same
way, each with its own X, even where no image of one matches any of the other.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from handeye_fg import frames, sfm
from handeye_fg.errors import HandEyeError
from handeye_fg.frames import Array
from handeye_fg.inputs import Inputs
from handeye_fg.motions import PosePairs
from handeye_fg.parts import as_fragment, only
from handeye_fg.solvers import trusted_rows
from handeye_fg.solvers.residuals import differences
from handeye_fg.solvers.rig import typical_pose
from handeye_fg.solvers.worlds import InWorld, common_start, in_world
from handeye_fg.types import Fragment, SfmModel, folder_of, folders_of

# So many motions, all fragments together, whose residuals (radians; part of the cameras' extent) are no
# larger, place further cameras to some pixels.
_FEWEST_MOTIONS = 4
_SURE_ROTATION, _SURE_TRANSLATION = np.deg2rad(1.0), 0.02
# No pose of an image, however few its points, that is right is farther from where the robot had it.
_FAR_ROTATION, _FAR_TRANSLATION = np.deg2rad(10.0), 0.2
# Of the points of the camera's median image: less is few.
_FEW = 0.25
# So few images say nothing against what links them to the others.
_FEWEST_LINKED = 3
_FALSELY_LINKED = "its matches put it elsewhere than the robot does"
_CONTRADICTS = "placed with {} others, apart from the rest, but they do not move as the robot did"

# This part of the images is most, if it is not fewer than tell X; and so often they are chosen again by what the
# chosen ones say.
_MOST, _FEWEST_TO_TELL, _MOST_STEPS = 2.0 / 3.0, 6, 5

_X = Mapping[str, Array]
"""gripper_T_camera (4, 4), metres, of the camera of each folder of images."""

_Camera = tuple[PosePairs, Array]
"""The poses of a camera in a world, and its X (4, 4)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """A fragment beside what the robot reported; ``data``: by camera, without the poses that disagree."""

    fragment: Fragment
    data: Mapping[str, PosePairs]


def joined(model: SfmModel, inputs: Inputs, folder: Path) -> SfmModel:
    """The model with those of the missing images that robot and matches agree on.

    Args:
        model: the largest of the reconstruction's models, and what is known of the others.
        inputs: the inputs.
        folder: of the reconstruction.
    """
    start = _without_false_links(_without_cameras_elsewhere(model, inputs), inputs)
    found = _with_missing(start, inputs, folder)
    if found.names == start.names:
        return found
    # Now X is better known, and places those that were bent with what falsely linked them.
    found = _with_missing(_without_weak_links(found, inputs), inputs, folder)
    return replace(found, by_robot=len({*found.names} - {*start.names}))


def _with_missing(model: SfmModel, inputs: Inputs, folder: Path) -> SfmModel:
    """The model with those of the missing images whose matches agree with where they should be, if any."""
    if not model.unregistered:
        return model
    parts = [_part(fragment, inputs) for fragment in (as_fragment(model), *model.fragments)]
    X = _common(parts)
    home = _agreeing(parts[0], X)
    missing = [name for name, _ in model.unregistered if folder_of(name) in X]
    if home is None or not missing:
        return model
    # Where the robot says that they were; in a fragment they are nearer to each other than the robot says.
    in_base = dict(zip(missing, _by_robot(missing, inputs, X), strict=True))
    contradicting: dict[str, str] = {}
    for part in parts[1:]:
        world, fragment = _agreeing(part, X), part.fragment
        if world is None and not part.data.keys() & X.keys():
            continue
        if world is None:
            why = _CONTRADICTS.format(len(fragment.names) - 1)
            contradicting |= dict.fromkeys(fragment.names, why)
            continue
        poses = world.base_T_world @ frames.scaled(
            fragment.world_T_camera, world.metres_per_world_unit
        )
        in_base |= {
            name: pose for name, pose in zip(fragment.names, poses, strict=True) if name in in_base
        }
    base_T_camera = np.array([in_base[name] for name in missing])
    expected = frames.scaled(
        frames.inverse(home.base_T_world) @ base_T_camera, 1.0 / home.metres_per_world_unit
    )
    cameras = {
        name: camera
        for fragment in (*reversed(model.fragments), as_fragment(model))
        for name, camera in fragment.cameras.items()
    }
    full = sfm.complete(folder, model, dict(zip(missing, expected, strict=True)), cameras)
    unregistered = tuple((name, contradicting.get(name, why)) for name, why in full.unregistered)
    return replace(full, unregistered=unregistered)


def elsewhere(model: SfmModel, inputs: Inputs) -> NDArray[np.bool_]:
    """Which images (n,) are far from where the robot had them; none of a camera whose X is not sure."""
    return _far(model, inputs, _FAR_ROTATION, _FAR_TRANSLATION)


def few_points(model: SfmModel) -> NDArray[np.bool_]:
    """Which images (n,) have few points beside the others of their camera."""
    points = np.bincount(model.tracks.image_index, minlength=len(model.names))
    own = [points[model.image_camera == k] for k in range(len(model.cameras))]
    return np.asarray(points < _FEW * np.array([np.median(n) for n in own])[model.image_camera])


def _far(model: SfmModel, inputs: Inputs, rotation: float, translation: float) -> NDArray[np.bool_]:
    """Which images (n,) are farther (radians; part of the extent) from where the robot had them."""
    part = _part(as_fragment(model), inputs)
    X = _sure_ones(part)
    world = _agreeing(part, X)
    far = np.zeros(len(model.names), dtype=np.bool_)
    if world is None:
        return far
    told = np.array([folder_of(name) in X for name in model.names])
    camera = frames.scaled(model.world_T_camera[told], world.metres_per_world_unit)
    names = [name for name in model.names if folder_of(name) in X]
    angle, distance = differences(_by_robot(names, inputs, X), world.base_T_world @ camera)
    extent = _extent(part.data.values(), world)
    far[told] = (angle > rotation) | (distance > translation * extent)
    return far


def _without_weak_links(model: SfmModel, inputs: Inputs) -> SfmModel:
    """The model without images that few points hold where the robot does not have them."""
    far = _far(model, inputs, _SURE_ROTATION, _SURE_TRANSLATION) & few_points(model)
    names = [name for name, is_far in zip(model.names, far, strict=True) if is_far]
    if not names:
        return model
    kept = only(model, [name for name in model.names if name not in names])
    unregistered = (*model.unregistered, *((name, _FALSELY_LINKED) for name in names))
    return replace(kept, unregistered=unregistered)


def _by_robot(names: Sequence[str], inputs: Inputs, X: _X) -> Array:
    """Where the robot had the cameras of images: base_T_camera (n, 4, 4)."""
    return np.asarray(inputs.robot_poses(names) @ [X[folder_of(name)] for name in names])


def _moves_as_reported(fragment: Fragment, inputs: Inputs) -> NDArray[np.bool_]:
    """Which of a fragment's images (n,) have a robot pose that agrees with those of the same camera."""
    reported = inputs.robot_poses(fragment.names)
    right = np.ones(len(fragment.names), dtype=np.bool_)
    for own in _of_each_camera(fragment).values():
        data = PosePairs(base_T_gripper=reported[own], world_T_camera=fragment.world_T_camera[own])
        right[own] = trusted_rows(data, scale_known=False)
    return right


def _of_each_camera(fragment: Fragment) -> dict[str, NDArray[np.bool_]]:
    """Which of a fragment's images (n,) each camera took."""
    folders = [folder_of(name) for name in fragment.names]
    return {name: np.array([name == other for other in folders]) for name in sorted({*folders})}


def _without_cameras_elsewhere(model: SfmModel, inputs: Inputs) -> SfmModel:
    """The model without the cameras that few false matches put elsewhere than the robot does; each is a fragment.

    Each of them moves as the robot does, only not in the world of the camera with the most images: no X brings
    its images there.
    """
    part = _part(as_fragment(model), inputs)
    X = _sure_ones(part)
    lead = max(X, key=lambda name: len(part.data[name]), default="")
    home = _world([(part.data[lead], X[lead])]) if lead in X else None
    if home is None:
        return model
    extent, apart = _extent([part.data[lead]], home), []
    for name in part.data.keys() - {lead}:
        data = part.data[name]
        camera = frames.scaled(data.world_T_camera, home.metres_per_world_unit)
        X_there = typical_pose(frames.inverse(data.base_T_gripper) @ home.base_T_world @ camera)
        angle, distance = _off(data, X_there, home)
        if np.median(angle) > _FAR_ROTATION or np.median(distance) > _FAR_TRANSLATION * extent:
            apart.append(name)
    for name in sorted(apart):
        model = _split(model, [image for image in model.names if folder_of(image) == name])
    return model


def _split(model: SfmModel, names: Sequence[str]) -> SfmModel:
    """The model without falsely linked images, which are a fragment then."""
    taken = np.isin(model.names, names)
    main = as_fragment(model)
    elsewhere = Fragment(
        names=tuple(names),
        world_T_camera=model.world_T_camera[taken],
        cameras={name: main.cameras[name] for name in folders_of(names)},
    )
    kept = only(model, [name for name in model.names if name not in names])
    return replace(
        kept,
        unregistered=(*model.unregistered, *((name, _FALSELY_LINKED) for name in names)),
        fragments=(elsewhere, *model.fragments),
    )


def _without_false_links(model: SfmModel, inputs: Inputs) -> SfmModel:
    """The model in two fragments, where few false matches link images that the robot has elsewhere.

    Images whose robot poses are wrong do not move as the robot says. These do, only not beside the others.
    """
    main = as_fragment(model)
    right = _moves_as_reported(main, inputs)
    names = [name for name, is_right in zip(main.names, right, strict=True) if not is_right]
    if len(names) < _FEWEST_LINKED:
        return model
    elsewhere = replace(main, names=tuple(names), world_T_camera=main.world_T_camera[~right])
    if _agreeing(_part(elsewhere, inputs), _sure_ones(_part(main, inputs))) is None:
        return model
    return _split(model, names)


def _part(fragment: Fragment, inputs: Inputs) -> _Part:
    right = _moves_as_reported(fragment, inputs)
    reported = inputs.robot_poses(fragment.names)
    data = {
        name: PosePairs(
            base_T_gripper=reported[own & right],
            world_T_camera=fragment.world_T_camera[own & right],
        )
        for name, own in _of_each_camera(fragment).items()
    }
    return _Part(fragment=fragment, data=data)


def _common(parts: Sequence[_Part]) -> _X:
    """X of the cameras of which it is sure."""
    names = {name for part in parts for name in part.data}
    found = {
        name: _of_those_that_agree(
            [part.data[name] for part in parts if name in part.data and len(part.data[name]) > 1]
        )
        for name in sorted(names)
    }
    return {name: X for name, X in found.items() if X is not None}


def _sure_ones(part: _Part) -> _X:
    """X of the cameras of which one part is sure."""
    found = {name: _sure([data]) for name, data in part.data.items()}
    return {name: X for name, X in found.items() if X is not None}


def _of_those_that_agree(worlds: Sequence[PosePairs]) -> Array | None:
    """X (4, 4) of the worlds of one camera that agree on it; None if it is not sure.

    One that contradicts the robot must not spoil the others: the first X is that of one world, or where none
    suffices that of all.
    """
    for chosen in (*([data] for data in worlds), list(worlds)):
        X = _sure(chosen)
        agreeing = [data for data in worlds if X is not None and _world(((data, X),)) is not None]
        better = _sure(agreeing)
        if better is not None:
            return better
    return None


def _sure(worlds: Sequence[PosePairs]) -> Array | None:
    """X of one camera in some worlds if it can say where further images of it were taken.

    False matches bend what they hold: X is that of the images that agree best, which are most of them.
    """
    if sum(len(data) - 1 for data in worlds) < _FEWEST_MOTIONS:
        return None
    core = list(worlds)
    for _ in range(_MOST_STEPS):
        try:
            X = common_start(core)
        except HandEyeError:
            return None
        if all(_as_reported([(data, X)]) is not None for data in core):
            return X
        core = [
            _best([(data, X)], [(own, X)])[0][0] for data, own in zip(worlds, core, strict=True)
        ]
    return None


def _agreeing(part: _Part, X: _X) -> InWorld | None:
    """How a fragment lies in the base; None where it does not move as the robot did, or no X is known."""
    return _world([(data, X[name]) for name, data in part.data.items() if name in X])


def _world(cameras: Sequence[_Camera]) -> InWorld | None:
    """How a world lies in the base, from the poses of cameras and their X; None where most contradict it."""
    moving = core = [(data, X) for data, X in cameras if len(data) > 1]
    for _ in range(_MOST_STEPS):
        world = _as_reported(core)
        if world is not None:
            return world
        core = _best(moving, core)
    return None


def _as_reported(cameras: Sequence[_Camera]) -> InWorld | None:
    """How a world lies in the base; None where one of the poses contradicts that."""
    data = [data for data, _ in cameras]
    world = in_world(data, [X for _, X in cameras])
    if world is None:
        return None
    right = (
        world.residual_rotation < _SURE_ROTATION
        and world.residual_translation < _SURE_TRANSLATION * _extent(data, world)
    )
    return world if right else None


def _best(cameras: Sequence[_Camera], core: Sequence[_Camera]) -> list[_Camera]:
    """Of the poses in a world most, those that are nearest to what some of them say; all if there are few."""
    world = in_world([data for data, _ in core], [X for _, X in core])
    n = sum(len(data) for data, _ in cameras)
    if world is None or _MOST * n < _FEWEST_TO_TELL:
        return list(cameras)
    off = [_off(data, X, world) for data, X in cameras]
    middle = np.median(np.concatenate(off, axis=1), axis=1)[:, None]
    apart = [np.max(one / np.maximum(middle, np.finfo(float).tiny), axis=0) for one in off]
    limit = np.quantile(np.concatenate(apart), _MOST)
    return [(_rows(data, d <= limit), X) for (data, X), d in zip(cameras, apart, strict=True)]


def _rows(data: PosePairs, kept: NDArray[np.bool_]) -> PosePairs:
    """Some of the poses."""
    return PosePairs(
        base_T_gripper=data.base_T_gripper[kept], world_T_camera=data.world_T_camera[kept]
    )


def _off(data: PosePairs, X: Array, world: InWorld) -> Array:
    """How far images are from where the robot had them: angles and distances (2, n), radians and metres."""
    camera = frames.scaled(data.world_T_camera, world.metres_per_world_unit)
    return np.stack(differences(data.base_T_gripper @ X, world.base_T_world @ camera))


def _extent(data: Iterable[PosePairs], world: InWorld) -> float:
    """How far the cameras are spread, metres."""
    centres = np.concatenate([one.world_T_camera[:, :3, 3] for one in data])
    return float(world.metres_per_world_unit * np.sqrt(np.sum(np.var(centres, axis=0))))
