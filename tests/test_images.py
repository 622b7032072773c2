"""Images as other programs write them: layers, windows, tiles, number formats, and none at all."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXRender as mx_render
import numpy as np
import OpenImageIO as oiio
import pytest

import mrm_nodes
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.filenames import udim
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.render import (
    Mesh,
    Renderer,
    imagelayers,
    load_mesh,
    parse_camera,
    plane,
    probe_backends,
    read_image,
    write_exr,
    write_png,
)
from mrm_nodes.render.environment import load_environment

BACKENDS = [probe.backend for probe in probe_backends() if probe.works]
COLOR = (0.5, 0.25, 0.125)


@pytest.fixture(scope="module", params=["egl", "osmesa"])
def renderer(request: pytest.FixtureRequest) -> Renderer:
    if request.param not in BACKENDS:
        pytest.skip(f"no {request.param} here")
    return Renderer(request.param)


def save(
    path: Path,
    pixels: Any,
    kind: Any = oiio.FLOAT,
    names: tuple[str, ...] = (),
    windows: tuple[tuple[int, int], tuple[int, int, int, int]] | None = None,
    **attributes: Any,
) -> Path:
    """Write an image with what its program would have said of it.

    windows: the data window's corner, and the display window's corner and size.
    """
    array = np.asarray(pixels, np.float32)
    spec = oiio.ImageSpec(array.shape[1], array.shape[0], array.shape[2], kind)
    if names:
        spec.channelnames = names
    if windows:
        (spec.x, spec.y), (spec.full_x, spec.full_y, spec.full_width, spec.full_height) = windows
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), spec), target.geterror()
    assert target.write_image(array), target.geterror()
    target.close()
    return path


def parts(path: Path, layers: dict[str, tuple[tuple[str, ...], Any]]) -> Path:
    """Write an EXR of several parts."""
    specs = []
    for name, (channels, pixels) in layers.items():
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], len(channels), oiio.FLOAT)
        spec.channelnames = channels
        spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    target = oiio.ImageOutput.create(str(path))
    assert target.open(str(path), tuple(specs)), target.geterror()
    for number, (spec, (_, pixels)) in enumerate(zip(specs, layers.values(), strict=True)):
        if number:
            assert target.open(str(path), spec, "AppendSubimage"), target.geterror()
        assert target.write_image(np.ascontiguousarray(pixels, np.float32)), target.geterror()
    target.close()
    return path


def flat(*color: float, size: int = 4) -> np.ndarray:
    return np.full((size, size, len(color)), color, np.float32)


def textured(folder: Path, file: str, kind: str = "color3", more: str = "", attributes: str = "") -> Path:
    """A document that shows an image."""
    shown = {"color3": "i", "color4": "c", "vector3": "c", "float": "c", "vector2": "c"}[kind]
    path = folder / "a.mtlx"
    path.write_text(f"""<materialx version="1.39" {attributes}>
      <image name="i" type="{kind}"><input name="file" type="filename" value="{file}" />{more}</image>
      <convert name="c" type="color3"><input name="in" type="{kind}" nodename="i" /></convert>
      <surface_unlit name="s" type="surfaceshader">
        <input name="emission_color" type="color3" nodename="{shown}" /></surface_unlit>
      <surfacematerial name="m" type="material">
        <input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial></materialx>""")
    return path


def drawn(renderer: Renderer, path: Path, mesh: Mesh | None = None, **options: Any) -> np.ndarray:
    """What a document shows on a plane that fills the picture, (16, 16, 3)."""
    shader = mrm_nodes.generate_shader(path, element="m", **options)
    camera = parse_camera("0,0,3:0,0,0:width=2")
    return np.asarray(renderer.render(shader, mesh or plane(), camera, size=(16, 16)).image)


def quietly(renderer: Renderer, path: Path) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return drawn(renderer, path)


RGB, RGBA = ("R", "G", "B"), ("R", "G", "B", "A")


def written(kind: str, folder: Path) -> str:
    """Write one of the images that show COLOR; its name."""
    rgb, rgba = flat(*COLOR), flat(*COLOR, 0.5)
    match kind:
        case "layer beside depth":
            names = ("Z", "beauty.R", "beauty.G", "beauty.B", "beauty.A")
            return save(folder / "a.exr", flat(99.0, *COLOR, 1.0), names=names).name
        case "colours beside layers":
            names = (*RGB, "diffuse.R", "diffuse.G", "diffuse.B")
            return save(folder / "a.exr", flat(*COLOR, 9.0, 9.0, 9.0), names=names).name
        case "beauty after others":
            names = ("albedo.R", "albedo.G", "albedo.B", "Combined.R", "Combined.G", "Combined.B")
            return save(folder / "a.exr", flat(9.0, 9.0, 9.0, *COLOR), names=names).name
        case "colours in another order":
            return save(folder / "a.exr", flat(*COLOR[::-1], 1.0), names=("x.B", "x.G", "x.R", "x.A")).name
        case "long names":
            return save(folder / "a.exr", rgb, names=("red", "green", "blue")).name
        case "second part":
            return parts(folder / "a.exr", {"depth": (("Z",), flat(99.0)), "rgb": (RGB, rgb)}).name
        case "parts with layers":
            diffuse = (("diffuse.R", "diffuse.G", "diffuse.B"), flat(9.0, 9.0, 9.0))
            return parts(folder / "a.exr", {"diffuse": diffuse, "rgba": (RGBA, rgba)}).name
        case "half":
            return save(folder / "a.exr", rgb, oiio.HALF).name
        case "16-bit PNG":
            return save(folder / "a.png", rgb, oiio.UINT16).name
        case "PNG with alpha":
            return save(folder / "a.png", rgba, oiio.UINT16, oiio__UnassociatedAlpha=1).name
        case "TIFF in tiles":
            return save(folder / "a.tif", flat(*COLOR, size=64), tile_width=16).name
        case "planar TIFF":
            return save(folder / "a.tif", rgb, planarconfig="separate").name
        case "TX":
            source = save(folder / "source.exr", flat(*COLOR, size=64))
            assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, str(source), str(folder / "a.tx"))
            return "a.tx"
        case "HDR":
            return save(folder / "a.hdr", rgb).name
        case "BMP" | "TGA":
            return save(folder / f"a.{kind.lower()}", rgb, oiio.UINT8).name
        case "Orientation":
            return save(folder / "a.tif", rgb, Orientation=6).name
        case _:
            raise AssertionError(kind)


WITH_A_WORD = {
    "layer beside depth": "shown is its layer beauty, and not the one without a name",
    "beauty after others": "shown is its layer Combined, and not albedo",
    "second part": "shown is its layer rgb, and not depth",
    "parts with layers": "shown is its layer rgba, and not diffuse",
}
PLAIN = [
    "colours beside layers", "colours in another order", "long names", "half", "16-bit PNG", "PNG with alpha",
    "TIFF in tiles", "planar TIFF", "TX", "HDR", "BMP", "TGA", "Orientation",
]  # fmt: skip


@pytest.mark.parametrize("kind", [*WITH_A_WORD, *PLAIN])
def test_the_colours_of_an_image_are_drawn(kind: str, renderer: Renderer, tmp_path: Path):
    path = textured(tmp_path, written(kind, tmp_path))
    if kind in WITH_A_WORD:
        with pytest.warns(MrmWarning, match=re.escape(WITH_A_WORD[kind])):
            image = drawn(renderer, path)
    else:
        image = quietly(renderer, path)
    assert image.reshape(-1, 3).min(axis=0) == pytest.approx(COLOR, abs=3e-3)
    assert image.reshape(-1, 3).max(axis=0) == pytest.approx(COLOR, abs=3e-3)


@pytest.mark.parametrize(
    "names", [("N.X", "N.Y", "N.Z"), ("normal.x", "normal.y", "normal.z"), ("X", "Y", "Z")]
)
def test_coordinates_are_read_as_they_are_named(names: tuple[str, ...], tmp_path: Path):
    """The Y of a normal is no luminance."""
    save(tmp_path / "n.exr", flat(0.5, 0.25, 0.125), names=names)
    assert read_image(tmp_path / "n.exr")[0, 0].tolist() == [0.5, 0.25, 0.125]


def test_a_layer_is_chosen_by_its_name(renderer: Renderer, tmp_path: Path):
    names = (*RGB, "diffuse.R", "diffuse.G", "diffuse.B")
    save(tmp_path / "a.exr", flat(9.0, 9.0, 9.0, *COLOR), names=names)
    layer = '<input name="layer" type="string" value="{}" />'
    path = textured(tmp_path, "a.exr", more=layer.format("diffuse"))
    assert quietly(renderer, path)[8, 8] == pytest.approx(COLOR)
    with pytest.raises(MrmError, match=r"a\.exr: unknown layer difuse; did you mean diffuse"):
        drawn(renderer, textured(tmp_path, "a.exr", more=layer.format("difuse")))
    wide = np.tile(flat(9.0, 9.0, 9.0, *COLOR), (1, 2, 1))
    sky = load_environment(save(tmp_path / "sky.exr", wide, names=names), layer="diffuse")
    assert sky.radiance[0, 0] == pytest.approx(COLOR)


def test_a_cropped_picture_stands_where_its_display_window_has_it(renderer: Renderer, tmp_path: Path):
    """The right half of the display window has data, the left none; and of an overscan only the middle is shown."""
    save(tmp_path / "a.exr", np.ones((16, 8, 3)), windows=((8, 0), (0, 0, 16, 16)))
    image = drawn(renderer, textured(tmp_path, "a.exr", more=CLOSEST))
    assert image[:, :8].max() == 0.0
    assert image[:, 8:].min() == 1.0
    over = np.zeros((32, 32, 3), np.float32)
    over[8:24, 8:24] = COLOR
    save(tmp_path / "b.exr", over, windows=((-8, -8), (0, 0, 16, 16)))
    assert drawn(renderer, textured(tmp_path, "b.exr", more=CLOSEST)).reshape(-1, 3).min(axis=0) == (
        pytest.approx(COLOR)
    )


CLOSEST = '<input name="filtertype" type="string" value="closest" />'


def test_what_is_no_picture_is_refused_by_name(tmp_path: Path):
    deep = oiio.ImageSpec(2, 2, 2, oiio.FLOAT)
    deep.channelnames, deep.deep = ("R", "Z"), True
    target = oiio.ImageOutput.create(str(tmp_path / "deep.exr"))
    data = oiio.DeepData()
    data.init(4, 2, (oiio.TypeDesc("float"), oiio.TypeDesc("float")), ("R", "Z"))
    assert target.open(str(tmp_path / "deep.exr"), deep)
    assert target.write_deep_image(data)
    target.close()
    with pytest.raises(MrmError, match=r"deep\.exr: a deep image .* flatten it first"):
        read_image(tmp_path / "deep.exr")
    save(tmp_path / "chroma.exr", flat(0.5, 0.0, 0.0), names=("Y", "RY", "BY"))
    with pytest.raises(MrmError, match=r"chroma\.exr: its colours are luminance and chroma"):
        read_image(tmp_path / "chroma.exr")
    save(tmp_path / "off.exr", flat(*COLOR), windows=((100, 100), (0, 0, 16, 16)))
    with pytest.raises(MrmError, match=r"off\.exr: its data window lies outside of its display window"):
        read_image(tmp_path / "off.exr")


def test_texels_that_are_no_numbers_are_named(renderer: Renderer, tmp_path: Path):
    pixels = flat(*COLOR)
    pixels[0, 0, 1], pixels[1, 1, 2] = np.nan, np.inf
    save(tmp_path / "a.exr", pixels)
    with pytest.warns(MrmWarning, match=r"a\.exr: 2 of its texels are NaN or infinite"):
        drawn(renderer, textured(tmp_path, "a.exr"))


@pytest.mark.parametrize("ending", ["tif", "gif"])
def test_of_several_pages_the_first_is_shown_and_that_is_said(
    renderer: Renderer, tmp_path: Path, ending: str
):
    path, spec = str(tmp_path / f"a.{ending}"), oiio.ImageSpec(16, 16, 3, oiio.UINT8)
    target = oiio.ImageOutput.create(path)
    assert target.open(path, (spec, spec))
    for page, value in enumerate((255, 0)):
        assert page == 0 or target.open(path, spec, "AppendSubimage")
        assert target.write_image(np.full((16, 16, 3), value, np.uint8))
    target.close()
    with pytest.warns(MrmWarning, match=rf"a\.{ending}: it has several pages: the first is shown"):
        image = drawn(renderer, textured(tmp_path, f"a.{ending}"))
    assert image[8, 8].tolist() == [1, 1, 1]


def test_a_grey_has_its_value_in_each_colour_and_its_alpha_is_materialx_s_green(
    renderer: Renderer, tmp_path: Path
):
    save(tmp_path / "grey.png", flat(0.4), oiio.UINT16)
    assert quietly(renderer, textured(tmp_path, "grey.png"))[8, 8] == pytest.approx([0.4] * 3, abs=1e-4)
    save(tmp_path / "alpha.png", flat(0.4, 0.6), oiio.UINT16, names=("Y", "A"), oiio__UnassociatedAlpha=1)
    with pytest.warns(
        MrmWarning, match=r"alpha\.png: it has two channels: MaterialX takes them for red and green"
    ):
        image = drawn(renderer, textured(tmp_path, "alpha.png"))
    assert image[8, 8] == pytest.approx([0.4, 0.6, 0.0], abs=1e-4)


@pytest.mark.parametrize("named", ['value=""', ""])
@pytest.mark.parametrize("space", ["", 'colorspace="lin_rec709"', 'colorspace="ACES2065-1"'])
def test_where_no_image_is_named_its_default_is_shown(
    named: str, space: str, renderer: Renderer, tmp_path: Path
):
    given = '<input name="default" type="color3" value="0.3, 0.2, 0.1" colorspace="lin_rec709" />'
    path = textured(tmp_path, "", more=given)
    path.write_text(path.read_text().replace('type="filename" value=""', f'type="filename" {named} {space}'))
    assert quietly(renderer, path)[8, 8] == pytest.approx([0.3, 0.2, 0.1])


def test_a_default_stands_beside_an_image(renderer: Renderer, tmp_path: Path):
    save(tmp_path / "a.exr", flat(*COLOR))
    path = textured(tmp_path, "a.exr")
    other = '<image name="j" type="color3"><input name="default" type="color3" value="0, 0, 1" /></image>'
    total = '<add name="k" type="color3"><input name="in1" type="color3" nodename="i" />'
    total += '<input name="in2" type="color3" nodename="j" /></add>'
    text = path.read_text().replace('color" type="color3" nodename="i"', 'color" type="color3" nodename="k"')
    path.write_text(text.replace("<surface_unlit", other + total + "<surface_unlit"))
    assert drawn(renderer, path)[8, 8] == pytest.approx([0.5, 0.25, 1.125])


#: A patch of a colour chart in linear Rec. 709, and in a space that only OpenColorIO knows.
PATCH, ACES = (0.4510, 0.3216, 0.2667), (0.3687, 0.3279, 0.2760)


def test_pixels_are_converted_as_they_are_read_and_alpha_is_not(renderer: Renderer, tmp_path: Path):
    save(tmp_path / "a.exr", flat(*ACES, 0.25))
    for attributes, own in (("", 'colorspace="ACES2065-1"'), ('colorspace="ACES2065-1"', "")):
        path = textured(tmp_path, "a.exr", attributes=attributes)
        path.write_text(path.read_text().replace('value="a.exr"', f'value="a.exr" {own}'))
        assert drawn(renderer, path)[8, 8] == pytest.approx(PATCH, abs=3e-4)
    path = textured(tmp_path, "a.exr", "color4", attributes='colorspace="ACES2065-1"')
    alpha = '<extract name="a" type="float"><input name="in" type="color4" nodename="i" />'
    alpha += '<input name="index" type="integer" value="3" /></extract>'
    text = path.read_text().replace("<convert", alpha + "<convert")
    path.write_text(
        text.replace(
            'in" type="color4" nodename="i" /></convert', 'in" type="float" nodename="a" /></convert'
        )
    )
    assert drawn(renderer, path)[8, 8] == pytest.approx([0.25] * 3)


def test_one_file_in_two_spaces_is_two_textures(renderer: Renderer, tmp_path: Path):
    save(tmp_path / "a.exr", flat(*ACES))
    images = [
        drawn(renderer, textured(tmp_path, f'a.exr" colorspace="{space}'))[8, 8]
        for space in ("ACES2065-1", "raw", "ACES2065-1")
    ]
    assert images[1] == pytest.approx(ACES)
    assert np.array_equal(images[0], images[2])
    assert images[0] == pytest.approx(PATCH, abs=3e-4)


def test_an_image_of_data_is_in_no_colour_space(renderer: Renderer, tmp_path: Path):
    save(tmp_path / "a.exr", flat(*ACES))
    path = textured(tmp_path, "a.exr", "vector3", attributes='colorspace="ACES2065-1"')
    assert drawn(renderer, path)[8, 8] == pytest.approx(ACES)
    assert drawn(renderer, textured(tmp_path, 'a.exr" colorspace="nobody knows', "vector3")) is not None
    with pytest.raises(MrmError, match="i/file: unknown colour space nobody knows"):
        drawn(renderer, textured(tmp_path, 'a.exr" colorspace="nobody knows'))


@pytest.mark.parametrize("mode", ["clamp", "periodic"])
def test_a_reduced_interface_reads_images_as_a_complete_one(mode: str, renderer: Renderer, tmp_path: Path):
    """MaterialX's generator leaves the modes out of it."""
    save(tmp_path / "a.exr", np.linspace(0.0, 1.0, 48).reshape(4, 4, 3))
    more = CLOSEST + f'<input name="uaddressmode" type="string" value="{mode}" />'
    path = textured(tmp_path, "a.exr", more=more)
    shifted = replace(plane(), texcoords=plane().texcoords * 3.0 - 1.0)
    images = [drawn(renderer, path, shifted, interface=each) for each in ("complete", "reduced")]
    assert np.array_equal(*images)
    assert len(np.unique(images[0].reshape(-1, 3), axis=0)) > 4


def tiled_plane() -> Mesh:
    """The square cut into 2 × 2 tiles, each with its own texture coordinates."""
    corners = [(x, y) for y in (0.0, 1.0, 1.0, 2.0) for x in (0.0, 1.0, 1.0, 2.0)]
    texcoords = np.array(corners)
    zero, one = np.zeros(16), np.ones(16)
    quads = [[4 * y + x + d for d in (0, 1, 5, 4)] for y in (0, 2) for x in (0, 2)]
    triangles = [[q[i] for i in each] for q in quads for each in ((0, 1, 2), (0, 2, 3))]
    positions = np.stack([texcoords[:, 0] - 1.0, texcoords[:, 1] - 1.0, zero], axis=1)
    up, right = np.stack([zero, zero, one], axis=1), np.stack([one, zero, zero], axis=1)
    return Mesh("tiles", positions, up, right, texcoords, np.array(triangles))


@pytest.mark.parametrize(("name", "token"), [("t.{}.exr", "&lt;UDIM&gt;"), ("t_{}.exr", "&lt;UVTILE&gt;")])
def test_a_set_of_tiles_is_drawn_by_tile(name: str, token: str, renderer: Renderer, tmp_path: Path):
    numbers = {
        "&lt;UDIM&gt;": (1001, 1002, 1011, 1012),
        "&lt;UVTILE&gt;": ("u1_v1", "u2_v1", "u1_v2", "u2_v2"),
    }
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.25, 0.125]])
    for number, color in zip(numbers[token], colors, strict=True):
        save(tmp_path / name.format(number), flat(*color))
    path = textured(tmp_path, name.format(token))
    image = drawn(renderer, path, tiled_plane())
    seen = [image[12, 4], image[12, 12], image[4, 4], image[4, 12]]
    assert np.allclose(seen, colors)
    assert np.array_equal(image, drawn(renderer, path, tiled_plane()))

    (tmp_path / name.format(numbers[token][1])).unlink()
    more = '<input name="default" type="color3" value="0.3, 0.2, 0.1" />'
    with pytest.warns(MrmWarning, match="no image of tile 1002, where mesh tiles has texture coordinates"):
        image = drawn(renderer, textured(tmp_path, name.format(token), more=more), tiled_plane())
    assert image[12, 12] == pytest.approx([0.3, 0.2, 0.1])
    assert image[12, 4] == pytest.approx([1.0, 0.0, 0.0])


def test_tiles_are_those_of_materialx(tmp_path: Path):
    """A triangle that lies in two tiles is of one: that of its smallest coordinates."""
    corners = [
        (0.1, 0.1),
        (0.9, 0.1),
        (0.9, 0.9),
        (0.6, 0.2),
        (1.4, 0.2),
        (1.4, 0.9),
        (2.2, 1.8),
        (3.0, 2.0),
        (2.5, 2.5),
    ]
    lines = [f"v {u} {v} 0" for u, v in corners] + [f"vt {u} {v}" for u, v in corners] + ["vn 0 0 1"]
    faces = [f"f {a}/{a}/1 {a + 1}/{a + 1}/1 {a + 2}/{a + 2}/1" for a in (1, 4, 7)]
    (tmp_path / "a.obj").write_text("\n".join([*lines, *faces]))
    handler = mx_render.GeometryHandler.create()
    handler.addLoader(mx_render.TinyObjLoader.create())
    handler.loadGeometry(mx.FilePath(str(tmp_path / "a.obj")), False)
    (theirs,) = handler.getMeshes()
    theirs.splitByUdims()
    parts = [theirs.getPartition(i) for i in range(theirs.getPartitionCount())]
    ours = load_mesh(tmp_path / "a.obj").tiles
    assert {part.getName(): part.getFaceCount() for part in parts} == {
        str(udim(tile)): len(part.indices) for tile, part in ours.items()
    }


LIT = """<materialx version="1.39" {attributes}>
<image name="i" type="color3"><input name="file" type="filename" value="{file}" {space} />
  <input name="default" type="color3" value="0.3, 0.2, 0.1" /></image>
<mrm_generalized_schlick_bsdf name="b" type="BSDF"><input name="color0" type="color3" nodename="i" />
  <input name="roughness" type="vector2" value="0.3, 0.3" /></mrm_generalized_schlick_bsdf>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial></materialx>"""


@pytest.mark.parametrize(
    ("file", "space"),
    [
        ("a.exr", 'colorspace="ACES2065-1"'),
        ("a.exr", 'colorspace="srgb_tx"'),
        ("", ""),
        ("t.&lt;UDIM&gt;.exr", ""),
    ],
)
def test_the_evaluator_sees_the_same_images(file: str, space: str, tmp_path: Path):
    if not BACKENDS:
        pytest.skip("no backend works")
    names = (*RGB, "diffuse.R", "diffuse.G", "diffuse.B")
    save(tmp_path / "a.exr", flat(*ACES, 9.0, 9.0, 9.0), names=names)
    write_exr(tmp_path / "t.1001.exr", flat(*COLOR))
    (tmp_path / "a.mtlx").write_text(LIT.format(file=file, space=space, attributes='colorspace="lin_rec709"'))
    (case,) = load(tmp_path).cases
    outcome = Worker(BACKENDS[0]).run(replace(case, size=(48, 48)), tmp_path / "report")
    assert (outcome.message, outcome.truth, outcome.verdict) == ("", "physics", "pass")
    assert outcome.figures is not None
    assert outcome.figures.lit > 500


def test_a_picture_of_a_giant_size_is_refused_before_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    file = tmp_path / "black.png"
    write_png(file, np.random.default_rng(0).random((64, 64, 3)))
    read_image(file)
    # Reading would find that it is cut short.
    file.write_bytes(file.read_bytes()[:2000])
    with pytest.raises(MrmError, match="damaged or truncated"):
        read_image(file)
    monkeypatch.setattr(imagelayers, "LARGEST", 64 * 64 * 3)
    with pytest.raises(MrmError, match=r"black\.png: 64 × 64 pixels of 3 channels are more than"):
        read_image(file)
