"""What a plan says; entry point ``planned``."""

from collections.abc import Sequence
from dataclasses import dataclass

from handeye_fg.frames import Array
from handeye_fg.planning.candidates import Candidates
from handeye_fg.planning.expected import Expected
from handeye_fg.types import Indices, frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KeptOut:
    """Robot poses that were kept out of X, and can be used without taking an image.

    Attributes:
        count: how many.
        used: how certain X is going to be with them, before any other pose is taken.
        unused: how certain with all of the planned poses, if these are kept out again.
    """

    count: int
    used: Expected
    unused: Expected


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Plan:
    """Poses to take, the one that helps most first.

    Attributes:
        names: names (k,) for their images.
        base_T_gripper: the poses (k, 4, 4), metres.
        visible: part (k,) of the scene's points that the images there are expected to see.
        present: how certain X is now; None before the first images.
        expected: how certain X is going to be with the first, the first two, ... of the poses, and with those
            that were kept out of it.
        message: what comes of it, in words.
        camera: of several cameras the one that is least certain in the end, of which ``present`` and ``expected``
            are; "" of one.
        kept_out: robot poses that have images, but were kept out of X; None where none were.
    """

    names: tuple[str, ...]
    base_T_gripper: Array
    visible: Array
    present: Expected | None
    expected: tuple[Expected, ...]
    message: str
    camera: str = ""
    kept_out: KeptOut | None = None

    def __post_init__(self) -> None:
        n = len(self.names)
        for name, shape in (("base_T_gripper", (n, 4, 4)), ("visible", (n,))):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))


def planned(
    options: Candidates,
    chosen: Indices,
    present: Expected | None,
    expected: tuple[Expected, ...],
    name: str,
    camera: str = "",
    kept_out: KeptOut | None = None,
) -> Plan:
    """The plan of some of the poses that may be taken.

    Args:
        options: the poses that may be taken.
        chosen: which of them (k,) are.
        present: how certain X is now; None before the first images.
        expected: with the first, the first two, ... of them; or with all.
        name: of their images, with a place for the number.
        camera: of several cameras the one of which this is.
        kept_out: robot poses that were kept out of X; None where none were.
    """
    return Plan(
        names=tuple(name.format(k + 1) for k in range(len(chosen))),
        base_T_gripper=options.base_T_gripper[chosen],
        visible=options.visible[chosen].any(axis=1).mean(axis=1),
        present=present,
        expected=expected,
        message=_message(len(chosen), present, expected, camera, kept_out),
        camera=camera,
        kept_out=kept_out,
    )


def _message(
    count: int,
    present: Expected | None,
    expected: Sequence[Expected],
    camera: str,
    kept_out: KeptOut | None,
) -> str:
    """What comes of it, in words."""
    last = expected[-1]
    parts = [
        f"With {'these' if present is None else 'the'} {count} {'poses' if count > 1 else 'pose'} the largest "
        f"standard deviations {f'of {camera}, the least certain of the cameras, ' if camera else ''}are expected to be {_worst(last)}"
        + (f"; they are {_worst(present)} now." if present is not None else ".")
    ]
    if kept_out is not None:
        one = kept_out.count == 1
        parts.append(
            f"This counts in the {'robot pose' if one else f'{kept_out.count} robot poses'} that --holdout kept out "
            f"of X: {'its image is' if one else 'their images are'} there, and a calibration without --holdout is "
            f"expected to bring X to {_worst(kept_out.used)} before any pose is taken. Kept out again, "
            f"{'it leaves' if one else 'they leave'} {_worst(kept_out.unused)} in the end."
        )
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
