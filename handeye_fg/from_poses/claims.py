"""Whether pose pairs are as they are said to be: what is wrong where they contradict; entry ``agreed_answer``.

Robot and camera stand on the two sides of one equation, A X = X B, so that either may be the one that is read
wrongly. An inverse of the one, an inverse of the other and the other setup are the same to it: only the length
of X tells which is likelier.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from handeye_fg.conventions import (
    AS_GIVEN,
    UNITS,
    Reading,
    Verdict,
    converted,
    extent_of,
    file_readings,
    judge,
    sentence,
)
from handeye_fg.errors import ConvergenceError, HandEyeError, InputDataError
from handeye_fg.frames import Array, inverse
from handeye_fg.from_poses.answer import Answer
from handeye_fg.from_poses.solution import Method, answer_of
from handeye_fg.io.pose_pairs import NamedPairs
from handeye_fg.io.poses import PoseFile
from handeye_fg.motions import PosePairs
from handeye_fg.options import PoseFileOptions
from handeye_fg.types import Indices, RobotPoses, Setup

# No camera is so near to its gripper, or so far from gripper or base (metres): the unit is another.
_NEAREST, _FARTHEST = 1e-3, 5.0
# Agreement that raises no question: radians, part of the extent (root mean squares over motions).
_USUAL_ROTATION, _USUAL_TRANSLATION = math.radians(5.0), 0.1
# More rows say no more, and take long.
_MOST_ROWS = 150
# Among hundreds of readings one fits so few rows by chance.
_FEWEST_ROWS = 6
# Of two explanations one that leaves so many times the other's angles is none.
_WORSE = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Converted:
    """By which convention the robot's poses were taken although they were given otherwise.

    Attributes:
        convention: its name; "": as given.
        note: the same in a sentence, for the message.
    """

    convention: str = ""
    note: str = ""


def as_meant(pairs: NamedPairs, robot: str, camera: str, setup: Setup) -> NamedPairs:
    """The pairs, read by the conventions that the user names.

    Args:
        pairs: as they were read.
        robot: names for the robot's poses, as for ``--convention``; "": none.
        camera: for the camera's.
        setup: for eye-to-hand the robot's poses in the pairs are inverses.

    Raises:
        InputDataError: there is no such convention, or the rows are motions.
    """
    if not (robot or camera):
        return pairs
    if not isinstance(pairs.data, PosePairs):
        raise InputDataError(
            f"convention {robot or camera!r} is of poses, but the rows are motions; convert the poses before "
            "the motions are made of them"
        )
    taken = converted(_robot_poses(pairs, setup), robot).base_T_gripper
    seen = converted(_camera_poses(pairs), camera).base_T_gripper
    return _with(pairs, taken, seen, setup)


def agreed_answer(
    pairs: NamedPairs, method: Method, setup: Setup, options: PoseFileOptions
) -> tuple[Answer, NamedPairs, Converted]:
    """X of pairs in which robot and camera agree; with ``auto_convention`` once they are converted.

    Args:
        pairs: the pairs.
        method: how X is to be found.
        setup: camera on the gripper, or static camera.
        options: of the robot's poses.

    Raises:
        HandEyeError: as ``answer_of``; of poses that follow another convention an InputDataError that names it.
    """
    failure: HandEyeError | None = None
    answer: Answer | None = None
    try:
        answer = answer_of(pairs.data, method)
    except (ConvergenceError, InputDataError) as error:
        failure = error
    if answer is not None and _is_plausible(answer.gripper_T_camera) and _agrees(answer, pairs):
        return answer, pairs, Converted()
    unasked = AS_GIVEN in options.convention.split(",") or not isinstance(pairs.data, PosePairs)
    found = None if unasked else _diagnosis(pairs, setup)
    if found is None:
        if answer is None:
            raise failure or ConvergenceError("robot and camera contradict each other")
        return answer, pairs, Converted()
    words, robot = found
    if robot is None or not (options.auto_convention and robot.fixable):
        raise InputDataError(words) from failure
    poses = robot.converted(_robot_poses(pairs, setup)).base_T_gripper
    right = _with(pairs, poses, _camera_poses(pairs).base_T_gripper, setup)
    looks, *_ = words.split(";")
    note = f"Y{looks[1:]}, and were taken as such (--auto-convention: {robot.convention})."
    return answer_of(right.data, method), right, Converted(convention=robot.convention, note=note)


def _diagnosis(pairs: NamedPairs, setup: Setup) -> tuple[str, Verdict | None] | None:
    """What the poses look like, in a sentence, with the verdict if that is of the robot's; None: nothing known."""
    rows = np.unique(np.linspace(0, len(pairs.names) - 1, _MOST_ROWS).astype(np.intp))
    if len(rows) < _FEWEST_ROWS:
        return None
    robot, camera = _robot_poses(pairs, setup), _camera_poses(pairs)
    in_equations = robot.base_T_gripper if setup == "eye-in-hand" else inverse(robot.base_T_gripper)
    # What the robot's poses are the camera's tell, and the other way round.
    taken = _judged(robot, camera.base_T_gripper, rows, setup, pairs.files.get("robot"))
    seen = _judged(
        camera, in_equations, rows, "eye-in-hand", pairs.files.get("camera"), units=False
    )
    found = [
        _Explanation(verdict=taken, of="robot", unit=UNITS.get(taken.unit, 1.0)),
        _Explanation(
            verdict=seen, of="camera", unit=1.0 / seen.best.evidence.metres_per_world_unit
        ),
    ]
    # Another tool or base from a row on is the robot's.
    wrong = [
        one
        for one in found
        if one.verdict.kind == "wrong" and (one.of == "robot" or one.verdict.parts is None)
    ]
    if not wrong:
        return None
    best = np.min([one.residuals for one in wrong], axis=0)
    likely = [one for one in wrong if (one.residuals <= _WORSE * best).all()] or wrong
    # An inverse of either explains the same; X of a camera on a gripper is short, that of another one long.
    inverted = all(one.verdict.best.reading.name == "inverted" for one in likely)
    if inverted and (found[1].length < found[0].length) is (setup == "eye-in-hand"):
        likely.reverse()
    names = tuple(pairs.names[i] for i in rows)
    words = [sentence(one.verdict, names, one.of) for one in likely]
    return "; or just as well ".join(words), taken if likely[0].of == "robot" else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Explanation:
    """What one side's poses are; ``unit``: of its lengths, metres."""

    verdict: Verdict
    of: Literal["robot", "camera"]
    unit: float

    @property
    def length(self) -> float:
        """Of X, metres."""
        return self.unit * float(np.linalg.norm(self.verdict.best.evidence.gripper_T_camera[:3, 3]))

    @property
    def residuals(self) -> Array:
        """Angle and distance (2,) that are left, radians and metres."""
        evidence = self.verdict.best.evidence
        return np.array([evidence.rotation, self.unit * evidence.translation])


def _judged(
    poses: RobotPoses,
    others: Array,
    rows: Indices,
    setup: Setup,
    file: PoseFile | None,
    *,
    units: bool = True,
) -> Verdict:
    """What poses are, held against the others; by their unit only if X is of no usual length."""
    readings = () if file is None else [_of_rows(one, file, poses) for one in file_readings(file)]
    verdict = judge(poses, rows, others[rows], setup=setup, others=readings, sizes=False)
    if not units or _is_plausible(verdict.best.evidence.gripper_T_camera):
        return verdict
    return judge(poses, rows, others[rows], setup=setup, others=readings)


def _of_rows(reading: Reading, file: PoseFile, poses: RobotPoses) -> Reading:
    """A reading of a file's numbers as one of those of its poses that have a partner."""
    whole = file.poses()
    place = {name: i for i, name in enumerate(whole.names)}
    rows = [place[name] for name in poses.names]
    return replace(reading, convert=lambda _: reading.convert(whole)[rows])


def _agrees(answer: Answer, pairs: NamedPairs) -> bool:
    """Whether robot and camera agree as usual ones do, so that no other reading need be tried."""
    if not isinstance(pairs.data, PosePairs):
        return True
    start, extent = answer.start, extent_of(pairs.data.base_T_gripper)
    return (
        start.residual_rotation < _USUAL_ROTATION
        and start.residual_translation < _USUAL_TRANSLATION * extent
    )


def _is_plausible(X: Array) -> bool:
    return bool(_NEAREST <= np.linalg.norm(X[:3, 3]) <= _FARTHEST)


def _robot_poses(pairs: NamedPairs, setup: Setup) -> RobotPoses:
    """base_T_gripper of the rows."""
    poses = _poses(pairs).base_T_gripper
    taken = poses if setup == "eye-in-hand" else inverse(poses)
    return RobotPoses(names=pairs.names, base_T_gripper=taken)


def _camera_poses(pairs: NamedPairs) -> RobotPoses:
    """world_T_camera of the rows, in the place of a robot's poses."""
    return RobotPoses(names=pairs.names, base_T_gripper=_poses(pairs).world_T_camera)


def _poses(pairs: NamedPairs) -> PosePairs:
    if not isinstance(pairs.data, PosePairs):
        raise TypeError("motions have no poses")
    return pairs.data


def _with(pairs: NamedPairs, robot: Array, camera: Array, setup: Setup) -> NamedPairs:
    """The pairs with other poses base_T_gripper and world_T_camera."""
    data = PosePairs(
        base_T_gripper=robot if setup == "eye-in-hand" else inverse(robot),
        world_T_camera=camera,
        weights=pairs.data.weights,
    )
    return replace(pairs, data=data)
