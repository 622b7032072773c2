"""No closure is lost in any target: what is layered over what, read from the generated code."""

from __future__ import annotations

from pathlib import Path

import MaterialX as mx
import pytest
from closure_stacks import Stacks, stacks

from mrm_nodes import cli, library, limits, mdl, shadergen
from mrm_nodes.surfaces import known_surfaces

TARGETS = shadergen.supported_targets()
LOST = "Only the top BSDF"


def document(nodes: str, bsdf: str = "total", before: str = "") -> mx.Document:
    """A material whose surface shows one BSDF."""
    doc = mx.createDocument()
    text = f"""<materialx version="1.39">{before}{nodes}
      <surface name="shader" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="{bsdf}" /></surface>
      <surfacematerial name="material" type="material">
        <input name="surfaceshader" type="surfaceshader" nodename="shader" />
      </surfacematerial>
    </materialx>"""
    mx.readFromXmlString(doc, text)
    doc.setDataLibrary(library.shared_library())
    return doc


def surface(category: str) -> mx.Document:
    doc = mx.createDocument()
    doc.setDataLibrary(library.shared_library())
    shader = doc.addNode(category, "shader", "surfaceshader")
    material = doc.addNode("surfacematerial", "material", "material")
    material.addInput("surfaceshader", "surfaceshader").setConnectedNode(shader)
    return doc


def generated(doc: mx.Document, target: str, element: str | None = None) -> Stacks:
    source = shadergen.generate_shader(doc, target, element).pixel
    assert LOST not in source
    found = stacks(source, target)
    assert found, "no closure was read"
    return found


def node(category: str, name: str, **inputs: str) -> str:
    """A BSDF; an input is a number, a colour, or the name of a node with a type before it: `BSDF:metal`."""
    parts = []
    for key, value in inputs.items():
        kind, _, source = value.rpartition(":")
        if kind in ("BSDF", "VDF"):
            parts.append(f'<input name="{key}" type="{kind}" nodename="{source}" />')
        else:
            parts.append(f'<input name="{key}" type="{kind or "float"}" value="{source}" />')
    return f'<{category} name="{name}" type="BSDF">{"".join(parts)}</{category}>'


OURS = node("mrm_dielectric_bsdf", "retro", retroreflectivity="0.5", roughness="vector2:0.1, 0.1")
SCHLICK = node("mrm_generalized_schlick_bsdf", "tape", retroreflectivity="0.5", color0="color3:0.2, 0.2, 0.2")
METAL = node("mrm_conductor_bsdf", "metal", retroreflectivity="0.5")
SHEEN = node("sheen_bsdf", "sheen", weight="0.5")
GLASS = node("dielectric_bsdf", "glass")
PAINT = node("oren_nayar_diffuse_bsdf", "paint")
VOLUME = '<anisotropic_vdf name="volume" type="VDF" />'


def layer(name: str, top: str, base: str) -> str:
    return node("layer", name, top=f"BSDF:{top}", base=f"BSDF:{base}")


GRAPH = f"""<nodegraph name="inner">{OURS}{GLASS}
  {node("mix", "blend", fg="BSDF:retro", bg="BSDF:glass", mix="0.25")}
  <output name="out" type="BSDF" nodename="blend" /></nodegraph>"""

DEFINITION = f"""<nodedef name="ND_mine" node="mine">
    <input name="amount" type="float" value="0.3" />
    <input name="normal" type="vector3" defaultgeomprop="Nworld" />
    <output name="out" type="BSDF" /></nodedef>
  <nodegraph name="NG_mine" nodedef="ND_mine">{GLASS}
    <mrm_dielectric_bsdf name="retro" type="BSDF">
      <input name="retroreflectivity" type="float" interfacename="amount" />
      <input name="normal" type="vector3" interfacename="normal" />
    </mrm_dielectric_bsdf>
    {node("mix", "blend", fg="BSDF:retro", bg="BSDF:glass", mix="0.25")}
    <output name="out" type="BSDF" nodename="blend" /></nodegraph>"""

STACKING = """<nodedef name="ND_stack" node="stack">
    <input name="upper" type="BSDF" value="" /><input name="lower" type="BSDF" value="" />
    <output name="out" type="BSDF" /></nodedef>
  <nodegraph name="NG_stack" nodedef="ND_stack">
    <layer name="both" type="BSDF"><input name="top" type="BSDF" interfacename="upper" />
      <input name="base" type="BSDF" interfacename="lower" /></layer>
    <output name="out" type="BSDF" nodename="both" /></nodegraph>"""

SURFACE = f"""<nodedef name="ND_sign" node="sign">
    <input name="amount" type="float" value="0.3" /><output name="out" type="surfaceshader" /></nodedef>
  <nodegraph name="NG_sign" nodedef="ND_sign">{PAINT}
    <mrm_dielectric_bsdf name="retro" type="BSDF">
      <input name="retroreflectivity" type="float" interfacename="amount" /></mrm_dielectric_bsdf>
    {layer("total", "retro", "paint")}
    <surface name="made" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="total" /></surface>
    <output name="out" type="surfaceshader" nodename="made" /></nodegraph>
  <sign name="sign" type="surfaceshader" />
  <surfacematerial name="painted" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="sign" /></surfacematerial>"""

#: Graphs as people write them; each with the stacks that it has.
EXACT: dict[str, tuple[str, set[str]]] = {
    "our node over another": (OURS + PAINT + layer("total", "retro", "paint"), {"dielectric oren_nayar_diffuse"}),
    "generalized Schlick over another": (
        SCHLICK + PAINT + layer("total", "tape", "paint"),
        {"generalized_schlick oren_nayar_diffuse"},
    ),
    "a conductor lets nothing through": (METAL + PAINT + layer("total", "metal", "paint"), {"conductor"}),
    "our node below": (GLASS + METAL + layer("total", "glass", "metal"), {"dielectric conductor"}),
    "a mix on top": (
        OURS + SCHLICK + PAINT + node("mix", "both", fg="BSDF:retro", bg="BSDF:tape", mix="0.3")
        + layer("total", "both", "paint"),
        {"dielectric oren_nayar_diffuse", "generalized_schlick oren_nayar_diffuse"},
    ),
    "a mix of mixes on top": (
        OURS + SCHLICK + SHEEN + PAINT + node("mix", "both", fg="BSDF:retro", bg="BSDF:tape", mix="0.3")
        + node("mix", "three", fg="BSDF:both", bg="BSDF:sheen", mix="0.5") + layer("total", "three", "paint"),
        {
            "dielectric oren_nayar_diffuse",
            "generalized_schlick oren_nayar_diffuse",
            "sheen oren_nayar_diffuse",
        },
    ),
    "a mix with a metal on top": (
        OURS + METAL + PAINT + node("mix", "both", fg="BSDF:retro", bg="BSDF:metal", mix="0.3")
        + layer("total", "both", "paint"),
        {"dielectric oren_nayar_diffuse", "conductor"},
    ),
    "a mix inside the base": (
        OURS + METAL + PAINT + node("mix", "both", fg="BSDF:metal", bg="BSDF:paint", mix="0.3")
        + layer("total", "retro", "both"),
        {"dielectric oren_nayar_diffuse", "dielectric conductor"},
    ),
    "layers on top of layers": (
        OURS + SCHLICK + SHEEN + PAINT + layer("one", "sheen", "retro") + layer("two", "one", "tape")
        + layer("total", "two", "paint"),
        {"sheen dielectric generalized_schlick oren_nayar_diffuse"},
    ),
    "layers below layers": (
        OURS + SCHLICK + SHEEN + PAINT + layer("one", "tape", "paint") + layer("two", "retro", "one")
        + layer("total", "sheen", "two"),
        {"sheen dielectric generalized_schlick oren_nayar_diffuse"},
    ),
    "a base with two tops": (
        OURS + SCHLICK + PAINT + layer("one", "retro", "paint") + layer("two", "tape", "paint")
        + node("mix", "total", fg="BSDF:one", bg="BSDF:two", mix="0.5"),
        {"dielectric oren_nayar_diffuse", "generalized_schlick oren_nayar_diffuse"},
    ),
    "a factor on top": (
        OURS + PAINT + node("multiply", "half", in1="BSDF:retro", in2="0.5") + layer("total", "half", "paint"),
        {"dielectric oren_nayar_diffuse"},
    ),
    "a colour times a mix times a factor on top": (
        OURS + SHEEN + PAINT + node("mix", "both", fg="BSDF:retro", bg="BSDF:sheen", mix="0.5")
        + node("multiply", "half", in1="BSDF:both", in2="0.5")
        + node("multiply", "red", in1="BSDF:half", in2="color3:1, 0.1, 0.1") + layer("total", "red", "paint"),
        {"dielectric oren_nayar_diffuse", "sheen oren_nayar_diffuse"},
    ),
    "a sum below": (
        OURS + METAL + PAINT + node("add", "both", in1="BSDF:metal", in2="BSDF:paint")
        + layer("total", "retro", "both"),
        {"dielectric conductor", "dielectric oren_nayar_diffuse"},
    ),
    "over a volume, and that over another": (
        OURS + PAINT + VOLUME + node("layer", "filled", top="BSDF:retro", base="VDF:volume")
        + layer("total", "filled", "paint"),
        {"dielectric oren_nayar_diffuse"},
    ),
    "our node in a node graph": (
        GRAPH + PAINT + '<layer name="total" type="BSDF"><input name="top" type="BSDF" nodegraph="inner" '
        'output="out" /><input name="base" type="BSDF" nodename="paint" /></layer>',
        {"dielectric oren_nayar_diffuse"},
    ),
    "our node in a definition": (
        DEFINITION + PAINT + node("mine", "own", amount="0.7") + layer("total", "own", "paint"),
        {"dielectric oren_nayar_diffuse"},
    ),
}  # fmt: skip


def expected(texts: set[str]) -> Stacks:
    return frozenset(tuple(text.split()) for text in texts)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("own", known_surfaces())
def test_a_surface_of_ours_stacks_what_materialx_own_does(own: str, target: str) -> None:
    ours = generated(surface(known_surfaces()[own].name), target)
    # MaterialX's MDL generator may lose layers of its own surfaces, in older releases.
    assert ours == generated(surface(own), "glsl")
    assert max(map(len, ours)) >= 3


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("graph", EXACT)
def test_every_target_stacks_what_the_document_says(graph: str, target: str) -> None:
    nodes, texts = EXACT[graph]
    assert generated(document(nodes), target) == expected(texts)


@pytest.mark.parametrize("target", TARGETS)
def test_a_layer_inside_the_definition_of_a_surface_is_kept(target: str) -> None:
    doc = document(SURFACE + METAL, "metal")
    assert generated(doc, target, "painted") == expected({"dielectric oren_nayar_diffuse"})
    assert generated(doc, target, "material") == expected({"conductor"})


def test_half_a_layer_is_the_half_that_is_there() -> None:
    lone = '<layer name="total" type="BSDF"><input name="top" type="BSDF" nodename="retro" /></layer>'
    assert generated(document(OURS + lone), "mdl") == expected({"dielectric"})
    lone = lone.replace('"top"', '"base"')
    assert generated(document(OURS + lone), "mdl") == expected({"dielectric"})


def test_a_sum_that_lets_nothing_through_has_no_base() -> None:
    nodes = OURS + METAL + PAINT + node("add", "both", in1="BSDF:retro", in2="BSDF:metal")
    nodes += layer("total", "both", "paint")
    assert generated(document(nodes), "mdl") == expected({"dielectric", "conductor"})
    assert not any(message.startswith("both:") for message in ignored(nodes))


def test_a_definition_that_layers_what_it_is_given_keeps_it_all() -> None:
    nodes = STACKING + OURS + SCHLICK + PAINT + node("stack", "one", upper="BSDF:retro", lower="BSDF:tape")
    nodes += node("stack", "total", upper="BSDF:one", lower="BSDF:paint")
    assert generated(document(nodes), "mdl") == expected(
        {"dielectric generalized_schlick oren_nayar_diffuse"}
    )


def test_a_mix_of_one_shows_the_base_past_it() -> None:
    one = node("mix", "one", fg="BSDF:retro", mix="0.5")
    assert generated(document(OURS + PAINT + one + layer("total", "one", "paint")), "mdl") == expected(
        {"dielectric oren_nayar_diffuse", "oren_nayar_diffuse"}
    )


def test_the_document_and_the_library_stay_as_they_were() -> None:
    doc = document(EXACT["a mix on top"][0])
    before = mx.writeToXmlString(doc), mx.writeToXmlString(library.shared_library())
    shadergen.generate_shader(doc, "mdl")
    assert (mx.writeToXmlString(doc), mx.writeToXmlString(library.shared_library())) == before


def test_the_inputs_of_a_surface_keep_their_names_in_mdl() -> None:
    source = shadergen.generate_shader(surface("mrm_open_pbr_surface"), "mdl").pixel
    assert 'origin("shader/specular_retroreflectivity")' in source


# ---- what MDL draws in another way is named


def ignored(nodes: str) -> list[str]:
    return limits.ignored_inputs(document(nodes), "genmdl")


def test_a_sum_on_top_is_kept_as_two_layers_and_named() -> None:
    nodes = OURS + SHEEN + PAINT + node("add", "both", in1="BSDF:retro", in2="BSDF:sheen")
    nodes += layer("total", "both", "paint")
    assert generated(document(nodes), "mdl") == expected({"dielectric sheen oren_nayar_diffuse"})
    assert [message for message in ignored(nodes) if message.startswith("both:")] == [
        "both: in1 is drawn over in2: MDL has no base under a sum"
    ]


def test_a_factor_of_generalized_schlick_on_top_is_named() -> None:
    nodes = SCHLICK + PAINT + node("multiply", "half", in1="BSDF:tape", in2="0.5")
    nodes += layer("total", "half", "paint")
    assert generated(document(nodes), "mdl") == expected({"generalized_schlick oren_nayar_diffuse"})
    assert any("lets more light through" in message for message in ignored(nodes))


def test_nothing_is_named_where_mdl_draws_what_the_document_says() -> None:
    nodes = "".join((GLASS, SHEEN, PAINT, node("mix", "both", fg="BSDF:glass", bg="BSDF:sheen", mix="0.5")))
    assert ignored(nodes + layer("total", "both", "paint")) == []


# ---- whether MDL is retroreflective


MODULE = "mdl 1.10;\n// backscatter: not yet\n/* df::backscatter_reflect */\n"


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder on MDL's search path, for the module that generated code imports."""
    folder = tmp_path / "mdl" / "materialx"
    folder.mkdir(parents=True)
    monkeypatch.setenv("MDL_USER_PATH", str(folder.parent))
    return folder / f"{limits._mdl_module()}.mdl"


needs_the_switch = pytest.mark.skipif(
    "genmdl" in library.host().forward_targets, reason="this MaterialX has no retroreflective for MDL"
)


@needs_the_switch
def test_without_its_module_mdl_is_said_to_be_forward_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MDL_USER_PATH", raising=False)
    (message,) = ignored(OURS + "".join(layer("total", "retro", "retro")))
    assert message.startswith(
        "retro/retroreflectivity is ignored by genmdl: it renders the forward lobe only"
    )


@needs_the_switch
def test_a_module_without_backscatter_is_forward_only(modules: Path) -> None:
    modules.write_text(MODULE)
    (message,) = limits.ignored_inputs(document(OURS, "retro"), "genmdl")
    assert message.endswith(f"{modules} has no backscatter")
    assert limits.honoured_inputs(document(OURS, "retro"), "genmdl") == []


@needs_the_switch
def test_a_module_with_backscatter_is_retroreflective_and_generate_says_so(
    modules: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    modules.write_text("mdl 1.11;\nexport using .::pbrlib_1_7 import mx_dielectric_bsdf;\n")
    modules.with_name("pbrlib_1_7.mdl").write_text("mode: df::backscatter_reflect,")
    assert limits.ignored_inputs(document(OURS, "retro"), "genmdl") == []
    file = tmp_path / "sign.mtlx"
    mx.writeToXmlFile(document(OURS, "retro"), str(file))
    with pytest.raises(SystemExit) as exit_:
        cli.main(["generate", str(file), "--target", "mdl", "--strict", "-o", str(tmp_path / "out")])
    assert exit_.value.code == 0
    assert f"retro/retroreflectivity is drawn by genmdl: {modules} has backscatter" in capsys.readouterr().err


def test_a_weight_of_zero_is_not_talked_about(modules: Path) -> None:
    modules.write_text("backscatter")
    plain = node("mrm_dielectric_bsdf", "retro", retroreflectivity="0")
    assert limits.honoured_inputs(document(plain, "retro"), "genmdl") == []
    assert mdl.has_backscatter(modules)
