"""What of a document is rendered, what that is made of, and whether it is sound."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterable, Iterator, Set

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes import library
from mrm_nodes.errors import MrmError, MrmWarning, unknown
from mrm_nodes.substitution import twin_with

_SHOWN = 20
"""Names of elements that an error lists."""


def find_renderable(document: mx.Document, where: str, element: str | None) -> mx.Element:
    """Return the element to generate: the one named, or the only one that can be rendered.

    Raises:
        MrmError: no such element, none that can be rendered, or several.
    """
    renderables = _renderables(document)
    names = [renderable.getNamePath() for renderable in renderables]
    if element is not None:
        found = descendant(document, element)
        if found is None:
            raise MrmError(f"{where}: {unknown('element', element, names)}")
        return found
    if not renderables:
        # MaterialX passes over a material whose shader is not there.
        for each in (*document.getMaterialNodes(), *document.getOutputs()):
            check_document(document, where, each)
        raise MrmError(f"{where}: nothing to render: no material, shader or output")
    if len(renderables) > 1:
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        raise MrmError(
            f"{where}: several elements can be rendered; name one with --element: "
            f"{', '.join(names[:_SHOWN])}{more}"
        )
    return renderables[0]


def descendant(document: mx.Document, path: str) -> mx.Element | None:
    """An element by its name path; of the document's own elements also one whose name has a slash in it."""
    return (document.getDescendant(path) or document.getChild(path)) if path else None


def _renderables(document: mx.Document) -> list[mx.Element]:
    return [
        found
        for found in mx_gen_shader.findRenderableElements(document)
        # A graph that implements a definition, as the library's do, is not the document's own output.
        if not found.getParent().getAttribute("nodedef")
    ]


#: Where a literal value of our nodes' inputs is clamped, and why; MaterialX's own nodes clamp the same way.
_RANGES: dict[str, tuple[float, float]] = {
    "roughness": (1e-8, 1.0),
    "retroreflectivity": (0.0, 1.0),
    "tint": (0.0, math.inf),
    "color0": (0.0, math.inf),
    "color82": (0.0, math.inf),
    "color90": (0.0, math.inf),
}

#: Types whose values are numbers, and what such a value is.
_NUMBERS = {
    "boolean": "true or false",
    "integer": "an integer",
    "float": "a finite number",
    **{f"{kind}{n}": f"{n} finite numbers" for kind in ("vector", "color") for n in (2, 3, 4)},
    "matrix33": "9 finite numbers",
    "matrix44": "16 finite numbers",
}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


def check_document(
    document: mx.Document, where: str = "document", element: mx.Element | None = None, target: str = ""
) -> None:
    """Check that all that an element uses is sound; warn of values that the nodes will clamp.

    What it does not use may be of a program that MaterialX does not know.

    Args:
        element: by default each that can be rendered.
        target: MaterialX's own name for the target, where the implementations of one are to be looked at.

    Raises:
        MrmError: an unknown node; an input that its node does not have, or of another type; a value that is
            malformed, NaN or infinite; a connection to something that does not exist or has another type.
    """
    roots = _renderables(document) if element is None else [element]
    used = used_by(roots, target)
    # MaterialX looks each up among all that there are.
    definitions = {id(each): each.getNodeDef() for each in used if isinstance(each, mx.Node)}
    for each in used:
        if isinstance(each, mx.Node) and _is_ill_defined(each, definitions[id(each)]):
            raise MrmError(f"{where}: node {each.getNamePath()}: {_why_undefined(each, document)}")
    own = document.getChildren()
    defining = {each.getName() for each in own if isinstance(each, mx.NodeGraph) and each.getNodeDefString()}
    defining |= {each.getNodeGraph() for each in own if isinstance(each, mx.Implementation)}
    for each in used:
        if isinstance(each, mx.Input | mx.Output):
            _check_port(each, where, defining, definitions.get(id(each.getParent())))


def _is_ill_defined(node: mx.Node, definition: mx.NodeDef | None) -> bool:
    """Whether a node has no definition, or names one that lacks an input of ours: that would do nothing."""
    category = node.getCategory()
    return definition is None or any(
        twin_with(category, port.getName()) and definition.getActiveInput(port.getName()) is None
        for port in node.getInputs()
    )


def used_by(elements: Iterable[mx.Element], target: str = "") -> list[mx.Element]:
    """What elements are made of, themselves first: nodes with their inputs, and of graphs what leads to them.

    What a library's nodes are made of is the library's.

    target: MaterialX's own name for the target whose implementations are followed; by default every target's.
    """
    # By identity, which an element keeps while it is held: a path is put together anew each time that it is asked for.
    found: dict[int, mx.Element] = {}
    pending = list(elements)[::-1]
    defines = bool(pending) and any(
        isinstance(each, mx.NodeDef) for each in pending[0].getDocument().getChildren()
    )
    while pending:
        each = pending.pop()
        if id(each) not in found:
            found[id(each)] = each
            sources = [*_sources(each), *(_own_graphs(each, target) if defines else ())]
            pending += reversed([source for source in sources if source is not None])
    return list(found.values())


_CONNECTIONS = ("nodename", "nodegraph", "output")


def _sources(element: mx.Element) -> Iterator[mx.Element | None]:
    if isinstance(element, mx.NodeGraph):
        yield from element.getOutputs()
    elif isinstance(element, mx.Node):
        yield from element.getInputs()
    elif isinstance(element, mx.Input | mx.Output):
        name = element.getInterfaceName()
        graph = graph_around(element) if name else None
        if graph is not None:
            yield graph.getInput(name)
        if name or any(map(element.hasAttribute, _CONNECTIONS)):
            yield element.getConnectedOutput()
            yield element.getConnectedNode()


def graph_around(element: mx.Element) -> mx.NodeGraph | None:
    """The graph that an element is a part of."""
    each = element.getParent()
    while each is not None and not each.isA(mx.NodeGraph):
        each = each.getParent()
    return each


def _own_graphs(node: mx.Element, target: str) -> Iterator[mx.NodeGraph]:
    """The graphs of the document that implement a node; of anything else, none."""
    if not isinstance(node, mx.Node):
        return
    document = node.getDocument()
    definition = node.getNodeDef(target) or node.getNodeDef()
    # Not by name: from 1.39.5 on a document finds its data library's elements too.
    if definition is None or definition.getDocument() is not document:
        return
    if target:
        found = [definition.getImplementation(target)]
    else:
        found = document.getMatchingImplementations(definition.getName())
    for each in found:
        if isinstance(each, mx.NodeGraph) and each.getDocument() is document:
            yield each


def _why_undefined(node: mx.Node, document: mx.Document) -> str:
    """Say what keeps a node from having a definition: its name, its type, or one of its inputs."""
    category = node.getCategory()
    definitions = {definition.getName(): definition for definition in document.getNodeDefs()}
    definitions |= {each.getName(): each for each in library.shared_library().getNodeDefs()}
    alike = [each for each in definitions.values() if each.getNodeString() == category]
    if not alike:
        return unknown("node", category, {each.getNodeString() for each in definitions.values()})
    of_type = [each for each in alike if each.getType() == node.getType()]
    if not of_type:
        return f"{category} has no type {node.getType()}; known: {_listed(each.getType() for each in alike)}"
    for port in node.getInputs():
        name = port.getName()
        types = {each.getActiveInput(name).getType() for each in of_type if each.getActiveInput(name)}
        if not types:
            if twin := twin_with(category, name):
                return f"{category} has no input {name}: use {twin}, or mrm-nodes retrofit"
            known = {each.getName() for definition in of_type for each in definition.getActiveInputs()}
            return f"{category}: {unknown('input', name, known)}"
        if port.getType() not in types:
            return f"input {name} has type {port.getType()}, not {_listed(types)}"
    return f"no {category} has these inputs together"


def _listed(names: Iterable[str]) -> str:
    return " or ".join(sorted(set(names)))


def _check_port(
    port: mx.Input | mx.Output, where: str, defining: Set[str], definition: mx.NodeDef | None
) -> None:
    """definition: of the node that an input is one of."""
    text, kind = port.getValueString(), port.getType()
    if text and kind in _NUMBERS and not _is_number(port, text, kind, where):
        raise MrmError(f"{_place(port, where)}: {text} is not {_NUMBERS[kind]}")
    source = port.getAttribute("nodename") or port.getAttribute("nodegraph")
    # Generation would go on without it, or end in the compiler. Other complaints it can live with.
    if source and not _is_plainly_connected(port, defining) and "port connection" in port.validate()[1]:
        output = port.getOutputString()
        raise MrmError(
            f"{_place(port, where)}: connected to {source}{'/' + output if output else ''}, "
            f"which does not exist here or is no {kind}"
        )
    if definition is None:
        return
    name = port.getName()
    declared = definition.getActiveInput(name) if text else None
    if declared is not None:
        _warn_of_geometry(port, declared, where)
    if kind == "string" and declared is not None and (choices := declared.getAttribute("enum")):
        known = [choice.strip() for choice in choices.split(",")]
        if text not in known:
            raise MrmError(f"{_place(port, where)}: {unknown('value', text, known)}")
    if text and name in _SHARES and definition.getType() == "BSDF":
        _warn_of_share(port, where)
    if name in _RANGES and definition.getNodeString().startswith("mrm_"):
        _warn_of_clamping(port, where)


def _place(port: mx.Input | mx.Output, where: str) -> str:
    return f"{where}: {port.getNamePath()}"


def _is_plainly_connected(port: mx.Input | mx.Output, defining: Set[str]) -> bool:
    """Whether a port has the output that it names, of a node or of a graph that defines none, and that its type.

    MaterialX's validation would say the same of it, but follows outputs through their whole graph and looks for a
    graph's definition among all that there are.

    defining: names of the document's graphs that define nodes.
    """
    node, name = port.getConnectedNode(), port.getOutputString()
    if node is None:
        return False
    source: mx.Element | None = node
    if port.getAttribute("nodegraph"):
        is_one = name and isinstance(port, mx.Input) and not port.getAttribute("nodename")
        source = port.getConnectedOutput() if is_one else None
        graph = None if source is None else source.getParent()
        if graph is None or not graph.isA(mx.NodeGraph) or graph.getName() in defining:
            return False
    elif name:
        definition = node.getNodeDef() if node.getType() == "multioutput" else None
        source = definition and definition.getOutput(name)
    return source is not None and source.getType() == port.getType()


def _is_number(port: mx.Input | mx.Output, text: str, kind: str, where: str) -> bool:
    """Whether a value is what its type says; MaterialX itself takes `0,5` for 0 and `1x` for 1."""
    if port.getValue() is None:
        return False
    if kind == "boolean":
        return True
    if kind in ("float", "integer"):
        number = text.strip()
        return bool(_NUMBER.fullmatch(number)) and (kind == "float" or float(number).is_integer())
    for number in text.replace(",", " ").split():
        read = _NUMBER.match(number)
        if read is None:
            return False
        # Among several it is clear which number is meant, and MaterialX's own documents have such.
        if read[0] != number:
            told = f"{_place(port, where)}: {number} is read as {read[0]}"
            warnings.warn(told, MrmWarning, stacklevel=5)
    return True


def _warn_of_geometry(port: mx.Input, declared: mx.Input, where: str) -> None:
    """MaterialX's generators pass over a value where an input takes the geometry's."""
    taken = declared.getAttribute("defaultgeomprop")
    if taken and not any(port.hasAttribute(each) for each in ("nodename", "nodegraph", "interfacename")):
        told = f"{_place(port, where)}: its value is ignored, MaterialX takes {taken}: connect a node"
        warnings.warn(told, MrmWarning, stacklevel=5)


_SHARES = {"mix", "weight"}
"""Inputs of BSDF nodes that are shares of 1, and that MaterialX does not clamp."""


def _warn_of_share(port: mx.Input, where: str) -> None:
    source = port.getInterfaceInput() or port
    value = source.getValue()
    if not isinstance(value, float) or 0.0 <= value <= 1.0:
        return
    taken = (
        "counts as 0"
        if port.getName() == "weight" and value < 0.0
        else "is taken as it is: energy is made or lost"
    )
    told = f"{_place(port, where)}: {source.getValueString()} is outside 0 to 1, and {taken}"
    warnings.warn(told, MrmWarning, stacklevel=5)


def _warn_of_clamping(port: mx.Input, where: str) -> None:
    low, high = _RANGES[port.getName()]
    # Through a graph's interface, what is set there reaches the node.
    source = port.getInterfaceInput() or port
    value = source.getValue()
    numbers = value.asTuple() if hasattr(value, "asTuple") else (value,)
    if any(isinstance(number, float) and not low <= number <= high for number in numbers):
        limits = f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
        told = f"{_place(port, where)}: {source.getValueString()} is clamped to its range, {limits}"
        warnings.warn(told, MrmWarning, stacklevel=5)
