"""Alpha masks are cut out and opacity is blended as MaterialX's viewer does; what is not drawn is named."""

import warnings
from dataclasses import replace
from pathlib import Path

import MaterialX as mx
import numpy as np
import pytest
from gltf_writer import SQUARE, write_glb

from mrm_nodes import shadergen
from mrm_nodes.errors import MrmWarning
from mrm_nodes.regression.cases.material_case import MaterialCase, _Bench
from mrm_nodes.regression.cases.workshop import Workshop
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.verdict.outcome import Outcome
from mrm_nodes.render import BACKENDS, Camera, DirectionalLight, load_mesh, plane, render, sphere
from mrm_nodes.render.environment import find_environment
from mrm_nodes.shadergen import generate_shader, supported_targets

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"
FRONT = Camera((0.5, 0.5, 3.0), (0.5, 0.5, 0.0))
LIGHTS = (DirectionalLight((0.2, -0.1, -1.0)),)
VERTEX_COLOR = '<geomcolor name="c" type="color4"/>'
VERTEX_ALPHA = (
    VERTEX_COLOR
    + """
  <extract name="a" type="float">
    <input name="in" type="color4" nodename="c"/><input name="index" type="integer" value="3"/>
  </extract>
  <convert name="rgb" type="color3"><input name="in" type="color4" nodename="c"/></convert>"""
)


FIRST, LAST = BACKENDS[0], BACKENDS[-1]


@pytest.fixture(scope="module", params=BACKENDS)
def renderer(request):
    from test_render_gl import renderer_of

    return renderer_of(request.param)


def document(nodes, surface="s"):
    doc = mx.createDocument()
    material = f"""<surfacematerial name="m" type="material">
      <input name="surfaceshader" type="surfaceshader" nodename="{surface}"/></surfacematerial>"""
    mx.readFromXmlString(doc, f'<?xml version="1.0"?><materialx version="1.39">{nodes}{material}</materialx>')
    return doc


def surface(category, *inputs):
    """A surface node; inputs are `name=value` or `name<node`, with their types."""
    lines = []
    for kind, text in inputs:
        name, mark, value = text.partition("<") if "<" in text else text.partition("=")
        given = f'nodename="{value}"' if mark == "<" else f'value="{value}"'
        lines.append(f'<input name="{name}" type="{kind}" {given}/>')
    return f'<{category} name="s" type="surfaceshader">{"".join(lines)}</{category}>'


def two_squares(path, front, back, order=1):
    """Two squares, the first nearer, each of its own vertex colours (r, g, b, a)."""
    shapes = [
        SQUARE | {"COLOR_0": [front] * 4},
        SQUARE | {"POSITION": [(x, y, -0.5) for x, y, _ in SQUARE["POSITION"]], "COLOR_0": [back] * 4},
    ]
    write_glb(path, [shapes[::order]])
    return load_mesh(path)


MASKED = {
    "gltf_pbr": surface(
        "gltf_pbr",
        ("color3", "base_color<rgb"),
        ("float", "alpha<a"),
        ("integer", "alpha_mode=1"),
        ("float", "alpha_cutoff=0.5"),
    ),
    "mrm_gltf_pbr": surface(
        "mrm_gltf_pbr",
        ("color3", "base_color<rgb"),
        ("float", "alpha<a"),
        ("integer", "alpha_mode=1"),
        ("float", "alpha_cutoff=0.5"),
    ),
    "UsdPreviewSurface": surface(
        "UsdPreviewSurface",
        ("color3", "diffuseColor<rgb"),
        ("float", "opacity<a"),
        ("float", "opacityThreshold=0.5"),
    ),
}


@pytest.mark.parametrize("name", MASKED)
@pytest.mark.parametrize("order", [1, -1])
def test_an_alpha_mask_is_cut_out_of_everything(renderer, tmp_path, name, order):
    shader = generate_shader(document(VERTEX_ALPHA + MASKED[name]), interface="reduced")
    solid = two_squares(tmp_path / "solid.glb", (1, 0, 0, 0.6), (0, 1, 0, 1), order)
    holed = two_squares(tmp_path / "holed.glb", (1, 0, 0, 0.4), (0, 1, 0, 1), order)
    gone = two_squares(tmp_path / "gone.glb", (1, 0, 0, 0.4), (0, 1, 0, 0.1), order)
    seen, through, nothing = (
        renderer.render(shader, mesh, FRONT, LIGHTS, size=(9, 9)) for mesh in (solid, holed, gone)
    )
    assert seen.position[4, 4, 2] == 0.0 and through.position[4, 4, 2] == -0.5
    assert seen.image[4, 4, 0] > 2 * seen.image[4, 4, 1]
    assert through.image[4, 4, 1] > 2 * through.image[4, 4, 0]
    np.testing.assert_allclose(through.normal[4, 4], (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose(through.texcoord[4, 4], (0.5, 0.5), atol=0.05)
    assert not nothing.mask.any()
    for data in (nothing.image, nothing.position, nothing.normal, nothing.tangent, nothing.texcoord):
        assert not data.any()


# Every surface's own input for it.
OPACITIES = {
    "standard_surface": ("color3", "opacity<aaa"),
    "open_pbr_surface": ("float", "geometry_opacity<a"),
    "mrm_open_pbr_surface": ("float", "geometry_opacity<a"),
    "gltf_pbr": ("float", "alpha<a"),
    "surface_unlit": ("float", "opacity<a"),
}


# A driver blends what it is given: how each surface has it, one driver tells.
@pytest.mark.parametrize(
    ("renderer", "category"),
    [*((FIRST, each) for each in OPACITIES), (LAST, "gltf_pbr"), (LAST, "surface_unlit")],
    indirect=["renderer"],
)
def test_opacity_is_blended_as_the_viewer_does(renderer, tmp_path, category):
    grey = '<convert name="aaa" type="color3"><input name="in" type="float" nodename="a"/></convert>'
    blended = [("integer", "alpha_mode=2")] if category == "gltf_pbr" else []
    written = document(VERTEX_ALPHA + grey + surface(category, OPACITIES[category], *blended))
    shader = generate_shader(written, interface="reduced")
    pictures = {}
    for opacity in (0.0, 0.25, 1.0):
        write_glb(tmp_path / "m.glb", [[SQUARE | {"COLOR_0": [(1, 1, 1, opacity)] * 4}]])
        mesh = load_mesh(tmp_path / "m.glb")
        pictures[opacity] = renderer.render(shader, mesh, FRONT, LIGHTS, size=(9, 9))
    assert not pictures[0.0].mask.any() and not pictures[0.0].image.any()
    assert pictures[1.0].image[4, 4].min() > 0.0
    # Over black: MaterialX's surface is dimmed by its opacity, and blending dims it again.
    alpha = 1.0 - 0.9999 * 0.75
    expected = pictures[1.0].image * 0.25 * alpha
    np.testing.assert_allclose(pictures[0.25].image[4, 4], expected[4, 4], rtol=1e-5)
    for name in ("position", "normal", "tangent", "texcoord", "mask"):
        np.testing.assert_array_equal(getattr(pictures[0.25], name), getattr(pictures[1.0], name))


@pytest.mark.parametrize("order", [1, -1])
def test_what_is_opaque_is_drawn_first_and_shines_through(renderer, tmp_path, order):
    unlit = surface("surface_unlit", ("color3", "emission_color<rgb"), ("float", "opacity<a"))
    shader = generate_shader(document(VERTEX_ALPHA + unlit))
    mesh = two_squares(tmp_path / "m.glb", (1, 0, 0, 0.25), (0, 1, 0, 1), order)
    drawn = renderer.render(shader, mesh, FRONT, size=(9, 9))
    alpha = 1.0 - 0.9999 * 0.75
    np.testing.assert_allclose(drawn.image[4, 4], (0.25 * alpha, 1.0 - alpha, 0.0), atol=1e-6)
    assert drawn.position[4, 4, 2] == 0.0
    # Behind what is opaque, it is not seen.
    mesh = two_squares(tmp_path / "m.glb", (0, 1, 0, 1), (1, 0, 0, 0.25), order)
    drawn = renderer.render(shader, mesh, FRONT, size=(9, 9))
    np.testing.assert_array_equal(drawn.image[4, 4], (0.0, 1.0, 0.0))


@pytest.mark.parametrize(
    ("renderer", "category"), [(FIRST, "UsdPreviewSurface"), (LAST, "gltf_pbr")], indirect=["renderer"]
)
def test_the_code_for_transparency_changes_no_bit_of_an_opaque_surface(renderer, monkeypatch, category):
    environment = find_environment("studio", samples=4)
    pictures = []
    for transparent in (True, False):
        monkeypatch.setattr(shadergen, "may_be_transparent", lambda *_, answer=transparent: answer)
        shader = generate_shader(document(surface(category)), interface="reduced")
        assert ("u_alphaThreshold" in shader.pixel) == transparent
        pictures.append(renderer.render(shader, sphere(), None, LIGHTS, (33, 33), environment=environment))
    for name in ("image", "position", "normal", "tangent", "texcoord", "mask"):
        np.testing.assert_array_equal(getattr(pictures[0], name), getattr(pictures[1], name))
    assert pictures[0].image.any()


def test_an_opaque_surface_has_no_code_for_transparency():
    for category in ("standard_surface", "open_pbr_surface", "mrm_open_pbr_surface"):
        assert "discard" not in generate_shader(document(surface(category))).pixel


UNLIT = ("color3", "emission_color=0.9, 0.6, 0.3")


def test_blending_is_over_when_the_next_thing_is_drawn(renderer):
    opaque = generate_shader(document(surface("surface_unlit", UNLIT)))
    glass = generate_shader(document(surface("surface_unlit", UNLIT, ("float", "opacity=0.5"))))
    first, second, third, fourth = (
        renderer.render(shader, sphere(), None, LIGHTS, (17, 17)) for shader in (opaque, glass, opaque, glass)
    )
    np.testing.assert_array_equal(first.image, third.image)
    np.testing.assert_array_equal(second.image, fourth.image)
    assert second.image.any() and first.image.max() > second.image.max()


@pytest.mark.parametrize("name", ["s/opacity", "s_opacity"])
def test_an_opacity_that_a_uniform_sets_is_blended(renderer, name):
    written = document(surface("surface_unlit", UNLIT, ("float", "opacity=0.25")))
    expected = renderer.render(generate_shader(written), plane(), None, size=(9, 9))
    opaque = document(surface("surface_unlit", UNLIT))
    given = generate_shader(opaque, varying=[name])
    drawn = renderer.render(given, plane(), None, size=(9, 9), uniforms={name: 0.25})
    np.testing.assert_array_equal(drawn.image, expected.image)
    np.testing.assert_array_equal(
        render(opaque, "plane", size=(9, 9), uniforms={name: 0.25}, backend=renderer.backend).image,
        expected.image,
    )
    assert "discard" not in generate_shader(opaque, varying=["s/emission"]).pixel


def test_every_point_of_a_cloud_is_drawn(renderer):
    shader = generate_shader(document(VERTEX_ALPHA + MASKED["gltf_pbr"]), interface="reduced")
    points = {"position": [(0, 0, 0)] * 2, "normal": [(0, 0, 1)] * 2, "tangent": [(1, 0, 0)] * 2}
    points["color_0"] = [(1, 1, 1, 0), (1, 1, 1, 1)]
    arrays = {name: np.array(data, np.float32) for name, data in points.items()}
    drawn = renderer.draw_points(shader, arrays, (0.3, 0.2, 3.0), LIGHTS)
    np.testing.assert_array_equal(drawn["normal"], arrays["normal"])
    assert drawn["image"][1].any() and not drawn["image"][0].any()


@pytest.mark.parametrize("target", [name for name in supported_targets() if name not in ("osl", "mdl")])
def test_every_target_of_hardware_discards(target):
    masked = surface("gltf_pbr", ("float", "alpha=0.5"), ("integer", "alpha_mode=1"))
    assert "discard" in generate_shader(document(masked), target).pixel


# Physics ----------------------------------------------------------------------------------------------

PHYSICAL = (
    VERTEX_ALPHA
    + """
  <ifgreatereq name="cut" type="float">
    <input name="value1" type="float" nodename="a"/><input name="value2" type="float" value="0.5"/>
    <input name="in1" type="float" value="1"/><input name="in2" type="float" value="0"/>
  </ifgreatereq>
  <oren_nayar_diffuse_bsdf name="b" type="BSDF">
    <input name="color" type="color3" nodename="rgb"/>
  </oren_nayar_diffuse_bsdf>
  <surface name="s" type="surfaceshader">
    <input name="bsdf" type="BSDF" nodename="b"/><input name="opacity" type="float" nodename="cut"/>
  </surface>"""
)


def case_of(folder, nodes, **more):
    (folder / "m.mtlx").write_text(mx.writeToXmlString(document(nodes)))
    return MaterialCase(
        name="case",
        root=folder,
        material="m.mtlx",
        element="m",
        truth="physics",
        reason="",
        lights=LIGHTS,
        size=(17, 17),
        depends=("m.mtlx",),
        **more,
    )


@pytest.mark.parametrize("order", [1, -1])
def test_physics_sees_through_the_holes_of_a_mask(renderer, tmp_path, order):
    two_squares(tmp_path / "m.glb", (0.8, 0.1, 0.1, 0.2), (0.1, 0.8, 0.1, 1), order)
    outcome = Worker(renderer.backend).run(case_of(tmp_path, PHYSICAL, mesh="m.glb", camera=FRONT), tmp_path)
    assert outcome.verdict == "pass", outcome.message
    assert outcome.figures.lit > 20


def test_physics_has_no_word_on_what_is_half_transparent(renderer, tmp_path):
    two_squares(tmp_path / "m.glb", (0.8, 0.1, 0.1, 1), (0.1, 0.8, 0.1, 1))
    half = PHYSICAL.replace('name="in1" type="float" value="1"', 'name="in1" type="float" value="0.5"')
    outcome = Worker(renderer.backend).run(case_of(tmp_path, half, mesh="m.glb", camera=FRONT), tmp_path)
    assert outcome.verdict == "error" and "opacity is not 1 everywhere" in outcome.message


@pytest.mark.parametrize("first", [0.25, 1.0])
def test_cases_of_one_shader_are_what_each_is_alone(renderer, tmp_path, first):
    """Opacity is a uniform: whether the surface is transparent is not decided by the case that comes first."""
    case = case_of(tmp_path, surface("surface_unlit", UNLIT))
    workshop = Workshop(renderer.backend)
    drawn = {}
    for opacity in (first, 1.25 - first):
        each = replace(case, inputs={"s/opacity": opacity})
        bench = _Bench(each, workshop, Outcome("case", "m", renderer.backend, "error"))
        drawn[opacity] = bench.render(bench.shader("m")).image
    for opacity, image in drawn.items():
        shader = generate_shader(document(surface("surface_unlit", UNLIT, ("float", f"opacity={opacity}"))))
        alone = renderer.render(shader, sphere(), case.camera, LIGHTS, case.size)
        np.testing.assert_array_equal(image, alone.image)


# What is not drawn ------------------------------------------------------------------------------------

DISPLACED = (
    surface("standard_surface")
    + """
  <displacement name="d" type="displacementshader">
    <input name="displacement" type="float" value="0.3"/>
  </displacement>
  <surfacematerial name="m" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="s"/>
    <input name="{0}" type="{1}" {2}/>
  </surfacematerial>"""
)


@pytest.mark.parametrize(
    ("name", "kind", "given", "message"),
    [
        ("displacementshader", "displacementshader", 'nodename="d"', "m: its displacement is not drawn"),
        ("backsurfaceshader", "surfaceshader", 'nodename="s"', "m: its backsurface is not drawn"),
        ("displacementshader", "displacementshader", 'value=""', None),
    ],
)
@pytest.mark.parametrize("target", ["glsl", "osl"])
def test_what_a_material_has_beside_its_surface_is_named(name, kind, given, message, target):
    doc = mx.createDocument()
    text = DISPLACED.format(name, kind, given)
    mx.readFromXmlString(doc, f'<?xml version="1.0"?><materialx version="1.39">{text}</materialx>')
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        generate_shader(doc, target)
    texts = [str(each.message) for each in caught if issubclass(each.category, MrmWarning)]
    assert texts == ([f"document: {message}"] if message else [])


@pytest.mark.skipif(not CASES.is_dir(), reason="the shared cases are not here")
def test_the_shared_cases_are_cut_out_or_named(renderer):
    masked = generate_shader(CASES / "doc" / "gltf_mask.mtlx", interface="reduced")
    assert not renderer.render(masked, sphere(), None, LIGHTS, (9, 9)).mask.any()
    with pytest.warns(MrmWarning, match=r"displacement\.mtlx: m: its displacement is not drawn"):
        generate_shader(CASES / "doc" / "displacement.mtlx")
    masked = generate_shader(document(VERTEX_ALPHA + MASKED["gltf_pbr"]), interface="reduced")
    mesh = load_mesh(CASES / "alphamask_vcol.glb")
    assert not renderer.render(masked, mesh, None, LIGHTS, (9, 9)).mask.any()
