"""What solvers and refinement find: a start, noise levels, how certain they are, and what stays open.

Frozen values that cross module borders, as those of ``handeye_fg.types``.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from handeye_fg.frames import Array
from handeye_fg.types import frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinearStart:
    """A closed-form answer, before any noise model.

    Attributes:
        method: the solver's name.
        gripper_T_camera: X (4, 4), metres.
        base_T_world: Z (4, 4), metres: base_T_gripper X = Z scaled(world_T_camera); None for motions.
        metres_per_world_unit: the scale, positive.
        residual_rotation, residual_translation: root mean square over the motion pairs of the
            angle (radians) and the length (metres) of A X against X B.
        first_T_cameras: where there are several cameras, the pose of each in the first (k, 4, 4),
            metres.
        trusted: (n,) which of the given rows agree with each other and were solved; None: all.
    """

    method: str
    gripper_T_camera: Array
    base_T_world: Array | None
    metres_per_world_unit: float
    residual_rotation: float
    residual_translation: float
    first_T_cameras: Array | None = None
    trusted: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        for name, shape in (
            ("gripper_T_camera", (4, 4)),
            ("base_T_world", (4, 4)),
            ("first_T_cameras", (None, 4, 4)),
        ):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))
        if self.trusted is not None:
            trusted = np.array(self.trusted, dtype=np.bool_)
            trusted.setflags(write=False)
            object.__setattr__(self, "trusted", trusted)


@dataclass(frozen=True, slots=True, kw_only=True)
class SecondStart:
    """What a second optimisation from a start far off came to.

    Attributes:
        agrees: whether it reached the same optimum, within a tenth of X's standard deviation.
        restarted: whether an earlier second start had found a better optimum, which then was the start.
        rotation, translation: how far apart the two optima have X, radians and metres.
    """

    agrees: bool
    restarted: bool
    rotation: float
    translation: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseLevels:
    """Standard deviations per axis.

    Attributes:
        pixel: of an observation, pixels; NaN without images.
        robot_rotation: of a reported robot pose, radians.
        robot_translation: of a reported robot pose, metres.
        estimated: whether they were found from the data (else given by the user).
        corner: of an observed corner of a known target, pixels; None without target.
        image_inflation: variance of what the images say together, over that of independent errors of
            the size ``pixel``: neighbouring features err alike.
    """

    pixel: float
    robot_rotation: float
    robot_translation: float
    estimated: bool
    corner: float | None = None
    image_inflation: float = 1.0

    @property
    def image_sigma(self) -> float:
        """Standard deviation with which an observation counts, pixels."""
        return self.pixel * math.sqrt(self.image_inflation)

    @property
    def corner_image_sigma(self) -> float:
        """Standard deviation with which a corner counts, pixels; 1 without target.

        What makes features err alike, such as a lens that is not quite its model, makes corners do so.
        """
        return 1.0 if self.corner is None else self.corner * math.sqrt(self.image_inflation)


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotErrors:
    """Whether the robot's errors are white noise, and what was done if not.

    Attributes:
        white: whether they may be.
        probability: of residuals as structured as these if they are.
        resampled_ratio: the largest ratio of a standard deviation of X that comes from leaving out blocks
            of poses to that of the model; None where white.
        hidden_rotation, hidden_translation: standard deviation, an axis, that was added for errors of the
            arm that no residual shows, radians and metres; None where white.
        reason: why the covariance is what it is, in words.
    """

    white: bool
    probability: float
    resampled_ratio: float | None
    hidden_rotation: float | None
    hidden_translation: float | None
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LevelCertainty:
    """How certain a noise level is.

    Attributes:
        degrees_of_freedom: effective; infinite where the user gave the level.
        low, high: ends of its 95 % interval, as multiples of it.
        source: what decided it: the data, a weak prior where they say next to nothing, or the user.
        found: where the user gave the level, that of the residuals, as a multiple of it, with the ends of its
            95 % interval; else None.
    """

    degrees_of_freedom: float
    low: float
    high: float
    source: Literal["data", "prior", "user"]
    found: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherIntrinsics:
    """X as it is with the other choice of intrinsics: fixed at the given values, or free.

    It is found by one linear step, on the subspace that the data determine.

    Attributes:
        kind: which choice it is: "free" where the intrinsics were kept, "fixed" where they were refined.
        gripper_T_camera: X (4, 4), metres.
        covariance: of X (6, 6), as that of the result.
        shift_rotation, shift_translation: how far it is from X of the result, radians and metres.
        shift_sigma: root mean square of the change in units of its own standard deviations, over the
            directions in which X can change: 1 on average where the given intrinsics are right.
    """

    kind: Literal["free", "fixed"]
    gripper_T_camera: Array
    covariance: Array
    shift_rotation: float
    shift_translation: float
    shift_sigma: float

    def __post_init__(self) -> None:
        for name, size in (("gripper_T_camera", 4), ("covariance", 6)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (size, size), name))


@dataclass(frozen=True, slots=True, kw_only=True)
class FocalOffset:
    """How focal length and the camera's position along its optical axis are tied to each other.

    Attributes:
        correlation: of the two where the intrinsics are unknowns.
        std_factor: how many times as certain the position is where the focal length is known.
        metres_per_percent: how far the position moves if the focal length is one per cent larger.
        confounded: whether the data hardly tell them apart.
    """

    correlation: float
    std_factor: float
    metres_per_percent: float
    confounded: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeDirection:
    """One direction that the data leave undetermined.

    Attributes:
        kind: "rotation", "translation" or "scale".
        vector: unit vector (3,) in ``frame``; for a scale the direction in which the camera's
            position changes with it, zeros if it does not.
        frame: the frame of the vector, the parent of X.
        description: one sentence for a person, with the remedy.
    """

    kind: Literal["rotation", "translation", "scale"]
    vector: Array
    frame: str
    description: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "vector", frozen_array(self.vector, (3,), "vector"))
