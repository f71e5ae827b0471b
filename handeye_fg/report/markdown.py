"""The result as Markdown, for an issue tracker or a log book; entry point ``markdown_text``."""

from collections.abc import Iterable, Sequence

import numpy as np

from handeye_fg.frames import Array, quaternion_xyzw
from handeye_fg.io.camera_results import (
    CameraReport,
    Stds,
    relative_std_rotation_deg,
    relative_std_translation_mm,
    std_rotation_deg,
    std_translation_mm,
)
from handeye_fg.io.results import Result
from handeye_fg.report import judgement, tables, wording
from handeye_fg.report.noise import levels, remarks
from handeye_fg.report.ties import none_tied, ties

_SPECIAL = str.maketrans({char: f"\\{char}" for char in "\\`*_{}[]<>#|&!"})


def markdown_text(result: Result) -> str:
    r"""The result as Markdown: verdict, transform, uncertainty, what limits it, what was bad.

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
    name, first = wording.transform_name(result), result.cameras[:1]
    blocks = [
        f"# Hand-eye calibration: {_plain(name)}",
        " ".join(filter(None, (judgement.verdict(result), judgement.advice(result)))),
        _plain(result.message),
        _plain(wording.direction(result)),
        *_pose(result.matrix, std_rotation_deg(result), std_translation_mm(result)),
        "" if result.covariance is None else _plain(wording.covered(result)),
        _list(item.description for item in result.free_directions),
        _errors(result),
        *_proof(result),
        *_section(
            "What limits it, and what to do next",
            _plain(" ".join(judgement.limits(result))),
            _list(judgement.next_steps(result)),
            _noise(result),
            _plain(" ".join(remarks(result))),
            *_tied(result),
            _plain(f"{result.intrinsics_note} {wording.other_intrinsics_text(result)}"),
        ),
        *_section(
            "Which data were bad",
            _plain(f"{wording.extent(result)}, {wording.rejected(result)}."),
            _bad(result),
        ),
        *(
            block
            for camera in result.cameras[1:]
            for block in _other_camera(camera, name, first[0].name)
        ),
    ]
    return "\n\n".join(block for block in blocks if block) + "\n"


def _section(title: str, *blocks: str) -> tuple[str, ...]:
    """What stands under a heading; without anything there is none."""
    return (f"## {title}", *blocks) if any(blocks) else ()


def _pose(matrix: Array, std_rotation: Stds, std_translation: Stds) -> tuple[str, ...]:
    """A pose with its standard deviations."""
    return (
        "\n".join(["```text", *(" ".join(f"{v: .9f}" for v in row) for row in matrix), "```"]),
        _table(
            ("along the camera's", "x", "y", "z"),
            (
                ("position, m", *wording.numbers(matrix[:3, 3], 6)),
                ("rotation, std, deg", *wording.numbers(std_rotation, 4)),
                ("translation, std, mm", *wording.numbers(std_translation, 3)),
            ),
        ),
        f"Quaternion x, y, z, w: {', '.join(wording.numbers(quaternion_xyzw(matrix[:3, :3]), 7))}",
    )


def _other_camera(camera: CameraReport, name: str, first: str) -> tuple[str, ...]:
    """X of a further camera, and its pose in the first."""
    return (
        *_section(
            f"{_plain(camera.name)}: {_plain(name)}",
            *_pose(camera.matrix, std_rotation_deg(camera), std_translation_mm(camera)),
            _list(item.description for item in camera.free_directions),
            _plain(f"{camera.intrinsics_note} {wording.other_intrinsics_text(camera)}"),
        ),
        *_section(
            f"{_plain(camera.name)} in {_plain(first)}",
            *_pose(
                camera.first_T_camera,
                relative_std_rotation_deg(camera),
                relative_std_translation_mm(camera),
            ),
        ),
    )


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


def _proof(result: Result) -> tuple[str, ...]:
    """How X predicts what it has not seen."""
    found = result.holdout
    if found is None:
        return ()
    head = ("held-out poses", "error", "expected")
    return _plain(wording.holdout_text(found)), _table(head, tables.holdout_rows(found))


def _noise(result: Result) -> str:
    """The noise against what was said of it."""
    rows = [
        (level.what, f"{level.value} {level.unit}", level.interval, level.basis)
        for level in levels(result)
    ]
    return _table(("noise, std per axis", "value", "95 % interval", "from"), rows) if rows else ""


def _tied(result: Result) -> tuple[str, ...]:
    """What the data hardly tell apart."""
    if result.covariance is None:
        return ()
    return "What the data hardly tell apart:", _list(ties(result) or (none_tied(result),))


def _bad(result: Result) -> str:
    """Images that were not used, or whose robot pose was rejected or kept out."""
    held = wording.kept_out(result)
    rows = [
        (
            _plain(image.name),
            wording.became(image, held_out=image.name in held),
            _plain(image.reason),
        )
        for image in result.images
        if image.reason
    ]
    return _table(("image", "", "reason"), rows) if rows else ""


def _list(sentences: Iterable[str]) -> str:
    return "\n".join(f"- {_plain(sentence)}" for sentence in sentences)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _plain(text: str) -> str:
    """Text from outside that shows as it is: no markup, no line of its own."""
    return wording.printable(" ".join(text.split())).translate(_SPECIAL)
