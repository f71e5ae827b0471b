"""The summary that a person reads in the terminal after a calibration."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path

from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.camera_results import (
    CameraReport,
    relative_std_rotation_deg,
    relative_std_translation_mm,
    std_rotation_deg,
    std_translation_mm,
)
from handeye_fg.io.results import Result
from handeye_fg.report import judgement, wording
from handeye_fg.report.noise import doubtful, remarks
from handeye_fg.report.ties import ties

_LONGEST = 100  # letters of a line of sentences, beside its label


def summary_text(result: Result, report: str | Path | None = None) -> str:
    """The result in a page of plain text.

    Args:
        result: the result.
        report: the page to point at, if one was written.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=10)
        >>> result = hf.solve(robot, camera)
        >>> [line for line in hf.summary_text(result).splitlines() if line.startswith("X")]
        ['X = gripper_T_camera']
    """
    name = wording.transform_name(result)
    std_rotation, std_translation = std_rotation_deg(result), std_translation_mm(result)
    lines = [
        wording.printable(result.message),
        *filter(None, (judgement.verdict(result), judgement.advice(result))),
        "",
        f"X = {name}",
        *matrix_lines(result.matrix),
        "",
        _row("translation", "  ".join(wording.numbers(result.matrix[:3, 3], 6)) + "  m"),
        _row(
            "quaternion xyzw",
            "  ".join(wording.numbers(quaternion_xyzw(result.matrix[:3, :3]), 6)),
        ),
        _row("std rotation", "  ".join(wording.numbers(std_rotation, 4)) + "  deg"),
        _row("std translation", "  ".join(wording.numbers(std_translation, 3)) + "  mm"),
        _row("", "(along the camera's x, y, z axes)"),
        _row("scale", wording.scale_text(result)),
    ]
    for camera in result.cameras[1:]:
        lines += _other_camera(camera, name, first=result.cameras[0].name)
    if (noise := result.noise) is not None:
        pixel = f"pixel {wording.significant(noise.pixel)} px, " if result.sfm is not None else ""
        levels = (
            f"{pixel}robot {wording.significant(math.degrees(noise.robot_rotation))} deg and "
            f"{wording.significant(1000.0 * noise.robot_translation)} mm per axis"
        )
        lines.append(_row("noise estimated" if noise.estimated else "noise given", levels))
    else:
        lines.append(_row("residual", f"{wording.residual_text(result)} rms over motion pairs"))
    lines += _sentences("", (*doubtful(result), *remarks(result)))
    if result.camera is not None:
        note = (result.intrinsics_note, wording.other_intrinsics_text(result))
        lines += _sentences("intrinsics", note)
    if result.target is not None:
        lines.append(_row("target", wording.printable(wording.target_text(result.target))))
    lines += [
        _row(f"{whose} poses", wording.printable(f"read as {one}"))
        for whose, one in result.poses_read_as.items()
    ]
    counts = f"{wording.extent(result)}, {wording.rejected(result)}"
    lines.append(_row("images" if result.sfm is not None else "rows", counts))
    kept_out = wording.kept_out(result)
    lines += [
        f"  {wording.printable(image.name)}: {wording.printable(image.reason)}"
        for image in result.images
        if image.reason and image.name not in kept_out
    ]
    if result.free_directions:
        lines.append(_row("undetermined", ""))
        lines += [f"  {wording.printable(item.description)}" for item in result.free_directions]
    else:
        lines.append(_row("undetermined", "nothing"))
    lines += _sentences("tied together", ties(result))
    lines += _sentences("limits", judgement.limits(result))
    lines += _sentences("do next", judgement.next_steps(result))
    lines += ["", wording.direction(result)]
    if report is not None:
        lines.append(f"Report: {wording.printable(str(report))}")
    return "\n".join(lines)


def _other_camera(camera: CameraReport, name: str, *, first: str) -> list[str]:
    """X of a further camera, and its pose in the first."""
    rotation = wording.numbers(relative_std_rotation_deg(camera), 4)
    translation = wording.numbers(relative_std_translation_mm(camera), 3)
    return [
        "",
        f"X of {wording.printable(camera.name)} = {name}",
        *matrix_lines(camera.matrix),
        f"{wording.printable(first)}_T_{wording.printable(camera.name)}",
        *matrix_lines(camera.first_T_camera),
        _row("std rotation", "  ".join(rotation) + "  deg"),
        _row("std translation", "  ".join(translation) + "  mm"),
        "",
    ]


def _sentences(label: str, sentences: Sequence[str]) -> list[str]:
    """Each from a line of its own on, broken at words; without any there is no row."""
    lines: list[str] = []
    for sentence in filter(None, sentences):
        text = wording.printable(sentence)
        lines += textwrap.wrap(text, _LONGEST, break_long_words=False, break_on_hyphens=False)
    return [_row("" if i else label, line) for i, line in enumerate(lines)]


def matrix_lines(matrix: Array) -> list[str]:
    """A 4x4 matrix, one row a line, columns aligned."""
    return ["  [" + " ".join(f"{value:11.7f}" for value in row) + "]" for row in matrix]


def _row(label: str, text: str) -> str:
    return f"{label:<16} {text}".rstrip()
