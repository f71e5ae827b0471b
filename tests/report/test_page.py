import dataclasses
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import escape

from handeye_fg.errors import InputDataError
from handeye_fg.findings import FreeDirection, SecondStart
from handeye_fg.io.results import Result
from handeye_fg.report import judgement, summary_text, write_report
from handeye_fg.report.page import render
from handeye_fg.report.view import view
from handeye_fg.report.wording import printable

# The page's own: data of the 3D view, the library that draws it, the page's script.
OWN = {"script": 3, "img": 0, "link": 0, "iframe": 0, "object": 0}
ATTACK = "<img src=x onerror=alert(1)>.jpg"
VOID = {"meta", "br", "img"}


def without_scripts(text: str) -> str:
    return text[: text.index("<script")]


class Page(HTMLParser):
    """Tags, ids and the balance of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.labels: list[str] = []
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            assert not name.startswith("on"), (tag, name)
            if name == "id":
                self.ids.append(value or "")
            if name == "aria-label":
                self.labels.append(value or "")
            if name in {"src", "href", "xlink:href", "data", "action"}:
                self.addresses.append(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_data(self, data: str) -> None:
        self.text += data

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def free_direction(kind: str, vector: list[float]) -> FreeDirection:
    return FreeDirection(
        kind=kind,  # type: ignore[arg-type]  # one of the three
        vector=np.array(vector),
        frame="gripper",
        description="The height of the camera along the gripper's z axis is free; tilt the arm.",
    )


def test_page_is_one_well_formed_file(result: Result, tmp_path: Path) -> None:
    path = write_report(result, tmp_path / "new" / "folder")
    assert path == tmp_path / "new" / "folder" / "report.html"
    assert list(path.parent.iterdir()) == [path]
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {tag: page.tags.count(tag) for tag in OWN} == OWN
    assert all(address.startswith("#") for address in page.addresses)
    assert {address[1:] for address in page.addresses} <= set(page.ids)
    assert set(re.findall(r"url\(#([^)]*)\)", without_scripts(text))) <= set(page.ids)
    assert "://" not in without_scripts(text)
    assert '<html lang="en">' in text
    assert page.tags.count("h1") == 1


def test_the_most_influential_pose_comes_first(result: Result) -> None:
    drawings = re.findall(r"<svg.*?</svg>", without_scripts(render(result)), flags=re.DOTALL)
    drawing = next(one for one in drawings if "Which poses carry" in one)
    names = re.findall(r"frame_\d{4}\.jpg", drawing)
    largest = max(result.images, key=lambda image: image.influence_translation or 0.0).name
    assert names[0] == largest
    assert "frame_0005.jpg" not in names  # rejected: it has no influence


def test_what_the_second_start_came_to_is_told(result: Result) -> None:
    assert "start far off" not in render(result)
    second = SecondStart(agrees=True, restarted=False, rotation=1e-9, translation=1e-9)
    assert "leads to the same optimum." in render(dataclasses.replace(result, second_start=second))
    other = SecondStart(agrees=False, restarted=True, rotation=0.1, translation=0.0254)
    text = " ".join(render(dataclasses.replace(result, second_start=other)).split())
    assert "X is 5.7 deg and 25 mm from there." in text
    assert "repeated from another start" in text


def test_figures_have_descriptions_and_follow_the_theme(result: Result) -> None:
    text = render(result)
    drawings = re.findall(r"<svg.*?</svg>", without_scripts(text), flags=re.DOTALL)
    assert len(drawings) == 8
    for drawing in drawings:
        root = ET.fromstring(drawing)
        assert root.get("role") == "img"
        assert len(root.get("aria-label") or "") > 20
        # No colour of its own: on a dark page a fixed black could not be seen.
        assert not re.search(r"(fill|stroke): #", drawing)
        assert not re.search(r"(fill|stroke): (black|white)", drawing)
    for name in ("ink", "muted", "line", "first", "second", "bad"):
        assert f"--{name}:" in text


def test_page_says_what_a_person_needs(result: Result) -> None:
    text = " ".join(render(result).split())
    for words in (
        "OK</span> <strong>Usable for 2 mm tasks at 400 mm from the camera: 95 % of the points",
        "<p>All six components of X are determined.",
        "Put a point given in camera coordinates into gripper coordinates: p_gripper =",
        "p_gripper = gripper_T_camera p_camera; the point 0.5 m in front of the camera",
        "right perturbation in the camera frame",
        '0.0286 deg</dd><dd class="more">95 %: ± 0.0688 deg',
        '0.410 mm</dd><dd class="more">95 %: ± 0.900 mm',
        "0.2345679 ± 0.00012 metres per world unit",
        "Noise found in the data",
        "Refined near the values of the file",
        "too few matches with other images",
        "17 of 18 registered, 1 robot pose rejected",
        "andreff_scale",
    ):
        assert words in text, words
    titles = re.findall(r"<h2[^>]*>(.*?)</h2>", text)
    assert titles == [
        "X and how sure it is",
        "What it is good for",
        "What limits it, and what to do next",
        "Which data were bad",
        "How it was made",
    ]


def test_same_result_gives_same_bytes(result: Result) -> None:
    assert render(result) == render(result)


def test_partial_result_names_what_is_free(result: Result) -> None:
    directions = (
        free_direction("translation", result.matrix[:3, 0].tolist()),
        free_direction("rotation", (result.matrix[:3, :3] @ [0.6, 0.64, 0.48]).tolist()),
        free_direction("scale", [0.0, 0.0, 0.0]),
    )
    partial = dataclasses.replace(result, status="partial", free_directions=directions)
    text = " ".join(render(partial).split())
    assert "Partial</span>" in text
    shown = re.sub(r"<pre.*?</pre>", "", text, flags=re.DOTALL)  # what is copied says it again
    assert shown.count("tilt the arm") == 3
    assert "metres per world unit (undetermined)" in text
    assert 'rotation</dt><dd class="figure">—</dd><dd class="more">no axis determined' in text
    row = re.search(r"position, std \(mm\)</th>(.*?)</tr>", text)
    assert row
    # The free direction is the camera's x axis: its std is no number, the others are.
    assert re.findall(r"<td>(.*?)</td>", row[1]) == ["—", "0.250", "0.410"]
    assert "NaN" not in without_scripts(text)
    assert "undetermined" in summary_text(partial)
    assert "tilt the arm" in summary_text(partial)


def test_static_camera_is_in_the_base_frame(result: Result) -> None:
    text = render(dataclasses.replace(result, setup="eye-to-hand"))
    assert "p_base = base_T_camera p_camera" in text
    assert "gripper_T_camera" not in text
    assert "Where the camera was" not in text


@pytest.mark.parametrize(
    "name",
    [
        ATTACK,
        "</svg></figure><script>alert(1)</script>",
        '" onload="alert(1)',
        "$\\frac{1}{$.jpg",
        "-->{{ 7 * 7 }}<!--",
        "画像 один.jpg",
        "bell\a escape\x1b[31m null.jpg",
        "not\udce9utf8.jpg",
        "#010101 url(#a) id=",
        "x" * 300,
    ],
)
def test_hostile_names_stay_text(
    name: str, renamed: Callable[[str], Result], tmp_path: Path
) -> None:
    hostile = dataclasses.replace(renamed(name), message=name, intrinsics_note=name)
    text = write_report(hostile, tmp_path).read_text(encoding="utf-8")
    page = Page(text)
    assert page.open == []
    assert {tag: page.tags.count(tag) for tag in OWN} == OWN
    assert "\x1b" not in text
    assert printable(name) in page.text
    for drawing in re.findall(r"<svg.*?</svg>", without_scripts(text), flags=re.DOTALL):
        ET.fromstring(drawing)
    assert "\x1b" not in summary_text(hostile)


def test_hostile_name_is_readable_in_table_and_figure(renamed: Callable[[str], Result]) -> None:
    text = render(renamed(ATTACK))
    assert "&lt;img src=x onerror=alert(1)&gt;.jpg" in text
    assert "<img src=x" not in text
    drawings = re.findall(r"<svg.*?</svg>", without_scripts(text), flags=re.DOTALL)
    assert "&lt;img src=x" in "".join(drawings)


def test_markup_in_a_name_is_none_for_the_view(renamed: Callable[[str], Result]) -> None:
    shown = view(renamed("<b>bold</b>.jpg"))
    assert shown is not None
    texts = [trace["text"][0] for trace in shown["traces"] if "text" in trace]
    assert len(texts) == 2
    assert all(text.startswith("&lt;b&gt;bold&lt;/b&gt;.jpg<br>") for text in texts)


def test_few_and_many_images(result: Result) -> None:
    none = dataclasses.replace(result, images=result.images[-1:])
    assert (
        without_scripts(render(none)).count("<svg") == 3
    )  # over the distance, the ellipsoid, and the correlations
    many = dataclasses.replace(result, images=result.images[:17] * 20)
    drawings = re.findall(r"<svg.*?</svg>", without_scripts(render(many)), flags=re.DOTALL)
    drawing = next(one for one in drawings if "Reported against" in one)
    assert 20 < drawing.count("frame_") <= 37


def test_camera_parameters_have_names(result: Result) -> None:
    text = render(result)
    found = re.findall(r'<th scope="row" class="text">(\w+)</th><td>[-.0-9]+</td><td>(.*?)<', text)
    assert [name for name, _ in found] == ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"]
    assert [std for _, std in found] == [
        "0.6",
        "0.6",
        "0.4",
        "0.4",
        "0.0005",
        "0.001",
        "6e-05",
        "fixed",
    ]


def test_what_is_tied_is_told_in_words(result: Result) -> None:
    """High correlations of X with itself and with the intrinsics; nothing of low ones."""
    text = render(result)
    assert "The camera&#39;s fx and the position along z (correlation -0.91)." in text
    assert "The camera&#39;s fy" not in text
    stds = np.sqrt(np.diag(result.covariance))
    covariance = result.covariance.copy()
    covariance[0, 4] = covariance[4, 0] = -0.93 * stds[0] * stds[4]
    text = render(replace(result, covariance=covariance))
    assert "The rotation about x and the position along y (correlation -0.93)." in text
    loose = replace(result, covariance=np.diag(stds**2), intrinsics_correlation=None)
    assert "all correlations of the components of X" in render(loose)


def test_the_noise_is_held_against_what_was_said(result: Result) -> None:
    text = render(result)
    assert "given; the residuals say 0.54 (0.45 to 0.66), which is more" in text
    assert "data sheet" not in text
    text = render(replace(result, repeatability=1e-4))
    assert "states a repeatability of 0.1 mm, which is 0.028 mm per axis" in text
    assert "off by 11 times as much" in text


def test_unlisted_camera_model_has_numbered_parameters(result: Result) -> None:
    camera = dataclasses.replace(result.camera, model="THIN_PRISM")
    text = render(dataclasses.replace(result, camera=camera))
    assert '<th scope="row" class="text">8</th>' in text


def test_unwritable_folder_is_an_input_error(result: Result, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputDataError, match="file"):
        write_report(result, tmp_path / "file")


def test_summary_in_the_terminal(result: Result, tmp_path: Path) -> None:
    text = summary_text(result, tmp_path / "report.html")
    for words in (
        "X = gripper_T_camera",
        "std rotation     0.0229  0.0286  0.0115  deg",
        "std translation  0.300  0.250  0.410  mm",
        "0.2345679 ± 0.00012 metres per world unit",
        "noise estimated  pixel 0.43 px, robot 0.0286 deg and 0.3 mm per axis",
        "17 of 18 registered, 1 robot pose rejected",
        "undetermined     nothing",
        "p_gripper = gripper_T_camera p_camera; the point 0.5 m in front of the camera",
        f"Report: {tmp_path / 'report.html'}",
    ):
        assert words in text, words
    assert "Report:" not in summary_text(result)


def test_the_other_choice_of_intrinsics_is_told(result: Result, tmp_path: Path) -> None:
    text = write_report(result, tmp_path).read_text(encoding="utf-8")
    assert "With the given intrinsics fixed, X would be 0.011 deg and 0.31 mm from here" in text
    assert "1.25 times the standard deviation of this change" in text
    assert (
        "the camera would be 1.5 mm farther back along its optical axis (correlation -0.43)" in text
    )
    free = dataclasses.replace(result.other_intrinsics, kind="free")
    text = write_report(dataclasses.replace(result, other_intrinsics=free), tmp_path).read_text(
        "utf-8"
    )
    assert "With free intrinsics, X would be" in text


def test_what_the_intervals_rest_on_is_told(result: Result) -> None:
    page = render(result)
    assert "Student&#39;s t" in page
    assert "12 degrees of freedom or more" in page
    assert "errors are not independent noise (p = 0.002)" in page
    assert "the data say next to nothing: a prior for usual arms decided" in page
    assert "900 degrees of freedom" in page
    assert "± 0.0630" in page  # 1.1e-3 rad
    without = render(replace(result, certainty=None))
    assert "1.96 standard deviations" in without


def test_the_verdict_is_about_the_task(result: Result) -> None:
    """Within the tolerance, out of it, and the smallest usual one where none was given."""
    found = result.accuracy
    assert found is not None
    radius = found.at_work.within_95
    for tolerance, words in (
        (None, "Usable for"),
        (2.0 * radius, "Usable for the tolerance"),
        (0.5 * radius, "Not good enough"),
    ):
        one = dataclasses.replace(result, accuracy=dataclasses.replace(found, tolerance=tolerance))
        page, text = render(one), summary_text(one)
        assert words in page
        assert words in text
        assert str(escape(judgement.advice(one))) in page
        assert bool(judgement.advice(one)) == (words == "Not good enough")
    assert "Usable" not in render(dataclasses.replace(result, accuracy=None))


def test_the_advice_names_how_many_images_would_do(result: Result) -> None:
    """Four times as many for half the error; where the arm is to blame, none."""
    found = result.accuracy
    assert found is not None
    narrow = dataclasses.replace(found, tolerance=0.5 * found.at_work.within_95)
    one = dataclasses.replace(result, accuracy=narrow)
    assert "arm's own errors" in judgement.advice(one)
    white = dataclasses.replace(one, certainty=None)
    assert "about 64 like these" in judgement.advice(white)
