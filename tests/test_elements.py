"""What of a document counts is what the element that is asked for is made of; and all of it has names that compile."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import mrm_nodes
from mrm_nodes import cycles, library
from mrm_nodes.documents import parse_document, read_document
from mrm_nodes.elements import find_renderable, used_by
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.regression.suites.suitefile import load
from mrm_nodes.shadergen import generate_shader, supported_targets

PRIVATE = (
    '<houdini_private_node name="x" type="color3">'
    '<input name="a" type="float" value="0,5" /></houdini_private_node>'
)
USED = '<input name="base_color" type="color3" {} />'


def written(folder: Path, *body: str) -> Path:
    file = folder / "a.mtlx"
    file.write_text(f'<materialx version="1.39">{"".join(body)}</materialx>')
    return file


def surface(*inputs: str, name: str = "s", material: str = "m", more: str = "") -> str:
    return (
        f'<standard_surface name="{name}" type="surfaceshader">{"".join(inputs)}</standard_surface>'
        f'<surfacematerial name="{material}" type="material">'
        f'<input name="surfaceshader" type="surfaceshader" nodename="{name}" />{more}</surfacematerial>'
    )


def fault_of(file: Path, **options: str) -> str:
    with pytest.raises(MrmError) as fault:
        generate_shader(file, **options)
    assert "\n" not in str(fault.value)
    return str(fault.value)


# --- what is not used stops nothing; what is used is named

OWN_NODE = '<nodedef name="ND_own" node="own"><output name="out" type="color3" /></nodedef>'
UNUSED = {
    "a node": PRIVATE,
    "a node in a graph": f'<nodegraph name="g">{PRIVATE}</nodegraph>',
    "a node beside the one that a graph gives": f'<nodegraph name="g">{PRIVATE}<constant name="c" type="color3" />'
    '<output name="out" type="color3" nodename="c" /></nodegraph>'
    + surface(USED.format('nodegraph="g" output="out"'), name="s2", material="m2"),
    "another material": PRIVATE + surface(USED.format('nodename="x"'), name="s2", material="m2"),
    "what makes a node that is not used": f'{OWN_NODE}<nodegraph name="NG_own" nodedef="ND_own">{PRIVATE}'
    '<output name="out" type="color3" nodename="x" /></nodegraph>',
    "a value": '<constant name="c" type="float"><input name="value" type="float" value="0,5" /></constant>',
    "an input": '<constant name="c" type="float"><input name="valeu" type="float" value="1" /></constant>',
    "a loose end": '<constant name="c" type="float"><input name="value" type="float" nodename="gone" /></constant>',
}


@pytest.mark.parametrize("body", UNUSED.values(), ids=UNUSED)
def test_what_the_element_does_not_use_stops_nothing(tmp_path: Path, body: str):
    alone = generate_shader(written(tmp_path, surface())).pixel
    assert generate_shader(written(tmp_path, body, surface()), element="m").pixel == alone


LEADS_THERE = {
    "directly": PRIVATE + surface(USED.format('nodename="x"')),
    "through a graph": f'<nodegraph name="g">{PRIVATE}<output name="out" type="color3" nodename="x" /></nodegraph>'
    + surface(USED.format('nodegraph="g" output="out"')),
    "through a graph's interface": PRIVATE + '<nodegraph name="g"><input name="i" type="color3" nodename="x" />'
    '<dot name="d" type="color3"><input name="in" type="color3" interfacename="i" /></dot>'
    '<output name="out" type="color3" nodename="d" /></nodegraph>'
    + surface(USED.format('nodegraph="g" output="out"')),
    "through what makes a node": f'{OWN_NODE}<nodegraph name="NG_own" nodedef="ND_own">{PRIVATE}'
    '<output name="out" type="color3" nodename="x" /></nodegraph><own name="o" type="color3" />'
    + surface(USED.format('nodename="o"')),
    "through another node": PRIVATE + '<dot name="d" type="color3"><input name="in" type="color3" nodename="x" /></dot>'
    + surface(USED.format('nodename="d"')),
}  # fmt: skip


@pytest.mark.parametrize("body", LEADS_THERE.values(), ids=LEADS_THERE)
def test_an_unknown_node_that_is_used_is_named_with_three_near_names(tmp_path: Path, body: str):
    message = fault_of(written(tmp_path, body), element="m")
    assert re.search(r"node (g/|NG_own/)?x: unknown node houdini_private_node; did you mean", message)
    assert message.count(" or ") == 2 and len(message) < 300 + len(str(tmp_path))


@pytest.mark.parametrize("shader", ["gone", "m"])
def test_a_material_whose_shader_is_not_there_is_named(tmp_path: Path, shader: str):
    end = surface()[surface().index("<surfacematerial") :].replace('nodename="s"', f'nodename="{shader}"')
    assert f"m/surfaceshader: connected to {shader}, which does not exist" in fault_of(written(tmp_path, end))


def test_of_very_many_elements_some_are_listed(tmp_path: Path):
    many = "".join(surface(name=f"s{n}", material=f"m{n}") for n in range(50))
    message = fault_of(written(tmp_path, many))
    assert "m0, m1" in message and message.endswith("m19 and 30 more")


def test_what_makes_a_node_for_another_target_may_be_unknown(tmp_path: Path):
    nodes = (
        f'{OWN_NODE}<nodegraph name="NG_own_osl" nodedef="ND_own" target="genosl">{PRIVATE}'
        '<output name="out" type="color3" nodename="x" /></nodegraph>'
        '<nodegraph name="NG_own" nodedef="ND_own"><constant name="c" type="color3" />'
        '<output name="out" type="color3" nodename="c" /></nodegraph><own name="o" type="color3" />'
    )
    file = written(tmp_path, nodes, surface(USED.format('nodename="o"')))
    assert generate_shader(file).pixel
    assert not load(tmp_path).cases[0].broken
    assert "unknown node houdini_private_node" in fault_of(file, target="osl")


def test_an_output_of_nothing_is_named(tmp_path: Path):
    assert "o: connected to gone" in fault_of(
        written(tmp_path, '<output name="o" type="float" nodename="gone" />')
    )


def test_what_an_element_uses_is_each_thing_once(tmp_path: Path):
    chain = "".join(
        f'<add name="a{n}" type="float"><input name="in1" type="float" nodename="a{n + 1}" />'
        f'<input name="in2" type="float" nodename="a{n + 1}" /></add>'
        for n in range(300)
    )
    file = written(tmp_path, chain, '<output name="out" type="float" nodename="a0" />')
    document = parse_document(file.read_bytes(), file)
    used = [each.getNamePath() for each in used_by([find_renderable(document, "", None)])]
    assert len(used) == len(set(used)) == 901


def test_what_a_library_s_surface_is_made_of_is_the_library_s(tmp_path: Path):
    whole = (
        '<mrm_standard_surface name="s" type="surfaceshader" />'
        '<surfacematerial name="m" type="material">'
        '<input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial>'
    )
    document = read_document(written(tmp_path, whole))
    for target in ("", "genglsl"):
        used = used_by([find_renderable(document, "", None)], target)
        assert [each.getNamePath() for each in used] == ["m", "m/surfaceshader", "s"]


# --- values that are none

EMPTY = {
    "a surface": '<input name="backsurfaceshader" type="surfaceshader" value="" />',
    "a displacement": '<input name="displacementshader" type="displacementshader" value="" />',
    "a node's name": '<input name="displacementshader" type="displacementshader" nodename="" />',
    "a graph's name": '<input name="displacementshader" type="displacementshader" nodegraph="" output="" />',
}


@pytest.mark.parametrize("target", supported_targets())
@pytest.mark.parametrize("empty", EMPTY.values(), ids=EMPTY)
def test_an_empty_text_where_a_node_could_be_is_nothing(tmp_path: Path, empty: str, target: str):
    alone = generate_shader(written(tmp_path, surface()), target).pixel
    assert generate_shader(written(tmp_path, surface(more=empty)), target).pixel == alone


@pytest.mark.parametrize("kind", ["BSDF", "EDF", "float"])
def test_an_empty_text_at_a_surface_s_input_is_nothing(tmp_path: Path, kind: str):
    name = {"BSDF": "bsdf", "EDF": "edf", "float": "opacity"}[kind]
    lit = '<surface name="s" type="surfaceshader">{}</surface>'
    end = surface()[surface().index("<surfacematerial") :]
    alone = generate_shader(written(tmp_path, lit.format(""), end), interface="reduced").pixel
    empty = f'<input name="{name}" type="{kind}" value="" />'
    assert generate_shader(written(tmp_path, lit.format(empty), end), interface="reduced").pixel == alone


def test_a_definition_s_own_inputs_have_no_value_and_stay(tmp_path: Path):
    definition = (
        '<nodedef name="ND_over" node="over"><input name="top" type="BSDF" /><input name="base" type="BSDF" value="" />'
        '<output name="out" type="BSDF" /></nodedef><nodegraph name="NG_over" nodedef="ND_over">'
        '<layer name="l" type="BSDF"><input name="top" type="BSDF" interfacename="top" />'
        '<input name="base" type="BSDF" interfacename="base" /></layer>'
        '<output name="out" type="BSDF" nodename="l" /></nodegraph>'
    )
    nodes = (
        '<dielectric_bsdf name="d" type="BSDF" /><conductor_bsdf name="c" type="BSDF" /><over name="o" type="BSDF">'
        '<input name="top" type="BSDF" nodename="d" /><input name="base" type="BSDF" nodename="c" /></over>'
        '<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="o" /></surface>'
    )
    code = generate_shader(written(tmp_path, definition, nodes), element="s").pixel
    assert "mx_dielectric_bsdf" in code and "mx_conductor_bsdf" in code


@pytest.mark.parametrize("text", ["0,5", "0.5f", "1 2", "1e", "--1", "0x10", "1_000", "infinity", "½"])
def test_a_number_that_is_none_is_refused_by_input_and_value(tmp_path: Path, text: str):
    file = written(tmp_path, surface(f'<input name="base" type="float" value="{text}" />'))
    assert fault_of(file) == f"{file}: s/base: {text} is not a finite number"


@pytest.mark.parametrize("text", ["0.5", ".5", "5.", " 1 ", "+1", "1e-3", "1E+2", "-0", "007"])
def test_a_number_in_any_form_that_materialx_reads_is_one(tmp_path: Path, text: str):
    assert generate_shader(
        written(tmp_path, surface(f'<input name="base" type="float" value="{text}" />'))
    ).pixel


@pytest.mark.parametrize("text", ["1,0.5,0", "1, 0.5, 0", "1 0.5 0", " 1,  0.5 ,0 "])
def test_numbers_are_parted_by_commas_or_spaces(tmp_path: Path, text: str):
    body = surface(f'<input name="base_color" type="color3" value="{text}" />')
    assert generate_shader(written(tmp_path, body)).pixel


def test_what_follows_one_of_several_numbers_is_left_out_with_a_warning(tmp_path: Path):
    file = written(tmp_path, surface('<input name="base_color" type="color3" value="0.1, 0.5.0, 1" />'))
    with pytest.warns(MrmWarning, match=r"s/base_color: 0\.5\.0 is read as 0\.5$"):
        assert generate_shader(file).pixel
    for text in ("0,1, 0,5, 0,2", "0.1, x, 0.2", "0.1, 0.2"):
        file = written(tmp_path, surface(f'<input name="base_color" type="color3" value="{text}" />'))
        assert f"s/base_color: {text} is not 3 finite numbers" in fault_of(file)


def test_a_whole_number_may_have_a_point_and_no_fraction(tmp_path: Path):
    def noise(text: str) -> Path:
        return written(
            tmp_path,
            f'<fractal3d name="f" type="float"><input name="octaves" type="integer" value="{text}" /></fractal3d>'
            '<output name="out" type="float" nodename="f" />',
        )

    assert generate_shader(noise("3.0")).pixel == generate_shader(noise("3")).pixel
    assert "f/octaves: 3.5 is not an integer" in fault_of(noise("3.5"))


# --- what MaterialX has beside nodes

TYPEDEF = (
    '<typedef name="pair"><member name="a" type="float" value="0.25" />'
    '<member name="b" type="float" value="0.5" /></typedef>'
)
BESIDE = {
    "a structure": TYPEDEF
    + '<constant name="p" type="pair"><input name="value" type="pair" value="{0.1;0.2}" /></constant>',
    "a structure on a graph": TYPEDEF
    + '<nodegraph name="g"><input name="p" type="pair" value="{0.1;0.2}" /></nodegraph>',
    "a look": '<look name="l"><materialassign name="a" material="m" geom="*" /><visibility name="v" /></look>',
    "a group of looks": '<look name="l" /><lookgroup name="lg" looks="l" default="l" />',
    "geometry": '<geominfo name="gi" geom="/a"><geomprop name="udimset" type="stringarray" value="1001,1002" />'
    '<token name="t" type="string" value="x" /></geominfo><geompropdef name="gp" type="float" geomprop="p" />',
    "a collection of itself": '<collection name="c" includegeom="/a" includecollection="c" />',
    "variants": '<variantset name="vs"><variant name="v"><input name="a" type="float" value="1" />'
    "</variant></variantset>",
    "a backdrop": '<backdrop name="b" contains="s, gone" width="1" height="1" />',
    "properties": '<propertyset name="ps"><property name="p" type="float" value="1" /></propertyset>',
    "a token": '<token name="t" type="string" value="x" />',
    "units and colour": '<unittypedef name="mass" /><unitdef name="u" unittype="mass">'
    '<unit name="g" scale="1" /></unitdef>',
    "attributes of others": '<attributedef name="ad" attrname="mine" type="float" value="1" '
    'elements="standard_surface" />',
    "comments of others": '<comment name="c1">text & text</comment>',
}


@pytest.mark.parametrize("body", BESIDE.values(), ids=BESIDE)
def test_what_is_no_part_of_the_element_is_read_and_left_alone(tmp_path: Path, body: str):
    alone = generate_shader(written(tmp_path, surface())).pixel
    read = generate_shader(written(tmp_path, body, surface()), element="m").pixel
    # Every generator writes down the types of its document.
    read = re.sub(r"struct pair\s*\{.*?\};", "", read, flags=re.DOTALL)
    assert read.split() == alone.split()


@pytest.mark.parametrize("target", supported_targets())
def test_a_structure_that_the_document_defines_is_generated(tmp_path: Path, target: str):
    """MaterialX's generators have to be told of a document's own types."""
    nodes = (
        '<nodedef name="ND_first" node="first"><input name="p" type="pair" value="{0.1;0.2}" />'
        '<output name="out" type="float" /></nodedef>'
        '<implementation name="IM_first" nodedef="ND_first" target="genglsl" sourcecode="{{p}}.a" />'
        '<implementation name="IM_first_osl" nodedef="ND_first" target="genosl" sourcecode="{{p}}.a" />'
        '<implementation name="IM_first_mdl" nodedef="ND_first" target="genmdl" sourcecode="{{p}}.a" />'
        '<first name="f" type="float"><input name="p" type="pair" value="{0.3;0.4}" /></first>'
        '<output name="out" type="float" nodename="f" />'
    )
    assert "pair" in generate_shader(written(tmp_path, TYPEDEF, nodes), target).pixel


# --- names that compile

DIGITS = """
<nodegraph name="2G"><input name="3c" type="color3" value="1, 0, 0" />
  <multiply name="4m" type="color3"><input name="in1" type="color3" interfacename="3c" /></multiply>
  <output name="5a" type="color3" nodename="4m" /><output name="6b" type="color3" nodename="4m" />
</nodegraph>
<nodedef name="ND_own" node="own">
  <input name="k" type="color3" value="1, 1, 1" /><output name="o" type="color3" />
</nodedef>
<nodegraph name="NG_own" nodedef="ND_own">
  <multiply name="7m" type="color3"><input name="in1" type="color3" interfacename="k" /></multiply>
  <output name="o" type="color3" nodename="7m" />
</nodegraph>
<own name="8/o" type="color3"><input name="k" type="color3" nodegraph="2G" output="6b" /></own>
<own name="n8_o" type="color3" />
"""


@pytest.mark.parametrize("target", supported_targets())
def test_names_that_begin_with_a_digit_or_have_a_slash_become_names_that_compile(tmp_path: Path, target: str):
    file = written(
        tmp_path, DIGITS, surface(USED.format('nodename="8/o"'), name="01_s", material="01/Default")
    )
    for element in ("01/Default", "2G/5a"):
        shader = generate_shader(file, target, element=element)
        code = re.sub(r"//.*", "", shader.pixel)
        assert not re.findall(r"(?<![\w.])\d\w*(?:_s|_o|_out|_in1|3c|4m|5a)\b", code)
        assert re.findall(r"\bn(?:01_s|4m|5a)", code)


def test_such_a_material_is_drawn_as_one_with_plain_names(tmp_path: Path):
    body = surface(USED.format('nodegraph="2G" output="5a"'), name="1/s", material="2 m")
    plain = body.replace("1/s", "s").replace("2 m", "m").replace('"2G"', '"G"').replace("5a", "a")
    graph = DIGITS[: DIGITS.index("<nodedef")]
    fair = (
        graph.replace('"2G"', '"G"')
        .replace("5a", "a")
        .replace("3c", "c")
        .replace("4m", "m")
        .replace("6b", "b")
    )
    drawn = [
        mrm_nodes.render(written(tmp_path, text), lights=["camera"], size=(16, 16)).image
        for text in (graph + body, fair + plain)
    ]
    assert drawn[0].max() > 0 and (drawn[0] == drawn[1]).all()


# --- the library


def test_the_library_is_looked_through_once_and_not_for_each_document(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    read_document(written(tmp_path, surface()))
    measured: list[str] = []
    measure = cycles._measure
    monkeypatch.setattr(cycles, "_measure", lambda name, *rest: measured.append(name) or measure(name, *rest))
    graph = '<nodegraph name="g"><standard_surface name="s" type="surfaceshader" /></nodegraph>'
    read_document(written(tmp_path, graph))
    assert set(measured) <= {"g", *(each.getName() for each in library.shared_library().getNodeGraphs())}
    assert len(measured) < 5


def test_a_graph_that_makes_a_library_s_node_of_that_node_is_found(tmp_path: Path):
    graph = (
        '<nodegraph name="NG_again" nodedef="ND_standard_surface_surfaceshader">'
        '<standard_surface name="s" type="surfaceshader" />'
        '<output name="out" type="surfaceshader" nodename="s" /></nodegraph>'
    )
    with pytest.raises(MrmError, match="NG_again: the graph of a node contains that node"):
        read_document(written(tmp_path, graph))
