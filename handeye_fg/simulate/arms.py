"""A six-axis arm whose links are not quite as its controller believes; entry point ``simulate_arm_scene``.

The arm is a UR5 by its Denavit-Hartenberg parameters. Its inverse kinematics are closed (eight solutions a
pose; R. S. Andersen, "Kinematics of a UR5", Aalborg University, 2018).
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from handeye_fg.frames import Array, inverse
from handeye_fg.simulate.scenes import (
    ROBOT_ROTATION_SIGMA,
    ROBOT_TRANSLATION_SIGMA,
    Scene,
    Truth,
    default_camera,
    disturbed,
    scene_of,
    truth_of,
)
from handeye_fg.types import RobotPoses

_SPARE = 3  # times as many poses are drawn as are asked for, since an arm does not reach all


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """Denavit-Hartenberg parameters of six joints, each (6,): metres and radians.

    The pose of frame i in frame i-1 is ``RotZ(q + theta) TransZ(d) TransX(a) RotX(alpha)``.
    """

    a: Array
    d: Array
    alpha: Array
    theta: Array

    def base_T_gripper(self, joints: Array) -> Array:
        """Poses (n, 4, 4) for joint angles (n, 6)."""
        result = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        for i in range(6):
            result = result @ self._link(i, joints[:, i])
        return result

    def disturbed(self, rng: np.random.Generator, length_sigma: float, angle_sigma: float) -> "Arm":
        """The same arm with errors of all parameters: metres for lengths, radians for angles."""
        noise = rng.standard_normal((4, 6))
        return Arm(
            a=self.a + length_sigma * noise[0],
            d=self.d + length_sigma * noise[1],
            alpha=self.alpha + angle_sigma * noise[2],
            theta=self.theta + angle_sigma * noise[3],
        )

    def joints(self, base_T_gripper: Array, signs: Array) -> Array:
        """Joint angles (n, 6) of poses (n, 4, 4); NaN out of reach. For the undisturbed UR5 only.

        Args:
            base_T_gripper: the poses.
            signs: +1 or -1 (n, 3): of shoulder, elbow and wrist.
        """
        with np.errstate(invalid="ignore"):
            return self._joints(base_T_gripper, signs)

    def _joints(self, poses: Array, signs: Array) -> Array:
        d4, d6, a2, a3 = self.d[3], self.d[5], self.a[1], self.a[2]
        shoulder, elbow, wrist = signs.T
        wrist_centre = poses[:, :3, 3] - d6 * poses[:, :3, 2]
        reach = np.hypot(wrist_centre[:, 0], wrist_centre[:, 1])
        azimuth = np.arctan2(wrist_centre[:, 1], wrist_centre[:, 0])
        q1 = azimuth + shoulder * np.arccos(d4 / reach) + np.pi / 2
        across = poses[:, 0, 3] * np.sin(q1) - poses[:, 1, 3] * np.cos(q1)
        q5 = wrist * np.arccos((across - d4) / d6)
        link1_T_gripper = inverse(self._link(0, q1)) @ poses
        gripper_T_link1 = inverse(link1_T_gripper)
        side = np.sign(np.sin(q5))
        q6 = np.arctan2(-gripper_T_link1[:, 1, 2] * side, gripper_T_link1[:, 0, 2] * side)
        hand = self._link(4, q5) @ self._link(5, q6)
        link1_T_link4 = link1_T_gripper @ inverse(hand)
        x, y = (link1_T_link4[:, :3, 3] - d4 * link1_T_link4[:, :3, 1]).T[:2]
        square = x**2 + y**2
        q3 = elbow * np.arccos((square - a2**2 - a3**2) / (2.0 * a2 * a3))
        q2 = -np.arctan2(y, -x) + np.arcsin(a3 * np.sin(q3) / np.sqrt(square))
        upper = self._link(1, q2) @ self._link(2, q3)
        link3_T_link4 = inverse(upper) @ link1_T_link4
        q4 = np.arctan2(link3_T_link4[:, 1, 0], link3_T_link4[:, 0, 0])
        return np.stack([q1, q2, q3, q4, q5, q6], axis=1)

    def _link(self, i: int, angle: Array) -> Array:
        """Pose of frame i + 1 in frame i (n, 4, 4)."""
        c, s = np.cos(angle + self.theta[i]), np.sin(angle + self.theta[i])
        ca, sa = np.cos(self.alpha[i]), np.sin(self.alpha[i])
        zero, one = np.zeros_like(c), np.ones_like(c)
        rows = [c, -s * ca, s * sa, self.a[i] * c]
        rows += [s, c * ca, -c * sa, self.a[i] * s]
        rows += [zero, sa * one, ca * one, self.d[i] * one, zero, zero, zero, one]
        return np.stack(rows, axis=1).reshape(-1, 4, 4)


_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))

UR5 = Arm(
    a=np.array([0.0, -0.425, -0.39225, 0.0, 0.0, 0.0]),
    d=np.array([0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823]),
    alpha=np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0]),
    theta=np.zeros(6),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkErrors:
    """How far an arm's links are off.

    Attributes:
        length: standard deviation of its lengths (a and d), metres.
        angle: of its angles (alpha and theta), radians.
        one_configuration: whether shoulder, elbow and wrist stay on the same side, as most controllers
            have it; else each pose is reached by any of the solutions.
    """

    length: float
    angle: float
    one_configuration: bool = True


def simulate_arm_scene(
    rng: np.random.Generator,
    errors: LinkErrors,
    *,
    n_images: int = 15,
    n_points: int = 300,
    pixel_sigma: float = 0.3,
    robot_rotation_sigma: float = ROBOT_ROTATION_SIGMA,
    robot_translation_sigma: float = ROBOT_TRANSLATION_SIGMA,
    start_sigma: float = 1e-3,
) -> Scene:
    """Simulate a camera on a UR5 with link errors, which looks at a desk with relief.

    With T the forward kinematics as the controller has them and E as they are, the pose at joint angles
    q is E(q) and T(q) is reported; here the error at the angles of the exact arm is taken, which is the
    same to first order.

    Args:
        rng: the source of all randomness.
        errors: of the links.
        n_images: number of images, all registered.
        n_points: number of scene points, as in ``simulate_scene``.
        pixel_sigma: standard deviation of an observation, per axis, pixels.
        robot_rotation_sigma: of the noise beside the link errors, as in ``simulate_scene``, radians.
        robot_translation_sigma: likewise, metres.
        start_sigma: how far the model's poses and points are from the truth, as in ``simulate_scene``.
    """
    truth, joints = _within_reach(rng, n_images, errors)
    scene = scene_of(
        rng,
        truth,
        default_camera(),
        n_points=n_points,
        pixel_sigma=pixel_sigma,
        robot_rotation_sigma=robot_rotation_sigma,
        robot_translation_sigma=robot_translation_sigma,
        visibility=1.0,
        start_sigma=start_sigma,
    )
    imperfect = UR5.disturbed(rng, errors.length, errors.angle)
    gripper_T_base = inverse(imperfect.base_T_gripper(joints))
    shown = truth.base_T_gripper @ gripper_T_base @ truth.base_T_gripper
    reported = disturbed(rng, shown, robot_rotation_sigma, robot_translation_sigma)
    poses = RobotPoses(names=scene.model.names, base_T_gripper=reported)
    return replace(scene, robot_poses=poses)


def _within_reach(rng: np.random.Generator, n: int, errors: LinkErrors) -> tuple[Truth, Array]:
    """A truth, and the joint angles (n, 6) of its poses."""
    while True:
        truth = truth_of(rng, _SPARE * n, "general")
        joints = _joints(rng, truth.base_T_gripper, errors)
        reached = np.flatnonzero(np.isfinite(joints).all(axis=1))[:n]
        if len(reached) == n:
            kept = replace(
                truth,
                base_T_gripper=truth.base_T_gripper[reached],
                world_T_camera=truth.world_T_camera[reached],
            )
            return kept, joints[reached]


def _joints(rng: np.random.Generator, base_T_gripper: Array, errors: LinkErrors) -> Array:
    """Joint angles (n, 6) with which a UR5 reaches poses (n, 4, 4); NaN where it does not."""
    n = len(base_T_gripper)
    if errors.one_configuration:
        return UR5.joints(base_T_gripper, np.tile(rng.choice([-1.0, 1.0], 3), (n, 1)))
    result = np.full((n, 6), np.nan)
    for which in rng.permuted(np.tile(np.arange(len(_SIGNS)), (n, 1)), axis=1).T:
        signs = _SIGNS[which]
        missing = np.isnan(result).any(axis=1)
        result[missing] = UR5.joints(base_T_gripper[missing], signs[missing])
    return result
