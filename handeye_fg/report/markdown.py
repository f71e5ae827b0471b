"""The result as Markdown, for an issue tracker or a log book; entry point ``markdown_text``."""

from collections.abc import Iterable, Sequence

import numpy as np

from handeye_fg.frames import quaternion_xyzw
from handeye_fg.io.camera_results import std_rotation_deg, std_translation_mm
from handeye_fg.io.results import Result
from handeye_fg.report import judgement, wording

_SPECIAL = str.maketrans({char: f"\\{char}" for char in "\\`*_{}[]<>#|&!"})


def markdown_text(result: Result) -> str:
    r"""The result as Markdown: verdict, transform, uncertainty, what was bad.

    Args:
        result: what to report.

    Examples:
        >>> import numpy as np
        >>> import handeye_fg as hf
        >>> from handeye_fg.simulate import simulate_poses
        >>> robot, camera, _ = simulate_poses(np.random.default_rng(0), n_poses=10)
        >>> print(hf.markdown_text(hf.solve(robot, camera)).splitlines()[0])
        # Hand-eye calibration: gripper\_T\_camera
    """
    matrix = result.matrix
    blocks = [
        f"# Hand-eye calibration: {_plain(wording.transform_name(result))}",
        " ".join(filter(None, (judgement.verdict(result), judgement.advice(result)))),
        _plain(result.message),
        _plain(wording.direction(result)),
        "\n".join(["```text", *(" ".join(f"{v: .9f}" for v in row) for row in matrix), "```"]),
        _table(
            ("along the camera's", "x", "y", "z"),
            (
                ("position, m", *wording.numbers(matrix[:3, 3], 6)),
                ("rotation, std, deg", *wording.numbers(std_rotation_deg(result), 4)),
                ("translation, std, mm", *wording.numbers(std_translation_mm(result), 3)),
            ),
        ),
        f"Quaternion x, y, z, w: {', '.join(wording.numbers(quaternion_xyzw(matrix[:3, :3]), 7))}",
        _errors(result),
        "\n".join(f"- {_plain(item.description)}" for item in result.free_directions),
        _bad(result),
    ]
    return "\n\n".join(block for block in blocks if block) + "\n"


def _errors(result: Result) -> str:
    """The error that X causes over the distance."""
    if result.accuracy is None:
        return ""
    rows = [
        (
            wording.number(1e3 * error.distance, 0),
            *wording.numbers(1e3 * np.sqrt(np.diag(error.covariance))),
            wording.number(1e3 * error.within_95),
        )
        for error in result.accuracy.along_axis
    ]
    return _table(("distance, mm", "std x, mm", "std y, mm", "std z, mm", "95 % within, mm"), rows)


def _bad(result: Result) -> str:
    """Images that were not used, or whose robot pose was rejected."""
    rows = [
        (
            _plain(image.name),
            "robot pose rejected" if image.outlier else "not used",
            _plain(image.reason),
        )
        for image in result.images
        if image.reason
    ]
    return _table(("image", "", "reason"), rows) if rows else ""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _plain(text: str) -> str:
    """Text from outside that shows as it is: no markup, no line of its own."""
    return wording.printable(" ".join(text.split())).translate(_SPECIAL)
