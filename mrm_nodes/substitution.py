"""Any surface shader made retroreflective: its base specular BSDFs exchanged for ours, one input added."""

from __future__ import annotations

import functools
import tomllib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources

import MaterialX as mx

from mrm_nodes.errors import MrmError, MrmWarning

#: Our node in place of each of MaterialX's microfacet BSDFs; inputs that both have keep name and meaning.
SUBSTITUTES = {
    "conductor_bsdf": "mrm_conductor_bsdf",
    "dielectric_bsdf": "mrm_dielectric_bsdf",
    "generalized_schlick_bsdf": "mrm_generalized_schlick_bsdf",
}

#: The weight of our nodes, and MaterialX's switch that it takes the place of.
WEIGHT = "retroreflectivity"
SWITCH = "retroreflective"

_KNOWN_VERSIONS = "mrm-nodes knows the surfaces of MaterialX 1.39.3 to 1.39.5"


@dataclass(frozen=True)
class Surface:
    """A surface shader whose graph is known."""

    node: str
    """MaterialX's."""
    name: str
    """Of the node that is made."""
    input: str
    """Its new input."""
    after: str
    """The input of the original that the new one follows."""
    uiname: str
    """How a user interface calls the new input."""
    folder: str
    """Where it shows it."""
    doc: str
    """What it says of it."""
    replace: Mapping[str, str]
    """Base specular: nodes of the graph, each with its BSDF."""
    keep: Mapping[str, str]
    """Coat and transmission: the nodes that stay as they are, likewise."""


@functools.cache
def known_surfaces() -> dict[str, Surface]:
    """Return the surfaces whose graphs are known, by MaterialX's name for the node."""
    text = (resources.files("mrm_nodes") / "surfaces.toml").read_text(encoding="utf-8")
    return {node: Surface(node=node, **fields) for node, fields in tomllib.loads(text).items()}


def twin_with(category: str, input_name: str) -> str:
    """Return the node of ours that has an input which MaterialX's node of a category lacks; empty for none."""
    surface = known_surfaces().get(category)
    if surface is not None and input_name == surface.input:
        return surface.name
    is_ours = input_name in (WEIGHT, "masking", "retro_transmission")
    return SUBSTITUTES.get(category, "") if is_ours else ""


def retrofit(
    document: mx.Document,
    nodedef: str | mx.NodeDef,
    name: str,
    input_name: str,
    base_specular: Mapping[str, str] | None = None,
) -> tuple[mx.NodeDef, mx.NodeGraph]:
    """Add to `document` a copy of a surface shader whose base specular is retroreflective by a weight.

    The one substitution of Portsmouth et al. 2026, section 3, for a node graph: its base specular BSDFs
    become ours, with the weight connected. Every other node, and so every other lobe, is copied as it is.

    Args:
        document: holds the definition and graph of `nodedef` and our nodes, or has them in its data library.
        nodedef: a node definition, its name, or the name of its node, such as `open_pbr_surface`.
        name: of the new node.
        input_name: of the new input: a float from 0 to 1, 0 by default.
        base_specular: the nodes of the graph to exchange, each with its BSDF, such as
            `{"specular_bsdf": "dielectric_bsdf"}`; known for open_pbr_surface, gltf_pbr and standard_surface.

    Raises:
        MrmError: no such definition, one without a node graph, a graph that is not laid out as expected, a
            name that is taken or is no name, or a library without our nodes. `document` is left as it was.
    """
    original = _definition(document, nodedef)
    where = original.getName()
    graph = original.getImplementation()
    if not isinstance(graph, mx.NodeGraph):
        raise MrmError(f"{where}: has no node graph to retrofit; only surfaces built from BSDF nodes can be")
    surface = known_surfaces().get(original.getNodeString())
    if base_specular is not None:
        replace = dict(base_specular)
    elif surface is not None:
        replace = dict(surface.replace)
        _check_layout(graph, surface)
    else:
        known = ", ".join(sorted(known_surfaces()))
        raise MrmError(
            f"{where}: its base specular is known only for {known}; name the nodes with base_specular"
        )
    _check_nodes(document, graph, replace)
    new_nodedef_name = _new_name(original, name)
    new_graph_name = f"NG_{new_nodedef_name.removeprefix('ND_')}"
    _check_names(document, original, name, input_name, (new_nodedef_name, new_graph_name))

    new_nodedef = document.addChildOfCategory("nodedef", new_nodedef_name)
    new_nodedef.copyContentFrom(original)
    # What it inherits becomes its own, so that it stands alone.
    new_nodedef.removeAttribute("inherit")
    for inherited in (*original.getActiveInputs(), *original.getActiveOutputs()):
        if new_nodedef.getChild(inherited.getName()) is None:
            child = new_nodedef.addChildOfCategory(inherited.getCategory(), inherited.getName())
            child.copyContentFrom(inherited)
    _forget_source(new_nodedef)
    new_nodedef.setNodeString(name)
    if original.hasAttribute("uiname"):
        new_nodedef.setAttribute("uiname", f"{original.getAttribute('uiname')}, Retroreflective")
    if original.hasAttribute("doc"):
        new_nodedef.setAttribute("doc", f"{original.getAttribute('doc')}, with a weight for retroreflection")
    _add_weight(new_nodedef, input_name, surface if base_specular is None else None)

    new_graph = document.addNodeGraph(new_graph_name)
    new_graph.copyContentFrom(graph)
    _forget_source(new_graph)
    new_graph.setNodeDefString(new_nodedef_name)
    for node_name in replace:
        _substitute(new_graph.getNode(node_name), input_name)
    return new_nodedef, new_graph


def surface_documents(library: mx.Document) -> dict[str, mx.Document]:
    """Return the retrofitted twin of every known surface in `library`: a document each, by the twin's name.

    Args:
        library: MaterialX's standard libraries and our nodes; it is not changed.

    A surface that is laid out in an unknown way is left out, with a warning: the nodes work without it.
    """
    documents = {}
    for surface in known_surfaces().values():
        versions = library.getMatchingNodeDefs(surface.node)
        if not versions:
            continue
        document = mx.createDocument()
        document.setDataLibrary(library)
        try:
            for version in versions:
                retrofit(document, version, surface.name, surface.input)
        except MrmError as error:
            warnings.warn(f"{surface.name} is left out: {error}", MrmWarning, stacklevel=2)
            continue
        heading = document.addChildOfCategory("comment")
        heading.setDocString(
            f" MaterialX's {surface.node}, its base specular exchanged for the nodes of mrm-nodes. "
        )
        document.setChildIndex(heading.getName(), 0)
        document.setDataLibrary(None)
        documents[surface.name] = document
    return documents


def _definition(document: mx.Document, nodedef: str | mx.NodeDef) -> mx.NodeDef:
    """Return the definition that is meant; of several versions of a node, the default one."""
    if isinstance(nodedef, mx.NodeDef):
        return nodedef
    found = document.getNodeDef(nodedef)
    if found is not None:
        return found
    candidates = document.getMatchingNodeDefs(nodedef)
    if not candidates:
        raise MrmError(
            f"{nodedef}: no such node definition; load MaterialX's libraries into the document first"
        )
    return next((candidate for candidate in candidates if candidate.getDefaultVersion()), candidates[0])


def _check_layout(graph: mx.NodeGraph, surface: Surface) -> None:
    """Check that every microfacet node of the graph is one that `surfaces.toml` knows."""
    for expected in (surface.replace, surface.keep):
        for node_name, category in expected.items():
            _expect(graph, node_name, category)
    for node in graph.getNodes():
        known = node.getName() in surface.replace or node.getName() in surface.keep
        if node.getCategory() in (*SUBSTITUTES, *SUBSTITUTES.values()) and not known:
            raise MrmError(
                f"{graph.getName()}: did not expect a {node.getCategory()} named {node.getName()}; "
                f"{_KNOWN_VERSIONS}"
            )


def _expect(graph: mx.NodeGraph, node_name: str, category: str) -> mx.Node:
    node = graph.getNode(node_name)
    if node is None:
        found = "there is none"
    elif node.getCategory() != category:
        found = f"it is a {node.getCategory()}"
    else:
        return node
    raise MrmError(
        f"{graph.getName()}: expected a {category} named {node_name}, but {found}; {_KNOWN_VERSIONS}"
    )


def _check_nodes(document: mx.Document, graph: mx.NodeGraph, replace: Mapping[str, str]) -> None:
    """Check that each node to be exchanged has a substitute with the same inputs."""
    if not replace:
        raise MrmError(f"{graph.getName()}: base_specular names no node")
    for node_name, category in replace.items():
        if category not in SUBSTITUTES:
            raise MrmError(
                f"{graph.getName()}: {category} has no substitute; it is for {', '.join(SUBSTITUTES)}"
            )
        node = _expect(graph, node_name, category)
        definitions = document.getMatchingNodeDefs(SUBSTITUTES[category])
        if not definitions:
            raise MrmError(
                f"{graph.getName()}: {SUBSTITUTES[category]} is not in the document; load it first"
            )
        inputs = {one.getName() for definition in definitions for one in definition.getActiveInputs()}
        switch = node.getInput(SWITCH)
        if switch is not None and (switch.getValueString() != "false" or switch.hasInterfaceName()):
            raise MrmError(f"{graph.getName()}: {node_name} is retroreflective already")
        unknown = {one.getName() for one in node.getInputs()} - inputs - {SWITCH}
        if unknown:
            raise MrmError(
                f"{graph.getName()}: {SUBSTITUTES[category]} lacks the input {min(unknown)} of {node_name}"
            )


def _new_name(original: mx.NodeDef, name: str) -> str:
    node = original.getNodeString()
    return original.getName().replace(node, name, 1) if node in original.getName() else f"ND_{name}"


def _check_names(
    document: mx.Document, original: mx.NodeDef, name: str, input_name: str, children: tuple[str, ...]
) -> None:
    for text in (name, input_name):
        if not (text and mx.isValidName(text)):
            raise MrmError(
                f"{original.getName()}: {text!r} is no name in MaterialX: letters, digits and underscores"
            )
    if input_name in {one.getName() for one in original.getActiveInputs()}:
        raise MrmError(f"{original.getName()}: it has an input {input_name} already; choose another name")
    if input_name in {one.getName() for one in original.getActiveOutputs()}:
        raise MrmError(f"{original.getName()}: it has an output {input_name}; choose another name")
    inputs = {one.getName() for one in original.getActiveInputs()} | {input_name}
    for present in document.getMatchingNodeDefs(name):
        # Another version of the same surface may have the same name.
        is_version = present.getVersionString() not in ("", original.getVersionString())
        if not is_version or {one.getName() for one in present.getActiveInputs()} != inputs:
            raise MrmError(f"{name}: a node of this name is defined already; choose another name")
    for child in children:
        taken = document.getChild(child) or document.getNodeDef(child) or document.getNodeGraph(child)
        if taken is not None:
            raise MrmError(f"{child}: the document has an element of this name already; choose another name")


def _forget_source(element: mx.Element) -> None:
    """Make a copy an element of its new document: one that has a source is written as a reference to it."""
    for descendant in element.traverseTree():
        descendant.setSourceUri("")


def _add_weight(nodedef: mx.NodeDef, input_name: str, surface: Surface | None) -> None:
    weight = nodedef.addInput(input_name, "float")
    weight.setValueString("0.0")
    weight.setAttribute("uimin", "0.0")
    weight.setAttribute("uimax", "1.0")
    if surface is None:
        weight.setAttribute("doc", "Blends the base specular from mirror-like (0) to retroreflective (1).")
        after = nodedef.getInputs()[-2] if len(nodedef.getInputs()) > 1 else None
    else:
        weight.setAttribute("uiname", surface.uiname)
        weight.setAttribute("uifolder", surface.folder)
        weight.setAttribute("doc", surface.doc)
        after = nodedef.getInput(surface.after)
    if after is not None:
        nodedef.setChildIndex(input_name, nodedef.getChildIndex(after.getName()) + 1)


def _substitute(node: mx.Node, input_name: str) -> None:
    node.setCategory(SUBSTITUTES[node.getCategory()])
    node.removeAttribute("nodedef")
    node.removeInput(SWITCH)
    weight = node.addInput(WEIGHT, "float")
    weight.setInterfaceName(input_name)
    roughness = node.getChildIndex("roughness")
    if roughness >= 0:
        node.setChildIndex(WEIGHT, roughness + 1)
