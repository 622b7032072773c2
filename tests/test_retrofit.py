"""Surfaces made retroreflective: the substitution, and what it refuses."""

from __future__ import annotations

import warnings

import MaterialX as mx
import pytest

import mrm_nodes
from mrm_nodes.errors import MrmError, MrmWarning
from mrm_nodes.substitution import SUBSTITUTES
from mrm_nodes.surfaces import known_surfaces, surface_documents

SURFACES = list(known_surfaces().values())
by_surface = pytest.mark.parametrize("surface", SURFACES, ids=lambda surface: surface.node)


@pytest.fixture(scope="module")
def library() -> mx.Document:
    return mrm_nodes.load_library()


@pytest.fixture
def bare() -> mx.Document:
    """MaterialX's libraries and our nodes, without the surfaces made by the substitution."""
    return mrm_nodes.load_library(surfaces=False)


def definition(document: mx.Document, node: str) -> mx.NodeDef:
    return document.getMatchingNodeDefs(node)[0]


def described(element: mx.Element, omit: tuple[str, ...] = ()) -> dict[str, str]:
    return {name: element.getAttribute(name) for name in element.getAttributeNames() if name not in omit}


@by_surface
def test_the_interface_is_the_original_one_and_one_float(library: mx.Document, surface) -> None:
    original, ours = definition(library, surface.node), definition(library, surface.name)
    names = [one.getName() for one in original.getActiveInputs()]
    names.insert(names.index(surface.after) + 1, surface.input)
    assert [one.getName() for one in ours.getActiveInputs()] == names
    for one in original.getActiveInputs():
        assert described(ours.getInput(one.getName())) == described(one)
    assert ours.getInheritString() == ""
    weight = ours.getInput(surface.input)
    assert (weight.getType(), weight.getValue(), weight.getIsUniform()) == ("float", 0.0, False)
    assert [described(o) for o in ours.getActiveOutputs()] == [
        described(o) for o in original.getActiveOutputs()
    ]


@by_surface
def test_only_the_base_specular_is_exchanged(library: mx.Document, surface) -> None:
    original = definition(library, surface.node).getImplementation()
    ours = definition(library, surface.name).getImplementation()
    assert [one.getName() for one in ours.getChildren()] == [one.getName() for one in original.getChildren()]
    for node in original.getNodes():
        twin = ours.getNode(node.getName())
        inputs = [described(one) for one in node.getInputs()]
        if node.getName() in surface.replace:
            assert twin.getCategory() == SUBSTITUTES[node.getCategory()]
            weight = twin.getInput("retroreflectivity")
            assert weight.getInterfaceName() == surface.input
            assert [described(one) for one in twin.getInputs() if one.getName() != weight.getName()] == inputs
        else:
            assert twin.getCategory() == node.getCategory()
            assert [described(one) for one in twin.getInputs()] == inputs


@by_surface
def test_no_reflective_lobe_is_left_behind(library: mx.Document, surface) -> None:
    graph = definition(library, surface.name).getImplementation()
    left = {node.getName() for node in graph.getNodes() if node.getCategory() in SUBSTITUTES}
    assert left == set(surface.keep)


def test_the_library_is_valid_with_its_surfaces(library: mx.Document) -> None:
    assert len(library.getMatchingNodeDefs("mrm_standard_surface")) == 2  # MaterialX has two versions of it
    assert library.validate() == (True, "")


def test_the_surfaces_can_be_left_out(bare: mx.Document) -> None:
    assert [surface.name for surface in SURFACES if bare.getMatchingNodeDefs(surface.name)] == []
    assert bare.getMatchingNodeDefs("mrm_conductor_bsdf")


@by_surface
@pytest.mark.parametrize("target", mrm_nodes.supported_targets())
def test_each_generates_for_every_target(surface, target: str) -> None:
    document = mx.createDocument()
    shader = document.addNode(surface.name, "shader", "surfaceshader")
    shader.addInput(surface.input, "float").setValue(0.5)
    document.addMaterialNode("material", shader)
    assert mrm_nodes.generate_shader(document, target).pixel


def test_a_copy_is_written_out_whole(bare: mx.Document) -> None:
    nodedef, graph = mrm_nodes.retrofit(bare, "standard_surface", "my_surface", "retro")
    assert nodedef.getName() == "ND_my_surface_surfaceshader"
    assert graph.getName() == "NG_my_surface_surfaceshader"
    assert nodedef.getImplementation().getName() == graph.getName()
    own = mx.writeToXmlString(bare, _only_own())
    assert own.count("<mrm_") == 2
    assert "xi:include href" not in own


def _only_own() -> mx.XmlWriteOptions:
    options = mx.XmlWriteOptions()
    options.elementPredicate = lambda element: not element.hasSourceUri()
    return options


def test_any_surface_can_be_retrofitted_by_naming_its_nodes(bare: mx.Document) -> None:
    graph = definition(bare, "UsdPreviewSurface").getImplementation()
    microfacet = {n.getName(): n.getCategory() for n in graph.getNodes() if n.getCategory() in SUBSTITUTES}
    base = {name: kind for name, kind in microfacet.items() if not name.startswith(("coat", "transmission"))}
    nodedef, _ = mrm_nodes.retrofit(bare, "UsdPreviewSurface", "retro_preview", "retro", base)
    shader = bare.addNode("retro_preview", "shader", "surfaceshader")
    assert shader.getNodeDef().getName() == nodedef.getName()
    bare.addMaterialNode("preview", shader)
    assert "mrm_microfacet" in mrm_nodes.generate_shader(bare, "glsl", "preview").pixel


@by_surface
def test_an_unknown_layout_names_the_node_that_was_expected(bare: mx.Document, surface) -> None:
    expected = next(iter(surface.replace))
    definition(bare, surface.node).getImplementation().removeNode(expected)
    before = len(bare.getChildren())
    with pytest.raises(
        MrmError, match=f"expected a {surface.replace[expected]} named {expected}, but there is none"
    ):
        mrm_nodes.retrofit(bare, surface.node, "my_surface", "retro")
    assert len(bare.getChildren()) == before


def test_a_node_of_another_kind_is_an_unknown_layout(bare: mx.Document) -> None:
    definition(bare, "standard_surface").getImplementation().getNode("metal_bsdf").setCategory(
        "dielectric_bsdf"
    )
    with pytest.raises(
        MrmError, match="expected a conductor_bsdf named metal_bsdf, but it is a dielectric_bsdf"
    ):
        mrm_nodes.retrofit(bare, "standard_surface", "my_surface", "retro")


def test_a_lobe_that_is_new_is_an_unknown_layout(bare: mx.Document) -> None:
    definition(bare, "open_pbr_surface").getImplementation().addNode("dielectric_bsdf", "second_coat", "BSDF")
    with pytest.raises(MrmError, match="did not expect a dielectric_bsdf named second_coat"):
        mrm_nodes.retrofit(bare, "open_pbr_surface", "my_surface", "retro")


def test_a_surface_of_unknown_layout_leaves_the_others_usable(bare: mx.Document) -> None:
    definition(bare, "gltf_pbr").getImplementation().removeNode("tf_metal_bsdf")
    with pytest.warns(MrmWarning, match="mrm_gltf_pbr is left out.*tf_metal_bsdf"):
        documents = surface_documents(bare)
    assert list(documents) == ["mrm_open_pbr_surface", "mrm_standard_surface"]


def test_a_lobe_that_is_retroreflective_already_is_refused(bare: mx.Document) -> None:
    node = definition(bare, "standard_surface").getImplementation().getNode("metal_bsdf")
    node.addInput("retroreflective", "boolean").setValue(True)
    with pytest.raises(MrmError, match="metal_bsdf is retroreflective already"):
        mrm_nodes.retrofit(bare, "standard_surface", "my_surface", "retro")


@pytest.mark.parametrize(
    ("nodedef", "name", "input_name", "message"),
    [
        ("no_such_surface", "mine", "retro", "no_such_surface: no such node definition"),
        ("dielectric_bsdf", "mine", "retro", "has no node graph"),
        ("disney_principled", "mine", "retro", "name the nodes with base_specular"),
        ("standard_surface", "open_pbr_surface", "retro", "open_pbr_surface: a node of this name is defined"),
        ("standard_surface", "mine", "metalness", "has an input metalness already"),
        ("standard_surface", "mine", "out", "has an output out"),
        ("standard_surface", "my surface", "retro", "'my surface' is no name"),
        ("standard_surface", "mine", "", "'' is no name"),
    ],
)
def test_a_request_that_cannot_be_met_is_refused(
    bare: mx.Document, nodedef: str, name: str, input_name: str, message: str
) -> None:
    before = len(bare.getChildren())
    with pytest.raises(MrmError, match=message):
        mrm_nodes.retrofit(bare, nodedef, name, input_name)
    assert len(bare.getChildren()) == before


def test_our_nodes_must_be_in_the_document() -> None:
    document = mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), document)
    with pytest.raises(MrmError, match="mrm_dielectric_bsdf is not in the document; load it first"):
        mrm_nodes.retrofit(document, "standard_surface", "mine", "retro")


def test_loading_the_installed_materialx_warns_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", MrmWarning)
        assert len(surface_documents(mrm_nodes.load_library(surfaces=False))) == len(SURFACES)
