"""Shader generation: every node for every target, and one clear line for every request that makes no sense."""

from __future__ import annotations

import os
import re
import warnings
from pathlib import Path

import MaterialX as mx
import pytest

import mrm_nodes
from mrm_nodes.documents import read_document
from mrm_nodes.elements import check_document
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.library import materials_path

NODES = ["mrm_conductor_bsdf", "mrm_dielectric_bsdf", "mrm_generalized_schlick_bsdf"]
TARGETS = ["glsl", "essl", "vulkan", "wgsl", "msl", "slang", "osl", "mdl"]
FUSED_TARGETS = ["glsl", "essl", "vulkan", "wgsl", "msl", "slang"]

SURFACE = """
  <surface name="shell" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="lobe" /></surface>
  <surfacematerial name="coated" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="shell" />
  </surfacematerial>"""


def lobe(inputs: str = "", node: str = "mrm_dielectric_bsdf") -> str:
    return f'<{node} name="lobe" type="BSDF">{inputs}</{node}>'


def value(name: str, type_: str, text: str) -> str:
    return f'<input name="{name}" type="{type_}" value="{text}" />'


def write(folder: Path, elements: str, surface: str = SURFACE) -> Path:
    """A .mtlx file of these elements, with a material that shows the one named lobe."""
    file = folder / "material.mtlx"
    file.write_text(f'<?xml version="1.0"?>\n<materialx version="1.39">{elements}{surface}\n</materialx>\n')
    return file


def document_of(elements: str) -> mx.Document:
    document = mx.createDocument()
    mx.readFromXmlString(
        document, f'<?xml version="1.0"?><materialx version="1.39">{elements}{SURFACE}</materialx>'
    )
    return document


def fault_of(file: object, **options: object) -> str:
    """The message of the error that generation ends in: one line that names the file."""
    with pytest.raises(MrmError) as error:
        mrm_nodes.generate_shader(file, **options)
    message = str(error.value)
    assert "\n" not in message
    return message


# --- what it generates


def test_every_target_of_materialx_is_known():
    assert set(mrm_nodes.supported_targets()) >= {"glsl", "essl", "vulkan", "msl", "osl", "mdl"}
    assert [target for target in TARGETS if target in mrm_nodes.supported_targets()] == (
        mrm_nodes.supported_targets()[: len(TARGETS)]
    )


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("node", NODES)
def test_every_node_generates_for_every_target(tmp_path: Path, node: str, target: str):
    if target not in mrm_nodes.supported_targets():
        pytest.skip(f"this MaterialX has no target {target}")
    shader = mrm_nodes.generate_shader(write(tmp_path, lobe(node=node)), target)
    assert (shader.target, shader.name) == (target, "coated")
    assert shader.pixel
    assert bool(shader.vertex) == (target not in ("osl", "mdl"))
    assert ("mrm_microfacet(" in shader.pixel) == (target in FUSED_TARGETS)


@pytest.mark.parametrize("target", TARGETS)
def test_the_three_nodes_share_one_shader_and_its_helpers_appear_once(target: str):
    if target not in mrm_nodes.supported_targets():
        pytest.skip(f"this MaterialX has no target {target}")
    inner = "".join(lobe(node=node).replace("lobe", f"part_{index}") for index, node in enumerate(NODES))
    sums = """
      <add name="sum" type="BSDF">
        <input name="in1" type="BSDF" nodename="part_0" /><input name="in2" type="BSDF" nodename="part_1" />
      </add>
      <add name="lobe" type="BSDF">
        <input name="in1" type="BSDF" nodename="sum" /><input name="in2" type="BSDF" nodename="part_2" />
      </add>"""
    shader = mrm_nodes.generate_shader(document_of(inner + sums), target)
    if target in FUSED_TARGETS:
        assert len(re.findall(r"^\s*void mrm_microfacet\(", shader.pixel, re.MULTILINE)) == 1


@pytest.mark.parametrize("environment", ["fis", "prefilter", "none"])
@pytest.mark.parametrize("interface", ["complete", "reduced"])
def test_every_option_generates(tmp_path: Path, environment: str, interface: str):
    file = write(tmp_path, lobe())
    shader = mrm_nodes.generate_shader(file, environment=environment, interface=interface, max_lights=2)
    assert ("uniform float lobe_retroreflectivity" in shader.pixel) == (interface == "complete")
    assert re.search(r"MAX_LIGHT_SOURCES 2\b", shader.pixel)


def test_a_document_generates_what_its_file_does(tmp_path: Path):
    elements = lobe(value("retroreflectivity", "float", "0.5"))
    document = document_of(elements)
    from_file = mrm_nodes.generate_shader(write(tmp_path, elements))
    assert mrm_nodes.generate_shader(document).pixel == from_file.pixel
    mrm_nodes.load_library(document)
    assert mrm_nodes.generate_shader(document).pixel == from_file.pixel


def test_the_same_file_generates_the_same_text_each_time():
    file = materials_path() / "number_plate.mtlx"
    assert mrm_nodes.generate_shader(file).pixel == mrm_nodes.generate_shader(file).pixel


@pytest.mark.parametrize("element", ["coated", "shell", "lobe"])
def test_a_material_a_shader_or_a_node_can_be_named(tmp_path: Path, element: str):
    assert mrm_nodes.generate_shader(write(tmp_path, lobe()), element=element).name == element


def test_an_output_of_a_graph_can_be_named():
    file = materials_path() / "traffic_cone.mtlx"
    shader = mrm_nodes.generate_shader(file, element="NG_traffic_cone/retroreflectivity")
    assert shader.name == "NG_traffic_cone_retroreflectivity"
    assert "mrm_microfacet" not in shader.pixel


def test_a_file_with_several_materials_generates_the_one_that_is_named(tmp_path: Path):
    file = write(tmp_path, lobe(), SURFACE + SURFACE.replace("coated", "second").replace("shell", "shell2"))
    assert mrm_nodes.generate_shader(file, element="second").name == "second"


# --- what it refuses: the request


def test_a_missing_file_is_named(tmp_path: Path):
    assert fault_of(tmp_path / "absent.mtlx") == f"{tmp_path / 'absent.mtlx'}: no such file"


def test_a_folder_is_no_file(tmp_path: Path):
    assert fault_of(tmp_path).startswith(f"{tmp_path}: ")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        b"<a/>",
        bytes(range(256)),
        b'<?xml version="1.0"?><materialx version="1.39"><surface name=',
    ],
    ids=["empty", "no XML", "another XML", "binary", "truncated"],
)
def test_a_malformed_file_is_named(tmp_path: Path, content: bytes):
    file = tmp_path / "broken.mtlx"
    file.write_bytes(content)
    assert fault_of(file).startswith(f"{file}: not a MaterialX document: ")
    assert file.read_bytes() == content


def test_a_missing_include_is_named(tmp_path: Path):
    include = '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="absent.mtlx" />'
    assert "absent.mtlx" in fault_of(write(tmp_path, include + lobe()))


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read anything")
def test_a_file_that_may_not_be_read_is_named(tmp_path: Path):
    file = write(tmp_path, lobe())
    file.chmod(0)
    assert fault_of(file).startswith(f"{file}: ")


def test_an_unknown_target_gets_a_suggestion(tmp_path: Path):
    assert "unknown target glslx; did you mean glsl" in fault_of(write(tmp_path, lobe()), target="glslx")


@pytest.mark.parametrize("option", ["environment", "interface"])
def test_an_unknown_option_lists_those_there_are(tmp_path: Path, option: str):
    message = fault_of(write(tmp_path, lobe()), **{option: "xyz"})
    assert message.startswith(f"unknown {option} xyz; known: ")


def test_a_negative_number_of_lights_is_refused(tmp_path: Path):
    assert "max_lights -1" in fault_of(write(tmp_path, lobe()), max_lights=-1)


@pytest.mark.parametrize("element", ["coted", "lobe/ior", "coated/absent", ""])
def test_an_unknown_element_is_answered_with_those_there_are(tmp_path: Path, element: str):
    message = fault_of(write(tmp_path, lobe()), element=element)
    assert f"unknown element {element}; " in message
    assert "coated" in message


def test_an_element_that_is_no_shader_is_refused(tmp_path: Path):
    file = write(tmp_path, lobe())
    assert fault_of(file, element="ND_mrm_dielectric_bsdf").startswith(f"{file}: ")


def test_of_several_materials_one_must_be_named(tmp_path: Path):
    file = write(tmp_path, lobe(), SURFACE + SURFACE.replace("coated", "second").replace("shell", "shell2"))
    message = fault_of(file)
    assert "name one with --element: " in message
    assert "coated" in message and "second" in message


def test_a_file_with_nothing_to_render_says_so(tmp_path: Path):
    assert "nothing to render" in fault_of(write(tmp_path, "", surface=""))


# --- what it refuses: the document

GRAPH = """
  <nodegraph name="pattern">
    <input name="strength" type="float" value="{value}" />
    <multiply name="product" type="float"><input name="in1" type="float" interfacename="strength" /></multiply>
    <output name="out" type="float" nodename="product" />
  </nodegraph>"""
DRIVEN = '<input name="retroreflectivity" type="float" nodegraph="pattern" output="out" />'


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e400", "none"])
def test_a_value_that_is_no_number_is_refused(tmp_path: Path, text: str):
    file = write(tmp_path, lobe(value("ior", "float", text)))
    assert fault_of(file) == f"{file}: lobe/ior: {text} is not a finite number"


@pytest.mark.parametrize("text", ["nan, 0.1", "0.1", "0.1, x"])
def test_a_pair_needs_two_numbers(tmp_path: Path, text: str):
    message = fault_of(write(tmp_path, lobe(value("roughness", "vector2", text))))
    assert f"lobe/roughness: {text} is not 2 finite numbers" in message


def test_nan_on_a_graph_s_interface_is_refused(tmp_path: Path):
    message = fault_of(write(tmp_path, GRAPH.format(value="nan") + lobe(DRIVEN)))
    assert "pattern/strength: nan is not a finite number" in message


def test_a_misspelt_node_gets_a_suggestion(tmp_path: Path):
    message = fault_of(write(tmp_path, lobe(node="mrm_dielectrc_bsdf")))
    assert "node lobe: unknown node mrm_dielectrc_bsdf; did you mean mrm_dielectric_bsdf" in message


def test_a_misspelt_input_gets_a_suggestion(tmp_path: Path):
    message = fault_of(write(tmp_path, lobe(value("retroreflectivty", "float", "1"))))
    assert "unknown input retroreflectivty; did you mean retroreflectivity" in message


def test_the_boolean_of_materialx_s_own_node_is_no_input_of_ours(tmp_path: Path):
    message = fault_of(write(tmp_path, lobe(value("retroreflective", "boolean", "true"))))
    assert "unknown input retroreflective; did you mean retroreflectivity" in message


def test_an_input_of_another_type_is_named(tmp_path: Path):
    message = fault_of(write(tmp_path, lobe(value("retroreflectivity", "color3", "1, 1, 1"))))
    assert "input retroreflectivity has type color3, not float" in message


def test_a_misspelt_choice_gets_a_suggestion(tmp_path: Path):
    message = fault_of(write(tmp_path, lobe(value("distribution", "string", "gxx"))))
    assert "lobe/distribution: unknown value gxx; did you mean ggx" in message


@pytest.mark.parametrize(
    "connection",
    [
        'nodename="absent"',
        'nodegraph="absent" output="out"',
        'nodegraph="pattern" output="absent"',
        'nodename="red"',
    ],
    ids=["no such node", "no such graph", "no such output", "another type"],
)
def test_a_loose_connection_is_refused(tmp_path: Path, connection: str):
    elements = GRAPH.format(value="1") + '<constant name="red" type="color3" />'
    message = fault_of(
        write(tmp_path, elements + lobe(f'<input name="retroreflectivity" type="float" {connection} />'))
    )
    assert "lobe/retroreflectivity: connected to " in message


def test_a_circle_of_nodes_is_refused(tmp_path: Path):
    circle = "".join(
        f'<multiply name="{a}" type="float"><input name="in1" type="float" nodename="{b}" /></multiply>'
        for a, b in (("egg", "hen"), ("hen", "egg"))
    )
    message = fault_of(
        write(tmp_path, circle + lobe('<input name="retroreflectivity" type="float" nodename="hen" />'))
    )
    assert "cycle" in message


def test_a_fault_in_a_document_without_a_file_is_named_too():
    assert fault_of(document_of(lobe(value("ior", "float", "nan")))).startswith("document: lobe/ior: ")


# --- what it warns of


@pytest.mark.parametrize(
    ("name", "type_", "text"),
    [
        ("retroreflectivity", "float", "1.5"),
        ("retroreflectivity", "float", "-0.1"),
        ("roughness", "vector2", "0.1, 2"),
        ("roughness", "vector2", "0, 0.1"),
        ("tint", "color3", "1, -1, 1"),
    ],
)
def test_a_value_that_the_node_clamps_is_a_warning(tmp_path: Path, name: str, type_: str, text: str):
    file = write(tmp_path, lobe(value(name, type_, text)))
    with pytest.warns(MrmWarning, match=re.escape(f"{file}: lobe/{name}: {text} is clamped to its range")):
        assert mrm_nodes.generate_shader(file).pixel


def test_a_clamped_value_on_a_graph_s_interface_is_a_warning(tmp_path: Path):
    graph = f"""
      <nodegraph name="coat">
        <input name="share" type="float" value="3" />
        {lobe('<input name="retroreflectivity" type="float" interfacename="share" />')}
        <output name="out" type="BSDF" nodename="lobe" />
      </nodegraph>"""
    surface = SURFACE.replace('nodename="lobe"', 'nodegraph="coat" output="out"')
    with pytest.warns(MrmWarning, match="coat/lobe/retroreflectivity: 3 is clamped"):
        mrm_nodes.generate_shader(write(tmp_path, graph, surface))


@pytest.mark.parametrize("file", sorted(materials_path().glob("*.mtlx")), ids=lambda file: file.stem)
def test_a_sound_file_passes_without_a_word(file: Path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_document(read_document(file), str(file))


def test_what_materialx_can_live_with_is_no_fault(tmp_path: Path):
    """A value beside a connection, an empty value, a node that nothing uses: exporters write them."""
    elements = '<constant name="glass" type="float" /><constant name="unused" type="color3" />' + lobe(
        '<input name="ior" type="float" nodename="glass" value="1.4" />' + value("weight", "float", "")
    )
    assert mrm_nodes.generate_shader(write(tmp_path, elements)).pixel


def test_an_image_tagged_srgb_is_decoded() -> None:
    document = mx.createDocument()
    image = document.addNode("image", "image", "color3")
    file = image.addInput("file", "filename")
    file.setValueString("any.png")
    file.setColorSpace("srgb_texture")
    emission = document.addNode("uniform_edf", "emission", "EDF")
    emission.addInput("color", "color3").setNodeName("image")
    surface = document.addNode("surface", "surface", "surfaceshader")
    surface.addInput("edf", "EDF").setNodeName("emission")
    material = document.addNode("surfacematerial", "material", "material")
    material.addInput("surfaceshader", "surfaceshader").setNodeName("surface")
    assert "srgb_texture_to_lin_rec709" in mrm_nodes.generate_shader(document).pixel
