"""Options of a calibration: one frozen source for Python, TOML files and command-line flags.

The first paragraph under each field is its help text on the command line.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Annotated, Literal, get_args

import tyro

from handeye_fg.priors import Priors

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


@dataclass(frozen=True, slots=True, kw_only=True)
class TaskOptions:
    """What the calibration is for; it decides the verdict, not X."""

    tolerance_mm: float | None = None
    """How far off, in millimetres, a point that the camera sees may end up in the gripper's frame (the
    base's, for eye-to-hand)."""
    distance_mm: float | None = None
    """How far in front of the camera the work is, in millimetres; left out: the median distance of the scene."""
    repeatability_mm: float | None = None
    """Position repeatability that the arm's data sheet states (ISO 9283), in millimetres; the report holds the
    noise that was found against it."""

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
