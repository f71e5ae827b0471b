"""Robot and camera poses with noise made as physics makes it, not as the graph models it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from handeye_fg.findings import LinearStart
from handeye_fg.frames import Array, exp, inverse, pose, scaled
from handeye_fg.graph.poses import CameraNoise, Component
from handeye_fg.motions import PosePairs
from handeye_fg.simulate import Motion, simulate_poses
from handeye_fg.solvers import METHODS, start_of

LEVELS: Mapping[Component, float] = {
    "robot_rotation": float(np.deg2rad(0.1)),
    "robot_translation": 5e-4,
    "camera_rotation": float(np.deg2rad(0.15)),
    "camera_across": 4e-4,
    "camera_along": 1.2e-3,
    "odometry_rotation": float(np.deg2rad(0.1)),
    "odometry_translation": 1e-3,
    "scale_drift": 0.0,
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulated:
    """Poses with noise, and the truth.

    Attributes:
        data: robot and camera poses.
        gripper_T_camera, base_T_world: X and Z.
        unit: metres per world unit, that of the first pose where the scale drifts.
        scale_known: whether the unit is one metre.
        inverted: whether the robot's poses are gripper_T_base.
    """

    data: PosePairs
    gripper_T_camera: Array
    base_T_world: Array
    unit: float
    scale_known: bool
    inverted: bool

    def with_data(self, **changes: Array) -> "Simulated":
        """The same truth with other poses."""
        return replace(self, data=replace(self.data, **changes))

    def start(self) -> LinearStart:
        """The closed form's answer."""
        method = "li" if self.scale_known else "andreff_scale"
        return start_of(self.data, METHODS[method].solve(self.data), method)


def simulated(
    seed: int,
    n: int,
    *,
    camera: CameraNoise = "independent",
    scale_known: bool = True,
    inverted: bool = False,
    motion: Motion = "general",
    tails: float | None = None,
    in_camera: bool = False,
    **levels: float,
) -> Simulated:
    """Poses of a camera that looks at a target: the world's origin.

    Args:
        seed: of all randomness.
        n: number of poses.
        camera: whether each pose has noise, or each motion.
        scale_known: whether the world's unit is the metre.
        inverted: the robot's poses are gripper_T_base.
        motion: of the gripper.
        tails: degrees of freedom of Student's t, by which the noise is distributed; None: normal.
        in_camera: the camera's noise turns the camera about itself, not what it sees.
        levels: standard deviations other than ``LEVELS`` (of Student's t: scale parameters).
    """
    rng = np.random.default_rng(seed)
    sigma = {**LEVELS, **levels}
    _, _, truth = simulate_poses(rng, n_poses=n, motion=motion)
    unit = 1.0 if scale_known else truth.metres_per_world_unit
    X, A = truth.gripper_T_camera, truth.base_T_gripper
    # The target lies where the cameras look: about half a metre in front of the robot.
    Z = pose(truth.base_T_world[:3, :3], np.array([0.5, 0.0, 0.05]))
    world_T_camera = inverse(Z) @ A @ X

    def noise(*components: Component) -> Array:
        size = np.repeat([sigma[name] for name in components], 6 // len(components))
        draw = rng.standard_normal((n, 6)) if tails is None else rng.standard_t(tails, (n, 6))
        return size * draw

    robot_noise = exp(noise("robot_rotation", "robot_translation"))
    reported = robot_noise @ A if inverted else A @ robot_noise
    if camera == "independent":
        error = noise("camera_rotation", "camera_across")
        error[:, 5] *= sigma["camera_along"] / sigma["camera_across"]
        camera_T_world = inverse(world_T_camera)
        turned = camera_T_world[:, :3, :3] @ exp(error * [1, 1, 1, 0, 0, 0])[:, :3, :3]
        seen = inverse(pose(turned, camera_T_world[:, :3, 3] + error[:, 3:]))
        seen = world_T_camera @ exp(error) if in_camera else seen
    else:
        motions = inverse(world_T_camera[:-1]) @ world_T_camera[1:]
        motions = motions @ exp(noise("odometry_rotation", "odometry_translation")[1:])
        poses = [world_T_camera[0]]
        for step in motions:
            poses.append(poses[-1] @ step)
        seen = np.array(poses)
    drift = np.concatenate([[0.0], np.cumsum(sigma["scale_drift"] * rng.standard_normal(n - 1))])
    seen = scaled(seen, np.exp(-drift)[:, None] / unit)
    return Simulated(
        data=PosePairs(base_T_gripper=reported, world_T_camera=seen),
        gripper_T_camera=X,
        base_T_world=Z,
        unit=unit,
        scale_known=scale_known,
        inverted=inverted,
    )


@pytest.fixture(scope="session", name="simulated")
def simulated_fixture():
    """The function ``simulated``."""
    return simulated


@pytest.fixture(scope="session")
def levels():
    """Standard deviations in ``simulated``, unless it is told others."""
    return {name: sigma for name, sigma in LEVELS.items() if sigma > 0.0}


@pytest.fixture(scope="session")
def no_noise():
    """Levels of exact poses; the sigma across divides, so that it is not quite zero."""
    return dict.fromkeys(LEVELS, 0.0) | {"camera_across": 1e-300}
