"""The report as a browser shows it: Debian's chromium, without a network."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from markdown_it import MarkdownIt
from PIL import Image, ImageColor
from playwright.sync_api import Browser, Page, expect, sync_playwright
from pypdf import PdfReader

from handeye_fg.io.files import write_atomic
from handeye_fg.io.result_reader import load_result
from handeye_fg.io.results import Result
from handeye_fg.io.scene_file import RefinedScene
from handeye_fg.report import markdown_text, write_report

CHROMIUM = shutil.which("chromium")
REAL = Path(__file__).parents[1] / "data" / "doosan"
ATTACK = "<img src=x onerror=alert(1)>.jpg"
MOST_PAGES = 6
MOST_BYTES = 3_000_000
# Of the 3D view: pixels in one of its colours that are no accident.
FEW_PIXELS = 100

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the path"),
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        # WebGL without a GPU; the sandbox is not to be had in all containers.
        arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield browser
        browser.close()


@pytest.fixture(scope="module", params=["tabletop", "real"])
def report(
    request: pytest.FixtureRequest, tabletop_output: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The page of a rendered and of a real set."""
    if request.param == "tabletop":
        return tabletop_output / "report.html"
    output = tmp_path_factory.mktemp("real")
    shutil.copytree(REAL, output, dirs_exist_ok=True)
    return write_report(load_result(output), output)


@pytest.fixture(scope="module")
def loaded(browser: Browser, report: Path) -> Iterator[tuple[Page, list[str]]]:
    with opened(browser, report) as (page, troubles):
        yield page, troubles


@pytest.fixture
def page(loaded: tuple[Page, list[str]]) -> Iterator[Page]:
    """The page, wide and light, with all its parts open; it must cause no trouble, whatever is done to it."""
    page, troubles = loaded
    page.set_viewport_size({"width": 1280, "height": 900})
    page.emulate_media(color_scheme="light", media="screen")
    page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = true; })")
    page.mouse.move(0, 0)
    yield page
    assert troubles == []


def wait_until(page: Page, condition: str) -> None:
    """Ask until it is so: the page's policy lets no script be made of text that could wait in it."""
    for _ in range(300):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(100)
    pytest.fail(f"it never came to {condition}")


@contextmanager
def opened(
    browser: Browser, report: Path, scheme: Literal["light", "dark"] = "light"
) -> Iterator[tuple[Page, list[str]]]:
    """The page when all of it is drawn, and a list of errors, dialogs and requests for anything else."""
    troubles: list[str] = []
    context = browser.new_context(
        viewport={"width": 1280, "height": 900},
        color_scheme=scheme,
        permissions=["clipboard-read", "clipboard-write"],
    )
    page = context.new_page()
    page.on("console", lambda told: troubles.append(told.text) if told.type == "error" else None)
    page.on("pageerror", lambda error: troubles.append(str(error)))
    page.on("dialog", lambda dialog: (troubles.append(dialog.message), dialog.dismiss()))
    page.on("request", lambda asked: troubles.append(asked.url) if foreign(asked.url) else None)
    page.goto(report.as_uri())
    page.wait_for_selector("#view[data-drawn]")
    yield page, troubles
    context.close()


def foreign(url: str) -> bool:
    return not (url.startswith(("data:", "blob:")) or url.endswith("/report.html"))


def colour(page: Page, name: str) -> np.ndarray:
    """One of the page's colours, such as "first"."""
    text = page.evaluate(
        "name => getComputedStyle(document.documentElement).getPropertyValue('--' + name)", name
    )
    return np.array([int(text.strip()[i : i + 2], 16) for i in (1, 3, 5)])


def pixels(page: Page) -> np.ndarray:
    """What the canvas of the 3D view shows, without the labels above it."""
    page.add_style_tag(content="#view svg { visibility: hidden; }")
    page.locator("#view").scroll_into_view_if_needed()
    with Image.open(BytesIO(page.locator("#view").screenshot())) as shot:
        return np.asarray(shot.convert("RGB")).astype(int)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_view_is_drawn_in_the_colours_of_the_page(
    page: Page, scheme: Literal["light", "dark"]
) -> None:
    page.emulate_media(color_scheme=scheme)
    page.wait_for_timeout(500)
    shown = pixels(page)
    for name in ("muted", "first", "second"):  # scene points, grippers, cameras
        near = np.abs(shown - colour(page, name)).max(axis=2) < 40
        assert near.sum() > FEW_PIXELS, name


def test_the_file_is_small(report: Path) -> None:
    assert report.stat().st_size <= MOST_BYTES


def test_copy_buttons_copy(page: Page, report: Path) -> None:
    wanted = json.loads((report.parent / "result.json").read_text())["calibration"]["matrix"]
    buttons = page.locator("button[data-copy]")
    assert buttons.count() == 6
    for button in buttons.all():
        button.click()
        copied = page.evaluate("navigator.clipboard.readText()")
        source = page.locator(f"#{button.get_attribute('data-copy')}")
        assert copied == source.text_content()
        assert len(copied) > 40
        told = page.locator("#copied").text_content()
        assert told == f"{button.get_attribute('data-what')} copied"
    buttons.first.click()
    assert json.loads(page.evaluate("navigator.clipboard.readText()")) == wanted


def test_everything_is_reached_by_the_keyboard(page: Page) -> None:
    usable = "a[href], button, summary, [tabindex='0']"
    wanted = page.locator(usable).count()
    page.evaluate(
        f'document.querySelectorAll("{usable}").forEach((e, i) => {{ e.dataset.at = i; }})'
    )
    page.locator(usable).first.focus()
    page.keyboard.press("Tab")
    page.keyboard.press("Shift+Tab")
    order = []
    for _ in range(wanted):
        at, outline = page.evaluate(
            "() => { const e = document.activeElement, s = getComputedStyle(e);"
            "return [e.dataset.at, s.outlineStyle + ' ' + s.outlineWidth]; }"
        )
        assert outline == "solid 2px", page.evaluate("document.activeElement.outerHTML")[:200]
        order.append(int(at))
        page.keyboard.press("Tab")
    assert order == list(range(wanted))


def test_the_keyboard_does_what_the_mouse_does(page: Page) -> None:
    page.locator("button[data-copy]").first.focus()
    page.keyboard.press("Enter")
    expect(page.locator("#copied")).to_contain_text("Matrix")
    assert page.evaluate("navigator.clipboard.readText()").startswith("[[")

    eye = "JSON.stringify(document.getElementById('view').layout.scene.camera.eye)"
    for press in ("ArrowLeft", "ArrowUp", "+"):
        before = page.evaluate(eye)
        page.locator("#view").focus()
        page.keyboard.press(press)
        wait_until(page, f"{eye} !== '{before}'")

    second = page.locator("#strip button").nth(1)
    second.focus()
    page.keyboard.press("Enter")
    expect(second).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#told")).to_contain_text(second.text_content())


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_contrast_and_names_are_accessible(
    page: Page, width: int, scheme: Literal["light", "dark"]
) -> None:
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa", "wcag21aa"]})
    assert found.response["violations"] == []
    passed = {rule["id"] for rule in found.response["passes"]}
    assert {"color-contrast", "button-name", "document-title"} <= passed


def test_it_prints_on_few_pages(page: Page) -> None:
    page.evaluate("document.querySelectorAll('details').forEach(part => { part.open = false; })")
    page.emulate_media(color_scheme="dark", media="print")
    white = "rgb(255, 255, 255)"
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == white
    printed = PdfReader(BytesIO(page.pdf(format="A4", print_background=True)))
    assert 2 <= len(printed.pages) <= MOST_PAGES
    text = " ".join(one.extract_text() for one in printed.pages)
    for words in ("X and how sure it is", "Where the camera was", "Provenance"):
        assert words in text


@pytest.mark.parametrize("width", [390, 320])
def test_it_fits_a_phone(page: Page, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") == width
    # The 3D view follows when it has been drawn again.
    wait_until(page, "document.querySelector('#view canvas').clientWidth < innerWidth")


# Where a point of the 3D view is on the screen.
_ON_SCREEN = """
(point) => {
  const place = document.getElementById("view"), scene = place._fullLayout.scene._scene;
  const { model, view, projection } = scene.glplot.cameraParams;
  const times = (m, v) => [0, 1, 2, 3].map((i) => v.reduce((sum, x, j) => sum + m[4 * j + i] * x, 0));
  const scaled = point.map((x, i) => x * scene.dataScale[i]);
  const [x, y, , w] = times(projection, times(view, times(model, [...scaled, 1])));
  const box = place.querySelector("canvas").getBoundingClientRect();
  return [box.left + (0.5 + 0.5 * x / w) * box.width, box.top + (0.5 - 0.5 * y / w) * box.height];
}
"""


def test_an_image_stands_before_its_camera(
    browser: Browser, result: Result, tmp_path: Path
) -> None:
    """Upright and not mirrored, with its name; the legend puts it away."""
    colours = {
        (0.25, 0.25): "red",
        (0.75, 0.25): "lime",
        (0.25, 0.75): "blue",
        (0.75, 0.75): "yellow",
    }
    with Image.new("RGB", (128, 96)) as picture, BytesIO() as buffer:
        for (right, down), name in colours.items():
            corner = round(128 * right) - 32, round(96 * down) - 24
            picture.paste(name, (*corner, corner[0] + 64, corner[1] + 48))
        picture.save(buffer, "JPEG")
        thumbnail = buffer.getvalue()
    image, camera = result.images[3], result.camera
    write_report(with_scene(result, {image.name: thumbnail}), tmp_path)
    fx, fy, cx, cy = camera.params[:4]
    with opened(browser, tmp_path / "report.html") as (page, troubles):
        switch = page.locator("#view .traces", has_text="images").locator(".legendtoggle")
        for shown in ("'legendonly'", "true"):
            switch.click()
            wait_until(page, f"{_IMAGES} === {shown}")
        # Alone, seen from behind the camera and a little aside.
        page.evaluate(_ALONE)
        eye = image.base_T_camera[:3, :3] @ [0.1, -0.2, -1.5]
        page.evaluate(
            "eye => Plotly.relayout('view', {'scene.camera.eye': eye})",
            dict(zip("xyz", eye, strict=True)),
        )
        page.locator("#view").scroll_into_view_if_needed()
        page.wait_for_timeout(500)
        seen, box = pixels(page), page.locator("#view").bounding_box()
        corner = page.evaluate(
            "JSON.parse(document.getElementById('view-data').textContent).corners[3][0]"
        )
        depth = (np.array(corner) - image.base_T_camera[:3, 3]) @ image.base_T_camera[:3, 2]
        for (right, down), name in colours.items():
            ray = [(right * camera.width - cx) / fx, (down * camera.height - cy) / fy, 1.0]
            point = image.base_T_camera[:3, :3] @ ray * depth + image.base_T_camera[:3, 3]
            x, y = page.evaluate(_ON_SCREEN, point.tolist())
            found = seen[round(y - box["y"]), round(x - box["x"])]
            assert np.abs(found - ImageColor.getrgb(name)).max() < 60, (name, found)
            page.mouse.move(x - 3, y - 3)
            page.mouse.move(x, y, steps=5)
            expect(page.locator("#view .hovertext").first).to_contain_text(image.name)
        assert troubles == []


_IMAGES = "document.getElementById('view')._fullData.find(trace => trace.name === 'images').visible"
_ALONE = """
Plotly.restyle("view", { visible: false },
    document.getElementById("view").data.flatMap((trace, i) => trace.name === "images" ? [] : [i]))
"""


def test_a_hostile_name_is_text_everywhere(
    browser: Browser, renamed: Callable[[str], Result], tmp_path: Path
) -> None:
    """In the table, the list of bad data, the figures, the 3D view, and in Markdown."""
    result = renamed(ATTACK)
    with BytesIO() as buffer:
        Image.new("RGB", (64, 48), "teal").save(buffer, "JPEG")
        picture = buffer.getvalue()
    hostile = with_scene(result, {ATTACK: picture})
    hostile.save(tmp_path)
    write_report(load_result(tmp_path), tmp_path)
    with opened(browser, tmp_path / "report.html", "dark") as (page, troubles):
        button = page.locator("#strip button").first
        assert button.text_content() == ATTACK
        button.click()
        assert page.locator("#told").text_content().startswith(f"{ATTACK}: ")
        centre = result.images[0].base_T_camera[:3, 3].tolist()
        page.locator("#view").scroll_into_view_if_needed()
        x, y = page.evaluate(_ON_SCREEN, centre)
        page.mouse.move(x - 30, y - 30)
        page.mouse.move(x, y, steps=5)
        label = page.locator("#view .hovertext").first
        label.wait_for()
        assert ATTACK in label.text_content()
        assert page.locator("th", has_text=ATTACK).count() == 2
        assert page.locator("li", has_text=ATTACK).count() == 1
        assert page.locator("figure svg text", has_text="<img src=x").count() >= 2
        assert page.locator("img[onerror], img[src='x'], script[src]").count() == 0
        assert troubles == []

    shown = MarkdownIt("commonmark").enable("table").render(markdown_text(hostile))
    write_atomic(tmp_path / "markdown" / "report.html", f"<div id=view data-drawn>{shown}</div>")
    with opened(browser, tmp_path / "markdown" / "report.html") as (page, troubles):
        assert ATTACK in page.locator("body").text_content()
        assert page.locator("img").count() == 0
        assert troubles == []


def with_scene(result: Result, thumbnails: dict[str, bytes]) -> Result:
    """The result with some points to draw."""
    rng = np.random.default_rng(3)
    scene = RefinedScene(
        points=rng.normal([0.5, 0.0, 0.0], 0.1, (200, 3)),
        n_points=200,
        image=np.zeros(50, dtype=np.int64),
        pixels=rng.uniform(0, 900, (50, 2)),
        errors=rng.normal(0, 0.4, (50, 2)),
        sigmas=np.full(50, 0.4),
        n_observations=50,
        names=tuple(image.name for image in result.images if image.registered),
        thumbnails=thumbnails,
        path=np.stack([result.initial.gripper_T_camera, result.matrix]),
    )
    return replace(result, scene=scene)
