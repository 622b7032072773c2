"""Materials laid out so that MaterialX's MDL generator keeps every closure of them.

It builds a layer only over a node that it knows by name to have a base: under a mix, a sum, a factor, another layer or
a node that a graph implements, the base is lost (MaterialX/source/MaterialXGenMdl/Nodes/ClosureLayerNodeMdl.cpp). What
pbrlib's GLSL says of layer, mix, add and multiply lets each be written with such nodes on top.
"""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import MaterialX as mx

from mrm_nodes import library

TARGET = "genmdl"

#: BSDFs with a base in MDL, each with its inputs that scale its reflected light.
_LAYERABLE = {
    "dielectric_bsdf": ("tint",),
    "sheen_bsdf": ("color",),
    "generalized_schlick_bsdf": ("color0", "color90"),
}
#: BSDFs that let nothing through: pbrlib's GLSL gives each the throughput 0.
_OPAQUE = {
    "conductor_bsdf",
    "oren_nayar_diffuse_bsdf",
    "burley_diffuse_bsdf",
    "translucent_bsdf",
    "subsurface_bsdf",
    "chiang_hair_bsdf",
}
#: The inputs through which each node is made of other BSDFs.
_PARTS = {
    "mix": ("fg", "bg"),
    "add": ("in1", "in2"),
    "multiply": ("in1",),
    "layer": ("top", "base"),
}
_CONNECTIONS = ("nodename", "nodegraph", "output", "interfacename", "channels")
#: What an input is set to; what is not here describes it.
_SETTINGS = (*_CONNECTIONS, "value", "colorspace", "unit", "unittype")
_GEOMETRY = {
    "P": "position",
    "N": "normal",
    "T": "tangent",
    "B": "bitangent",
    "V": "viewdirection",
    "U": "texcoord",
}


def prepared(
    document: mx.Document, libraries: str | os.PathLike[str] | None = None
) -> tuple[mx.Document, list[str]]:
    """Return a copy of a document that loses nothing in MDL, and what is drawn there in another way than elsewhere.

    Our nodes leave `distribution` alone in it: the generator takes such an input for its own type of that name, which
    knows ggx only; the portable graphs, which MDL renders, do not use it.
    """
    copy = mx.createDocument()
    copy.copyContentFrom(document)
    notes: dict[str, list[str]] = {}
    if document.hasDataLibrary():
        shared, notes = _library(None if libraries is None else Path(libraries).resolve())
        copy.setDataLibrary(shared)
    graphs = [child for child in copy.getChildren() if isinstance(child, mx.NodeGraph)]
    for node in [*copy.getNodes(), *(node for graph in graphs for node in graph.getNodes())]:
        if node.getCategory().startswith("mrm_") and node.getType() == "BSDF":
            node.removeInput("distribution")
    for graph in graphs:
        if not graph.getNodeDefString() and any(_is_closure(port) for port in _ports_of(graph)):
            _inline_graph(copy, graph)
    found = [note for graph in (copy, *graphs) for note in _rewrite(graph)]
    used: dict[str, None] = {}
    for graph in (copy, *(each for each in graphs if not each.getNodeDefString())):
        _add_graphs_behind(graph, used)
    return copy, list(dict.fromkeys([*found, *(note for name in used for note in notes.get(name, []))]))


@functools.cache
def _library(libraries: Path | None) -> tuple[mx.Document, dict[str, list[str]]]:
    """The library with its own graphs laid out for MDL, and what had to be drawn in another way, by graph."""
    copy = mx.createDocument()
    copy.copyContentFrom(library.shared_library(libraries))
    return copy, {graph.getName(): _rewrite(graph) for graph in copy.getNodeGraphs()}


def _rewrite(graph: mx.GraphElement) -> list[str]:
    # One that is given BSDFs is copied into the graph that gives them.
    is_given = any(
        _is_closure(port) and port.hasAttribute("interfacename")
        for node in graph.getNodes()
        for port in node.getInputs()
    )
    return [] if is_given else _Rewriting(graph).rewrite()


def _add_graphs_behind(graph: mx.GraphElement, found: dict[str, None]) -> None:
    """Add the names of the graphs that implement the nodes of a graph, all the way down."""
    for node in graph.getNodes():
        inner = node.getImplementation(TARGET)
        if isinstance(inner, mx.NodeGraph) and inner.getName() not in found:
            found[inner.getName()] = None
            _add_graphs_behind(inner, found)


def _is_closure(port: mx.PortElement | mx.Input | mx.Output) -> bool:
    return bool(port.getType() == "BSDF")


def _ports_of(graph: mx.NodeGraph) -> list[mx.Input | mx.Output]:
    return [*graph.getInputs(), *graph.getOutputs()]


def _scope(graph: mx.GraphElement) -> Iterator[mx.Input | mx.Output]:
    """Yield the ports that name nodes of a graph."""
    for node in graph.getNodes():
        yield from node.getInputs()
    yield from graph.getOutputs()
    if isinstance(graph, mx.Document):
        for inner in graph.getNodeGraphs():
            yield from inner.getInputs()


def _set_as(port: mx.Input | mx.Output, source: mx.ValueElement | None) -> None:
    """Set a port to what another one is set to."""
    for name in _SETTINGS:
        port.removeAttribute(name)
        if source is not None and source.hasAttribute(name):
            port.setAttribute(name, source.getAttribute(name))
    if source is not None and not port.hasAttribute("colorspace") and source.hasAttribute("value"):
        space = source.getActiveColorSpace()
        if space and (port.getType().startswith("color") or port.getType() == "filename"):
            port.setAttribute("colorspace", space)


# --- graphs in graphs ---------------------------------------------------------------------------------------


def _inline(
    owner: mx.GraphElement, graph: mx.NodeGraph, stem: str, given: Callable[[str], mx.ValueElement | None]
) -> dict[str, mx.Output]:
    """Copy the nodes of a graph to `owner`; return its outputs, set so as to name the copies.

    given: what is set from outside, by the graph's input.
    """
    names = {}
    for node in graph.getNodes():
        made = owner.addNode(
            node.getCategory(), owner.createValidChildName(f"{stem}_{node.getName()}"), node.getType()
        )
        made.copyContentFrom(node)
        names[node.getName()] = made.getName()
        for attribute in ("fileprefix", "geomprop", "colorspace"):
            if graph.hasAttribute(attribute) and not made.hasAttribute(attribute):
                made.setAttribute(attribute, graph.getAttribute(attribute))
    for name in names.values():
        node = owner.getNode(name)
        for port in node.getInputs():
            if port.hasAttribute("interfacename"):
                source = given(port.getInterfaceName())
                _set_as(port, source)
                if not any(port.hasAttribute(one) for one in (*_CONNECTIONS, "value")):
                    _set_to_geometry(owner, node, port, source)
            elif port.hasAttribute("nodename"):
                port.setNodeName(names.get(port.getNodeName(), port.getNodeName()))
    outputs = {}
    holder = mx.createDocument()
    for output in graph.getOutputs():
        made = holder.addOutput(output.getName(), output.getType())
        _set_as(
            made,
            given(output.getAttribute("interfacename")) if output.hasAttribute("interfacename") else output,
        )
        if made.hasAttribute("nodename") and not output.hasAttribute("interfacename"):
            made.setNodeName(names.get(made.getNodeName(), made.getNodeName()))
        outputs[output.getName()] = made
    return outputs


def _set_to_geometry(
    owner: mx.GraphElement, node: mx.Node, port: mx.Input, source: mx.ValueElement | None
) -> None:
    """Set an input that nothing is given for: to the geometry that the outer definition names, or as its own says."""
    wanted = source.getAttribute("defaultgeomprop") if source is not None else ""
    definition = node.getNodeDef(TARGET)
    own = definition.getActiveInput(port.getName()) if definition is not None else None
    if wanted and (own is None or own.getAttribute("defaultgeomprop") != wanted):
        made = owner.addNode(
            _GEOMETRY[wanted[0]], owner.createValidChildName(f"{node.getName()}_{wanted}"), port.getType()
        )
        if wanted[0] != "U":
            made.addInput("space", "string").setValueString(wanted[1:])
        port.setNodeName(made.getName())
    else:
        node.removeInput(port.getName())


def _inline_graph(document: mx.Document, graph: mx.NodeGraph) -> None:
    """Have what refers to a graph's BSDFs refer to copies of its nodes beside it."""
    outputs = _inline(document, graph, graph.getName(), graph.getInput)
    first = next(iter(outputs), "")
    for port in list(_scope(document)):
        if port.getAttribute("nodegraph") == graph.getName() and _is_closure(port):
            _set_as(port, outputs.get(port.getAttribute("output") or first))


def _inline_node(graph: mx.GraphElement, node: mx.Node, inner: mx.NodeGraph) -> None:
    definition = node.getNodeDef(TARGET)
    outputs = _inline(
        graph,
        inner,
        node.getName(),
        lambda name: node.getInput(name) or definition.getActiveInput(name),
    )
    first = next(iter(outputs), "")
    for port in list(_scope(graph)):
        if port.getAttribute("nodename") == node.getName():
            _set_as(port, outputs.get(port.getAttribute("output") or first))
    graph.removeNode(node.getName())


# --- layers -------------------------------------------------------------------------------------------------


class _Rewriting:
    """Rewrites the layers of one graph in place."""

    def __init__(self, graph: mx.GraphElement) -> None:
        self.graph = graph
        self.notes: list[str] = []
        self.made: dict[tuple[str, str], str] = {}

    def rewrite(self) -> list[str]:
        """Rewrite every layer that MDL would lose, and return what is drawn in another way than elsewhere."""
        while (found := self._opaque_to_the_generator()) is not None:
            _inline_node(self.graph, *found)
        for node in self._layers():
            top, base = self._part(node, "top"), self._part(node, "base")
            kept = top and base and self._category(top) in _LAYERABLE
            if self._is_over_volume(node) or kept:
                continue
            self._redirect(node.getName(), self.over(top, base))
            self.graph.removeNode(node.getName())
        return self.notes

    def _layers(self) -> list[mx.Node]:
        return [node for node in self.graph.getNodes("layer") if node.getType() == "BSDF"]

    def _opaque_to_the_generator(self) -> tuple[mx.Node, mx.NodeGraph] | None:
        """A node that a graph implements, and the graph, where the generator has to see into it."""
        tops = {name for layer in self._layers() for name in self._made_of(self._part(layer, "top"))}
        for node in self.graph.getNodes():
            takes = any(_is_closure(port) for port in node.getInputs())
            if node.getName() in tops or takes:
                inner = node.getImplementation(TARGET)
                if isinstance(inner, mx.NodeGraph):
                    return node, inner
        return None

    def _made_of(self, name: str) -> Iterator[str]:
        if name:
            yield name
            for part in _PARTS.get(self._category(name), ()):
                yield from self._made_of(self._part(self.graph.getNode(name), part))

    def _part(self, node: mx.Node, name: str) -> str:
        """Return the name of the node that an input is connected to; empty for none."""
        port = node.getInput(name)
        found = port.getNodeName() if port is not None else ""
        return found if found and self.graph.getNode(found) is not None else ""

    def _category(self, name: str) -> str:
        return str(self.graph.getNode(name).getCategory())

    def _is_over_volume(self, node: mx.Node) -> bool:
        base = node.getInput("base")
        return node.getCategory() == "layer" and base is not None and base.getType() == "VDF"

    def _redirect(self, old: str, new: str) -> None:
        for port in list(_scope(self.graph)):
            if port.getAttribute("nodename") == old:
                if new:
                    port.setNodeName(new)
                else:
                    port.removeAttribute("nodename")

    def _copy(self, name: str, **parts: str) -> str:
        """Add a copy of a node that is made of other BSDFs."""
        original = self.graph.getNode(name)
        made = self.graph.addNode(
            original.getCategory(), self.graph.createValidChildName(f"{name}_over"), original.getType()
        )
        made.copyContentFrom(original)
        for part, source in parts.items():
            made.removeInput(part)
            if source:
                made.addInput(part, "BSDF").setNodeName(source)
        return str(made.getName())

    def over(self, top: str, base: str) -> str:
        """Return the name of a node that is `top` over `base`, by nodes that MDL can layer."""
        if not top or not base or self._is_opaque(top):
            return top or base
        if (top, base) not in self.made:
            self.made[top, base] = self._over(top, base)
        return self.made[top, base]

    def _over(self, top: str, base: str) -> str:
        node, category = self.graph.getNode(top), self._category(top)
        parts = [self._part(node, part) for part in _PARTS.get(category, ())]
        if category == "mix":
            return self._copy(top, fg=self.over(parts[0], base), bg=self.over(parts[1], base))
        if self._is_over_volume(node):
            return self._copy(top, top=self.over(parts[0], base))
        if category == "layer":
            return self.over(parts[0], self.over(parts[1], base))
        if category == "add" and all(parts):
            self._note(top, "in1 is drawn over in2: MDL has no base under a sum")
            return self.over(parts[0], self.over(parts[1], base))
        if category == "add":
            return self.over(parts[0] or parts[1], base)
        if category == "multiply" and not parts[0]:
            return base
        if category == "multiply":
            scaled = self._scaled(parts[0], node.getInput("in2"))
            if self._category(scaled) != "multiply":
                return self.over(scaled, base)
        if category not in _LAYERABLE:
            self._note(top, f"{category} is drawn without its base, {base}: MDL has no base for it")
        made = self.graph.addNode("layer", self.graph.createValidChildName(f"{top}_layer"), "BSDF")
        made.addInput("top", "BSDF").setNodeName(top)
        made.addInput("base", "BSDF").setNodeName(base)
        return str(made.getName())

    def _note(self, name: str, what: str) -> None:
        self.notes.append(f"{self.graph.getNode(name).getNamePath()}: {what}")

    def _is_opaque(self, name: str) -> bool:
        """Whether nothing below it is seen, by the throughputs of pbrlib's GLSL."""
        if not name:
            return False
        category = self._category(name)
        parts = [self._is_opaque(self._part(self.graph.getNode(name), p)) for p in _PARTS.get(category, ())]
        if category == "mix":
            return all(parts)
        return category in _OPAQUE or any(parts)

    def _scaled(self, name: str, factor: mx.Input | None) -> str:
        """Return the name of a node that reflects a part of the light of another and lets through as much."""
        node, category = self.graph.getNode(name), self._category(name)
        if category == "multiply":
            inner = self._scaled(self._part(node, "in1"), node.getInput("in2"))
            if self._category(inner) != "multiply":
                return self._scaled(inner, factor)
        elif category in _PARTS:
            parts = ("top",) if self._is_over_volume(node) else _PARTS[category]
            sources = {part: self._part(node, part) for part in parts}
            return self._copy(
                name, **{part: source and self._scaled(source, factor) for part, source in sources.items()}
            )
        elif category in _LAYERABLE:
            if len(_LAYERABLE[category]) > 1:
                self._note(name, "lets more light through where it is multiplied: MDL has no tint for it")
            copy = self._copy(name)
            for tinted in _LAYERABLE[category]:
                self._tint(self.graph.getNode(copy), tinted, factor)
            return copy
        made = self.graph.addNode("multiply", self.graph.createValidChildName(f"{name}_scaled"), "BSDF")
        made.addInput("in1", "BSDF").setNodeName(name)
        _set_as(made.addInput("in2", factor.getType() if factor is not None else "float"), factor)
        return str(made.getName())

    def _tint(self, node: mx.Node, name: str, factor: mx.Input | None) -> None:
        """Multiply an input of a node by a factor, clamped to [0, 1] as pbrlib's multiply clamps it."""
        if factor is None:
            return
        limited = self.graph.addNode(
            "clamp", self.graph.createValidChildName(f"{node.getName()}_factor"), factor.getType()
        )
        _set_as(limited.addInput("in", factor.getType()), factor)
        product = self.graph.addNode(
            "multiply", self.graph.createValidChildName(f"{node.getName()}_{name}"), "color3"
        )
        _set_as(
            product.addInput("in1", "color3"),
            node.getInput(name) or node.getNodeDef(TARGET).getActiveInput(name),
        )
        product.addInput("in2", factor.getType()).setNodeName(limited.getName())
        node.removeInput(name)
        node.addInput(name, "color3").setNodeName(product.getName())


# --- retroreflection ----------------------------------------------------------------------------------------


def find_module(name: str, libraries: str | os.PathLike[str] | None = None) -> Path | None:
    """Return the file of one of MaterialX's MDL modules: beside the node libraries, else on MDL's search path."""
    roots = [(library.own_libraries() if libraries is None else Path(libraries)) / "mdl"]
    for variable in ("MDL_USER_PATH", "MDL_SYSTEM_PATH"):
        roots += [Path(root) for root in os.environ.get(variable, "").split(os.pathsep) if root]
    files = (root / "materialx" / f"{name}.mdl" for root in roots)
    return next((file for file in files if file.is_file()), None)


def has_backscatter(module: Path) -> bool:
    """Whether a module's microfacet closures turn the light back, its own or those that it takes from older ones."""
    seen: set[str] = set()
    names = [module.stem]
    while names:
        name = names.pop()
        file = module.with_name(f"{name}.mdl")
        if name in seen or not file.is_file():
            continue
        seen.add(name)
        text = re.sub(r"//[^\n]*|/\*.*?\*/", "", file.read_text(encoding="utf-8"), flags=re.DOTALL)
        if re.search(r"\bbackscatter", text):
            return True
        names += re.findall(r"\.::(pbrlib_\w+)", text)
    return False
