"""What the joints of an arm reach: its chain from a URDF, and inverse kinematics within the joints' limits."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from handeye_fg import frames
from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.io.fields import reason, shown
from handeye_fg.types import frozen_array

_MOVING = ("revolute", "continuous", "prismatic")
# A pose is reached where it is met to this (radians, metres).
_MET = 1e-4
_ITERATIONS = 40
# Of so many random joint positions the nearest few to a pose are where the search for it starts.
_CLOUD, _STARTS = 3000, 6
_DAMPING, _LEAST_DAMPING = 1e-3, 1e-9
_LONGEST_STEP = 0.5  # of a joint, radians or metres
_SEED = 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Arm:
    """A chain of joints from the base to the gripper.

    Attributes:
        base_T_first: pose (4, 4) of the frame that the first joint moves, in the base, all joints at zero.
        next_T: for each joint (n, 4, 4) the pose of what follows its frame, up to the frame of the next
            joint or the gripper.
        axes: of the joints (n, 3) in their frames.
        slides: (n,) which of them slide, and do not turn.
        low, high: limits (n,), radians or metres.
    """

    base_T_first: Array
    next_T: Array
    axes: Array
    slides: NDArray[np.bool_]
    low: Array
    high: Array

    def __post_init__(self) -> None:
        n = len(self.axes)
        for name, shape in (
            ("base_T_first", (4, 4)),
            ("next_T", (n, 4, 4)),
            ("axes", (n, 3)),
            ("low", (n,)),
            ("high", (n,)),
        ):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape, name))

    def base_T_gripper(self, joints: Array) -> Array:
        """The poses (m, 4, 4) of the gripper at joint positions (m, n)."""
        return self._chain(joints)[0]

    def reachable(self, base_T_gripper: Array) -> NDArray[np.bool_]:
        """Which of the poses (m, 4, 4) the joints reach within their limits."""
        rng = np.random.default_rng(_SEED)
        cloud = rng.uniform(self.low, self.high, (_CLOUD, len(self.axes)))
        tree = KDTree(_rows(self.base_T_gripper(cloud)))
        nearest = np.asarray(tree.query(_rows(base_T_gripper), k=range(1, _STARTS + 1))[1])
        met = np.zeros(len(base_T_gripper), dtype=bool)
        for start in nearest.T:
            rest = np.flatnonzero(~met)
            met[rest] = self._met(base_T_gripper[rest], cloud[start[rest]])
        return met

    def _met(self, wanted: Array, joints: Array) -> NDArray[np.bool_]:
        """Which poses (m, 4, 4) damped Gauss-Newton steps from joint positions (m, n) come to."""
        for _ in range(_ITERATIONS):
            there, jacobian = self._chain(joints)
            error = frames.log(frames.inverse(there) @ wanted)
            transposed = np.swapaxes(jacobian, 1, 2)
            damping = _DAMPING * np.sum(error**2, axis=1) + _LEAST_DAMPING
            normal = transposed @ jacobian + damping[:, None, None] * np.eye(len(self.axes))
            step = np.linalg.solve(normal, transposed @ error[..., None])[..., 0]
            longest = np.abs(step).max(axis=1, keepdims=True)
            joints = joints + step * np.minimum(1.0, _LONGEST_STEP / np.maximum(longest, 1e-12))
            joints = np.clip(joints, self.low, self.high)
        error = frames.log(frames.inverse(self._chain(joints)[0]) @ wanted)
        return np.asarray(np.linalg.norm(error, axis=1) < _MET)

    def _chain(self, joints: Array) -> tuple[Array, Array]:
        """Poses (m, 4, 4) at joint positions (m, n), and their derivatives (m, 6, n), right perturbations."""
        m, n = joints.shape
        twists = np.where(
            self.slides[:, None],
            np.hstack([np.zeros((n, 3)), self.axes]),
            np.hstack([self.axes, np.zeros((n, 3))]),
        )
        after = np.broadcast_to(np.eye(4), (m, 4, 4))
        derivatives = np.empty((m, 6, n))
        for i in reversed(range(n)):
            after = self.next_T[i] @ after
            derivatives[:, :, i] = frames.adjoint(frames.inverse(after)) @ twists[i]
            after = frames.exp(joints[:, i, None] * twists[i]) @ after
        return self.base_T_first @ after, derivatives


def _rows(poses: Array) -> Array:
    """Poses (m, 4, 4) as points (m, 12) that are near where the poses are."""
    return poses[:, :3].reshape(-1, 12)


def read_arm(path: Path, tip: str, base: str | None = None) -> Arm:
    """The chain from a URDF.

    Args:
        path: the file.
        tip: the link whose pose the controller reports.
        base: the link in which it reports it; None: the root.

    Raises:
        InputDataError: the file is no URDF, has no such links, or yourdfpy is not installed.

    Examples:
        >>> import handeye_fg as hf
        >>> arm = hf.read_arm("arm.urdf", "tool0", "base_link")  # doctest: +SKIP
        >>> plan = hf.plan_first((0.5, 0.0, 0.0), 0.4, arm)  # doctest: +SKIP
    """
    where = f"URDF {path}"
    try:
        import yourdfpy  # type: ignore[import-untyped]  # noqa: PLC0415  # an extra, without types
    except ImportError as error:
        raise InputDataError(
            f"{where}: cannot be read without yourdfpy; install it: pip install 'handeye-fg[urdf]'"
        ) from error
    try:
        robot = yourdfpy.URDF.load(
            str(path), build_scene_graph=False, load_meshes=False, build_collision_scene_graph=False
        ).robot
    except Exception as error:  # whatever a parser of XML raises
        raise InputDataError(
            f"{where}: cannot be read ({reason(error)}); give the robot's URDF, not its xacro"
        ) from error
    by_child = {joint.child: joint for joint in robot.joints}
    links = {link.name for link in robot.links}
    for name in filter(None, (tip, base)):
        if name not in links:
            raise InputDataError(
                f"{where}: has no link {shown(name)}; choose of {', '.join(sorted(links)[:20])}"
            )
    chain = []
    link = tip
    while link != base and link in by_child:
        chain.append(by_child[link])
        link = chain[-1].parent
        if len(chain) > len(robot.joints):
            raise InputDataError(f"{where}: its links form a loop at {shown(link)}; mend the file")
    if base is not None and link != base:
        raise InputDataError(f"{where}: no joints lead from {shown(base)} to {shown(tip)}")
    return _arm(chain[::-1], where)


def _arm(chain: Sequence[Any], where: str) -> Arm:
    """The moving joints of a chain; the fixed ones between them become parts of its poses.

    Raises:
        InputDataError: nothing moves, or a joint moves in more than one way.
    """
    poses, moving = [np.eye(4)], []
    for joint in chain:
        if joint.type not in (*_MOVING, "fixed"):
            raise InputDataError(
                f"{where}: joint {shown(joint.name)} is {shown(joint.type)}, but must be fixed or one of "
                f"{', '.join(_MOVING)}; give the chain from another base or to another tip"
            )
        if joint.origin is not None:
            poses[-1] = poses[-1] @ joint.origin
        if joint.type in _MOVING:
            moving.append(joint)
            poses.append(np.eye(4))
    if not moving:
        raise InputDataError(f"{where}: no joint moves between base and tip; name other links")
    limits = np.array([_limits(joint, where) for joint in moving])
    axes = np.array([(1.0, 0.0, 0.0) if j.axis is None else j.axis for j in moving], dtype=float)
    return Arm(
        base_T_first=poses[0],
        next_T=np.array(poses[1:]),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        slides=np.array([joint.type == "prismatic" for joint in moving]),
        low=limits[:, 0],
        high=limits[:, 1],
    )


def _limits(joint: Any, where: str) -> tuple[float, float]:
    """Lowest and highest position of a joint."""
    if joint.type == "continuous":
        return -np.pi, np.pi
    low, high = getattr(joint.limit, "lower", None), getattr(joint.limit, "upper", None)
    if low is None or high is None or not low < high:
        raise InputDataError(
            f"{where}: joint {shown(joint.name)} has the limits {shown(low)} to {shown(high)}, but must have "
            "a lower and a larger upper one; add them"
        )
    return float(low), float(high)
