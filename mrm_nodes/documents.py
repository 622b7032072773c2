"""Documents: how a .mtlx file is read, what of it is rendered, and whether that is sound."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes import cycles, external, library
from mrm_nodes.errors import MrmError, MrmWarning, unknown


def read_document(
    path: str | os.PathLike[str],
    libraries: str | os.PathLike[str] | None = None,
    allow_external: bool = False,
) -> mx.Document:
    """Read a .mtlx file, with MaterialX's standard libraries and ours beside it.

    libraries: a MaterialX `libraries` folder in place of the installed MaterialX's.
    allow_external: whether it may include documents and name images outside of its folder and the node libraries.

    Raises:
        MrmError: the file is missing, is not MaterialX, or names a file that it may not read.
    """
    file = Path(path)
    if not file.is_file():
        raise MrmError(f"{file}: no such file")
    external.check_includes(file, allow_external)
    document = mx.createDocument()
    try:
        mx.readFromXmlFile(document, str(file), mx.FileSearchPath(str(file.resolve().parent)))
    except Exception as error:  # MaterialX's own exception types differ between versions
        raise MrmError(f"{file}: not a MaterialX document: {one_line(error)}") from None
    external.check_images(document, file, allow_external)
    document.setDataLibrary(library.shared_library(libraries))
    cycles.check_cycles(document, str(file))
    return document


def find_renderable(document: mx.Document, where: str, element: str | None) -> mx.Element:
    """Return the element to generate: the one named, or the only one that can be rendered.

    Raises:
        MrmError: no such element, none that can be rendered, or several.
    """
    # A graph that implements a definition, as the library's do, is not the document's own output.
    renderables = [
        found
        for found in mx_gen_shader.findRenderableElements(document)
        if not found.getParent().getAttribute("nodedef")
    ]
    names = [renderable.getNamePath() for renderable in renderables]
    if element is not None:
        found = document.getDescendant(element) if element else None
        if found is None:
            raise MrmError(f"{where}: {unknown('element', element, names)}")
        return found
    if not renderables:
        raise MrmError(f"{where}: nothing to render: no material, shader or output")
    if len(renderables) > 1:
        raise MrmError(
            f"{where}: several elements can be rendered; name one with --element: {', '.join(names)}"
        )
    return renderables[0]


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


def check_document(document: mx.Document, where: str = "document") -> None:
    """Check that every node, input, value and connection is sound; warn of values that the nodes will clamp.

    Raises:
        MrmError: an unknown node; an input that its node does not have, or of another type; a value that is
            malformed, NaN or infinite; a connection to something that does not exist or has another type.
    """
    for node in nodes_of(document):
        if node.getNodeDef() is None:
            raise MrmError(f"{where}: node {node.getNamePath()}: {_why_undefined(node, document)}")
    for port in _ports(document):
        _check_port(port, f"{where}: {port.getNamePath()}")


def _own(document: mx.Document) -> list[mx.Element]:
    """Return the elements of a document that are no library's."""
    shared = library.shared_library()
    return [child for child in document.getChildren() if shared.getChild(child.getName()) is None]


def nodes_of(document: mx.Document) -> Iterator[mx.Node]:
    for child in _own(document):
        if child.isA(mx.NodeGraph):
            yield from child.getNodes()
        elif child.isA(mx.Node):
            yield child


def _ports(document: mx.Document) -> Iterator[mx.Input | mx.Output]:
    """Yield the inputs and outputs of the document itself, of node graphs and, last, of nodes."""
    for child in _own(document):
        if child.isA(mx.NodeGraph):
            yield from child.getInputs()
            yield from child.getOutputs()
        elif child.isA(mx.Input) or child.isA(mx.Output):
            yield child
    for node in nodes_of(document):
        yield from node.getInputs()


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
            known = {each.getName() for definition in of_type for each in definition.getActiveInputs()}
            return f"{category}: {unknown('input', name, known)}"
        if port.getType() not in types:
            return f"input {name} has type {port.getType()}, not {_listed(types)}"
    return f"no {category} has these inputs together"


def _listed(names: Iterable[str]) -> str:
    return " or ".join(sorted(set(names)))


def _check_port(port: mx.Input | mx.Output, place: str) -> None:
    text = port.getValueString()
    if text and port.getValue() is None and port.getType() in _NUMBERS:
        raise MrmError(f"{place}: {text} is not {_NUMBERS[port.getType()]}")
    source = port.getAttribute("nodename") or port.getAttribute("nodegraph")
    # Generation would go on without it, or end in the compiler. Other complaints it can live with.
    if source and "port connection" in port.validate()[1]:
        output = port.getOutputString()
        raise MrmError(
            f"{place}: connected to {source}{'/' + output if output else ''}, "
            f"which does not exist here or is no {port.getType()}"
        )
    node = port.getParent()
    if text and port.isA(mx.Input) and node.isA(mx.Node) and port.getType() == "string":
        choices = node.getNodeDef().getActiveInput(port.getName()).getAttribute("enum")
        known = [choice.strip() for choice in choices.split(",")] if choices else [text]
        if text not in known:
            raise MrmError(f"{place}: {unknown('value', text, known)}")
    if node.getCategory().startswith("mrm_") and port.getName() in _RANGES:
        _warn_of_clamping(port, place)


def _warn_of_clamping(port: mx.Input, place: str) -> None:
    low, high = _RANGES[port.getName()]
    # Through a graph's interface, what is set there reaches the node.
    source = port.getInterfaceInput() or port
    text = source.getValueString() if source.getValue() is not None else ""
    if any(not low <= float(number) <= high for number in text.replace(",", " ").split()):
        limits = f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
        warnings.warn(f"{place}: {text} is clamped to its range, {limits}", MrmWarning, stacklevel=5)


def one_line(error: Exception) -> str:
    """What an exception of MaterialX says."""
    return " ".join(str(error).split())
