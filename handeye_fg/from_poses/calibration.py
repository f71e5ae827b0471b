"""Calibration from pose pairs alone: robot and camera poses, or motions, without images; ``solve``."""

import math
from collections.abc import Sequence
from importlib.metadata import version
from typing import get_args

import numpy as np

from handeye_fg.errors import InputDataError
from handeye_fg.frames import Array
from handeye_fg.from_poses.answer import Answer, digest, message, row_reports
from handeye_fg.from_poses.claims import agreed_answer, as_meant
from handeye_fg.from_poses.solution import Method
from handeye_fg.io.pose_pairs import NamedPairs, PoseList, read_pairs
from handeye_fg.io.results import Result, parent_frame
from handeye_fg.known import OfXAndScale, in_world_units
from handeye_fg.motions import PosePairs
from handeye_fg.options import CameraNoise, MethodName, PoseFileOptions, RobotNoise, TaskOptions
from handeye_fg.point_errors import Accuracy, accuracy
from handeye_fg.priors import AnyPrior, CameraPrior, DistancePrior, ScalePrior
from handeye_fg.progress import Stopwatch
from handeye_fg.solvers import METHODS
from handeye_fg.types import Setup

_PACKAGES = ("handeye-fg", "numpy", "scipy")


def solve(
    base_T_gripper: PoseList,
    world_T_camera: PoseList,
    method: str = "andreff_scale",
    *,
    motions: bool = False,
    weights: Array | None = None,
    setup: Setup = "eye-in-hand",
    robust: bool = True,
    metric: bool = False,
    camera_noise: CameraNoise = "auto",
    noise: RobotNoise | None = None,
    priors: Sequence[AnyPrior] = (),
    names: Sequence[str] | None = None,
    robot_file: PoseFileOptions | None = None,
    camera_file: PoseFileOptions | None = None,
    seed: int = 0,
    task: TaskOptions | None = None,
) -> Result:
    """Find the pose of a camera on a robot arm from poses of the robot and of the camera.

    Eye-in-hand: ``world_T_camera`` is the pose of the camera in anything that stands still (a
    board, a map, a structure-from-motion model), and X = gripper_T_camera. Eye-to-hand: the camera
    stands still, ``world_T_camera`` is its pose in what moves with the gripper (of a board on the
    gripper: the inverse of the board's pose in the camera), and X = base_T_camera.

    Args:
        base_T_gripper: robot poses (n, 4, 4) in metres, in the order in which they were taken; or
            with names: a file of any format of ``PoseFileOptions``, or a mapping.
        world_T_camera: camera poses of the same instants, in the same form; paired by order, or by
            name. Translations in metres, or in any unit for ``andreff_scale`` and
            ``pose_graph``.
        method: a closed form (``handeye_fg.solvers.METHODS``), or "pose_graph": least squares with the
            noise of both lists modelled and estimated, from a closed form.
        motions: whether both are motions, gi_T_gj and ci_T_cj (k, 4, 4). For eye-to-hand the
            robot's are base_T_gripper_i inverse(base_T_gripper_j).
        weights: relative weights (n,) of the squared residuals of the rows.
        setup: camera on the gripper, or static camera.
        robust: whether rows that disagree with the majority are left out, and named.
        metric: for ``pose_graph``: whether the camera's translations are in metres, as those of a
            known target are; else it finds their unit.
        camera_noise: for ``pose_graph``: whether each camera pose has an error of its own
            ("independent") or each motion to the next pose has ("odometry"); "auto": the data tell.
        noise: for ``pose_graph``: the robot's noise levels, where they are known.
        priors: what else is known of X and, where the unit of the camera's translations is not, of the
            scale; with priors X is found by least squares.
        names: of the rows (n,) of arrays; None: "row 0", "row 1", ...
        robot_file: how a file of the robot's poses is to be read, and how its rows find the camera's
            where they have no names: by time, interpolated, or, if asked for, by order.
        camera_file: how a file of the camera's poses is to be read.
        seed: of the samples that tell wrong rows from right ones.
        task: what the calibration is for; None: nobody said.

    Returns:
        The result; where the motions leave directions free, what they determine of X ("partial").

    Raises:
        InputDataError: the input breaks its format, does not fit together, or follows another
            convention.
        UnobservableError: the robot or the camera did not move.
        ConvergenceError: robot and camera contradict each other.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> base_T_gripper, world_T_camera, truth = simulate_poses(np.random.default_rng(0), n_poses=12)
        >>> result = hf.solve(base_T_gripper, world_T_camera)
        >>> result.status, result.matrix.shape, result.covariance.shape
        ('ok', (4, 4), (6, 6))
        >>> bool(np.allclose(result.matrix, truth.gripper_T_camera, atol=2e-3))
        True

        By name, with the noise of both lists estimated:

        >>> robot = {f"{i}.jpg": matrix for i, matrix in enumerate(base_T_gripper)}
        >>> camera = {f"{i}.jpg": matrix for i, matrix in enumerate(world_T_camera)}
        >>> result = hf.solve(robot, camera, "pose_graph")
        >>> [row.name for row in result.images if row.outlier]
        []
    """
    if method not in get_args(MethodName):
        raise InputDataError(
            f"unknown method {method!r}: choose one of {', '.join(get_args(MethodName))}"
        )
    robot_file, camera_file = robot_file or PoseFileOptions(), camera_file or PoseFileOptions()
    scale_known = metric if method == "pose_graph" else METHODS[method].scale_known
    clock = Stopwatch()
    # 1. Read everything, and pair the rows.
    pairs = read_pairs(
        base_T_gripper,
        world_T_camera,
        names=names,
        robot_file=robot_file,
        camera_file=camera_file,
        weights=weights,
        setup=setup,
        motions=motions,
    )
    pairs = as_meant(pairs, robot_file.convention, camera_file.convention, setup)
    clock.lap("input")
    # 2. Leave out the rows that disagree with the majority, and solve the rest, or what it determines.
    how = Method(
        name=method,
        frame=parent_frame(setup),
        scale_known=scale_known,
        inverted=setup == "eye-to-hand",
        camera_noise=None if camera_noise == "auto" else camera_noise,
        noise=noise,
        priors=_known(priors, pairs, scale_known=scale_known),
        robust=robust,
        seed=seed,
    )
    answer, pairs, converted = agreed_answer(pairs, how, setup, robot_file)
    clock.lap("solution")
    # 3. X, its covariance, and what is to be known of every row.
    observability = answer.observability
    scale, free = answer.metres_per_world_unit, observability.free_directions
    return Result(
        status="partial" if free else "ok",
        setup=setup,
        message=" ".join(filter(None, (message(pairs, answer), converted.note))),
        matrix=answer.gripper_T_camera,
        covariance=observability.covariance,
        free_directions=free,
        metres_per_world_unit=scale,
        metres_per_world_unit_std=math.nan if scale_known else scale * observability.log_scale_std,
        base_T_world=answer.base_T_world,
        noise=answer.noise,
        initial=answer.start,
        accuracy=_accuracy(answer, task or TaskOptions()),
        repeatability=None
        if task is None or task.repeatability_mm is None
        else 1e-3 * task.repeatability_mm,
        images=row_reports(pairs, answer, setup),
        observability={
            "weakest_std_over_limit": observability.weakest_std,
            "rows_used": float(np.count_nonzero(answer.trusted)),
            **answer.figures,
        },
        poses_read_as=pairs.read_as,
        timing_s=clock.timing_s,
        provenance={
            **{name: version(name) for name in _PACKAGES},
            "method": method,
            "robust": "yes" if robust else "no",
            "input_digest": digest(pairs),
            "convention": ",".join(filter(None, (robot_file.convention, converted.convention)))
            or "as given",
            "seed": seed,
        },
    )


def _accuracy(answer: Answer, task: TaskOptions) -> Accuracy | None:
    """The error that X causes at the work; None where X has free directions."""
    if answer.observability.free_directions:
        return None
    return accuracy(
        answer.gripper_T_camera,
        answer.observability.covariance,
        answer.figures.get("degrees_of_freedom", math.inf),
        None if task.distance_mm is None else 1e-3 * task.distance_mm,
        None if task.tolerance_mm is None else 1e-3 * task.tolerance_mm,
    )


def _known(
    priors: Sequence[AnyPrior], pairs: NamedPairs, *, scale_known: bool
) -> tuple[OfXAndScale, ...]:
    """The priors in terms of X and the scale.

    Raises:
        InputDataError: one is of intrinsics, or of a length where the method takes the camera's translations as metres,
            or of a distance between motions.
    """
    if any(isinstance(prior, CameraPrior) for prior in priors):
        raise InputDataError(
            "a prior of kind intrinsics is about a camera file, but pose pairs come without images; leave "
            "it out"
        )
    lengths = [prior.kind for prior in priors if isinstance(prior, ScalePrior | DistancePrior)]
    if lengths and scale_known:
        raise InputDataError(
            f"a prior of kind {lengths[0]} says what the camera's translations are in metres, but the "
            "method takes them as metres; leave it out, or use andreff_scale or pose_graph"
        )
    if isinstance(pairs.data, PosePairs):
        return in_world_units(priors, pairs.names, np.asarray(pairs.data.world_T_camera))
    if "distance" in lengths:
        raise InputDataError(
            "a prior of kind distance is between two camera poses, but the rows are motions; give the "
            "scale instead"
        )
    return in_world_units(priors, (), np.empty((0, 4, 4)))
