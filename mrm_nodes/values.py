"""What the values of a document mean, made plain before code is generated from it: units and colour spaces.

MaterialX's generators read both from the input of the node that uses a value. Here they come there from a graph's
interface too; and what is in a colour space that only OpenColorIO knows is converted: a constant in the document,
an image's pixels by whoever reads them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import MaterialX as mx

from mrm_nodes import colorspaces, library, units
from mrm_nodes.elements import used_by
from mrm_nodes.errors import MrmError

_COLORS = ("color3", "color4")


@dataclass(frozen=True)
class Settled:
    """A document whose values mean the same to every generator.

    Args:
        document: the one that was given, or a copy.
        spaces: by the path of a colour or a file name, the colour space that whoever sets or reads it converts
            from; OpenColorIO's name.
        foreign: a line for each use of a colour space that MaterialX does not know.
        unapplied: a line for each unit that MaterialX does not apply.
        definitions: its units, where it uses any.
    """

    document: mx.Document
    spaces: Mapping[str, str] = field(default_factory=dict)
    foreign: tuple[str, ...] = ()
    unapplied: tuple[str, ...] = ()
    definitions: mx.Document | None = None


@dataclass
class _Edits:
    """What is to be changed in a document, by the paths of its elements, and what is noted of it."""

    attributes: dict[str, dict[str, str]] = field(default_factory=dict)
    values: dict[str, str] = field(default_factory=dict)
    inserted: dict[str, tuple[str, float | None]] = field(default_factory=dict)
    """By the port that it comes before: a node's category, and its second operand if it has one."""
    spaces: dict[str, str | None] = field(default_factory=dict)
    foreign: dict[str, None] = field(default_factory=dict)
    unapplied: dict[str, None] = field(default_factory=dict)

    def set(self, element: mx.Element, **attributes: str) -> None:
        self.attributes.setdefault(element.getNamePath(), {}).update(attributes)

    def apply(self, document: mx.Document) -> None:
        """Make the changes."""
        for path, attributes in self.attributes.items():
            for name, value in attributes.items():
                _element_at(document, path).setAttribute(name, value)
        for path, text in self.values.items():
            _element_at(document, path).setValueString(text)
        for path, (category, operand) in self.inserted.items():
            _insert(_element_at(document, path), category, operand)


def _element_at(document: mx.Document, path: str) -> Any:
    """The element of a path, which MaterialX itself does not find where a name has a slash in it."""
    found = document.getDescendant(path)
    return found or next(each for each in document.traverseTree() if each.getNamePath() == path)


def _insert(port: mx.Input, category: str, operand: float | None) -> None:
    """Put a node between a graph's interface and the port that takes its value from there."""
    node = port.getParent()
    scope = node.getParent()
    name = scope.createValidChildName(f"{node.getName()}_{port.getName()}_{category}")
    between = scope.addNode(category, name, port.getType())
    taken = between.addInput("in" if operand is None else "in1", port.getType())
    taken.setInterfaceName(port.getInterfaceName())
    if operand is not None:
        between.addInput("in2", "float").setValueString(f"{operand:.9g}")
    for attribute in ("interfacename", "value", "unit", "unittype"):
        port.removeAttribute(attribute)
    port.setNodeName(name)
    for each in (port, taken):
        each.setColorSpace(colorspaces.LINEAR)


def settle(document: mx.Document, element: mx.Element, where: str) -> Settled:
    """Make the values of a document plain; the document itself stays as it is.

    Args:
        element: what is rendered of it: what that does not use may be wrong.

    Raises:
        MrmError: a unit or a colour space that is unknown, or one value in two colour spaces.
    """
    shared = library.shared_library()
    own = colorspaces.own_names()
    edits = _Edits()
    ports = list(_node_inputs(document))
    has_units = any(port.hasAttribute("unit") for port in _inputs(document))
    definitions = units.unit_definitions(document, shared) if has_units else None
    used: set[str] | None = None
    for port in ports:
        try:
            _settle_space(port, own, edits)
            if definitions is not None:
                _settle_unit(port, definitions, edits)
        except MrmError as error:
            if used is None:
                used = {each.getNamePath() for each in used_by([element])}
            if port.getNamePath() in used:
                raise MrmError(f"{where}: {error}") from None
    _decode_once(ports, edits)
    return Settled(
        _edited(document, edits),
        {path: space for path, space in edits.spaces.items() if space is not None},
        tuple(edits.foreign),
        tuple(edits.unapplied),
        definitions,
    )


def _inputs(document: mx.Document) -> Iterator[mx.Input]:
    """The inputs of what is a document's own."""
    shared = library.shared_library()
    for child in document.getChildren():
        if shared.getChild(child.getName()) is None:
            if isinstance(child, mx.Input):
                yield child
            yield from (each for each in child.traverseTree() if isinstance(each, mx.Input))


def _node_inputs(document: mx.Document) -> Iterator[mx.Input]:
    return (port for port in _inputs(document) if isinstance(port.getParent(), mx.Node))


def outermost(port: mx.Input) -> mx.Input:
    """The input of the graph around a port, or of the document, that a value comes in by; not one of a definition."""
    for _ in range(100):
        outer = port.getInterfaceInput() if port.hasAttribute("interfacename") else None
        if outer is None or outer.getParent().isA(mx.NodeDef):
            return port
        port = outer
    raise MrmError(f"{port.getNamePath()} is its own interface")


def _has_value(port: mx.Input) -> bool:
    return port.hasAttribute("value") and not (
        port.hasAttribute("nodename") or port.hasAttribute("nodegraph")
    )


def space_of(port: mx.Input) -> str:
    """The colour space of a node's input: its own, that of the interface that it comes by, or the one around it."""
    holder = outermost(port)
    return str(
        port.getAttribute("colorspace") or holder.getAttribute("colorspace") or port.getActiveColorSpace()
    )


def _settle_space(port: mx.Input, own: frozenset[str], edits: _Edits) -> None:
    node, holder = port.getParent(), outermost(port)
    path = holder.getNamePath()
    is_file = port.getType() == "filename"
    # MaterialX decodes what a file comes to, but no colour that a definition's graph gets from its interface.
    if not _has_value(holder) and not (is_file and port.hasAttribute("interfacename")):
        return
    if not (port.getType() in _COLORS or (is_file and _gives_colors(node, port.getName()))):
        edits.spaces.setdefault(path, None)
        if edits.spaces[path] is not None:
            raise MrmError(f"{path} is used as data too, and in colour space {edits.spaces[path]}: split it")
        return
    space = space_of(port)
    found = None
    if not colorspaces.is_data(space) and space not in own:
        found = colorspaces.ocio_name(space)
        if found is None:
            raise MrmError(f"{path}: {colorspaces.unknown_space(space, own)}")
    alike = None if found is None else colorspaces.equivalents(own).get(found)
    converted = found if alike is None else None
    if path in edits.spaces and edits.spaces[path] != converted:
        raise MrmError(f"{path} is used in colour space {space} and in another: split it")
    edits.spaces[path] = converted
    name = space if found is None else alike or colorspaces.LINEAR
    plain = colorspaces.LINEAR if colorspaces.is_data(name) else name
    if port is not holder and not is_file and plain != colorspaces.LINEAR:
        # Of a graph's output alone, MaterialX converts nothing that comes by the graph's interface.
        edits.inserted[port.getNamePath()] = (colorspaces.decoding_node(plain), None)
    elif plain != port.getActiveColorSpace() and space:
        edits.set(port, colorspace=plain)
    if found is None:
        return
    what = f"{path}: MaterialX does not know the colour space {space}"
    if alike is not None:
        edits.foreign[f"{what}, which is its {alike}: that is generated"] = None
    elif not is_file:
        edits.values[path] = as_linear(holder.getValueString(), found)
        edits.foreign[f"{what}: its value is converted to {colorspaces.LINEAR}"] = None
    elif _has_value(holder):
        edits.foreign[f"{what}, so that the code takes the image as linear: convert its pixels"] = None
    else:
        raise MrmError(f"{what}: write one that it knows, or give it to the node that names the file")


def _decode_once(ports: Iterable[mx.Input], edits: _Edits) -> None:
    """Leave one tagged file to a node of several, such as triplanarprojection; where they differ, none.

    MaterialX decodes what the node gives, once for each file that is tagged: its generators crash at the second.
    """
    tagged: dict[str, list[tuple[mx.Input, str]]] = {}
    for port in ports:
        if port.getType() == "filename":
            space = edits.attributes.get(port.getNamePath(), {}).get("colorspace", port.getActiveColorSpace())
            if not colorspaces.is_linear(space):
                tagged.setdefault(port.getParent().getNamePath(), []).append((port, space))
    for files in tagged.values():
        if len(files) == 1:
            continue
        alike = len({space for _, space in files}) == 1
        for port, space in files[1:] if alike else files:
            edits.set(port, colorspace=colorspaces.LINEAR)
            if not alike:
                path = outermost(port).getNamePath()
                edits.spaces[path] = colorspaces.ocio_name(space)
                what = f"{path}: MaterialX decodes files in one colour space for a node, and not {space} beside others"
                edits.foreign[f"{what}: the code takes the image as linear: convert its pixels"] = None


def as_linear(text: str, space: str) -> str:
    """A colour as MaterialX writes it, converted from a space of OpenColorIO's."""
    numbers = [float(number) for number in text.split(",")]
    return ", ".join(f"{number:.9g}" for number in colorspaces.linear(numbers, space))


def _gives_colors(node: mx.Node, name: str) -> bool:
    """Whether MaterialX decodes the image that an input of a node names: a colour comes of it."""
    if node.getType() in _COLORS:
        return True
    definition = node.getNodeDef()
    graph = None if definition is None else definition.getImplementation()
    return isinstance(graph, mx.NodeGraph) and any(
        inner.getType() in _COLORS and port.getAttribute("interfacename") == name
        for inner in graph.getNodes()
        for port in inner.getInputs()
        if port.getType() == "filename"
    )


def _settle_unit(port: mx.Input, definitions: mx.Document, edits: _Edits, insert: bool = True) -> None:
    holder = outermost(port)
    named = port if port.hasAttribute("unit") else holder
    unit, kind = named.getAttribute("unit"), named.getAttribute("unittype")
    if not unit or not _has_value(holder):
        return
    path = holder.getNamePath()
    if not kind or definitions.getUnitTypeDef(kind) is None:
        what = f"unit type {kind} is unknown" if kind else "it has no unittype"
        edits.unapplied[f"{path}: unit {unit} is not applied, as in MaterialX: {what}"] = None
    elif port.getType() not in units.CONVERTED:
        edits.unapplied[f"{path}: unit {unit} is not applied, as in MaterialX: it is a {port.getType()}"] = (
            None
        )
    else:
        scale = units.factor(port, unit, kind, definitions)
        if port is holder:
            return
        if insert:
            edits.inserted[port.getNamePath()] = ("multiply", scale)
        else:
            edits.set(port, unit=unit, unittype=kind)


def _edited(document: mx.Document, edits: _Edits) -> mx.Document:
    if not (edits.attributes or edits.values or edits.inserted):
        return document
    copy = _copied(document)
    edits.apply(copy)
    return copy


def _copied(document: mx.Document) -> mx.Document:
    copy = mx.createDocument()
    copy.copyContentFrom(document)
    copy.setSourceUri(document.getSourceUri())
    if document.hasDataLibrary():
        copy.setDataLibrary(document.getDataLibrary())
    return copy


def explicit(document: mx.Document) -> mx.Document:
    """Return a copy that has at each node's input the unit and the colour space that hold there.

    Its graphs can be flattened: a scope's colour space would otherwise reach the values of a definition whose graph
    comes into it.
    """
    copy = _copied(document)
    ports = list(_inputs(copy))
    has_units = any(port.hasAttribute("unit") for port in ports)
    definitions = units.unit_definitions(copy, library.shared_library()) if has_units else None
    edits = _Edits()
    for port in ports:
        if not isinstance(port.getParent(), mx.Node):
            continue
        if port.getType() in (*_COLORS, "filename") and (space := space_of(port)):
            edits.set(port, colorspace=space)
        if definitions is not None:
            _settle_unit(port, definitions, edits, insert=False)
    for element in (copy, *copy.traverseTree()):
        if not isinstance(element, mx.ValueElement):
            element.removeAttribute("colorspace")
    edits.apply(copy)
    return copy


def convert_units(node: mx.Node) -> None:
    """Write the values of a node's inputs in the units that its definition wants.

    Raises:
        MrmError: an unknown unit.
    """
    ports = [port for port in node.getInputs() if port.hasAttribute("unit")]
    if not ports:
        return
    definitions = units.unit_definitions(node.getDocument(), library.shared_library())
    for port in ports:
        holder = outermost(port)
        kind = port.getUnitType()
        if _has_value(holder) and definitions.getUnitTypeDef(kind) and port.getType() in units.CONVERTED:
            scale = units.factor(port, port.getUnit(), kind, definitions)
            numbers = [float(number) * scale for number in holder.getValueString().split(",")]
            port.removeAttribute("interfacename")
            port.setValueString(", ".join(f"{number:.9g}" for number in numbers))
        port.removeAttribute("unit")
