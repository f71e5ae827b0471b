"""Images and fragments that structure from motion left apart, joined through the robot; ``joined``.

X is common to all of them. From the fragments whose motions agree with the robot's it is found in closed
form; it says where each fragment lies in the robot's base, and where the images were that hang together
with none. What the matches say against that stays apart.
"""

from collections.abc import Sequence
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
from handeye_fg.solvers.worlds import InWorld, common_start, in_world
from handeye_fg.types import Fragment, SfmModel, folders_of

# So many motions, all fragments together, whose residuals (radians; part of the cameras' extent) are no
# larger, place further cameras to some pixels.
_FEWEST_MOTIONS = 4
_SURE_ROTATION, _SURE_TRANSLATION = np.deg2rad(1.0), 0.02
# No pose of an image, however few its points, that is right is farther from where the robot had it.
_FAR_ROTATION, _FAR_TRANSLATION = np.deg2rad(10.0), 0.2
# So few images say nothing against what links them to the others.
_FEWEST_LINKED = 3
_FALSELY_LINKED = "its matches put it elsewhere than the robot does"
_CONTRADICTS = "placed with {} others, apart from the rest, but they do not move as the robot did"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Part:
    """A fragment beside what the robot reported; ``data`` without the poses that disagree."""

    fragment: Fragment
    data: PosePairs


def joined(model: SfmModel, inputs: Inputs, folder: Path) -> SfmModel:
    """The model with those of the missing images that robot and matches agree on.

    Args:
        model: the largest of the reconstruction's models, and what is known of the others.
        inputs: the inputs.
        folder: of the reconstruction.
    """
    if len(folders_of(inputs.names)) > 1:  # X is of one camera
        return model
    model = _without_false_links(model, inputs)
    missing = [name for name, _ in model.unregistered]
    if not missing:
        return model
    main = as_fragment(model)
    parts = [_part(fragment, inputs) for fragment in (main, *model.fragments)]
    X = _common(parts)
    home = None if X is None else _agreeing(parts[0], X)
    if X is None or home is None:
        return model
    # Where the robot says that they were; in a fragment they are nearer to each other than the robot says.
    in_base = dict(zip(missing, inputs.robot_poses(missing) @ X, strict=True))
    contradicting: dict[str, str] = {}
    for part in parts[1:]:
        world, fragment = _agreeing(part, X), part.fragment
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
    full = sfm.complete(folder, model, dict(zip(missing, expected, strict=True)))
    return replace(
        full,
        unregistered=tuple((name, contradicting.get(name, why)) for name, why in full.unregistered),
        by_robot=len(full.names) - len(model.names),
    )


def elsewhere(model: SfmModel, inputs: Inputs) -> NDArray[np.bool_]:
    """Which images (n,) of one camera are far from where the robot had it; none where X is not sure."""
    part = _part(as_fragment(model), inputs)
    X = _sure([part])
    world = None if X is None else _agreeing(part, X)
    if X is None or world is None:
        return np.zeros(len(model.names), dtype=np.bool_)
    camera = frames.scaled(model.world_T_camera, world.metres_per_world_unit)
    angle, distance = differences(inputs.robot_poses(model.names) @ X, world.base_T_world @ camera)
    return np.asarray(
        (angle > _FAR_ROTATION) | (distance > _FAR_TRANSLATION * _extent(part, world))
    )


def _moves_as_reported(fragment: Fragment, inputs: Inputs) -> NDArray[np.bool_]:
    """Which of a fragment's images (n,), of one camera, have a robot pose that agrees with the others'."""
    reported = inputs.robot_poses(fragment.names)
    data = PosePairs(base_T_gripper=reported, world_T_camera=fragment.world_T_camera)
    return trusted_rows(data, scale_known=False)


def _without_false_links(model: SfmModel, inputs: Inputs) -> SfmModel:
    """The model in two fragments, where few false matches link images that the robot has elsewhere.

    Images whose robot poses are wrong do not move as the robot says. These do, only not beside the others.
    """
    main = as_fragment(model)
    right = _moves_as_reported(main, inputs)
    names = [name for name, is_right in zip(main.names, right, strict=True) if not is_right]
    if len(names) < _FEWEST_LINKED:
        return model
    elsewhere = Fragment(names=tuple(names), world_T_camera=main.world_T_camera[~right])
    X = _sure([_part(main, inputs)])
    if X is None or _agreeing(_part(elsewhere, inputs), X) is None:
        return model
    kept = only(model, [name for name in main.names if name not in names])
    return replace(
        kept,
        unregistered=(*model.unregistered, *((name, _FALSELY_LINKED) for name in names)),
        fragments=(elsewhere, *model.fragments),
    )


def _part(fragment: Fragment, inputs: Inputs) -> _Part:
    right = _moves_as_reported(fragment, inputs)
    reported = inputs.robot_poses(fragment.names)[right]
    data = PosePairs(base_T_gripper=reported, world_T_camera=fragment.world_T_camera[right])
    return _Part(fragment=fragment, data=data)


def _common(parts: Sequence[_Part]) -> Array | None:
    """X (4, 4) of the fragments that agree on it; None if it is not sure.

    A fragment that contradicts the robot must not spoil the others: the first X is that of one
    fragment, or where none suffices that of all.
    """
    for chosen in (*([part] for part in parts), list(parts)):
        X = _sure(chosen)
        agreeing = [part for part in parts if X is not None and _agreeing(part, X) is not None]
        better = _sure(agreeing)
        if better is not None:
            return better
    return None


def _sure(parts: Sequence[_Part]) -> Array | None:
    """X of fragments if it can say where further cameras were."""
    if sum(len(part.data) - 1 for part in parts) < _FEWEST_MOTIONS:
        return None
    try:
        X = common_start([part.data for part in parts])
    except HandEyeError:
        return None
    return X if all(_agreeing(part, X) is not None for part in parts) else None


def _agreeing(part: _Part, X: Array) -> InWorld | None:
    """How a fragment lies in the base; None where it does not move as the robot did."""
    world = in_world(part.data, X)
    if world is None:
        return None
    right = (
        world.residual_rotation < _SURE_ROTATION
        and world.residual_translation < _SURE_TRANSLATION * _extent(part, world)
    )
    return world if right else None


def _extent(part: _Part, world: InWorld) -> float:
    """How far the cameras are spread, metres."""
    centres = world.metres_per_world_unit * part.data.world_T_camera[:, :3, 3]
    return float(np.sqrt(np.sum(np.var(centres, axis=0))))
