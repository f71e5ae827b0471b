"""Options of a calibration: one frozen source for Python, TOML files and command-line flags.

The first paragraph under each field is its help text on the command line.
"""

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import tyro

if TYPE_CHECKING:
    from handeye_fg.frames import Array

Preset = Literal["auto", "fast", "normal", "thorough"]
Pairs = Literal["auto", "all", "robot"]
Intrinsics = Literal["auto", "fixed", "prior", "free"]
Setup = Literal["eye-in-hand", "eye-to-hand"]
CameraNoise = Literal["auto", "independent", "odometry"]
PoseFormatName = Literal[
    "auto",
    "csv",
    "tum",
    "kitti",
    "euroc",
    "eth",
    "kinhec",
    "ros",
    "ur",
    "abb",
    "kuka",
    "fanuc",
    "yaskawa",
    "kawasaki",
    "mitsubishi",
    "franka",
    "matrix",
    "zivid",
    "visp",
    "moveit",
    "robot-cal-tools",
]
RotationKind = Literal[
    "auto",
    "xyzw",
    "wxyz",
    "rotation-vector",
    "matrix",
    "matrix-transposed",
    "XYZ",
    "XZY",
    "YXZ",
    "YZX",
    "ZXY",
    "ZYX",
    "XYX",
    "XZX",
    "YXY",
    "YZY",
    "ZXZ",
    "ZYZ",
    "xyz",
    "xzy",
    "yxz",
    "yzx",
    "zxy",
    "zyx",
    "xyx",
    "xzx",
    "yxy",
    "yzy",
    "zxz",
    "zyz",
]
LengthUnit = Literal["auto", "m", "mm"]
AngleUnit = Literal["auto", "deg", "rad"]
PairBy = Literal["auto", "name", "time", "nearest-time", "number", "order"]
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

    preset: Preset = "auto"
    """How many features are searched for and how finely: accuracy against time. auto: the more images,
    the fewer features each of them needs."""
    pairs: Pairs = "auto"
    """Which pairs of images are matched: all, or those that should see the same things by the robot's
    poses. auto: all of up to 30 images, by the robot of more."""
    max_features: int | None = None
    """Most features kept in an image; otherwise the preset says."""
    threads: int = 0
    """Threads to use; 0: all cores."""

    def __post_init__(self) -> None:
        if self.max_features is not None and self.max_features < 1:
            raise ValueError(f"sfm.max_features is {self.max_features}, but must be 1 or more")
        if self.threads < 0:
            raise ValueError(f"sfm.threads is {self.threads}, but must be 0 or more")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseFileOptions:
    """How a file of poses is to be read."""

    format: Annotated[PoseFormatName, tyro.conf.arg(name="pose-format")] = "auto"
    """Format of the poses; auto: recognised, and refused where several fit."""
    units: LengthUnit = "auto"
    """Unit of the positions; auto: what the file says, else the format's."""
    angles: AngleUnit = "auto"
    """Unit of angles and rotation vectors; auto: what the file says, else the format's."""
    rotation: Annotated[RotationKind, tyro.conf.arg(metavar="KIND")] = "auto"
    """What the numbers of the rotation mean, if not what the format says: xyzw or wxyz (quaternions),
    rotation-vector, matrix, matrix-transposed, or three axes: ZYX for angles about axes that turn along
    and xyz about axes that stay."""
    inverted: tyro.conf.FlagCreatePairsOff[bool] = False
    """The file holds the inverse: the pose of the base in the gripper."""
    pair_by: PairBy = "auto"
    """How poses find their images. By name: the image's name in the file. By the time in the image's name
    (time interpolates, nearest-time takes the nearest pose, for an arm that stood still). By number: that in
    the image's name is the time, or else counts the poses from 0. By order: sorted images and poses one by
    one, as many of each. auto: by name or time, never by number or order."""
    time_tolerance_s: float = 0.1
    """An image in time has its pose between two poses that are both this near, or near one."""
    convention: str = ""
    """How the poses, once read, are to be converted, such as inverted, transposed, mirrored-y or shifted+1;
    handeye-fg check names it; several separated by commas. as-given: use them unchecked, whatever the images say."""
    auto_convention: tyro.conf.FlagCreatePairsOff[bool] = False
    """Where the images show that the poses follow another convention, convert them and say so, instead of stopping."""

    def __post_init__(self) -> None:
        for name, kind in (
            ("format", PoseFormatName),
            ("units", LengthUnit),
            ("angles", AngleUnit),
            ("rotation", RotationKind),
            ("pair_by", PairBy),
        ):
            if getattr(self, name) not in get_args(kind):
                raise ValueError(
                    f"{name} is {getattr(self, name)!r}, but must be one of {', '.join(get_args(kind))}"
                )
        if not 0.0 < self.time_tolerance_s < math.inf:
            raise ValueError(
                f"time_tolerance_s is {self.time_tolerance_s}, but must be a positive number of seconds"
            )


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskOptions:
    """What the calibration is for; it decides the verdict, not X."""

    tolerance_mm: float | None = None
    """How far off, in millimetres, a point that the camera sees may end up in the gripper's frame (the
    base's, for eye-to-hand)."""
    distance_mm: float | None = None
    """How far in front of the camera the work is, in millimetres; left out: the median distance of the scene."""

    def __post_init__(self) -> None:
        for name in fields(self):
            value = getattr(self, name.name)
            if value is not None and not 0.0 < value < float("inf"):
                raise ValueError(f"task.{name.name} is {value}, but must be a positive number")


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Everything that changes a calibration, beside its input files."""

    setup: Setup = "eye-in-hand"
    """Camera on the gripper, or static camera that looks at an object on the gripper."""
    seed: int = 0
    """Seed of everything random."""
    priors: Priors = ()
    """What is known beforehand, with a standard deviation; may be given several times, adds to those of the
    --config file. The camera's position along an axis of the gripper (the base, for eye-to-hand), in metres:
    translation-along 0,0,1 0.080 0.001. Its whole pose there, with the standard deviations of rotation and
    position (- for unknown): pose X,Y,Z,QX,QY,QZ,QW DEG MM. The distance of the camera's places in two
    images, in metres: distance a.jpg b.jpg 0.250 0.0001. How right the camera file is: intrinsics
    FOCAL_PERCENT CENTRE_PX. For poses or a model that exist already, the unit
    of their world: scale METRES_PER_WORLD_UNIT STD."""
    holdout: float = 0.0
    """Part of the robot poses (such as 0.2) that is kept out of X, and predicted by it in the end: a proof
    of X and its uncertainty on data that it has not seen."""
    poses: Annotated[PoseFileOptions, tyro.conf.arg(name="")] = field(
        default_factory=PoseFileOptions
    )
    sfm: SfmOptions = field(default_factory=SfmOptions)
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    graph: GraphOptions = field(default_factory=GraphOptions)
    task: TaskOptions = field(default_factory=TaskOptions)

    def __post_init__(self) -> None:
        if not 0.0 <= self.holdout <= 0.5:
            raise ValueError(f"holdout is {self.holdout}, but must be between 0 and 0.5")
