"""Values mean what MaterialX means: lengths in metres, angles in degrees, colours in linear Rec. 709."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose

import mrm_nodes
from mrm_nodes.cli import cli
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.render import Renderer, plane, probe_backends, write_png

UNLIT = """
<surface_unlit name="s" type="surfaceshader"><input name="emission_color" type="color3" {} /></surface_unlit>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>"""

BACKENDS = [probe.backend for probe in probe_backends() if probe.works]


@pytest.fixture(scope="module", params=["egl", "osmesa"])
def renderer(request: pytest.FixtureRequest) -> Renderer:
    if request.param not in BACKENDS:
        pytest.skip(f"no {request.param} here")
    return Renderer(request.param)


def write(folder: Path, body: str, attributes: str = "", shown: str = "") -> Path:
    """A document whose surface shows the node `c`, or the output of the graph `g`."""
    default = 'nodegraph="g" output="out"' if "<nodegraph" in body else 'nodename="c"'
    path = folder / "a.mtlx"
    path.write_text(
        f'<materialx version="1.39" {attributes}>{body}{UNLIT.format(shown or default)}</materialx>'
    )
    return path


def drawn(renderer: Renderer, path: Path, **options: object) -> np.ndarray:
    """What a document shows in the middle of a plane, (3,)."""
    shader = mrm_nodes.generate_shader(path, element="m")
    image = renderer.render(shader, plane(), size=(8, 8), **options).image  # type: ignore[arg-type]
    return np.asarray(image[4, 4])


GRAY = '<convert name="c" type="color3"><input name="in" type="float" nodename="k" /></convert>'


def constant(value: str, unit: str, kind: str = "distance") -> str:
    given = f'<input name="value" type="float" value="{value}" unit="{unit}" unittype="{kind}" />'
    return f'<constant name="k" type="float">{given}</constant>{GRAY}'


def graph(outer: str, inner: str) -> str:
    """A graph with a float of its interface; both its declaration and its use may have attributes."""
    return f"""<nodegraph name="g"><input name="x" type="float" value="50" {outer} />
      <constant name="k" type="float"><input name="value" type="float" interfacename="x" {inner} /></constant>
      {GRAY}<output name="out" type="color3" nodename="c" /></nodegraph>"""


CM = 'unit="centimeter" unittype="distance"'


def triple(values: tuple[float, ...]) -> str:
    return ", ".join(f"{value:.7g}" for value in values)


def color_graph(value: tuple[float, ...], outer: str, inner: str) -> str:
    return f"""<nodegraph name="g"><input name="x" type="color3" value="{triple(value)}" {outer} />
      <constant name="c" type="color3"><input name="value" type="color3" interfacename="x" {inner} /></constant>
      <output name="out" type="color3" nodename="c" /></nodegraph>"""


FURLONG = '<unitdef name="more" unittype="distance"><unit name="furlong" scale="201.168" /></unitdef>'
OWN_NODE = (
    """
<nodedef name="ND_plank" node="plank">
  <input name="width" type="float" value="2" unit="centimeter" unittype="distance" />
  <output name="out" type="float" />
</nodedef>
<nodegraph name="NG_plank" nodedef="ND_plank">
  <constant name="v" type="float"><input name="value" type="float" interfacename="width" /></constant>
  <output name="out" type="float" nodename="v" />
</nodegraph>
<plank name="k" type="float">{}</plank>"""
    + GRAY
)

LENGTHS = {
    "centimetres": (constant("50", "centimeter"), 0.5),
    "feet": (constant("2", "foot"), 0.6096),
    "metres": (constant("0.7", "meter"), 0.7),
    "of the document": (FURLONG + constant("0.002", "furlong"), 0.402336),
    "radians": (constant("0.01", "radian", "angle"), 0.57295780),
    "degrees": (constant("0.6", "degree", "angle"), 0.6),
    "another type": (
        '<unittypedef name="mass" /><unitdef name="masses" unittype="mass"><unit name="gram" scale="1" />'
        '<unit name="kilogram" scale="1000" /></unitdef>' + constant("0.0005", "kilogram", "mass"),
        0.5,
    ),
    "interface": (graph(CM, ""), 0.5),
    "use of an interface": (graph("", CM), 0.5),
    "both of them": (graph(CM, CM), 0.5),
    "a definition's default": (OWN_NODE.format(""), 2.0),
    "into a definition's unit": (
        OWN_NODE.format('<input name="width" type="float" value="0.03" unit="meter" unittype="distance" />'),
        3.0,
    ),
}


@pytest.mark.parametrize("kind", LENGTHS)
def test_a_value_with_a_unit_comes_in_the_unit_that_its_node_wants(
    kind: str, renderer: Renderer, tmp_path: Path
):
    body, expected = LENGTHS[kind]
    path = write(tmp_path, body, shown='nodename="c"' if kind.startswith(("a def", "into")) else "")
    assert drawn(renderer, path) == pytest.approx([expected] * 3, rel=1e-6)


ROTATED = """
<constant name="one" type="vector2"><input name="value" type="vector2" value="1, 0" /></constant>
<rotate2d name="r" type="vector2"><input name="in" type="vector2" nodename="one" />
  <input name="amount" type="float" value="{}" unit="{}" unittype="angle" /></rotate2d>
<convert name="r3" type="vector3"><input name="in" type="vector2" nodename="r" /></convert>
<convert name="{}" type="color3"><input name="in" type="vector3" nodename="r3" /></convert>"""
WITH_LENGTH = (
    ROTATED.format("-60", "degree", "turned")
    + constant("50", "centimeter").replace('name="c"', 'name="gray"')
    + '<multiply name="c" type="color3"><input name="in1" type="color3" nodename="turned" />'
    '<input name="in2" type="color3" nodename="gray" /></multiply>'
)


@pytest.mark.parametrize(("value", "unit"), [("-60", "degree"), ("-1.0471975512", "radian")])
def test_an_angle_turns_by_its_unit(value: str, unit: str, renderer: Renderer, tmp_path: Path):
    path = write(tmp_path, ROTATED.format(value, unit, "c"))
    assert drawn(renderer, path) == pytest.approx([0.5, 0.8660254, 0.0], abs=1e-6)


def test_a_length_and_an_angle_live_in_one_document(renderer: Renderer, tmp_path: Path):
    assert drawn(renderer, write(tmp_path, WITH_LENGTH)) == pytest.approx([0.25, 0.4330127, 0.0], abs=1e-6)


@pytest.mark.parametrize("interface", ["complete", "reduced"])
@pytest.mark.parametrize("target", mrm_nodes.supported_targets())
def test_every_target_converts_units(target: str, interface: str, tmp_path: Path):
    path = write(tmp_path, WITH_LENGTH)
    code = mrm_nodes.generate_shader(path, target, element="m", interface=interface).pixel
    assert "k_value_unit_out" in code
    assert "r_amount_unit_out" in code


@pytest.mark.parametrize(
    "body",
    [
        graph(CM, ""),
        graph("", CM),
        *(
            color_graph((0.5, 0.4, 0.3), "", f'colorspace="{space}"')
            for space in ("srgb_texture", "ACES2065-1")
        ),
    ],
)
def test_a_graph_s_output_shows_what_its_material_does(body: str, renderer: Renderer, tmp_path: Path):
    path = write(tmp_path, body)
    alone = mrm_nodes.generate_shader(path, element="g/out")
    shown = renderer.render(alone, plane(), size=(8, 8)).image[4, 4]
    assert shown == pytest.approx(drawn(renderer, path), rel=1e-6)
    assert shown != pytest.approx([50.0] * 3)


def test_a_value_given_in_place_of_the_document_s_has_the_document_s_unit(renderer: Renderer, tmp_path: Path):
    path = write(tmp_path, constant("50", "centimeter"))
    assert drawn(renderer, path, uniforms={"k/value": 70.0}) == pytest.approx([0.7] * 3)
    path = write(tmp_path, graph(CM, ""))
    assert drawn(renderer, path, uniforms={"g/x": 70.0}) == pytest.approx([0.7] * 3)


def test_documents_with_units_of_their_own_do_not_meet(renderer: Renderer, tmp_path: Path):
    long = write(tmp_path, FURLONG.replace("201.168", "1") + constant("0.5", "furlong"))
    assert drawn(renderer, long) == pytest.approx([0.5] * 3)
    longer = write(tmp_path, FURLONG.replace("201.168", "2") + constant("0.5", "furlong"))
    assert drawn(renderer, longer) == pytest.approx([1.0] * 3)
    without = write(tmp_path, constant("0.5", "furlong"))
    with pytest.raises(MrmError, match=r"a\.mtlx: k/value: unknown unit furlong of distance; .*meter"):
        drawn(renderer, without)


def test_an_unknown_unit_is_refused_where_it_is_used(tmp_path: Path):
    with pytest.raises(
        MrmError, match="k/value: unknown unit centimetre of distance; did you mean centimeter"
    ):
        mrm_nodes.generate_shader(write(tmp_path, constant("5", "centimetre")), element="m")
    unused = constant("5", "centimetre").replace('name="c"', 'name="unused"')
    blue = '<constant name="c" type="color3" />'
    assert mrm_nodes.generate_shader(write(tmp_path, unused + blue), element="m").pixel


@pytest.mark.parametrize(
    ("attributes", "reason"),
    [
        ('unit="centimeter"', "it has no unittype"),
        ('unit="cm" unittype="length"', "unit type length is unknown"),
    ],
)
def test_a_unit_that_materialx_does_not_apply_is_named(
    attributes: str, reason: str, renderer: Renderer, tmp_path: Path
):
    path = write(tmp_path, graph(attributes, ""))
    with pytest.warns(MrmWarning, match=f"g/x: unit c.* is not applied, as in MaterialX: {reason}"):
        assert drawn(renderer, path) == pytest.approx([50.0] * 3)


#: One patch of a colour chart in the spaces of MaterialX's own test suite, whose numbers are rounded to 4 digits.
PATCH = (0.4510, 0.3216, 0.2667)
SPACES = {
    "ACES2065-1": (0.3687, 0.3279, 0.2760),
    "lin_ap1_scene": (0.3983, 0.3299, 0.2765),
    "lin_rec709": PATCH,
    "Utility - sRGB - Texture": (0.7021, 0.6026, 0.5532),
    "sRGB Encoded P3-D65": (0.6858, 0.6062, 0.5600),
    "CIE XYZ-D65 - Scene-referred": (0.3491, 0.3451, 0.3005),
    "Linear P3-D65": (0.4280, 0.3259, 0.2738),
    "Linear Rec.2020": (0.4004, 0.3299, 0.2745),
    "Gamma 2.2 Encoded AdobeRGB": (0.6697, 0.5970, 0.5504),
    "Gamma 2.4 Encoded Rec.709": (0.7176, 0.6233, 0.5765),
    "srgb_texture": (0.7021, 0.6026, 0.5532),
    "srgb_tx": (0.7021, 0.6026, 0.5532),
    "gamma24": (0.7176, 0.6233, 0.5765),
    "ACEScc": tuple((np.log2(x) + 9.72) / 17.52 for x in (0.3983, 0.3299, 0.2765)),
    **dict.fromkeys(("none", "raw", "data", "Utility - Raw", "linear"), PATCH),
}


def colored(value: tuple[float, ...], attributes: str) -> str:
    given = f'<input name="value" type="color3" value="{triple(value)}" {attributes} />'
    return f'<constant name="c" type="color3">{given}</constant>'


@pytest.mark.parametrize("space", SPACES)
def test_a_colour_of_any_space_is_the_same_colour(space: str, renderer: Renderer, tmp_path: Path):
    attribute = f'colorspace="{space}"'
    for path in (
        write(tmp_path, colored(SPACES[space], attribute)),
        write(tmp_path, colored(SPACES[space], ""), attribute),
    ):
        assert drawn(renderer, path) == pytest.approx(PATCH, abs=3e-4)


@pytest.mark.parametrize("space", ["srgb_texture", "Utility - sRGB - Texture", "ACES2065-1"])
def test_a_colour_of_an_interface_has_the_space_of_its_declaration_or_use(
    space: str, renderer: Renderer, tmp_path: Path
):
    attribute = f'colorspace="{space}"'
    for outer, inner in ((attribute, ""), ("", attribute), (attribute, attribute)):
        path = write(tmp_path, color_graph(SPACES[space], outer, inner))
        assert drawn(renderer, path) == pytest.approx(PATCH, abs=3e-4)
        given = {"g/x": SPACES[space]}
        assert drawn(renderer, write(tmp_path, color_graph((0, 0, 0), outer, inner)), uniforms=given) == (
            pytest.approx(PATCH, abs=3e-4)
        )


def test_alpha_is_in_no_colour_space(renderer: Renderer, tmp_path: Path):
    value = triple((*SPACES["ACES2065-1"], 0.25))
    body = f"""<constant name="k" type="color4">
      <input name="value" type="color4" value="{value}" colorspace="ACES2065-1" /></constant>
      <extract name="a" type="float"><input name="in" type="color4" nodename="k" />
      <input name="index" type="integer" value="{{}}" /></extract>
      <convert name="c" type="color3"><input name="in" type="float" nodename="a" /></convert>"""
    seen = [drawn(renderer, write(tmp_path, body.format(index)))[0] for index in range(4)]
    assert seen == pytest.approx([*PATCH, 0.25], abs=3e-4)


def test_a_space_that_nobody_knows_is_refused_where_it_is_used(tmp_path: Path):
    with pytest.raises(
        MrmError, match=r"a\.mtlx: c/value: unknown colour space sRGB_textur; did you mean .*srgb_tex"
    ):
        mrm_nodes.generate_shader(write(tmp_path, colored(PATCH, 'colorspace="sRGB_textur"')), element="m")
    unused = colored(PATCH, 'colorspace="sRGB_textur"').replace('name="c"', 'name="unused"')
    assert mrm_nodes.generate_shader(write(tmp_path, unused + colored(PATCH, "")), element="m").pixel


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (colored(PATCH, 'colorspace="srgb_tx"'), "c/value: .*srgb_tx, which is its srgb_texture"),
        (colored(PATCH, 'colorspace="ACEScc"'), "c/value: .*ACEScc: its value is converted to lin_rec709"),
        (
            '<image name="c" type="color3"><input name="file" type="filename" value="a.exr" '
            'colorspace="ACES2065-1" /></image>',
            "c/file: .*ACES2065-1, so that the code takes the image as linear",
        ),
    ],
)
def test_generated_code_comes_with_a_word_on_colour_spaces_that_are_not_materialx_s(
    body: str, said: str, tmp_path: Path
):
    request = [
        "generate",
        str(write(tmp_path, body)),
        "--element",
        "m",
        "--target",
        "osl",
        "-o",
        str(tmp_path),
    ]
    with pytest.warns(MrmWarning, match=said):
        done = CliRunner().invoke(cli, request)
    assert done.exit_code == 0
    strict = CliRunner().invoke(cli, [*request, "--strict"])
    assert isinstance(strict.exception, MrmError)
    assert re.search(said, str(strict.exception))


@pytest.mark.parametrize("target", mrm_nodes.supported_targets())
@pytest.mark.parametrize("around", ["", 'colorspace="srgb_texture"'])
def test_a_node_of_several_tagged_files_is_generated(around: str, target: str, tmp_path: Path):
    """MaterialX 1.39.5's generators crash at a second file that they are to decode."""
    path = write(tmp_path, triplanar(["" if around else "srgb_texture"] * 3), around)
    code = mrm_nodes.generate_shader(path, target).pixel
    assert "srgb_texture_to_lin_rec709" in code


@pytest.mark.parametrize("spaces", [["srgb_texture"] * 3, ["none", "srgb_texture", "none"]])
def test_files_of_one_node_are_decoded(spaces: list[str], renderer: Renderer, tmp_path: Path):
    write_png(tmp_path / "t.png", np.full((8, 8, 3), 0.2158605))
    shown = drawn(renderer, write(tmp_path, triplanar(spaces)))
    assert_allclose(shown, (128 / 255 + 0.055) ** 2.4 / 1.055**2.4, atol=1e-4)


def test_files_of_one_node_may_be_in_different_colour_spaces(renderer: Renderer, tmp_path: Path):
    """The plane faces z: the third file is what is seen."""
    write_png(tmp_path / "t.png", np.full((8, 8, 3), 0.2158605))
    path = write(tmp_path, triplanar(["g18_rec709", "g18_rec709", "srgb_texture"]))
    assert_allclose(drawn(renderer, path), (128 / 255 + 0.055) ** 2.4 / 1.055**2.4, atol=1e-4)
    with pytest.warns(MrmWarning, match="c/filez: MaterialX decodes files in one colour space for a node"):
        CliRunner().invoke(cli, ["generate", str(path), "--target", "osl", "-o", str(tmp_path)])
    strict = ["generate", str(path), "--target", "osl", "-o", str(tmp_path), "--strict"]
    assert isinstance(CliRunner().invoke(cli, strict).exception, MrmError)


def triplanar(spaces: list[str]) -> str:
    tags = [f'colorspace="{space}"' if space else "" for space in spaces]
    files = "".join(
        f'<input name="file{axis}" type="filename" value="t.png" {tag} />'
        for axis, tag in zip("xyz", tags, strict=True)
    )
    return f'<triplanarprojection name="c" type="color3">{files}</triplanarprojection>'


def test_a_value_in_two_colour_spaces_is_refused(tmp_path: Path):
    body = color_graph(PATCH, "", 'colorspace="ACES2065-1"').replace(
        "<output",
        '<constant name="d" type="color3"><input name="value" type="color3" interfacename="x" /></constant>'
        '<add name="both" type="color3"><input name="in1" type="color3" nodename="c" />'
        '<input name="in2" type="color3" nodename="d" /></add><output',
    )
    shown = body.replace('nodename="c" /></nodegraph>', 'nodename="both" /></nodegraph>')
    path = write(tmp_path, shown)
    with pytest.raises(MrmError, match=r"g/x is used in colour space .* and in another"):
        mrm_nodes.generate_shader(path, element="m")


LOBE = """
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial>"""
PHYSICS: dict[str, tuple[str, str]] = {
    "a film in microns": (
        '<mrm_conductor_bsdf name="b" type="BSDF"><input name="thinfilm_thickness" type="float" value="0.4" '
        'unit="micron" unittype="distance" /><input name="roughness" type="vector2" value="0.2, 0.2" />'
        "</mrm_conductor_bsdf>" + LOBE,
        "",
    ),
    "a roughness in centimetres, from a graph": (
        graph(CM, "")
        .replace(
            "<constant",
            '<dot name="t" type="float"><input name="in" type="float" '
            'interfacename="x" unit="centimeter" unittype="distance" /></dot><constant',
        )
        .replace(
            GRAY, '<convert name="c" type="vector2"><input name="in" type="float" nodename="k" /></convert>'
        )
        .replace('type="color3"', 'type="vector2"')
        + '<mrm_dielectric_bsdf name="b" type="BSDF"><input name="roughness" type="vector2" nodegraph="g" '
        'output="out" /></mrm_dielectric_bsdf>' + LOBE,
        "",
    ),
    "a colour in ACES2065-1": (
        f'<mrm_generalized_schlick_bsdf name="b" type="BSDF"><input name="color0" type="color3" '
        f'value="{triple(SPACES["ACES2065-1"])}" colorspace="ACES2065-1" /></mrm_generalized_schlick_bsdf>'
        + LOBE,
        "",
    ),
    "a whole surface, in a document in acescg": (
        '<mrm_standard_surface name="s" type="surfaceshader"><input name="base_color" type="color3" '
        'value="0.5, 0.4, 0.3" /><input name="specular_roughness" type="float" value="0.5" />'
        '<input name="specular_color" type="color3" value="0.5, 0.8, 0.9" colorspace="Linear Rec.2020" />'
        '<input name="thin_film_thickness" type="float" value="0" unit="nanometer" unittype="distance" />'
        "</mrm_standard_surface>" + LOBE[LOBE.index("<surfacematerial") :],
        'colorspace="acescg"',
    ),
}


@pytest.mark.parametrize("kind", PHYSICS)
def test_the_evaluator_reads_the_same_values(kind: str, tmp_path: Path):
    if not BACKENDS:
        pytest.skip("no backend works")
    body, attributes = PHYSICS[kind]
    (tmp_path / "a.mtlx").write_text(f'<materialx version="1.39" {attributes}>{body}</materialx>')
    (case,) = load(tmp_path).cases
    outcome = Worker(BACKENDS[0]).run(replace(case, size=(48, 48)), tmp_path / "report")
    assert (outcome.message, outcome.truth, outcome.verdict) == ("", "physics", "pass")
    assert outcome.figures is not None
    assert outcome.figures.lit > 500
