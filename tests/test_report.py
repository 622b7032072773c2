"""The report holds what happened, for machines and for people."""

import base64
import hashlib
import json
import re
import zlib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.cloud import Cloud
from mrm_nodes.regression.cases.pictures import HEAT_OVER, heat_map, page_data, write_pictures
from mrm_nodes.regression.report import page as report_module
from mrm_nodes.regression.report.page import PIECE, figure, share, write_report
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.verdict.compare import Figures
from mrm_nodes.regression.verdict.outcome import as_record, from_record, outcome_of
from mrm_nodes.regression.verdict.perceptual import exposure_for
from mrm_nodes.render import probe_backends, read_image, render
from mrm_nodes.render.exposure import auto_exposure
from mrm_nodes.render.tonemap import find_tonemap, srgb_encoded

ENVIRONMENT = {
    "date": "2026-07-01 12:00 UTC",
    "platform": "Linux",
    "processors": 2,
    "backends": {"egl": "llvmpipe, OpenGL 4.5"},
    "versions": {"mrm-nodes": "0.1.0"},
    "jobs": 1,
    "backend_seconds": {"egl": 1.0},
}
SCHEMA = {"name", "node", "target", "backend", "verdict", "passed", "tolerance", "seconds"}
FIGURES = {"max_abs", "max_rel", "p999_rel", "rmse"}


def figures(used):
    return Figures(1e-3, 1e-4 * used, 1e-5, 1e-6, used, 100, 90)


def outcomes():
    passing, failing, broken, missing, *_ = default_suite()
    decades = [
        {"alpha": list(alpha), "film": film, "configurations": 10, "max_rel": 1e-4, "p999_rel": 1e-5,
         "max_used": 0.3, "p999_used": 0.2}
        for alpha in ((1e-3, 1e-2), (1e-2, 1e-1), (1e-1, 1.0)) for film in (False, True)
    ]  # fmt: skip
    tolerance = {"max_rel": 1e-4, "p999_rel": 1e-5}
    cloud = Cloud("mrm_conductor_bsdf", configurations=60)
    return [
        outcome_of(passing, "egl", "pass", figures=figures(0.4), tolerance=tolerance),
        outcome_of(failing, "egl", "fail", figures=figures(3.0), tolerance=tolerance),
        outcome_of(broken, "egl", "error", message="it broke: <script>alert(1)</script>"),
        outcome_of(missing, "osmesa", "skipped", message="libOSMesa is not installed"),
        outcome_of(
            cloud, "egl", "pass", figures=figures(0.3), tolerance=tolerance, details={"decades": decades}
        ),
    ]


class Page(HTMLParser):
    """Well-formedness enough for us: every element that must be closed is, in order."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self, text):
        super().__init__()
        self.open, self.addresses, self.tags = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [value for name, value in attributes if name in ("src", "href")]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture
def report(tmp_path):
    write_report(tmp_path, ENVIRONMENT, outcomes(), 12.5)
    return tmp_path


def test_the_json_follows_the_schema(report):
    data = json.loads((report / "report.json").read_text())
    assert set(data) == {"environment", "cases", "summary"}
    for case in data["cases"]:
        assert set(case) >= SCHEMA | FIGURES
        assert case["passed"] == (case["verdict"] == "pass")
        assert set(case["seconds"]) == {"generate", "compile", "render", "reference", "compare"}
    assert data["summary"] == {
        "total": 5, "passed": 2, "failed": 1, "undecided": 0, "errors": 1, "skipped": 1, "seconds": 12.5,
    }  # fmt: skip


def test_the_worst_comes_first(report):
    verdicts = [case["verdict"] for case in json.loads((report / "report.json").read_text())["cases"]]
    assert verdicts == ["fail", "error", "skipped", "pass", "pass"]


def test_numbers_that_are_not_finite_become_null(tmp_path):
    case = default_suite()[0]
    broken = Figures(np.nan, np.inf, np.inf, np.nan, np.inf, 10, 10)
    tolerance = {"max_rel": 1e-4, "p999_rel": 1e-5}
    write_report(
        tmp_path, ENVIRONMENT, [outcome_of(case, "egl", "fail", figures=broken, tolerance=tolerance)], 1.0
    )
    assert json.loads((tmp_path / "report.json").read_text())["cases"][0]["max_rel"] is None


def test_the_page_holds_the_whole_report(report):
    text = (report / "index.html").read_text()
    assert Page(text).open == []
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1]
    assert json.loads(data)["report"] == json.loads((report / "report.json").read_text())


@pytest.mark.parametrize(
    "evil",
    ["</script><script>alert(1)</script>", "</script ><b>", "<!--<script>", "&lt;b>", "\u2028'\"`${1}"],
)
def test_what_a_page_quotes_stays_text(tmp_path, evil):
    case, *_ = default_suite()
    broken = outcome_of(case, "egl", "error", message=evil, details={evil: evil})
    broken.name = broken.node = evil
    environment = {**ENVIRONMENT, "date": evil, "backends": {evil: evil}, "partial": evil}
    write_report(tmp_path, environment, [broken], 1.0)
    text = (tmp_path / "index.html").read_text()
    page, plain = Page(text), Page(page_of(tmp_path, "harmless"))
    assert page.tags == plain.tags
    data = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1]
    assert "<" not in data
    assert json.loads(data)["report"]["cases"][0]["message"] == evil


def page_of(tmp_path, word):
    case, *_ = default_suite()
    folder = tmp_path / "harmless"
    folder.mkdir()
    broken = outcome_of(case, "egl", "error", message=word)
    write_report(folder, ENVIRONMENT, [broken], 1.0)
    return (folder / "index.html").read_text()


def test_the_page_s_own_script_and_style_are_the_only_ones_it_allows(report):
    text = (report / "index.html").read_text()
    policy = re.search(r'Content-Security-Policy" content="(.*?)"', text)[1].replace("&#39;", "'")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    for element, rule in (("style", "style-src"), ("script", "script-src")):
        inside = re.search(rf"<{element}>(.*?)</{element}>", text, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(inside.encode()).digest()).decode()
        assert re.search(rf"{rule}[^;]*'sha256-{re.escape(digest)}'", policy)


def test_the_page_needs_no_network(report):
    text = (report / "index.html").read_text()
    assert not re.search(r"https?:|[\"'(]//\w|@import|url\(|fetch\(|XMLHttp|WebSocket|innerHTML|eval\(", text)


def test_a_page_without_cases_is_a_page(tmp_path):
    write_report(tmp_path, ENVIRONMENT, [], 0.1)
    assert Page((tmp_path / "index.html").read_text()).open == []


def test_the_records_beside_a_large_page_are_the_report_s_and_go_with_the_next(tmp_path, monkeypatch):
    case = default_suite()[0]
    many = [outcome_of(case, "egl", "error", message=f"</script> {n}") for n in range(2 * PIECE + 1)]
    for number, each in enumerate(many):
        each.name = f"case {number}"
    monkeypatch.setattr(report_module, "MOST_INSIDE", PIECE)
    written = write_report(tmp_path, ENVIRONMENT, many, 1.0)
    pieces = tmp_path / "cases" / "records"
    found = []
    for number in range(3):
        text = (pieces / f"{number}.js").read_text()
        found += json.loads(text.removeprefix("mrmCase(").removesuffix(");\n"))
    assert found == json.loads((tmp_path / "report.json").read_text())["cases"] == written["cases"]
    page = (tmp_path / "index.html").read_text()
    data = json.loads(
        re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)[1]
    )
    assert [each["name"] for each in data["report"]["cases"]] == [each["name"] for each in found]
    assert data["report"]["summary"] == written["summary"]
    assert not any("setup" in each for each in data["report"]["cases"])
    write_report(tmp_path, ENVIRONMENT, many[: PIECE + 1], 1.0)
    assert sorted(each.name for each in pieces.iterdir()) == ["0.js", "1.js"]
    write_report(tmp_path, ENVIRONMENT, many[:PIECE], 1.0)
    assert not [*pieces.iterdir()]


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path):
    with pytest.raises(MrmError, match=r"report\.json: cannot be written: No such file"):
        write_report(tmp_path / "missing", ENVIRONMENT, outcomes(), 1.0)


def test_a_report_leaves_nothing_else_behind(report):
    assert {path.name for path in report.iterdir()} == {"report.json", "index.html"}


@pytest.mark.parametrize(
    "name",
    [
        "schlick-checker-on-color0",
        "dielectric-over-diffuse-retro0.5",
        "conductor-beckmann-vcavity-a0.3x0.08-retro0.5",
    ],
)
def test_the_source_that_a_report_shows_renders_as_the_case_did(tmp_path, name):
    """Its shader has values as uniforms; the document has them written down, and stands alone."""
    working = [probe.backend for probe in probe_backends("auto") if probe.works]
    if not working:
        pytest.skip("needs OpenGL: see `mrm-nodes doctor`")
    case = replace(next(case for case in default_suite() if case.name == name), size=(48, 48))
    outcome = Worker(working[0]).run(case, tmp_path)
    assert outcome.verdict == "pass", outcome.message
    source = tmp_path / outcome.files["source"]
    drawn = render(source, case.mesh, case.camera, case.lights, case.size, working[0])
    shown = read_image(tmp_path / outcome.files["render_data"])
    assert drawn.image.max() > 0.01
    assert (np.where(drawn.mask[..., None], drawn.image, np.float32(0)) == shown).all()


def test_pictures_keep_data_in_float32_and_show_it_at_one_exposure(tmp_path):
    rng = np.random.default_rng(0)
    image = rng.uniform(0, 500, (8, 6, 3)).astype(np.float32)
    mask = np.ones((8, 6), bool)
    mask[0] = False
    files = write_pictures(tmp_path, image, image.astype(np.float64), mask, np.zeros((8, 6)))
    # The exposure of `mrm-nodes render`.
    stops = auto_exposure(image * mask[..., None], mask.astype(np.float32), find_tonemap("neutral").headroom)
    assert files["exposure"] == stops == pytest.approx(-9.0, abs=0.1)
    assert (read_image(tmp_path / files["render_data"])[1:] == image[1:]).all()
    shown = read_image(tmp_path / files["render"])
    assert shown.shape == (8, 6, 4)
    assert (shown[..., 3] == mask).all()
    mapped = find_tonemap("neutral")(image * np.float32(2.0**stops))
    assert np.abs(shown[1:, :, :3] - srgb_encoded(mapped)[1:]).max() < 0.6 / 255
    assert 0.5 < shown[..., :3].max() <= 1.0


def test_a_case_and_its_reference_share_the_reference_s_exposure(tmp_path):
    reference = np.full((4, 4, 3), 0.25, np.float32)
    mask = np.ones((4, 4), bool)
    alone = write_pictures(tmp_path, reference, reference, mask)["exposure"]
    for image in (2 * reference, 0 * reference, np.full_like(reference, np.nan)):
        files = write_pictures(tmp_path, image, reference, mask)
        assert files["exposure"] == alone
        seen = find_tonemap("neutral")(reference * np.float32(2.0**alone))
        assert (
            np.abs(read_image(tmp_path / files["reference"])[..., :3] - srgb_encoded(seen)).max() < 0.6 / 255
        )
    # What should be black and is not is seen.
    assert write_pictures(tmp_path, reference, 0 * reference, mask)["exposure"] == alone
    assert write_pictures(tmp_path, 0 * reference, 0 * reference, mask)["exposure"] == 0.0


def test_in_16_bits_only_what_is_not_finite_is_not_finite(tmp_path):
    image, mask = np.ones((1, 4, 3), np.float32), np.ones((1, 4), bool)
    data = page_data({"render": image}, {"used": np.array([[0.5, 1e9, np.inf, np.nan]])}, mask)
    unpacked = zlib.decompress(base64.b64decode(data["packed"]))[48:56]
    values = np.frombuffer(unpacked, np.uint8).reshape(2, 4).T.copy().view("<f2")[:, 0]
    np.testing.assert_array_equal(values, [0.5, 65504.0, np.inf, np.nan])


def test_the_page_s_numbers_are_the_pictures_own_bits(tmp_path):
    rng = np.random.default_rng(1)
    image = rng.normal(size=(5, 7, 3)).astype(np.float32)
    image[0, 0] = np.nan, np.inf, -0.0
    reference = image * np.float32(1 + 1e-6)
    mask = rng.random((5, 7)) < 0.8
    mask[0, 0] = True
    used = np.full((5, 7), 0.25)
    files = write_pictures(tmp_path, image, reference, mask, used, flip=used / 2, source="<materialx/>")
    assert (tmp_path / files["source"]).read_text() == "<materialx/>"
    text = (tmp_path / files["data"]).read_text()
    payload = json.loads(text.removeprefix("mrmCase(").removesuffix(");\n"))
    packed = zlib.decompress(base64.b64decode(payload["packed"]))
    found, start = {}, 0
    for name, size, channels in payload["parts"]:
        count = 35 * channels
        planes = np.frombuffer(packed[start : start + count * size], np.uint8).reshape(size, count)
        found[name] = np.ascontiguousarray(planes.T).view(f"<u{size}").reshape(5, 7, channels)
        start += count * size
    assert start == len(packed)
    shown = np.where(mask[..., None], image, np.float32(0))
    assert (found["render"] == shown.view(np.uint32)).all()
    kept = np.where(mask[..., None], reference, np.float32(0))
    assert ((found["render"] ^ found["reference"]) == kept.view(np.uint32)).all()
    assert (found["used"].view(np.float16)[mask] == 0.25).all()
    assert (found["flip"].view(np.float16)[mask] == 0.125).all()
    assert (found["mask"][..., 0] == mask).all()


def test_without_a_bound_on_pixels_the_picture_is_flip_s_and_without_flip_there_is_none(tmp_path):
    image, mask = np.ones((4, 4, 3)), np.ones((4, 4), bool)
    assert "error" not in write_pictures(tmp_path, image, image, mask, None)
    seen = np.linspace(0, 1, 16).reshape(4, 4)
    files = write_pictures(tmp_path, image, image, mask, None, flip=seen)
    luminance = read_image(tmp_path / files["error"])[..., :3] @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(luminance.ravel()) > 0).all()


def test_the_heat_map_marks_what_is_over_the_bound_and_what_is_not_finite():
    over = heat_map([[1.5, np.nan, np.inf]], np.ones((1, 3)))
    assert np.ptp(over, axis=1).max() == 0
    assert over[0, 0, 0] == pytest.approx(int(HEAT_OVER[1:3], 16) / 255)
    scale = heat_map([[0.0, 1e-4, 1e-2, 1.0]], np.ones((1, 4)))[0]
    luminance = scale[:, :3] @ [0.2126, 0.7152, 0.0722]
    assert luminance[0] == luminance[1] < luminance[2] < luminance[3]


@pytest.mark.parametrize(("brightest", "stops"), [(1.0, 0.0), (0.4, 1.0), (3.0, -2.0), (0.0, 0.0)])
def test_exposure_brings_the_brightest_value_below_white(brightest, stops):
    assert exposure_for(np.full((5, 3), brightest)) == stops


@pytest.mark.parametrize(
    ("value", "text"), [(3.21e-6, "3.2e-6"), (0.0, "0"), (12.0, "1.2e1"), (None, "not finite")]
)
def test_figures_have_two_digits(value, text):
    assert figure(value) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.42, "42 %"),
        (0.0034, "0.3 %"),
        (25.0, "25 ×"),
        (12345.6, "12 346 ×"),
        (3e7, "3.0e7 ×"),
        (None, "∞ ×"),
    ],
)
def test_shares_are_percentages_or_multiples(value, text):
    assert share(value) == text


def test_a_record_is_the_whole_outcome():
    for outcome in outcomes():
        record = as_record(outcome)
        assert json.loads(json.dumps(record, allow_nan=False)) == record
        again = from_record(record)
        assert as_record(again) == record
        assert (again.name, again.verdict, again.figures) == (outcome.name, outcome.verdict, outcome.figures)
    broken = outcome_of(
        default_suite()[0], "egl", "fail", figures=Figures(np.nan, np.inf, np.inf, np.nan, np.inf, 1, 1)
    )
    broken.details = {
        "numpy": np.float32(0.5),
        "array": np.arange(3),
        "deep": [{"x": (np.inf, 1)}],
        "path": Path("x"),
    }
    record = as_record(broken)
    assert record["details"] == {"numpy": 0.5, "array": [0, 1, 2], "deep": [{"x": [None, 1]}], "path": "x"}
    assert from_record(record).figures.used == np.inf
    assert as_record(from_record(json.loads(json.dumps(record)))) == record
