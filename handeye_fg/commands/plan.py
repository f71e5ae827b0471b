"""``plan``: which poses to take next."""

# ruff: noqa: PLC0415  # help and usage errors must not wait for GTSAM and pycolmap

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from handeye_fg.commands.exit_codes import EXIT_OK
from handeye_fg.console import say, stderr_console
from handeye_fg.errors import InputDataError
from handeye_fg.options import PoseFileOptions, PoseFormatName

if TYPE_CHECKING:
    from handeye_fg.planning import Expected, Plan, Reach

Point = tuple[float, float, float]
Box = tuple[float, float, float, float, float, float]
Pose = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanPoses:
    """Which poses to take next, so that X becomes as certain as possible, and how certain that will be.

    After a calibration: poses that add most to it. Before the first image, with --look-at and --standoff: a
    first set. Writes next_poses.csv (base_T_gripper), or --output.
    """

    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    """Folder of a calibration; for a first set any folder."""
    count: int = 0
    """How many poses; 0: 5 after a calibration, 12 for a first set."""
    workspace: Annotated[Box | None, tyro.conf.arg(metavar="X Y Z X Y Z")] = None
    """Lowest and highest corner of the box in which the gripper may be, in the base, metres. Default: the box
    that the gripper's positions so far span."""
    urdf: Path | None = None
    """URDF of the robot: only poses that its joints reach within their limits. Does not look for
    collisions. Needs the extra urdf."""
    tip: str | None = None
    """Link of the URDF whose pose the controller reports."""
    base: str | None = None
    """Link of the URDF in which it reports it. Default: the root."""
    look_at: Annotated[Point | None, tyro.conf.arg(metavar="X Y Z")] = None
    """For a first set: the middle of the scene, in the base, metres."""
    standoff: float | None = None
    """For a first set: distance of the camera from it, metres."""
    mount: Annotated[Pose, tyro.conf.arg(metavar="X Y Z QX QY QZ QW")] = (0, 0, 0, 0, 0, 0, 1)
    """For a first set: about where the camera is on the gripper, metres."""
    camera: Path | None = None
    """For a first set: camera file. Default: a view of 60 degrees."""
    output: Path | None = None
    """File to write, of some formats a folder. Default: OUT/next_poses.csv."""
    pose_format: PoseFormatName = "auto"
    """Format of the poses; auto: CSV with the header image,x,y,z,qx,qy,qz,qw."""
    seed: int = 0
    """Seed of everything random."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the plan as JSON on stdout."""
    quiet: Annotated[tyro.conf.FlagCreatePairsOff[bool], tyro.conf.arg(aliases=["-q"])] = False
    """Print nothing but errors."""

    def run(self) -> int:
        """Plan, write the poses and say what comes of them."""
        self._check()
        from handeye_fg.io.poses import write_poses
        from handeye_fg.io.results import to_json
        from handeye_fg.types import RobotPoses

        plan = self._plan()
        path = write_poses(
            RobotPoses(names=plan.names, base_T_gripper=plan.base_T_gripper),
            self.output or self.folder / "next_poses.csv",
            PoseFileOptions(format=self.pose_format),
        )
        if not self.quiet:
            say(stderr_console(), _text(plan, path))
        if self.json:
            sys.stdout.write(to_json(_document(plan)))
            sys.stdout.flush()
        return EXIT_OK

    def _check(self) -> None:
        if self.count < 0 or (self.look_at is not None and 0 < self.count < 3):
            raise InputDataError(
                f"--count is {self.count}, but must be 1 or more, and 3 or more for a first set"
            )
        if (self.look_at is None) != (self.standoff is None):
            raise InputDataError("a first set needs both --look-at and --standoff; give the other")
        if self.standoff is not None and not 0.0 < self.standoff < float("inf"):
            raise InputDataError(f"--standoff is {self.standoff}, but must be a length in metres")
        if self.look_at is not None and self.workspace is None and self.urdf is None:
            raise InputDataError(
                "a first set needs --workspace or --urdf, so that the arm reaches it"
            )
        if (self.urdf is None) != (self.tip is None):
            raise InputDataError("--urdf and --tip belong together; give the other")
        if self.workspace is not None and not all(
            low < high for low, high in zip(self.workspace[:3], self.workspace[3:], strict=True)
        ):
            raise InputDataError(
                f"--workspace is {self.workspace}, but must be the lowest and the highest corner of a box"
            )
        if self.look_at is None and not (self.folder / "result.json").is_file():
            raise InputDataError(
                f"{self.folder} has no result.json; give the folder of a calibration, or for a first set "
                "--look-at, --standoff and --workspace"
            )

    def _plan(self) -> "Plan":
        from handeye_fg.planning import Both, plan, plan_first

        if self.look_at is None or self.standoff is None:
            return plan(self.folder, count=self.count or 5, reach=self._reach(), seed=self.seed)
        import numpy as np

        from handeye_fg.io.cameras import read_camera
        from handeye_fg.io.poses import Convention
        from handeye_fg.io.poses.convention import to_poses

        return plan_first(
            self.look_at,
            self.standoff,
            self._reach() or Both(()),
            self.count or 12,
            X=to_poses(
                np.array([self.mount[:3]]), np.array([self.mount[3:]]), Convention(), ("--mount",)
            )[0],
            camera=None if self.camera is None else read_camera(self.camera),
            seed=self.seed,
        )

    def _reach(self) -> "Reach | None":
        from handeye_fg.planning import Both, Workspace, read_arm

        reaches: list[Reach] = []
        if self.workspace is not None:
            reaches.append(Workspace(self.workspace[:3], self.workspace[3:]))
        if self.urdf is not None and self.tip is not None:
            reaches.append(read_arm(self.urdf, self.tip, self.base))
        return Both(tuple(reaches)) if reaches else None


def _text(plan: "Plan", path: Path) -> str:
    """The plan as a person reads it."""
    from handeye_fg.report import wording

    lines = [wording.printable(plan.message), ""]
    if plan.present is not None:
        lines.append(_row("now", plan.present))
    if plan.kept_out is not None:
        lines.append(_row("with those kept out", plan.kept_out.used))
    if len(plan.expected) < len(plan.names):  # a first set
        lines.append(_row("with all of them", plan.expected[-1]))
    else:
        for k, (name, expected) in enumerate(zip(plan.names, plan.expected, strict=True)):
            lines.append(_row(f"with {name}" if k == 0 else f"and {name}", expected))
    lines.append("(standard deviations about and along the camera's x, y, z axes)")
    return "\n".join([*lines, f"Poses: {wording.printable(str(path))}"])


def _row(label: str, expected: "Expected") -> str:
    from handeye_fg.report import wording

    rotation = "  ".join(wording.numbers(expected.std_rotation_deg, 4))
    translation = "  ".join(wording.numbers(expected.std_translation_mm, 3))
    return f"{label:<20} {rotation}  deg   {translation}  mm"


def _document(plan: "Plan") -> dict[str, object]:
    """The plan for programs."""
    return {
        "message": plan.message,
        "camera": plan.camera,
        "poses": [
            {"image": name, "base_T_gripper": pose.tolist(), "visible": float(visible)}
            for name, pose, visible in zip(
                plan.names, plan.base_T_gripper, plan.visible, strict=True
            )
        ],
        "present": None if plan.present is None else _stds(plan.present),
        "expected": [_stds(expected) for expected in plan.expected],
        "kept_out": None
        if plan.kept_out is None
        else {
            "count": plan.kept_out.count,
            "used": _stds(plan.kept_out.used),
            "unused": _stds(plan.kept_out.unused),
        },
    }


def _stds(expected: "Expected") -> dict[str, object]:
    return {
        "std_rotation_deg": list(expected.std_rotation_deg),
        "std_translation_mm": list(expected.std_translation_mm),
        "free_directions": [direction.description for direction in expected.free_directions],
    }
