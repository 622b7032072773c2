"""Pictures for eyes: exposure, tone mapping, antialiasing, backgrounds; and that none of it touches the numbers."""

from __future__ import annotations

import functools
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest

import mrm_nodes
from mrm_nodes.errors import MrmError
from mrm_nodes.library import materials_path
from mrm_nodes.render import (
    load_mesh,
    parse_camera,
    parse_light,
    probe_backends,
    read_image,
    shared_renderer,
)
from mrm_nodes.render.antialias import sample_offsets
from mrm_nodes.render.background import environment_behind, parse_background
from mrm_nodes.render.environment import Environment, directions
from mrm_nodes.render.exposure import auto_exposure, lit_pixels, stops_text
from mrm_nodes.render.picture import Developer, Development, Picture
from mrm_nodes.render.tonemap import find_tonemap, srgb_decoded, srgb_encoded, tone_maps
from mrm_nodes.shadergen import Shader, generate_shader

MATERIALS = sorted(materials_path().glob("*.mtlx"))
TAPE = next(path for path in MATERIALS if path.stem == "hi_vis_tape")
BACKENDS = [probe.backend for probe in probe_backends() if probe.works]
ALL = bool(os.environ.get("MRM_PICTURES"))
"""Whether to draw every shipped material on each backend: a minute."""


@pytest.fixture(params=["egl", "osmesa"])
def backend(request: pytest.FixtureRequest) -> str:
    if request.param not in BACKENDS:
        pytest.skip(f"no {request.param} here")
    return str(request.param)


# ---- tone mapping


def khronos_neutral(color: tuple[float, float, float]) -> tuple[float, ...]:
    """The published GLSL, line by line, one colour at a time, in float64."""
    start_compression, desaturation = 0.8 - 0.04, 0.15
    x = min(color)
    offset = x - 6.25 * x * x if x < 0.08 else 0.04
    color = tuple(c - offset for c in color)
    peak = max(color)
    if peak < start_compression:
        return color
    d = 1.0 - start_compression
    new_peak = 1.0 - d * d / (peak + d - start_compression)
    color = tuple(c * new_peak / peak for c in color)
    g = 1.0 - 1.0 / (desaturation * (peak - new_peak) + 1.0)
    return tuple(c * (1.0 - g) + new_peak * g for c in color)


def some_colors() -> np.ndarray:
    rng = np.random.default_rng(5)
    random = np.exp2(rng.uniform(-8, 9, (300, 3))) * rng.choice([0.0, 1.0], (300, 3), p=[0.1, 0.9])
    return np.concatenate([random, [[0, 0, 0], [0.08, 0.08, 0.08], [0.8, 0.8, 0.8], [294, 294, 0]]])


def test_neutral_is_what_khronos_published():
    colors = some_colors()
    expected = np.array([khronos_neutral(tuple(color)) for color in colors])
    assert np.abs(find_tonemap("neutral")(colors) - np.clip(expected, 0.0, 1.0)).max() < 2e-6


@pytest.mark.parametrize("view", [name for name in tone_maps() if name not in ("none", "neutral", "Raw")])
def test_a_view_is_opencolorio_s_own(view):
    """Against a picture that OpenImageIO converts from another space: the same colours in ACES2065-1."""
    colors = some_colors().astype(np.float32)
    aces = oiio.ImageBufAlgo.colorconvert(
        oiio.ImageBuf(colors[None]), "Linear Rec.709 (sRGB)", "ACES2065-1", colorconfig="ocio://default"
    )
    shown = oiio.ImageBufAlgo.ociodisplay(
        aces, "sRGB - Display", view, "ACES2065-1", colorconfig="ocio://default"
    )
    expected = np.clip(shown.get_pixels(oiio.FLOAT)[0], 0.0, 1.0)
    assert np.abs(srgb_encoded(find_tonemap(view)(colors)) - expected).max() < 0.25 / 255
    numbers = np.linspace(0, 1, 30).reshape(10, 3)
    assert np.abs(srgb_encoded(find_tonemap("raw")(numbers)) - numbers).max() < 1e-5


def test_a_tone_mapping_s_name_is_of_either_case():
    assert find_tonemap("Neutral") == find_tonemap("neutral") and find_tonemap("NONE").name == "none"


@pytest.mark.parametrize("name", tone_maps())
def test_what_is_no_colour_does_no_harm(name):
    with np.errstate(all="raise"):
        shown = find_tonemap(name)(np.array([[np.nan, 0, 0], [np.inf, 0, 0], [-1, -1, -1], [3e38, 1, 1]]))
    assert np.isfinite(shown).all() and shown.min() >= 0 and shown.max() <= 1
    assert shown[1].max() > 0.5 and shown[2].max() < 0.01


def test_srgb_is_inverted():
    values = np.linspace(0, 1, 1001, dtype=np.float32)
    assert np.abs(srgb_decoded(srgb_encoded(values)) - values).max() < 1e-6


# ---- exposure


def drawn(material: Any, backend: str = "auto", size: int = 64, **options):
    return mrm_nodes.render(
        shader_of(material), lights=["camera"], size=(size, size), backend=backend, **options
    )


HARDEST = ("road_paint", "yellow_tape")
"""Their brightest pixels are hundreds of times their median."""


def check_exposed(rendered: mrm_nodes.render.RenderedImage) -> None:
    lit = lit_pixels(rendered.image, rendered.alpha)
    values = np.round(rendered.picture.encoded()[..., :3] * 255)[lit].max(axis=-1)
    assert (values == 255).mean() <= 0.01
    assert 0.7 * 255 <= np.percentile(values, 99) <= 255
    assert rendered.picture.clipped <= 0.01


@pytest.mark.parametrize("material", MATERIALS, ids=lambda path: path.stem)
def test_nearly_nothing_of_a_shipped_material_is_clipped_and_it_is_bright(material, backend):
    if not ALL and (backend != BACKENDS[0] or material.stem not in HARDEST):
        pytest.skip("MRM_PICTURES=1 draws all six, on each backend")
    rendered = drawn(material, backend)
    check_exposed(rendered)
    assert rendered.image.max() > 1, "today's picture clips"


BSDF = """<?xml version="1.0"?><materialx version="1.39">
  <mrm_generalized_schlick_bsdf name="b" type="BSDF">
    <input name="color0" type="color3" value="0.9, 0.8, 0.1" />
    <input name="roughness" type="vector2" value="{0}, {0}" />
    <input name="retroreflectivity" type="float" value="1" />
  </mrm_generalized_schlick_bsdf>
  <surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" />
    <input name="opacity" type="float" value="{1}" /></surface>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial></materialx>"""


@pytest.fixture(scope="module")
def tape(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A material that is quickly drawn."""
    path = tmp_path_factory.mktemp("tape") / "tape.mtlx"
    path.write_text(BSDF.format(0.03, 1))
    return path


VARYING = {"color": "b/color0", "alpha": "b/roughness", "weight": "b/retroreflectivity"}


@functools.cache
def shader_of(material: Path) -> Shader:
    """Generated once: it is most of what a small picture costs."""
    varying = VARYING.values() if material.stem == "tape" else ()
    return generate_shader(material, varying=varying)


@pytest.mark.parametrize("tonemap", ["neutral", "none", tone_maps()[2]])
def test_nor_of_random_ones(tonemap, tape):
    rng = np.random.default_rng(20)
    for _ in range(20):
        alpha = float(np.exp2(rng.uniform(-7, 0)))
        values = {"color": rng.random(3), "alpha": (alpha, alpha), "weight": float(rng.random())}
        uniforms = {VARYING[name]: value for name, value in values.items()}
        check_exposed(drawn(tape, size=48, tonemap=tonemap, uniforms=uniforms))


def test_what_is_printed_gives_the_same_picture_again():
    image = np.exp2(np.random.default_rng(1).normal(0, 3, (40, 40, 3))).astype(np.float32)
    alpha = np.ones((40, 40), np.float32)
    stops = auto_exposure(image, alpha, 4.0)
    assert float(f"{stops:.2f}") == stops
    assert stops_text(stops) == f"{stops:.2f}" and stops_text(-1.2345) == "-1.2345"
    assert stops_text(3.0, "+") == "+3.00" and float(stops_text(0.1 + 0.2)) == 0.1 + 0.2


def test_where_nothing_is_lit_exposure_has_no_opinion():
    image, alpha = np.zeros((8, 8, 3), np.float32), np.ones((8, 8), np.float32)
    assert auto_exposure(image, alpha, 4.0) is None
    assert auto_exposure(image, 0 * alpha, 4.0, image) is None
    behind = np.full((8, 8, 3), 500.0, np.float32)
    assert auto_exposure(image, alpha, 4.0, behind) is None, "all of it is hidden"
    assert 500 * 2.0 ** auto_exposure(image, 0 * alpha, 4.0, behind) == pytest.approx(2 * 0.98, rel=0.01)


@pytest.mark.parametrize(
    ("share", "said"),
    [(0.0, "none"), (1e-9, "0.01 %"), (0.00123, "0.12 %"), (0.0999, "10 %"), (0.254, "25 %"), (1.0, "100 %")],
)
def test_the_clipped_share_is_said_in_plain_numbers(share, said):
    picture = Picture(np.zeros((1, 1, 3), np.float32), None, -1.2345, share, "none")
    assert picture.summary() == f"exposure -1.2345 stops, none: {said} of lit pixels clipped"
    assert picture.said()["mrm:exposure"] == "-1.2345"


def test_what_is_behind_is_not_all_white():
    image, alpha = np.full((8, 8, 3), 0.1, np.float32), np.ones((8, 8), np.float32)
    alpha[:4], image[:4] = 0.0, 0.0
    for behind, brightest in ((5.0, 2.5), (0.01, 0.1)):
        stops = auto_exposure(image, alpha, 4.0, np.full((8, 8, 3), behind, np.float32))
        assert brightest * 2.0**stops == pytest.approx(0.98, rel=0.01)


# ---- antialiasing


SMALL = Environment(np.random.default_rng(2).uniform(0, 2, (16, 32, 3)).astype(np.float32), samples=4)


def test_one_sample_is_the_raw_render_to_the_bit(backend, tape, tmp_path):
    shader, camera, light = shader_of(tape), parse_camera("frame:0.3,0.2,1"), parse_light("camera")
    raw = shared_renderer(backend).render(shader, load_mesh("sphere"), camera, [light], (64, 48))
    for number, look in enumerate(
        ({}, {"exposure": -3.0}, {"tonemap": "none"}, {"background": "white"}, {"background": "environment"})
    ):
        around = SMALL if look.get("background") == "environment" else None
        if around is not None:
            raw = shared_renderer(backend).render(
                shader, load_mesh("sphere"), camera, [light], (64, 48), None, around
            )
        rendered = mrm_nodes.render(
            shader, "sphere", camera, light, (64, 48), backend, environment=around, samples=1, **look
        )
        rendered.save(tmp_path / f"{number}.exr")
        pixels = read_image(tmp_path / f"{number}.exr")
        assert np.array_equal(pixels[..., :3], raw.image) and raw.image.max() > 0
        assert np.array_equal(pixels[..., 3], raw.mask.astype(np.float32))
        rendered.save(tmp_path / f"{number}.png")
        shown = read_image(tmp_path / f"{number}.png")
        assert np.abs(shown - by_hand(rendered, look)).max() < 0.6 / 255, "a picture comes of it too"


def by_hand(rendered: mrm_nodes.render.RenderedImage, look: dict[str, Any]) -> np.ndarray:
    """The values of a PNG of an opaque ball: exposed, tone-mapped and encoded; what is behind it is, or is alpha."""
    assert rendered.picture.exposure == look.get("exposure", rendered.picture.exposure)
    background = look.get("background")
    light = rendered.image.copy()
    if background == "environment":
        light[~rendered.mask] = environment_behind(SMALL, rendered.camera, (64, 48))[~rendered.mask]
    exposed = light * np.float32(2.0**rendered.picture.exposure)
    if look.get("tonemap") == "none":
        shown = np.minimum(exposed, 1.0)
    else:
        shown = np.array([khronos_neutral(tuple(color)) for color in exposed.reshape(-1, 3).astype(float)])
        shown = np.clip(shown, 0.0, 1.0).reshape(exposed.shape)
    if background is None:
        return np.dstack([srgb_encoded(shown), rendered.mask])
    return np.where(rendered.mask[..., None] | (background == "environment"), srgb_encoded(shown), 1.0)


def test_without_a_picture_an_image_of_many_samples_is_the_same_and_none_is_developed(tape, monkeypatch):
    shader, ball = shader_of(tape), load_mesh("sphere")
    options = {"lights": "camera", "size": (24, 24), "samples": 4, "environment": SMALL}
    wanted = mrm_nodes.render(shader, ball, **options)
    monkeypatch.delattr(Developer, "add")
    alone = mrm_nodes.render(shader, ball, **options, picture=False)
    assert np.array_equal(alone.image, wanted.image) and np.array_equal(alone.alpha, wanted.alpha)
    assert alone.image.max() > 1
    with pytest.raises(MrmError, match="draw it with picture=True"):
        _ = alone.picture


def over_grey(rendered: mrm_nodes.render.RenderedImage) -> np.ndarray:
    """A picture as a page shows it, 0 to 255."""
    encoded = rendered.picture.encoded()
    alpha = encoded[..., 3:]
    return 255.0 * srgb_encoded(srgb_decoded(encoded[..., :3]) * alpha + 0.1 * (1.0 - alpha))


@dataclass(frozen=True)
class Reference:
    alpha: np.ndarray
    shown: np.ndarray
    """As `over_grey` has it."""


def very_many(tape: Path, backend: str, size: int, exposure: float) -> Reference:
    """16 × 16 samples of each pixel, from one large picture: each tone-mapped, and then their mean."""
    large = drawn(tape, backend, 16 * size, exposure=exposure)
    light = find_tonemap("neutral")(large.image * np.float32(2.0**exposure))
    pixels, alpha = (
        values.reshape(size, 16, size, 16, -1).mean(axis=(1, 3)) for values in (light, large.alpha)
    )
    return Reference(alpha[..., 0], 255.0 * srgb_encoded(pixels + 0.1 * (1.0 - alpha)))


def test_edges_agree_with_very_many_samples_and_nothing_else_changes(backend, tape):
    """A bright ball: its values are near 200, of which a mean before tone mapping would leave a jagged edge."""
    options = {"backend": backend, "size": 40}
    one = drawn(tape, **options)
    many = drawn(tape, samples=64, **options)
    reference = very_many(tape, backend, 40, one.picture.exposure)
    assert one.image.max() > 100
    edge = ((reference.alpha > 0) & (reference.alpha < 1)) | ((many.alpha > 0) & (many.alpha < 1))
    assert 100 < edge.sum() < 300
    assert np.abs(over_grey(many) - reference.shown)[edge].mean() < 4
    assert np.abs(over_grey(one) - reference.shown)[edge].mean() > 10
    assert np.array_equal(many.alpha[~edge], one.mask[~edge])
    inside = one.mask & ~edge
    assert np.abs(over_grey(many) - reference.shown)[inside].max() < 1.5
    assert np.median(np.abs(over_grey(many) - over_grey(one))[inside]) < 1
    assert np.array_equal(many.mask, one.mask) and np.array_equal(many.normal, one.normal)
    # Where all is white, what is half covered is half as bright: a mean of radiance would be white there too.
    white = drawn(tape, samples=16, exposure=12.0, **options)
    assert np.abs(white.picture.pixels.max(axis=-1) - white.alpha)[edge].mean() < 0.02


def test_samples_are_spread_evenly_about_the_middle():
    for count in (1, 2, 5, 9, 64):
        offsets = sample_offsets(count)
        assert offsets.shape == (count, 2) and np.abs(offsets).max() <= 0.5
        assert np.abs(offsets.mean(axis=0)).max() < 1e-9
        assert (0.0 in np.abs(offsets).max(axis=1)) == (count % 2 == 1)


# ---- backgrounds and alpha


def test_the_environment_is_drawn_where_its_mirror_image_would_be(backend, tape):
    """A texel that is bright alone lies where the camera's own projection puts its direction."""
    radiance = np.zeros((64, 128, 3), np.float32)
    radiance[28, 70] = 9.0
    toward = directions(64, 128)[28, 70]
    rotation = 30.0
    environment = Environment(radiance, rotation=rotation)
    turned = environment.matrix[:3, :3].T @ toward
    camera = parse_camera("0,0,3:0.2,0.1,0:fov=80")
    behind = environment_behind(environment, camera, (120, 80))
    row, column = np.unravel_index(behind[..., 0].argmax(), behind.shape[:2])
    clip = (
        camera.projection_matrix(1.5, 0.1, 10.0) @ camera.view_matrix() @ [*(turned + camera.position), 1.0]
    )
    x, y = clip[:2] / clip[3]
    assert abs((column + 0.5) / 60 - 1 - x) < 2.5 / 60 and abs(1 - (row + 0.5) / 40 - y) < 2.5 / 40
    # And it is what a mirror ball's rim does not hide: opaque everywhere.
    picture = mrm_nodes.render(
        shader_of(tape), camera=camera, size=(60, 40), backend=backend, environment=environment
    ).picture
    assert picture.alpha is None and picture.pixels.max() > 0.5


def test_a_background_is_seen_around_and_through(tape):
    red = drawn(tape, samples=4, background="#ff0000").picture
    assert red.alpha is None
    assert np.array_equal(red.pixels[0, 0], [1.0, 0.0, 0.0])
    clear = drawn(tape, samples=4).picture
    alpha = clear.alpha[..., None]
    assert np.allclose(red.pixels, clear.pixels + (1 - alpha) * [1.0, 0.0, 0.0], atol=1e-6)


def test_opacity_is_alpha_and_colours_are_straight_in_png(backend, tmp_path):
    document = tmp_path / "veil.mtlx"
    document.write_text(BSDF.format(0.3, 0.25))
    camera = "0,0,3:0,0,0:width=1"
    veil = mrm_nodes.render(document, "plane", camera, "camera", (8, 8), backend)
    assert np.allclose(veil.alpha, 0.25, atol=1e-3)
    veil.save(tmp_path / "a.exr")
    assert np.allclose(read_image(tmp_path / "a.exr")[..., 3], 0.25, atol=1e-3)
    veil.save(tmp_path / "a.png")
    pixels = read_image(tmp_path / "a.png")
    assert np.allclose(pixels[..., 3] * 255, 64, atol=0.6)
    straight = find_tonemap("neutral")(veil.image / veil.alpha[..., None] * 2**veil.picture.exposure)
    assert np.abs(pixels[..., :3] - srgb_encoded(straight)).max() < 0.6 / 255


@pytest.mark.parametrize(
    ("text", "color"),
    [("black", 0.0), ("WHITE", 1.0), ("#fff", 1.0), ("0.25,0.25,0.25", 0.25), ("#808080", 0.2158605)],
)
def test_colours_are_read_as_they_are_written(text, color):
    assert np.allclose(parse_background(text), color, atol=1e-6)


# ---- the command


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--exposure", "bright"], "exposure bright: write auto, or stops from -64 to 64 such as -1.5"),
        (["--exposure", "nan"], "exposure nan: write auto"),
        (["--exposure", "1e9"], "exposure 1e9: write auto"),
        (["--tonemap", "neutrl"], "unknown tone mapping neutrl; did you mean neutral?"),
        (["--tonemap", "filmic"], "unknown tone mapping filmic; known: "),
        (["--background", "trasparent"], "background trasparent: did you mean transparent?"),
        (["--background", "environment"], "background environment: there is no environment; name one with --env"),
        (["--background", "#12345"], "background #12345: write transparent, environment, black"),
        (["--background", "1,2,3"], "background 1,2,3: write transparent"),
        (["--samples", "0"], "0 samples: a pixel takes 1 to 1024"),
        (["--samples", "many"], "Invalid value for '--samples'"),
        (["--size", "8x8x8"], "size 8x8x8: write width and height as 640x480, or one number for both"),
        (["--size", "-8"], "size -8: write width and height"),
        (["--size", "16384"], "pixels would not fit into memory"),
        (["-o", "b.gif"], "b.gif: unknown image ending .gif; use .exr or .png"),
        (["--mesh", "pot.ply"], "pot.ply: unknown mesh"),
        (["--mesh", "pot.obj"], "pot.obj"),
        (["--camera", "0,0,nan"], "camera"),
        (["--light", "laser"], "unknown light laser"),
        (["--element", "nothing"], "unknown element nothing"),
        (["--backend", "glx"], "unknown backend glx"),
        (["-o", "sub/../new/sub/a.png"], "a.png: would be written twice, as -o new/sub/a.png and as -o sub/.."),
    ],
)  # fmt: skip
def test_a_bad_request_is_one_line_and_writes_nothing(run, tmp_path, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run("render", TAPE, "-o", "new/sub/a.png", *arguments)
    assert status == 2 and message in err and err.count("\n") == 1 and out == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not BACKENDS, reason="no backend works")
def test_one_draw_gives_several_files_and_says_how_it_was_shown(run, tmp_path, tape):
    view = tone_maps()[2]
    outputs = [tmp_path / name for name in ("a.png", "a.exr", "b.PNG")]
    given = [each for output in outputs for each in ("-o", output)]
    status, out, err = run("render", tape, *given, "--size", "24", "--tonemap", view.upper())
    assert status == 0, err
    assert out.split("\n") == [*map(str, outputs), ""]
    stops, share = re.fullmatch(
        rf"exposure ([+-]\d+\.\d\d) stops, {re.escape(view)} of sRGB.*, ocio://default of OpenColorIO \S+: "
        r"(\S+) .*of lit pixels clipped\n",
        err.replace("none of", "0 of"),
    ).groups()
    assert float(share) <= 1
    assert read_image(outputs[0]).shape == (24, 24, 4)
    assert read_image(outputs[1]).shape == (24, 24, 4)
    said = oiio.ImageInput.open(str(outputs[0])).spec()
    assert float(said.getattribute("mrm:exposure")) == float(stops)
    assert re.search(r"OpenColorIO \d", said.getattribute("mrm:tonemap"))
    assert outputs[0].read_bytes() == outputs[2].read_bytes()
    again = tmp_path / "again.png"
    assert run("render", tape, "-o", again, "--size", "24", "--tonemap", view, "--exposure", stops)[0] == 0
    assert again.read_bytes() == outputs[0].read_bytes()


def test_a_folder_in_a_file_s_place_is_refused_before_anything_is_drawn(run, tmp_path, tape, monkeypatch):
    monkeypatch.setattr("mrm_nodes.render.renderer.render", None)
    (tmp_path / "b.png").mkdir()
    status, _, err = run("render", tape, "-o", tmp_path / "a.exr", "-o", tmp_path / "b.png")
    assert status == 2 and f"{tmp_path / 'b.png'}: is a folder; name a file with -o" in err


def test_files_of_one_draw_go_into_place_together(run, tmp_path, tape, monkeypatch):
    draw = mrm_nodes.render

    def meanwhile(*arguments: Any, **options: Any) -> mrm_nodes.render.RenderedImage:
        (tmp_path / "b.png").mkdir()
        return draw(*arguments, **options)

    monkeypatch.setattr("mrm_nodes.render.renderer.render", meanwhile)
    (tmp_path / "a.exr").write_text("old")
    outputs = ["-o", tmp_path / "a.exr", "-o", tmp_path / "b.png", "-o", tmp_path / "c.png"]
    status, _, err = run("render", tape, *outputs, "--size", "8", "--samples", "1")
    assert status == 2
    assert f"{tmp_path / 'b.png'}: cannot be written: Is a directory; written before it: {tmp_path}" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "b.png"]


def test_what_an_exr_does_not_take_is_said(run, tmp_path, tape):
    given = ["render", tape, "-o", tmp_path / "a.exr", "--size", "8", "--samples", "1", "--exposure", "2"]
    status, _, err = run(*given)
    assert status == 0
    assert err == (
        "warning: --exposure: an .exr has linear light and alpha, whatever they say; they are for a .png\n"
    )


def test_a_development_is_checked_before_anything_is_drawn():
    for wrong in ({"exposure": math.inf}, {"tonemap": "x"}, {"background": "y"}):
        with pytest.raises(MrmError):
            Development(**wrong)
