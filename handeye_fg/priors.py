"""What may be known beforehand of X, the scale or the intrinsics, each with its standard deviation.

On the command line a prior is its kind and a few words.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from handeye_fg.frames import Array


@dataclass(frozen=True, slots=True)
class Prior:
    """Something known of X beforehand, with its standard deviation.

    Attributes:
        kind: "translation-along": the camera's position along an axis.
        axis: unit vector in the parent frame of X (gripper, or base for eye-to-hand); normalised here.
        value: the position along the axis, metres.
        std: its standard deviation, metres.
    """

    kind: Literal["translation-along"]
    axis: tuple[float, ...]
    value: float
    std: float

    def __post_init__(self) -> None:
        if self.kind != "translation-along":
            raise ValueError(f"the prior's kind is {self.kind!r}, but must be translation-along")
        length = math.hypot(*self.axis)
        if len(self.axis) != 3 or not 0.0 < length < math.inf:
            raise ValueError(
                f"the prior's axis is {self.axis}, but must be three numbers that are not all zero"
            )
        if not math.isfinite(self.value):
            raise ValueError(f"the prior's value is {self.value}, but must be a number of metres")
        if not 0.0 < self.std < math.inf:
            raise ValueError(
                f"the prior's standard deviation is {self.std}, but must be a positive number of metres"
            )
        # A unit vector stays as it is, so that written options read back are the same.
        length = 1.0 if abs(length - 1.0) < 1e-12 else length
        object.__setattr__(self, "axis", tuple(float(x) / length for x in self.axis))


@dataclass(frozen=True, slots=True)
class PosePrior:
    """X known beforehand, or its rotation or its position alone, with standard deviations.

    Attributes:
        position: of the camera in the parent frame of X (gripper, or base for eye-to-hand), metres.
        quaternion_xyzw: its orientation there; normalised here.
        std_rotation_deg: standard deviation of the rotation about each axis; None: not known.
        std_translation_mm: standard deviation of the position along each axis; None: not known.
    """

    position: tuple[float, ...]
    quaternion_xyzw: tuple[float, ...]
    std_rotation_deg: float | None = None
    std_translation_mm: float | None = None
    kind: Literal["pose"] = "pose"

    def __post_init__(self) -> None:
        length = math.hypot(*self.quaternion_xyzw)
        if len(self.position) != 3 or not all(map(math.isfinite, self.position)):
            raise ValueError(f"the prior's position is {self.position}, but must be three numbers")
        if len(self.quaternion_xyzw) != 4 or not 0.0 < length < math.inf:
            raise ValueError(
                f"the prior's quaternion is {self.quaternion_xyzw}, but must be four numbers that are "
                "not all zero"
            )
        given = [std for std in (self.std_rotation_deg, self.std_translation_mm) if std is not None]
        if not given:
            raise ValueError("the prior of the pose has no standard deviation; give one or both")
        for std in given:
            _require_positive(std, "degrees or millimetres")
        length = 1.0 if abs(length - 1.0) < 1e-12 else length
        unit = tuple(float(q) / length for q in self.quaternion_xyzw)
        object.__setattr__(self, "quaternion_xyzw", unit)
        object.__setattr__(self, "position", tuple(map(float, self.position)))

    @staticmethod
    def of(
        matrix: "Array",
        std_rotation_deg: float | None = None,
        std_translation_mm: float | None = None,
    ) -> "PosePrior":
        """The prior around a pose (4, 4) in metres, such as that of a drawing."""
        from handeye_fg.frames import quaternion_xyzw  # noqa: PLC0415  # scipy, which help can do without

        return PosePrior(
            tuple(matrix[:3, 3].tolist()),
            tuple(quaternion_xyzw(matrix[:3, :3]).tolist()),
            std_rotation_deg,
            std_translation_mm,
        )


@dataclass(frozen=True, slots=True)
class ScalePrior:
    """The unit of the camera's world known beforehand: that of a COLMAP model, or of camera poses.

    Attributes:
        value: metres per world unit.
        std: its standard deviation.
    """

    value: float
    std: float
    kind: Literal["scale"] = "scale"

    def __post_init__(self) -> None:
        _require_positive(self.value, "metres per world unit", "value")
        _require_positive(self.std, "metres per world unit")


@dataclass(frozen=True, slots=True)
class DistancePrior:
    """The distance between the places of the camera in two images known beforehand: a known length.

    Attributes:
        images: the names of the images.
        value: the distance between the camera's centres, metres.
        std: its standard deviation, metres.
    """

    images: tuple[str, ...]
    value: float
    std: float
    kind: Literal["distance"] = "distance"

    def __post_init__(self) -> None:
        if len(set(self.images)) != 2 or len(self.images) != 2:
            raise ValueError(
                f"the prior's images are {self.images}, but must be two different names"
            )
        _require_positive(self.value, "metres", "value")
        _require_positive(self.std, "metres")


@dataclass(frozen=True, slots=True)
class CameraPrior:
    """How right the camera file is; its values are then refined with it as prior.

    Attributes:
        focal_percent: standard deviation of the focal lengths, per cent.
        centre_px: of the principal point in each direction, pixels.
    """

    focal_percent: float
    centre_px: float
    kind: Literal["intrinsics"] = "intrinsics"

    def __post_init__(self) -> None:
        _require_positive(self.focal_percent, "per cent")
        _require_positive(self.centre_px, "pixels")


AnyPrior = Prior | PosePrior | ScalePrior | DistancePrior | CameraPrior
"""What may be known beforehand, each kind told by its ``kind``."""

# For each kind the words that follow it on the command line.
_WORDS = {
    "translation-along": "X,Y,Z METRES STD",
    "pose": "X,Y,Z,QX,QY,QZ,QW STD_DEG STD_MM",
    "scale": "METRES_PER_WORLD_UNIT STD",
    "distance": "IMAGE IMAGE METRES STD",
    "intrinsics": "FOCAL_PERCENT CENTRE_PX",
}


def _require_positive(number: float, unit: str, name: str = "standard deviation") -> None:
    if not 0.0 < number < math.inf:
        raise ValueError(f"the prior's {name} is {number}, but must be a positive number of {unit}")


def _prior_of(words: list[str]) -> AnyPrior:
    """A prior from its words on the command line."""
    kind, *rest = words or [""]
    if kind not in _WORDS:
        raise ValueError(f"the prior's kind is {kind!r}, but must be one of {', '.join(_WORDS)}")
    if len(rest) != len(_WORDS[kind].split()):
        raise ValueError(f"a prior of kind {kind} is written {kind} {_WORDS[kind]}")
    match kind:
        case "translation-along":
            return Prior("translation-along", _floats(rest[0]), float(rest[1]), float(rest[2]))
        case "pose":
            pose = _floats(rest[0])
            degrees, millimetres = (None if word == "-" else float(word) for word in rest[1:])
            return PosePrior(pose[:3], pose[3:], degrees, millimetres)
        case "scale":
            return ScalePrior(float(rest[0]), float(rest[1]))
        case "intrinsics":
            return CameraPrior(float(rest[0]), float(rest[1]))
        case _:
            return DistancePrior((rest[0], rest[1]), float(rest[2]), float(rest[3]))


def _floats(word: str) -> tuple[float, ...]:
    return tuple(map(float, word.split(",")))


def _words_of(prior: AnyPrior) -> list[str]:
    """The words of a prior on the command line."""
    if isinstance(prior, PosePrior):
        pose = ",".join(map(str, (*prior.position, *prior.quaternion_xyzw)))
        stds = (prior.std_rotation_deg, prior.std_translation_mm)
        return [prior.kind, pose, *("-" if std is None else str(std) for std in stds)]
    if isinstance(prior, CameraPrior):
        return [prior.kind, str(prior.focal_percent), str(prior.centre_px)]
    first = [",".join(map(str, prior.axis))] if isinstance(prior, Prior) else []
    first += prior.images if isinstance(prior, DistancePrior) else ()
    return [prior.kind, *first, str(prior.value), str(prior.std)]


Priors = Annotated[
    tuple[
        Annotated[
            AnyPrior,
            tyro.constructors.PrimitiveConstructorSpec(
                nargs="*",
                metavar="KIND ...",
                instance_from_str=_prior_of,
                is_instance=lambda instance: isinstance(instance, AnyPrior),
                str_from_instance=_words_of,
            ),
        ],
        ...,
    ],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(name="prior"),
]
"""Priors as a flag that may be repeated, for every command that has it."""
