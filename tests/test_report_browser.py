"""The report in a real browser, from a disk: what the slider, the probe, the filters and the keys show."""

from __future__ import annotations

import base64
import os
import re
import tempfile
from dataclasses import replace

import numpy as np
import pytest

from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.cloud import DECADES, MAP_ALPHAS, MAP_ANGLES, Cloud
from mrm_nodes.regression.cases.pictures import write_pictures
from mrm_nodes.regression.report.page import MOST_INSIDE, PIECE, figure, share, write_report
from mrm_nodes.regression.verdict.compare import VERDICTS, Figures
from mrm_nodes.regression.verdict.outcome import Outcome, outcome_of
from mrm_nodes.regression.verdict.tolerance import Tolerance, compare_images
from mrm_nodes.render.images import read_image
from mrm_nodes.render.tonemap import find_tonemap
from mrm_nodes.render.webgl import INSTALL, find_browser

MISSING = INSTALL
try:
    from playwright.sync_api import Page, expect, sync_playwright

    if find_browser() is not None:
        MISSING = ""
except ImportError:
    MISSING = "the report's page is tested through playwright: pip install 'mrm-nodes[targets]'"
if MISSING:
    assert "essl" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), MISSING
    pytest.skip(MISSING, allow_module_level=True)

SIZE = 32
ENVIRONMENT = {
    "date": "2026-07-01 12:00 UTC",
    "backends": {"egl": "llvmpipe, OpenGL 4.5"},
    "versions": {"mrm-nodes": "0.1.0"},
}
SOURCE = '<materialx version="1.39"><!-- </script><img src=x onerror="document.title=1"> --></materialx>'
EVIL = (
    "</script ></script><script>document.title='taken'</script><img src=x onerror=\"document.title='taken'\">"
)


def images(wrong: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render, reference and mask; left half red, right half dark blue, one pixel wrong, a border without mesh."""
    rng = np.random.default_rng(7)
    reference = rng.uniform(0.2, 0.6, (SIZE, SIZE, 3)) * np.array([1.0, 0.1, 0.05])
    reference[:, SIZE // 2 :] = 0.02 * rng.uniform(0.5, 1.0, (SIZE, SIZE // 2, 3)) * np.array([0.0, 0.3, 1.0])
    image = (reference * (1 + 1e-6)).astype(np.float32)
    image[10, 20] *= np.float32(1 + wrong)
    mask = np.zeros((SIZE, SIZE), bool)
    mask[2:-2, 2:-2] = True
    return image, reference, mask


def compared(folder, name: str, wrong: float, tolerance: Tolerance) -> dict:
    place = folder / "cases" / "egl" / name
    place.mkdir(parents=True)
    image, reference, mask = images(wrong)
    found = compare_images(image, reference, mask, tolerance)
    written = write_pictures(place, image, reference, mask, found.used, found.flip, SOURCE)
    return {
        "verdict": found.verdict,
        "figures": found.figures,
        "tolerance": tolerance.limits(),
        "files": {
            key: f"cases/egl/{name}/{file}" if isinstance(file, str) else file
            for key, file in written.items()
        },
    }


def outcomes(folder) -> list[Outcome]:
    """Every verdict; the names hold what a path or a page might trip over."""
    cases = default_suite()
    made = [
        ("fails #1 100%", compared(folder, "fails #1 100%", 3e-3, Tolerance(max_rel=1e-3, flip=0.1)), {}),
        ("passes", compared(folder, "passes", 0.0, Tolerance(max_rel=1e-3)), {}),
        ("passes too", compared(folder, "passes too", 1e-4, Tolerance(max_rel=1e-3)), {"truth": "baseline"}),
        ("breaks", {"verdict": "error", "message": EVIL}, {}),
        ("is noise", {"verdict": "undecided", "message": "within the standard error"}, {}),
        (
            "is left out",
            {"verdict": "skipped", "message": "libOSMesa is not installed"},
            {"backend": "osmesa"},
        ),
    ]
    told = []
    for (name, known, others), case in zip(made, cases, strict=False):
        outcome = outcome_of(case, "egl", **known)
        outcome.name = name
        told.append(replace(outcome, **others))
    decades = [
        {"alpha": list(alpha), "film": film, "max_rel": 1e-4, "p999_rel": 1e-5, "max_used": 0.3, "p999_used": 0.2}
        for alpha in DECADES for film in (False, True)
    ]  # fmt: skip
    cloud = Cloud("mrm_dielectric_bsdf", configurations=60_000)
    details = {"decades": decades, "maps": maps(), "worst": WORST[0], "worst_configurations": WORST}
    told.append(outcome_of(cloud, "egl", "pass", figures=told[1].figures, details=details))
    return told


OVER_BOUND = (16, 3)
"""The cell of the light's map without a film that is over the bound: its row, from 0 degrees up, and its column."""
WORST = [
    {"used": 1.5, "inputs": {"roughness": [0.05299999937415123, 0.25], "tint": [1.0, None, 0.5]},
     "view": [0.6, 0.0, 0.8], "light": [0.0, 0.0, 1.0], "image": [0.1, 0.2, None], "reference": [0.1, 0.2, 0.3]},
    {"used": 0.5, "inputs": {"roughness": [0.5, 0.5], "tint": [1.0, 1.0, 1.0]},
     "view": [0.0, 0.0, 1.0], "light": [0.0, 0.0, 1.0], "image": [0.1, 0.2, 0.3], "reference": [0.1, 0.2, 0.3]},
]  # fmt: skip


def maps() -> list[dict]:
    """A cloud's: a tenth of the bound, one cell over it, and one in which nothing lies."""
    found = []
    for film in (False, True):
        for angle in ("view", "light"):
            used = [[0.1] * MAP_ALPHAS for _ in range(MAP_ANGLES)]
            used[0][0] = None
            if angle == "light" and not film:
                used[OVER_BOUND[0]][OVER_BOUND[1]] = 1.5
            found.append({"angle": angle, "film": film, "used": used})
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("a report")
    write_report(folder, ENVIRONMENT, outcomes(folder), 12.5)
    return folder


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), args=["--no-sandbox"])
        yield browser
        browser.close()


class Opened:
    """A page, with everything that it complained about."""

    def __init__(self, browser, folder, fragment="", **context):
        self.context = browser.new_context(**{"viewport": {"width": 1400, "height": 900}, **context})
        self.page: Page = self.context.new_page()
        self.complaints: list[str] = []
        self.asked: list[str] = []
        self.page.on("console", self._listen)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto((folder / "index.html").as_uri() + fragment)
        self.page.wait_for_selector("html[data-ready]")

    def _listen(self, message) -> None:
        if message.type == "error":
            self.complaints.append(message.text)


@pytest.fixture
def opened(browser, folder):
    """Opens the report; a page that complains, or that asks for more than files, fails its test."""
    pages = []

    def open_page(fragment="", of=folder, **context):
        pages.append(Opened(browser, of, fragment, **context))
        return pages[-1].page

    yield open_page
    for each in pages:
        assert each.complaints == []
        assert [url for url in each.asked if not url.startswith("file://")] == []
        assert "taken" not in each.page.title()
        each.context.close()


def wait_until(page: Page, expression: str, argument: object = None) -> None:
    """`page.wait_for_function` evaluates a string on the page if it has to wait, which the page's policy forbids."""
    for _ in range(600):
        if page.evaluate(expression, argument):
            return
        page.wait_for_timeout(20)
    raise AssertionError(f"never true: {expression}")


def names(page: Page) -> list[str]:
    return page.locator(".card b").all_text_contents()


def open_case(page: Page, name: str) -> None:
    page.locator(".card a", has=page.get_by_text(name, exact=True)).click()
    page.wait_for_selector("#layer-map canvas")


def canvas(page: Page, layer: str, size: int = SIZE) -> np.ndarray:
    """The pixels of a canvas, `(h, w, 4)` 8 bits."""
    return pixels_of(page, f"#{layer} canvas", size)


def pixels_of(page: Page, selector: str, size: int) -> np.ndarray:
    text = page.evaluate(
        """(selector) => {
          const canvas = document.querySelector(selector);
          const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
          return btoa(Array.from(data, (byte) => String.fromCharCode(byte)).join(""));
        }""",
        selector,
    )
    return np.frombuffer(base64.b64decode(text), np.uint8).reshape(-1, size, 4)


def seen(page: Page, selector: str = "#frame-render") -> np.ndarray:
    """What the screen shows of an element: RGB, `(h, w, 3)`, 0 to 255."""
    png = page.locator(selector).screenshot()
    with tempfile.NamedTemporaryFile(suffix=".png") as file:
        file.write(png)
        file.flush()
        return np.rint(255 * read_image(file.name)[..., :3]).astype(int)


def probed(page: Page, row: str) -> list[str]:
    return page.locator(f"#probe-{row} td").all_text_contents()


def hover(page: Page, x: int, y: int, frame: str = "#frame-render") -> None:
    """Put the cursor on the middle of a pixel of an image that is not zoomed."""
    box = page.locator(frame).bounding_box()
    page.mouse.move(box["x"] + (x + 0.5) / SIZE * box["width"], box["y"] + (y + 0.5) / SIZE * box["height"])


# The wall


def test_the_wall_has_every_verdict_worst_first_and_skipped_last(opened):
    page = opened()
    verdicts = [text.strip("✓✕!?– ") for text in page.locator(".card .pill").all_text_contents()]
    assert verdicts == ["fail", "error", "undecided", "pass", "pass", "pass", "skipped"]
    colours = {
        verdict: page.locator(f".card .pill.{verdict}").first.evaluate("each => getComputedStyle(each).color")
        for verdict in VERDICTS
    }
    assert len(set(colours.values())) == len(VERDICTS)
    assert page.locator("#verdicts [data-verdict] b").all_text_contents() == ["1", "1", "1", "3", "1"]
    expect(page.locator("#skips")).to_contain_text("libOSMesa is not installed")


def test_pictures_of_cases_with_odd_names_are_found(opened):
    page = opened()
    wait_until(page, "[...document.querySelectorAll('.card img')].every((each) => each.complete)")
    widths = page.locator(".card img").evaluate_all("all => all.map((each) => each.naturalWidth)")
    assert widths == [SIZE] * 6
    alts = page.locator(".card img").evaluate_all("all => all.map((each) => each.alt)")
    assert "Render of fails #1 100%" in alts


def test_filters_and_search_leave_what_they_name(opened):
    page = opened()
    page.locator('[data-verdict="pass"]').click()
    assert sorted(names(page)) == ["cloud-dielectric-ggx-smith", "passes", "passes too"]
    assert page.locator('[data-verdict="pass"]').get_attribute("aria-pressed") == "true"
    page.locator("#filter-truth").select_option("baseline")
    assert names(page) == ["passes too"]
    expect(page.locator("#shown")).to_have_text("1 of 7")
    page.locator('[data-verdict="pass"]').click()
    page.locator("#filter-truth").select_option("")
    page.locator("#search").fill("OSMESA installed")
    assert names(page) == ["is left out"]
    page.locator("#search").fill("no such words")
    assert names(page) == []
    page.locator("#clear").click()
    assert len(names(page)) == 7
    page.locator("#filter-node").select_option("mrm_dielectric_bsdf")
    assert names(page) == ["cloud-dielectric-ggx-smith"]


def test_a_link_shows_what_its_sender_saw(opened):
    page = opened("#verdict=pass&truth=baseline")
    assert names(page) == ["passes too"]
    case = opened("#case=passes+too")
    expect(case.locator("#case-name")).to_contain_text("passes too")
    case.keyboard.press("Escape")
    expect(case.locator("#case")).not_to_be_visible()
    assert "case=" not in case.url
    lost = opened("#case=nowhere")
    expect(lost.locator("#unknown")).to_contain_text("no case nowhere")


def test_a_link_that_is_clicked_can_be_gone_back_from(opened):
    page = opened()
    open_case(page, "passes")
    assert "case=passes" in page.url
    page.go_back()
    expect(page.locator("#case")).not_to_be_visible()
    assert len(names(page)) == 7


# The keyboard


def test_the_keyboard_alone_goes_everywhere(opened):
    page = opened()
    focused = "document.activeElement.textContent"
    page.keyboard.press("End")
    assert "is left out" in page.evaluate(focused)
    page.keyboard.press("Home")
    page.keyboard.press("ArrowRight")
    assert "breaks" in page.evaluate(focused)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Enter")
    expect(page.locator("#case-name")).to_contain_text("fails #1 100%")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#case-name")).to_contain_text("breaks")
    expect(page.locator("#case-message")).to_have_text(EVIL)
    expect(page.locator("#images")).not_to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("#case")).not_to_be_visible()
    # The event that ends a case comes after the dialog is gone, and gives the wall the focus.
    page.wait_for_function("!location.hash.includes('case')")
    assert "breaks" in page.evaluate(focused)
    page.keyboard.press("/")
    expect(page.locator("#search")).to_be_focused()
    page.keyboard.type("passes too")
    expect(page.locator(".card b")).to_have_text(["passes too"])
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    expect(page.locator("#case-name")).to_contain_text("passes too")
    page.keyboard.press("?")
    expect(page.locator("#help")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("#help")).not_to_be_visible()
    expect(page.locator("#case")).to_be_visible()


def test_arrows_go_by_rows_and_columns_as_they_are_shown(opened):
    page = opened(viewport={"width": 700, "height": 900})
    assert page.evaluate("wall.columns") == 2
    page.keyboard.press("Home")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("wall.current") == 2
    page.keyboard.press("ArrowUp")
    assert page.evaluate("wall.current") == 0


# One case


def test_the_probe_reads_both_float32_values_and_the_error(opened):
    page = opened()
    open_case(page, "fails #1 100%")
    image, reference, _ = images(3e-3)
    for x, y in ((20, 10), (5, 25), (29, 29)):
        hover(page, x, y)
        expect(page.locator("#probe-place b")).to_have_text(f"x {x}, y {y}")
        truth = reference.astype(np.float32)
        for row, values in (("render", image[y, x]), ("reference", truth[y, x])):
            assert [np.float32(text) for text in probed(page, row)] == list(values)
        error = np.abs(image[y, x].astype(float) - truth[y, x]) / np.maximum(truth[y, x], 1e-4)
        assert probed(page, "error") == [figure(each) for each in error]
    hover(page, 20, 10)
    expect(page.locator("#probe-place")).to_contain_text(f"{share(3.0)} of its bound")
    hover(page, 0, 0)
    expect(page.locator("#probe-place")).to_contain_text("beside the mesh")


def test_numbers_are_written_as_the_terminal_writes_them_and_float32_in_full(opened):
    page = opened()
    rng = np.random.default_rng(3)
    values = (10.0 ** rng.uniform(-30, 30, 400) * rng.choice([-1, 1], 400)).astype(np.float32)
    texts = page.evaluate("values => values.map(float32Text)", [float(each) for each in values])
    assert [np.float32(text) for text in texts] == list(values)
    assert all(len(re.sub(r"e.*|[-.]|^0\.0*", "", text)) <= 9 for text in texts if "e" in text)
    known = [0.0, 3.4e-4, 0.00949, 0.0095, 0.42, 1.0, 9.99, 10.0, 12345.6]
    assert page.evaluate("values => values.map(share)", known) == [share(each) for each in known]
    assert page.evaluate("values => values.map(figure)", known) == [figure(each) for each in known]
    assert page.evaluate("[share(null), figure(null)]") == [share(None), figure(None)]


def test_a_case_opens_with_the_probe_on_its_worst_pixel_and_arrows_move_it(opened):
    page = opened()
    open_case(page, "fails #1 100%")
    expect(page.locator("#probe-place b")).to_have_text("x 20, y 10")
    page.locator("#frame-render").focus()
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowDown")
    expect(page.locator("#probe-place b")).to_have_text("x 19, y 20")
    expect(page.locator("#case-name")).to_contain_text("fails #1 100%")


def test_panes_show_the_numbers_at_the_exposure_of_the_pictures(opened):
    """The page's own colours against OpenImageIO's PNG of the same numbers."""
    page = opened()
    open_case(page, "passes")
    stops = float(re.sub("[^0-9.−]", "", page.locator("#exposure").text_content()).replace("−", "-"))
    image, reference, mask = images(0.0)
    for layer, values in (("layer-render", image), ("layer-reference", reference)):
        shown = canvas(page, layer)
        assert ((shown[..., 3] > 0) == mask).all()
        linear = find_tonemap("neutral")(values * 2.0**stops)
        srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        assert np.abs(shown[mask][:, :3] - 255 * srgb[mask]).max() <= 1.0


def test_exposure_brightens_and_comes_back(opened):
    page = opened()
    open_case(page, "passes")
    before = canvas(page, "layer-render").astype(int)
    page.keyboard.press("+")
    brighter = canvas(page, "layer-render").astype(int)
    page.keyboard.press("-")
    page.keyboard.press("-")
    darker = canvas(page, "layer-render").astype(int)
    _, _, mask = images(0.0)
    assert (brighter >= before).all()
    assert (before >= darker).all()
    assert brighter[mask].sum() > 1.05 * before[mask].sum()
    page.keyboard.press("0")
    assert (canvas(page, "layer-render") == before).all()


def test_the_maps_mark_the_wrong_pixel(opened):
    page = opened()
    open_case(page, "fails #1 100%")
    kinds = page.locator("#map-kind option").all_text_contents()
    assert kinds == ["share of bound", "FLIP", "relative error", "signed error"]
    over = [0xFF, 0x1F, 0x5A]
    shown = canvas(page, "layer-map")
    assert np.argwhere((shown[..., :3] == over).all(-1)).tolist() == [[10, 20]]
    page.keyboard.press("e")
    assert page.locator("#map-kind").input_value() == "flip"
    page.locator("#map-kind").select_option("signed")
    red, _, blue = (canvas(page, "layer-map")[10, 20, channel] for channel in range(3))
    assert red > 2 * blue
    expect(page.locator("#map-ends")).to_contain_text(f"+{figure(3e-3)}")


def test_false_colour_shows_luminance_in_stops(opened):
    page = opened()
    open_case(page, "passes")
    page.keyboard.press("c")
    shown = canvas(page, "layer-reference").astype(float)
    luminance = images(0.0)[1] @ [0.2126, 0.7152, 0.0722]
    bright, dark = (
        (shown[5, 5], shown[5, 25]) if luminance[5, 5] > luminance[5, 25] else (shown[5, 25], shown[5, 5])
    )
    assert bright[:3] @ [0.2126, 0.7152, 0.0722] > dark[:3] @ [0.2126, 0.7152, 0.0722]
    assert page.locator(".pictured").first.is_visible()


def test_the_slider_shows_the_render_left_of_it_and_the_reference_right(opened):
    page = opened()
    open_case(page, "passes")
    # What the render's canvas shows is made green, so that it can be told from the reference.
    page.evaluate(
        """() => {
          const canvas = document.querySelector("#layer-render canvas");
          const context = canvas.getContext("2d");
          context.fillStyle = "rgb(0, 255, 0)";
          context.fillRect(0, 0, canvas.width, canvas.height);
        }"""
    )
    page.keyboard.press("s")
    page.mouse.move(5, 5)

    def share_of_render() -> float:
        row = seen(page)[40]
        green = (row[:, 1] > 200) & (row[:, 0] < 60)
        edge = int(green.sum())
        assert green[4 : edge - 4].all()  # its ends fade into what lies beside it
        return edge / len(row)

    assert share_of_render() == pytest.approx(0.5, abs=0.02)
    page.locator("#wipe").fill("20")
    assert share_of_render() == pytest.approx(0.2, abs=0.02)
    page.locator("#wipe").focus()
    page.keyboard.press("ArrowRight")
    assert page.locator("#wipe").input_value() == "21"
    expect(page.locator("#case-name")).to_contain_text("passes")
    box = page.locator("#frame-render").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 9)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 9)
    page.mouse.up()
    page.mouse.move(5, 5)
    assert share_of_render() == pytest.approx(0.75, abs=0.02)


def test_flicker_shows_render_and_reference_in_turn(opened):
    page = opened()
    open_case(page, "passes")
    page.keyboard.press("f")
    for word in ("render", "reference", "render"):
        wait_until(
            page,
            """(word) => {
              const seen = (id) => getComputedStyle(byId(id)).visibility === "visible";
              const only = word === "render" ? [true, false] : [false, true];
              return byId("tag-left").textContent === word
                && seen("layer-render") === only[0] && seen("layer-behind") === only[1];
            }""",
            word,
        )
    page.keyboard.press("f")
    expect(page.locator("#pane-reference")).to_be_visible()
    assert page.evaluate("view.flicker") is None


def test_who_wants_no_motion_turns_the_pictures_himself(opened):
    page = opened(reduced_motion="reduce")
    open_case(page, "passes")
    page.keyboard.press("f")
    assert page.evaluate("view.flicker") is None
    expect(page.locator("#tag-left")).to_have_text("render")
    page.keyboard.press("f")
    expect(page.locator("#tag-left")).to_have_text("reference")


def test_zoom_keeps_the_point_under_the_cursor_and_the_panes_in_step(opened):
    page = opened()
    open_case(page, "passes")
    hover(page, 24, 8)
    for _ in range(3):
        page.mouse.wheel(0, -100)
    expect(page.locator("#zoom")).to_have_text("8 ×")
    boxes = page.locator(".layer:visible canvas").evaluate_all(
        """all => all.map((each) => {
          const inner = each.getBoundingClientRect(), outer = each.parentElement.getBoundingClientRect();
          return [inner.width / outer.width, (inner.x - outer.x) / outer.width, (inner.y - outer.y) / outer.height];
        })"""
    )
    assert len(boxes) == 3
    assert np.ptp(boxes, axis=0).max() < 1e-3
    assert boxes[0][0] == pytest.approx(8.0)
    box = page.locator("#frame-render").bounding_box()
    page.mouse.move(box["x"] + 24.5 / SIZE * box["width"] + 1, box["y"] + 8.5 / SIZE * box["height"] + 1)
    expect(page.locator("#probe-place b")).to_have_text("x 24, y 8")
    page.mouse.down()
    page.mouse.move(box["x"] + 0.1 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.up()
    expect(page.locator("#probe-place b")).to_have_text("x 24, y 8")
    page.keyboard.press("0")
    expect(page.locator("#zoom")).to_have_text("1 ×")


def test_the_case_shows_its_source_as_text(opened):
    page = opened()
    open_case(page, "passes")
    page.locator("#source summary").click()
    expect(page.locator("#source-text")).to_have_text(SOURCE)
    links = page.locator("#facts a").all_text_contents()
    assert links == ["render.exr", "reference.exr", "material.mtlx"]


def test_the_set_up_is_brief_and_whole_where_it_is_pointed_at(opened):
    page = opened()
    open_case(page, "passes")
    setup = default_suite()[1].describe()
    told = page.locator(".set-up")
    for light in setup["lights"]:
        whole = told.locator(f'[title="{light}"]')
        shown = whole.text_content()
        numbers = [float(each) for each in re.findall(r"-?[\d.]+(?:e-?\d+)?", shown)]
        assert numbers == pytest.approx(
            [float(each) for each in re.findall(r"-?[\d.]+(?:e-?\d+)?", light)], rel=1e-3
        )
        assert len(shown) < len(light)
    assert "None" in setup["camera"]
    assert "None" not in told.text_content()


OVER = [0xFF, 0x1F, 0x5A, 0xFF]


def test_a_cloud_is_a_picture_on_its_card_and_small_multiples_when_it_is_opened(opened):
    page = opened()
    card = page.locator(".card", has=page.get_by_text("cloud-dielectric-ggx-smith"))
    assert card.locator("canvas").count() == 2
    assert card.locator(".words").count() == 0
    assert "at most 150 %" in card.locator("canvas").first.get_attribute("aria-label")
    assert page.locator("#cloud-maps figure").count() == 1
    page.locator("#cloud-maps a").click()
    expect(page.locator("#case-name")).to_contain_text("cloud-dielectric-ggx-smith")
    assert page.locator("#facts .decade").count() == 2 * len(DECADES)
    assert page.locator("#facts .multiple").count() == 4
    shown = pixels_of(page, "#facts .multiple:nth-child(2) canvas", MAP_ALPHAS)
    # Angles go upwards.
    assert np.argwhere((shown == OVER).all(-1)).tolist() == [[MAP_ANGLES - 1 - OVER_BOUND[0], OVER_BOUND[1]]]
    assert shown[MAP_ANGLES - 1, 0, 3] == 0
    assert shown[..., 3].sum() == 255 * (MAP_ALPHAS * MAP_ANGLES - 1)


def test_the_worst_configurations_of_a_cloud_can_be_copied_with_all_of_their_digits(opened):
    page = opened("#case=cloud-dielectric-ggx-smith")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy the table").click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    rows = [line.split("\t") for line in page.evaluate("navigator.clipboard.readText()").split("\n")]
    heads = ["of its bound", "view °", "light °", "roughness", "tint", "v", "l", "image", "reference"]
    assert rows[0] == heads
    assert rows[1][:5] == ["150 %", "36.9", "0.0", "0.053, 0.25", "1, not finite, 0.5"]
    assert len(rows) == 3 and all(len(row) == len(heads) for row in rows)


def test_a_page_without_a_clipboard_copies_too(opened):
    page = opened("#case=cloud-dielectric-ggx-smith")
    page.evaluate("Object.defineProperty(navigator, 'clipboard', { value: undefined })")
    page.get_by_role("button", name="Copy the table").click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    assert page.locator("textarea").count() == 0


def on_two_backends(folder) -> list[Outcome]:
    """A case that passes on egl and fails on osmesa, one that osmesa cannot draw, and one that passes on both."""
    cases = default_suite()
    fine = compared(folder, "fine", 0.0, Tolerance(max_rel=1e-3))
    wrong = compared(folder, "wrong", 3e-3, Tolerance(max_rel=1e-3))
    broken = {"verdict": "error", "message": EVIL}
    return [
        outcome_of(case, backend, **known)
        for case, results in zip(cases, ((fine, wrong), (fine, broken), (fine, fine)), strict=False)
        for backend, known in zip(("egl", "osmesa"), results, strict=True)
    ]


def test_the_backends_of_one_case_share_a_card(tmp_path, opened):
    write_report(tmp_path, ENVIRONMENT, on_two_backends(tmp_path), 1.0)
    page = opened(of=tmp_path)
    pills = [each.locator(".pill").all_text_contents() for each in page.locator(".card").all()]
    assert pills == [["✕osmesa", "✓egl"], ["!osmesa", "✓egl"], ["✓pass"]]
    expect(page.locator("#shown")).to_have_text("6 of 6 on 3 cards")
    assert page.locator("#verdicts [data-verdict] b").all_text_contents() == ["1", "1", "4"]
    page.locator(".card a").first.click()
    page.wait_for_selector("#layer-map canvas")
    expect(page.locator("#case-place")).to_have_text("1 of 3")
    expect(page.locator("#case-verdict")).to_contain_text("fail")
    assert page.locator("#backends button").all_text_contents() == ["✕ osmesa 300 %", "✓ egl 0.1 %"]
    page.locator("#frame-render").focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator("#probe-place b")).to_have_text("x 21, y 10")
    page.locator("#backends button").last.click()
    expect(page.locator("#case-verdict")).to_contain_text("pass")
    expect(page.locator("#probe-place b")).to_have_text("x 21, y 10")
    assert page.url.endswith("%40egl")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#case-message")).to_have_text(EVIL)
    page.keyboard.press("Escape")
    page.locator("#filter-backend").select_option("egl")
    expect(page.locator("#shown")).to_have_text("3 of 6")
    assert page.locator(".card .pill").all_text_contents() == ["✓pass"] * 3


def test_a_card_in_error_says_why_over_a_picture_too(tmp_path, opened):
    write_report(tmp_path, ENVIRONMENT, on_two_backends(tmp_path), 1.0)
    page = opened(of=tmp_path)
    card = page.locator(".card").nth(1)
    assert card.locator("img").count() == 2
    expect(card.locator(".why")).to_have_text(EVIL)
    assert page.locator(".card").nth(2).locator(".why").count() == 0


def test_only_what_is_not_finite_is_called_so(tmp_path, opened):
    exact = compared(tmp_path, "exact", 3e-3, Tolerance(max_rel=0.0))
    assert exact["figures"].used == np.inf
    lost = {**exact, "figures": replace(exact["figures"], max_rel=np.inf, max_abs=np.inf)}
    huge = {**exact, "figures": replace(exact["figures"], used=12345.6)}
    told = [
        outcome_of(case, "egl", **known)
        for case, known in zip(default_suite(), (exact, lost, huge), strict=False)
    ]
    write_report(tmp_path, ENVIRONMENT, told, 7384.0)
    page = opened(of=tmp_path)
    shares = {
        case.name: page.locator(".card", has=page.get_by_text(case.name, exact=True)).locator(".number")
        for case in told
    }
    assert [each.text_content() for each in shares.values()] == ["∞ ×", "not finite", "12 346 ×"]
    expect(page.locator("#verdicts")).to_contain_text("2 h 3 min")
    page.locator(".card a").first.click()
    page.wait_for_selector("#layer-map canvas")
    expect(page.locator("#facts h3").first).to_have_text(
        re.compile("∞ × of its bound|Its error is not finite")
    )


def test_on_a_phone_the_slider_comes_first_until_another_is_chosen(opened):
    page = opened("#case=passes", viewport={"width": 390, "height": 844})
    page.wait_for_selector("#layer-map canvas")
    assert page.locator("#mode-slider").get_attribute("aria-pressed") == "true"
    expect(page.locator("#pane-reference")).not_to_be_visible()
    page.locator("#mode-side").click()
    page.evaluate("location.hash = '#case=passes+too'")
    expect(page.locator("#case-name")).to_contain_text("passes too")
    page.wait_for_selector("#layer-map canvas")
    assert page.locator("#mode-side").get_attribute("aria-pressed") == "true"
    wide = opened()
    open_case(wide, "passes")
    assert wide.locator("#mode-side").get_attribute("aria-pressed") == "true"


def test_without_scenes_the_strip_has_renders_at_weight_0_beside_weight_1(tmp_path, opened):
    known = compared(tmp_path, "fine", 0.0, Tolerance(max_rel=1e-3))
    told = [outcome_of(default_suite()[0], "egl", **known) for _ in range(3)]
    for each, name in zip(told, ("metal-a0.6-retro1", "metal-a0.6-retro0", "alone-retro0"), strict=True):
        each.name = name
    write_report(tmp_path, ENVIRONMENT, told, 1.0)
    page = opened(of=tmp_path)
    alts = page.locator("#scenes img").evaluate_all("all => all.map((each) => each.alt)")
    assert alts == ["Render of metal-a0.6-retro0", "Render of metal-a0.6-retro1"]
    page.locator("#scenes a").last.click()
    expect(page.locator("#case-name")).to_contain_text("metal-a0.6-retro1")


def test_the_numbers_are_loaded_when_a_case_is_looked_at(opened, browser, folder):
    each = Opened(browser, folder)
    assert [url for url in each.asked if url.endswith("data.js")] == []
    open_case(each.page, "fails #1 100%")
    assert len([url for url in each.asked if url.endswith("data.js")]) == 1
    assert each.complaints == []
    each.context.close()


def test_numbers_that_are_gone_leave_the_pictures(tmp_path, browser):
    write_report(tmp_path, ENVIRONMENT, outcomes(tmp_path), 1.0)
    (tmp_path / "cases/egl/passes/data.js").unlink()
    (tmp_path / "cases/egl/passes too/data.js").write_text("mrmCase({}")
    for name in ("passes", "passes too"):
        page = Opened(browser, tmp_path, f"#case={name}").page
        expect(page.locator("#trouble")).to_contain_text("these are the pictures only")
        assert page.locator("#layer-render img").evaluate("each => each.complete")
        assert page.locator("#brighter").is_disabled()
        page.context.close()


def test_a_render_without_a_reference_is_shown_alone(tmp_path, opened):
    place = tmp_path / "cases"
    place.mkdir()
    image, _, mask = images(0.0)
    files = write_pictures(place, image, None, mask, source=SOURCE)
    assert set(files) == {"exposure", "render", "render_data", "source", "data"}
    files = {name: f"cases/{file}" if isinstance(file, str) else file for name, file in files.items()}
    new = outcome_of(default_suite()[0], "egl", "error", message="it has no baseline yet", files=files)
    paired = outcome_of(
        default_suite()[1], "egl", **compared(tmp_path, "paired", 0.0, Tolerance(max_rel=1e-3))
    )
    write_report(tmp_path, ENVIRONMENT, [new, paired], 1.0)
    page = opened(of=tmp_path)
    page.keyboard.press("Home")
    page.keyboard.press("Enter")
    page.wait_for_selector("#layer-render canvas")
    assert page.locator(".pane:visible").count() == 1
    assert page.locator("#mode-slider").is_disabled()
    page.keyboard.press("s")
    hover(page, 5, 25)
    assert [np.float32(text) for text in probed(page, "render")] == list(image[25, 5])
    expect(page.locator("#probe-reference")).not_to_be_visible()
    expect(page.locator("#case-message")).to_have_text("it has no baseline yet")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#edge")).to_be_visible()
    assert page.locator(".pane:visible").count() == 2


def test_a_partial_run_says_so_and_scenes_come_first(tmp_path, opened):
    gallery = [{"title": "Cone", "caption": "by night", "image": "cone.png"}]
    environment = {**ENVIRONMENT, "partial": "it was interrupted", "gallery": gallery}
    (tmp_path / "cone.png").write_bytes(b"")
    write_report(tmp_path, environment, [], 1.0)
    page = opened(of=tmp_path)
    expect(page.locator("#partial")).to_have_text("This run did not finish. it was interrupted")
    expect(page.locator("#none")).to_contain_text("The run has no cases.")
    expect(page.locator("#scenes")).to_contain_text("by night")
    assert page.locator("#scenes img").get_attribute("alt") == "Cone"
    assert page.locator("#scenes").bounding_box()["y"] < page.locator("#verdicts").bounding_box()["y"]


# Two thousand cases


def test_two_thousand_cases_are_a_few_hundred_elements(tmp_path, opened):
    known = compared(tmp_path, "shared", 0.0, Tolerance(max_rel=1e-3))
    case = default_suite()[0]
    many = []
    for number in range(2000):
        many.append(outcome_of(case, "egl", **known))
        many[-1].name = f"case {number:04}"
    write_report(tmp_path, ENVIRONMENT, many, 100.0)
    page = opened(of=tmp_path)
    expect(page.locator("#shown")).to_have_text("2 000 of 2 000")
    assert page.evaluate("document.querySelectorAll('*').length") < 800
    first = names(page)
    assert first[0] == "case 0000"
    page.keyboard.press("End")
    assert "case 1999" in page.evaluate("document.activeElement.textContent")
    assert "case 1999" in names(page)
    assert page.locator(".card").count() < 60
    page.evaluate("scrollTo(0, document.body.scrollHeight / 2)")
    expect(page.locator(".card b").get_by_text("case 1000", exact=True)).to_have_count(1)
    page.locator("#search").fill("case 0777")
    assert names(page) == ["case 0777"]


def test_how_small_a_fault_the_cases_would_notice_is_counted_by_decade(tmp_path, browser):
    case = default_suite()[0]
    given = [3e-6, 1e-5, 2e-5, 5e-3, np.inf, None]
    told = []
    for number, notices in enumerate(given):
        verdict = "undecided" if notices == np.inf else "pass"
        figures = Figures(0.0, 0.0, 0.0, 0.0, 0.0, 1, 1, notices=notices)
        told.append(outcome_of(case, "egl", verdict, figures=figures))
        told[-1].name = f"case {number}"
    write_report(tmp_path, ENVIRONMENT, told, 1.0)
    page = Opened(browser, tmp_path).page
    assert page.locator("#noticed .quiet").all_inner_texts()[1] == "0.001 % to 0.01 %"
    # What has no bound of ours, as a stored image, is not counted.
    assert page.locator("#noticed .number").all_inner_texts() == ["2", "1", "0", "1", "0", "1"]


def test_without_a_bound_of_ours_nothing_is_said_of_faults(tmp_path, browser):
    figures = Figures(0.0, 0.0, 0.0, 0.0, 0.0, 1, 1)
    write_report(tmp_path, ENVIRONMENT, [outcome_of(default_suite()[0], "egl", "pass", figures=figures)], 1.0)
    expect(Opened(browser, tmp_path).page.locator("#power")).to_be_hidden()


@pytest.fixture
def large(tmp_path):
    """A report of more records than the page holds itself, with pictures for one of them and a cloud."""
    case = default_suite()[0]
    known = compared(tmp_path, "shared", 0.0, Tolerance(max_rel=1e-3))
    many = [outcome_of(case, "egl", **known) for _ in range(MOST_INSIDE + PIECE)]
    for number, each in enumerate(many):
        each.name = f"case {number:04}"
    many[1234 % len(many)].setup = {"lights": ["a beam of argon"]}
    many[7].message = EVIL
    write_report(tmp_path, ENVIRONMENT, [*many, outcomes(tmp_path)[-1]], 100.0)
    return tmp_path


def test_of_a_large_report_the_page_loads_what_is_looked_at(large, browser):
    each = Opened(browser, large)
    whole = (large / "report.json").stat().st_size
    assert (large / "index.html").stat().st_size < 0.4 * whole
    assert not [url for url in each.asked if "/cases/records/" in url]
    expect(each.page.locator("#cloud-maps canvas")).to_have_count(2)
    open_case(each.page, "case 0000")
    expect(each.page.locator(".set-up")).to_contain_text("camera")
    expect(each.page.locator("#facts")).to_contain_text("99.9 % below")
    asked = [url for url in each.asked if "/cases/records/" in url]
    assert len(asked) == 1
    each.page.keyboard.press("ArrowRight")
    expect(each.page.locator("#case-name")).to_contain_text("case 0001")
    expect(each.page.locator(".set-up")).to_contain_text("camera")
    assert [url for url in each.asked if "/cases/records/" in url] == asked
    assert "taken" not in each.page.title()
    assert each.complaints == []
    each.context.close()


def test_a_search_of_a_large_report_finds_what_a_set_up_says(large, opened):
    page = opened(of=large)
    page.locator("#search").fill("argon")
    name = f"case {1234 % (MOST_INSIDE + PIECE):04}"
    expect(page.locator("#shown")).to_have_text(f"1 of {MOST_INSIDE + PIECE + 1:,}".replace(",", " "))
    assert names(page) == [name]


def test_a_link_into_a_large_report_shows_its_case(large, opened):
    page = opened("#case=case+0999", of=large)
    expect(page.locator("#case-name")).to_contain_text("case 0999")
    expect(page.locator(".set-up")).to_contain_text("camera")


def test_records_that_are_gone_or_another_run_s_leave_what_the_wall_shows(large, browser):
    pieces = large / "cases" / "records"
    (pieces / "0.js").write_text((pieces / "1.js").read_text())
    (pieces / "3.js").unlink()
    for name, why in (("case 0007", "another run"), ("case 0350", "cannot be read")):
        page = Opened(browser, large, f"#case={name.replace(' ', '+')}").page
        expect(page.locator("#trouble")).to_contain_text(why)
        expect(page.locator("#case-name")).to_contain_text(name)
        page.context.close()


# For everybody


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_have_contrast(opened, scheme):
    """At least 4.5 to 1 (WCAG 2.2, 1.4.3) for every verdict's word and every quiet one, on what lies below."""
    page = opened(color_scheme=scheme)

    def luminance(text: str) -> float:
        colour = np.array([float(each) for each in re.findall(r"[\d.]+", text)[:3]]) / 255
        linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    for selector, ground in (
        (".card .pill", ".card"),
        (".tile b", ".tile"),
        (".quiet", "body"),
        (".card small", ".card"),
    ):
        below = luminance(
            page.locator(ground).first.evaluate("each => getComputedStyle(each).backgroundColor")
        )
        for colour in page.locator(selector).evaluate_all(
            "all => all.map((each) => getComputedStyle(each).color)"
        ):
            light, dark = sorted((luminance(colour), below), reverse=True)
            assert (light + 0.05) / (dark + 0.05) >= 4.5, (selector, colour)


def test_controls_have_names_and_pictures_have_words(opened):
    page = opened()
    open_case(page, "passes")
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, select, input, [role=img], img")].filter((each) =>
          !(each.getAttribute("aria-label") || each.getAttribute("alt") || each.textContent.trim()
            || document.querySelector(`label[for="${each.id}"]`)))
          .map((each) => each.outerHTML)"""
    )
    assert nameless == []


@pytest.mark.parametrize("width", [390, 420, 1400])
def test_nothing_reaches_beyond_the_window(opened, width):
    page = opened(viewport={"width": width, "height": 860})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    open_case(page, "fails #1 100%")
    assert page.evaluate("view.dialog.scrollWidth") <= width
    cloud = opened("#case=cloud-dielectric-ggx-smith", viewport={"width": width, "height": 860})
    assert cloud.evaluate("view.dialog.scrollWidth") <= width


def test_what_layering_costs_is_shown_and_sorted_by(opened, folder, tmp_path):
    expect(opened().locator("#sort option[value=layering]")).to_have_count(0)
    told = outcomes(tmp_path)
    for outcome, most in zip(told[1:3], (0.02, 0.34), strict=True):
        outcome.details = {"layering": {"max_rel": most, "mean_rel": most / 10.0}}
    write_report(tmp_path, ENVIRONMENT, told, 12.5)
    page = opened("#sort=layering", of=tmp_path)
    assert names(page)[:2] == ["passes too", "passes"]
    page = opened("#case=passes%20too", of=tmp_path)
    facts = page.locator("#facts section", has_text="MaterialX's layering beside the exact rule")
    expect(facts.locator("td")).to_have_text(["34 %", "3.4 %"])
    expect(facts).to_contain_text("no part of the verdict")
