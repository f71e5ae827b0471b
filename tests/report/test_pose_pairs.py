"""The page and the summary of a result from pose pairs: nothing about images."""

import re
from typing import Any

import numpy as np

from handeye_fg.from_poses import solve
from handeye_fg.io.results import Result
from handeye_fg.report import summary_text
from handeye_fg.report.page import render
from handeye_fg.simulate import simulate_poses


def pairs(**options: Any) -> Result:
    robot, camera, _ = simulate_poses(
        np.random.default_rng(3),
        n_poses=12,
        robot_rotation_sigma=3e-4,
        robot_translation_sigma=2e-4,
    )
    robot = robot.copy()
    robot[[3, 7]] = robot[[7, 3]]
    return solve(robot, camera, **options)


def test_page_of_pose_pairs_tells_of_rows() -> None:
    page = render(pairs())
    page = page[: page.index("<script")]
    for words in (
        "eye-in-hand, rows: 12 of 12 paired",
        "All rows</h3>",
        "rejected</span> ",
        "12 of 12 paired, 2 rows rejected",
        "far more than in the other rows",
        "Robot against camera",
        "Correlation of the components of X",
    ):
        assert words in page, words
    for words in ("registered", "reprojection", "Intrinsics", "Noise found", "Reported against"):
        assert words not in page, words
    assert re.search(r"<h3>Scale</h3>\s*<p>[\d.]+ ± ", page)


def test_page_of_motions_has_no_places() -> None:
    rng = np.random.default_rng(5)
    robot, camera, _ = simulate_poses(rng, n_poses=24, robot_rotation_sigma=3e-4)
    motions = [np.linalg.inv(poses[:12]) @ poses[12:] for poses in (robot, camera)]
    page = render(solve(*motions, motions=True))
    assert "Where the camera was" not in page
    assert "base_T_world" not in page


def test_summary_of_pose_pairs() -> None:
    text = summary_text(pairs())
    assert "rows             12 of 12 paired, 2 rows rejected" in text
    assert "rms over motion pairs" in text
    for words in ("pixel", "intrinsics", "registered", "nan"):
        assert words not in text, words
