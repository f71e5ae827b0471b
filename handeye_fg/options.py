"""Options of a calibration: one frozen source for Python, TOML files and command-line flags.

The first paragraph under each field is its help text on the command line.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Annotated, Literal

import tyro

Intrinsics = Literal["auto", "fixed", "prior", "free"]
Setup = Literal["eye-in-hand", "eye-to-hand"]
CameraNoise = Literal["auto", "independent", "odometry"]
MethodName = Literal[
    "andreff_scale",
    "andreff",
    "daniilidis",
    "horaud_dornaika",
    "li",
    "park_martin",
    "pose_graph",
    "shah",
    "tsai_lenz",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class SfmOptions:
    """Structure from motion."""

    max_features: int = 8192
    """Most features kept in an image."""
    threads: int = 0
    """Threads to use; 0: all cores."""

    def __post_init__(self) -> None:
        if self.max_features < 1:
            raise ValueError(f"sfm.max_features is {self.max_features}, but must be 1 or more")
        if self.threads < 0:
            raise ValueError(f"sfm.threads is {self.threads}, but must be 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotNoise:
    """Known noise levels of the robot; what is left out is estimated from the data."""

    robot_rotation_deg: float | None = None
    """Standard deviation of a reported robot orientation, per axis, in degrees."""
    robot_translation_mm: float | None = None
    """Standard deviation of a reported robot position, per axis, in millimetres."""

    def __post_init__(self) -> None:
        for name in fields(self):
            value = getattr(self, name.name)
            if value is not None and not 0.0 < value < float("inf"):
                raise ValueError(f"noise.{name.name} is {value}, but must be a positive number")

    @property
    def estimated(self) -> bool:
        """Whether a level is left to the data."""
        return any(getattr(self, name.name) is None for name in fields(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseOptions(RobotNoise):
    """Known noise levels; what is left out is estimated from the data."""

    pixel_px: float | None = None
    """Standard deviation of an image observation in pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GraphOptions:
    """Joint refinement."""

    intrinsics: Intrinsics = "auto"
    """What to do with the camera file's intrinsics: keep them (fixed), refine them near the file's
    values (prior), refine them freely (free), or keep them unless the images contradict them (auto).
    Without a camera file they are always refined freely."""
    max_iterations: int = 100
    """Most iterations of one optimisation."""

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise ValueError(
                f"graph.max_iterations is {self.max_iterations}, but must be 1 or more"
            )


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


def _prior_of(words: list[str]) -> Prior:
    """A prior from its words on the command line: KIND X,Y,Z METRES STD."""
    kind, axis, value, std = words
    # The ignored type: the prior itself checks its kind.
    return Prior(kind, tuple(map(float, axis.split(","))), float(value), float(std))  # type: ignore[arg-type]


def _words_of(prior: Prior) -> list[str]:
    """The words of a prior on the command line."""
    return [prior.kind, ",".join(map(str, prior.axis)), str(prior.value), str(prior.std)]


Priors = Annotated[
    tuple[
        Annotated[
            Prior,
            tyro.constructors.PrimitiveConstructorSpec(
                nargs=4,
                metavar="KIND X,Y,Z METRES STD",
                instance_from_str=_prior_of,
                is_instance=lambda instance: isinstance(instance, Prior),
                str_from_instance=_words_of,
            ),
        ],
        ...,
    ],
    tyro.conf.UseAppendAction,
    tyro.conf.arg(name="prior"),
]
"""Priors as a flag that may be repeated, for every command that has it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Everything that changes a calibration, beside its input files."""

    setup: Setup = "eye-in-hand"
    """Camera on the gripper, or static camera that looks at an object on the gripper."""
    seed: int = 0
    """Seed of everything random."""
    priors: Priors = ()
    """What is known of the camera's pose beforehand, such as --prior translation-along 0,0,1 0.080 0.001:
    the camera's position along the gripper's z axis (the base's, for eye-to-hand) is 0.080 m, with a
    standard deviation of 0.001 m. May be given several times; adds to those of the --config file."""
    sfm: SfmOptions = field(default_factory=SfmOptions)
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    graph: GraphOptions = field(default_factory=GraphOptions)
