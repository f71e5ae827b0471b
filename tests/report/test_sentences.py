"""What limits X and what to do next: the same sentences on the page, in the terminal and in Markdown."""

import html
import re
from dataclasses import replace

import numpy as np
import pytest

from handeye_fg.io.holdout import HeldOutImage, HoldoutReport
from handeye_fg.io.results import Result
from handeye_fg.report import judgement, markdown_text, summary_text, wording
from handeye_fg.report.noise import doubtful, remarks
from handeye_fg.report.page import render
from handeye_fg.report.ties import none_tied, ties

GIVEN = "given; the residuals say 0.54 (0.45 to 0.66), which is more"
PRIOR = "the data say next to nothing: a prior for usual arms decided"


@pytest.fixture(autouse=True)
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take nearly all the time of a page."""
    monkeypatch.setattr("handeye_fg.report.page.drawings", lambda _: ())


def in_all(result: Result) -> dict[str, str]:
    """What is read in each place, in one line."""
    page = re.sub(r"<[^>]*>", " ", render(result).split("<main>")[1].split("</main>")[0])
    texts = {
        "page": html.unescape(page),
        "terminal": summary_text(result),
        "markdown": markdown_text(result).replace("\\", ""),
    }
    return {place: " ".join(text.split()) for place, text in texts.items()}


@pytest.fixture
def doubted(result: Result) -> Result:
    """A result of which there is something to say in every respect."""
    assert result.covariance is not None
    assert result.noise is not None
    assert result.focal_offset is not None
    covariance = result.covariance.copy()
    covariance[0, 4] = covariance[4, 0] = -0.93 * np.sqrt(covariance[0, 0] * covariance[4, 4])
    carried = replace(result.images[2], influence_translation=0.01)
    return replace(
        result,
        images=(*result.images[:2], carried, *result.images[3:]),
        covariance=covariance,
        noise=replace(result.noise, image_inflation=2.5),
        repeatability=1e-4,
        focal_offset=replace(result.focal_offset, confounded=True, correlation=-0.85),
    )


def test_each_sentence_is_in_every_text(doubted: Result) -> None:
    groups = {
        "limits": judgement.limits(doubted),
        "steps": judgement.next_steps(doubted),
        "ties": ties(doubted),
        "remarks": remarks(doubted),
        "intrinsics": (wording.other_intrinsics_text(doubted),),
    }
    assert [len(group) for group in groups.values()] == [2, 5, 3, 2, 1]
    for place, text in in_all(doubted).items():
        for sentence in (sentence for group in groups.values() for sentence in group):
            assert sentence in text, (place, sentence)
        assert GIVEN in text, place
        assert PRIOR in text, place
        assert "Nothing" not in text, place


def test_levels_that_the_data_gave_are_not_doubted(doubted: Result) -> None:
    assert [sentence.split(":")[0] for sentence in doubtful(doubted)] == [
        "Reported robot orientation",
        "Reported robot position",
    ]
    assert doubtful(replace(doubted, certainty=None)) == ()


def test_nothing_tied_is_told_where_there_is_room(result: Result) -> None:
    loose = replace(
        result, covariance=np.diag(np.diag(result.covariance)), intrinsics_correlation=None
    )
    assert none_tied(result) == ""  # a parameter of the camera is tied
    assert "and those with the intrinsics," in none_tied(loose)
    assert "intrinsics" not in none_tied(replace(loose, intrinsics_refined=False))
    counts = {place: text.count(none_tied(loose)) for place, text in in_all(loose).items()}
    assert counts == {"page": 1, "markdown": 1, "terminal": 0}


def test_ties_of_every_camera_are_told(two_cameras: Result) -> None:
    wanted = (
        "right: The rotation about x and the position along y (correlation -0.93).",
        "right: The camera's fx and the position along z (correlation -0.91).",
        "right: Focal length and the position along the optical axis (correlation 0.88): ",
    )
    found = ties(two_cameras)
    assert len(found) == 3
    for sentence, start in zip(found, wanted, strict=True):
        assert sentence.startswith(start)
    for place, text in in_all(two_cameras).items():
        for start in wanted:
            assert start in text, place
        assert "left: " not in text.replace("left: image observations", ""), place


def test_markdown_has_every_camera(two_cameras: Result) -> None:
    text = markdown_text(two_cameras).replace("\\", "")
    assert "## right: gripper_T_camera" in text
    assert "## right in left" in text
    for camera in two_cameras.cameras:
        assert f"{camera.matrix[0, 3]: .9f}" in text
    assert text.count("```text") == 3


@pytest.fixture
def held_out(result: Result) -> HoldoutReport:
    return HoldoutReport(
        images=tuple(
            HeldOutImage(name=image.name, rotation=1e-4, translation=1e-4, reprojection_rms=0.5)
            for image in result.images[:3]
        ),
        rotation=1e-4,
        translation=1.1e-4,
        expected_rotation=2e-4,
        expected_translation=1.2e-4,
        normalised=0.51,
        probability=0.97,
        within=0.96,
    )


def test_poses_that_were_kept_out_are_no_bad_data(result: Result, held_out: HoldoutReport) -> None:
    kept = tuple(replace(image, reason="kept out, as asked for") for image in result.images[:3])
    texts = in_all(replace(result, images=(*kept, *result.images[3:]), holdout=held_out))
    for place in ("page", "markdown"):
        assert wording.holdout_text(held_out) in texts[place]
        assert "position (mm)" in texts[place]
    assert "of 3 images that were kept out of it" in texts["page"]
    assert "13 of 18" in texts["page"]
    assert "| frame_0000.jpg | kept out |" in texts["markdown"]
    assert "as asked for" not in texts["terminal"]  # the message tells of them


def test_new_images_are_not_of_the_calibration(result: Result, held_out: HoldoutReport) -> None:
    """Even where one has the name of an image that X rests on."""
    texts = in_all(replace(result, holdout=replace(held_out, new_images=True)))
    for place in ("page", "markdown"):
        assert "X predicts the robot poses of 3 new images: " in texts[place]
    assert "16 of 18" in texts["page"]
    for text in texts.values():
        assert "kept out" not in text


def test_poses_of_new_images_in_the_file_of_the_others_are_no_bad_data(
    result: Result, held_out: HoldoutReport
) -> None:
    *others, last = result.images
    rest = replace(last, reason="no image has this name")
    proof = replace(held_out, images=(replace(held_out.images[0], name=last.name),))
    result = replace(result, images=(*others, rest), holdout=replace(proof, new_images=True))
    texts = in_all(result)
    assert "1 robot pose rejected, 1 kept out" in texts["page"]
    assert "not used" not in texts["page"]
    assert "no image has this name" not in texts["page"] + texts["terminal"]
    assert f"| {last.name} | kept out |" in texts["markdown"]
