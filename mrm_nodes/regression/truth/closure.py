"""A material's closure tree: which scattering functions it is made of, and what drives each of their inputs.

The tree is read from a document whose surfaces and closures are flattened to MaterialX's own nodes. Values that are
written down come with it; where a graph drives an input, the document gets an output there, so that the very
graph can be generated and rendered: no pattern, texture or normal map is implemented twice.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import MaterialX as mx

from mrm_nodes import colorspaces, values
from mrm_nodes.elements import descendant
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.truth.material import CHANNELS, NODES, Value

PLAIN_NODES = ("conductor_bsdf", "dielectric_bsdf", "generalized_schlick_bsdf")
"""MaterialX's own nodes that the evaluator knows, as long as they are isotropic."""
DIFFUSE_NODE = "oren_nayar_diffuse_bsdf"
KNOWN_NODES = (*NODES, *PLAIN_NODES, DIFFUSE_NODE)

_OPAQUE = ("conductor_bsdf", DIFFUSE_NODE, "burley_diffuse_bsdf", "translucent_bsdf", "subsurface_bsdf")
"""Nodes below which nothing shows, whatever their weight."""

MOST_LOBES = 500
"""Parts of a tree beyond which a material is no longer taken apart."""
DEEPEST = 100
"""Mixes and layers within each other, likewise."""
_DEEPEST_FOLD = 8
"""Nodes within each other whose value is looked for."""

_OUTPUT = "mrm_truth_"
"""Start of the names of the outputs that are added to a document."""


class UnknownClosure(MrmError):
    """The evaluator has no model of a part of a material; the message says of which."""


@dataclass(frozen=True)
class Driven:
    """An input that a graph drives: its value has to be rendered."""

    element: str
    """Path of the output that shows it, in the closure's document."""
    channels: int
    infinite: bool = False
    """Whether it may be infinite."""


Port = Value | Driven | None
"""None: the geometry gives it (normal, tangent)."""


@dataclass(frozen=True)
class LobeNode:
    """A scattering function and all of its inputs."""

    node: str
    """Its category, one of KNOWN_NODES."""
    path: str
    inputs: Mapping[str, Port]


@dataclass(frozen=True)
class Nothing:
    """A scattering function of weight 0: no response."""

    opaque: bool
    """Whether it hides what lies below it all the same, as MaterialX's diffuse nodes and metals do."""


@dataclass(frozen=True)
class MixNode:
    """MaterialX's `mix`."""

    fg: Tree
    bg: Tree
    amount: Port


@dataclass(frozen=True)
class AddNode:
    """MaterialX's `add`."""

    in1: Tree
    in2: Tree


@dataclass(frozen=True)
class MultiplyNode:
    """MaterialX's `multiply`."""

    in1: Tree
    in2: Port


@dataclass(frozen=True)
class LayerNode:
    """MaterialX's `layer`."""

    top: Tree
    base: Tree


@dataclass(frozen=True)
class VolumeNode:
    """MaterialX's `layer` over a volume: it absorbs a part of what comes through the surface."""

    top: Tree
    absorption: Port
    """The exponent, for as much of the volume as MaterialX takes any light through."""


Tree = LobeNode | Nothing | MixNode | AddNode | MultiplyNode | LayerNode | VolumeNode


@dataclass(frozen=True)
class SurfaceTree:
    """A surface: what it scatters, and what has to be 1 (opacity) and 0 (emission) for it to be only that."""

    document: mx.Document
    """Where the outputs of driven inputs lie."""
    flattened: bool
    """Whether a node was replaced by its graph, so that the document's paths are no longer the material's."""
    tree: Tree
    opacity: Port
    emission: tuple[Port, ...]
    """Colours and weights of which, in each of the surface's emissions, one is a factor."""


def closure_of(document: mx.Document, element: str) -> SurfaceTree:
    """The closure tree of a material, or of a surface shader, by its path in a document that generation accepts.

    Raises:
        UnknownClosure: it has a part that the evaluator does not know.
    """
    copy = values.explicit(document)
    flattened = _flatten(copy)
    top = descendant(copy, element)
    if top is None and flattened:
        raise UnknownClosure(f"{element} is not itself a material: name the material")
    reader = _Reader(copy)
    surface = reader.surface(top)
    bsdf = surface.getInput("bsdf")
    return SurfaceTree(
        copy,
        flattened,
        Nothing(opaque=False) if bsdf is None else reader.tree(bsdf),
        reader.port(surface, "opacity"),
        tuple(reader.emissions(surface.getInput("edf"))),
    )


def lobes(tree: Tree) -> Iterator[LobeNode]:
    """The scattering functions of a tree."""
    match tree:
        case LobeNode():
            yield tree
        case MixNode(first, second, _) | AddNode(first, second) | LayerNode(first, second):
            yield from lobes(first)
            yield from lobes(second)
        case MultiplyNode(inner, _) | VolumeNode(inner, _):
            yield from lobes(inner)


def has_layers(tree: Tree) -> bool:
    """Whether one scattering function of a tree lies on another."""
    match tree:
        case LayerNode(top, base):
            both = all(any(lobes(each)) for each in (top, base))
            return both or has_layers(top) or has_layers(base)
        case MixNode(first, second, _) | AddNode(first, second):
            return has_layers(first) or has_layers(second)
        case MultiplyNode(inner, _) | VolumeNode(inner, _):
            return has_layers(inner)
        case _:
            return False


def ports(tree: Tree) -> Iterator[Port]:
    """All that a tree is given: the inputs of its lobes, and what mixes and multiplies them."""
    match tree:
        case LobeNode():
            yield from tree.inputs.values()
        case MixNode(first, second, amount):
            yield amount
            yield from ports(first)
            yield from ports(second)
        case AddNode(first, second) | LayerNode(first, second):
            yield from ports(first)
            yield from ports(second)
        case MultiplyNode(inner, port) | VolumeNode(inner, port):
            yield port
            yield from ports(inner)


def reflecting(tree: Tree) -> Tree:
    """The part of a tree that reflects light."""
    match tree:
        case LobeNode(inputs=inputs):
            mode = inputs.get("scatter_mode", "R")
            if mode == "T":
                return Nothing(opaque=False)
            return tree if mode == "R" else replace(tree, inputs={**inputs, "scatter_mode": "R"})
        case Nothing():
            return tree
        case MixNode(fg, bg, amount):
            return MixNode(reflecting(fg), reflecting(bg), amount)
        case AddNode(in1, in2):
            return AddNode(reflecting(in1), reflecting(in2))
        case MultiplyNode(in1, in2):
            return MultiplyNode(reflecting(in1), in2)
        case LayerNode(top, base):
            return LayerNode(reflecting(top), reflecting(base))
        case VolumeNode(top, _):
            return reflecting(top)


def _flatten(document: mx.Document) -> bool:
    """Replace surfaces and closures by the graphs that implement them; whether there were any."""

    def is_closure(node: mx.Node) -> bool:
        found = node.getType() in ("BSDF", "EDF", "VDF", "surfaceshader")
        if found:
            values.convert_units(node)
        return found

    # Not `getNodeGraphs`, which has those of the data library too.
    graphs = [each for each in document.getChildren() if isinstance(each, mx.NodeGraph)]
    replaced = False
    for graph in [document, *graphs]:
        if graph.getAttribute("nodedef"):
            continue
        closures = [each for each in graph.getChildren() if isinstance(each, mx.Node) and is_closure(each)]
        if any(isinstance(each.getImplementation("genglsl"), mx.NodeGraph) for each in closures):
            graph.flattenSubgraphs("genglsl", is_closure)
            replaced = True
    return replaced


@dataclass
class _Reader:
    """Reads trees from one document, adding an output for each source that drives an input."""

    document: mx.Document
    outputs: dict[tuple[str, ...], Driven] = field(default_factory=dict)
    above: list[str] = field(default_factory=list)
    """The nodes between the surface and the one that is read."""
    read: int = 0
    """How many were read."""
    declared: dict[int, tuple[mx.Node, mx.NodeDef]] = field(default_factory=dict)
    """Nodes, by their identity, and their definitions: MaterialX looks each up among all that there are."""

    def definition(self, node: mx.Node) -> mx.NodeDef:
        """The definition of a node, or None."""
        if id(node) not in self.declared:
            self.declared[id(node)] = node, node.getNodeDef()
        return self.declared[id(node)][1]

    def surface(self, element: mx.Element | None) -> mx.Node:
        """The `surface` node of a material, a shader or an output."""
        node = element
        if isinstance(node, mx.Output):
            node = node.getConnectedNode()
        if isinstance(node, mx.Node) and node.getType() == "material":
            shader = node.getInput("surfaceshader")
            node = _source(shader) if shader is not None else None
        if not isinstance(node, mx.Node) or node.getType() != "surfaceshader":
            raise UnknownClosure("it is no material with a surface")
        if node.getCategory() != "surface":
            raise UnknownClosure(
                f"{node.getName()} is a {node.getCategory()}, which the evaluator does not know"
            )
        return node

    def tree(self, port: mx.Input) -> Tree:
        """The tree that is connected to an input."""
        node = _source(port)
        if node is None:
            return Nothing(opaque=False)
        path, category = node.getNamePath(), node.getCategory()
        with self._within(path):
            return self._node(node, category, path)

    @contextmanager
    def _within(self, path: str) -> Iterator[None]:
        """Read what a node is made of."""
        if path in self.above:
            raise UnknownClosure(f"{path} contains itself")
        self.read += 1
        if self.read > MOST_LOBES:
            raise UnknownClosure(f"it has more than {MOST_LOBES} lobes, mixes and layers")
        if len(self.above) > DEEPEST:
            raise UnknownClosure(f"it has more than {DEEPEST} mixes and layers within each other")
        self.above.append(path)
        try:
            yield
        finally:
            self.above.pop()

    def _node(self, node: mx.Node, category: str, path: str) -> Tree:
        if category == "mix":
            amount = self.port(node, "mix")
            # A part that a constant leaves out need not be known.
            if amount in (0.0, 1.0):
                return self._part(node, "bg" if amount == 0.0 else "fg")
            return MixNode(self._part(node, "fg"), self._part(node, "bg"), amount)
        if category == "add":
            return AddNode(self._part(node, "in1"), self._part(node, "in2"))
        if category == "multiply":
            return MultiplyNode(self._part(node, "in1"), self.port(node, "in2"))
        if (
            category == "layer"
            and node.getInput("base") is not None
            and node.getInput("base").getType() == "VDF"
        ):
            return self._over_volume(node)
        if category == "layer":
            return LayerNode(self._part(node, "top"), self._part(node, "base"))
        if self._has_weight(node) and self.port(node, "weight") == 0.0:
            return Nothing(category.removeprefix("mrm_") in _OPAQUE)
        if category not in KNOWN_NODES:
            raise UnknownClosure(f"{path} is a {category}, which the evaluator does not know")
        return self._lobe(node, category, path)

    def _over_volume(self, node: mx.Node) -> Tree:
        top, below = self._part(node, "top"), _source(node.getInput("base"))
        if below is None:
            return top
        if below.getCategory() != "anisotropic_vdf":
            raise UnknownClosure(
                f"{below.getNamePath()} is a {below.getCategory()}, which the evaluator does not know"
            )
        absorption = self.port(below, "absorption")
        # The logarithm of a colour, which may be black.
        return VolumeNode(
            top, replace(absorption, infinite=True) if isinstance(absorption, Driven) else absorption
        )

    def _has_weight(self, node: mx.Node) -> bool:
        declared = self.definition(node)
        return declared is not None and declared.getActiveInput("weight") is not None

    def _part(self, node: mx.Node, name: str) -> Tree:
        port = node.getInput(name)
        return Nothing(opaque=False) if port is None else self.tree(port)

    def _lobe(self, node: mx.Node, category: str, path: str) -> LobeNode:
        inputs = {
            each.getName(): self.port(node, each.getName())
            for each in self.definition(node).getActiveInputs()
        }
        for name, value in inputs.items():
            if isinstance(value, Driven) and not value.channels:
                raise UnknownClosure(f"{path}/{name} is driven by a graph, and is no number")
        alpha = inputs.get("roughness")
        reflects = inputs.get("scatter_mode") != "T"
        if category in PLAIN_NODES and reflects and isinstance(alpha, tuple) and alpha[0] != alpha[1]:
            raise UnknownClosure(
                f"{path} is an anisotropic {category}, whose masking MaterialX approximates; mrm_{category} is exact"
            )
        return LobeNode(category, path, inputs)

    def emissions(self, port: mx.Input | None) -> list[Port]:
        """What has to be 0 for a tree of emission to emit nothing; the evaluator adds none."""
        node = None if port is None else _source(port)
        if node is None:
            return []
        if node.getCategory() == "uniform_edf":
            colour = self.port(node, "color")
            return [] if colour == (0.0, 0.0, 0.0) else [colour]
        factor = {"multiply": "in2", "mix": "mix"}.get(node.getCategory())
        if factor == "in2" and self.port(node, "in2") in (0.0, (0.0, 0.0, 0.0)):
            return []
        found = []
        with self._within(node.getNamePath()):
            for each in node.getInputs():
                if each.getType() == "EDF":
                    found += self.emissions(each)
        return found

    def port(self, node: mx.Node, name: str, folded_in: int = 0) -> Port:
        """What an input of a node is given.

        folded_in: how many nodes' values hang on it.
        """
        declared = self.definition(node).getActiveInput(name)
        given = node.getInput(name)
        port = None if given is None else _outermost(given)
        if port is not None and (port.hasAttribute("nodename") or port.hasAttribute("nodegraph")):
            folded = self._folded(port, folded_in + 1)
            return self._driven(port) if folded is None else folded
        if declared.getAttribute("defaultgeomprop"):
            # MaterialX's generators pass over a value there.
            return None
        if port is not None and port.getValue() is not None:
            space = values.space_of(given) if port.getType() == "color3" else ""
            return plain_value(port) if colorspaces.is_linear(space) else self._decoded(port, space)
        return plain_value(declared)

    def _folded(self, port: mx.Input, depth: int) -> float | None:
        """The number that `extract` and `max` make of constants: so `gltf_pbr` knows that it has no sheen."""
        node = _source(port)
        is_known = node is not None and port.getType() == "float" and node.getCategory() in ("extract", "max")
        if node is None or not is_known or depth > _DEEPEST_FOLD:
            return None
        if node.getCategory() == "extract":
            whole, index = self.port(node, "in", depth), self.port(node, "index", depth)
            return whole[int(index)] if isinstance(whole, tuple) and isinstance(index, float) else None
        first, second = self.port(node, "in1", depth), self.port(node, "in2", depth)
        return max(first, second) if isinstance(first, float) and isinstance(second, float) else None

    def _driven(self, port: mx.Input) -> Driven:
        """What drives a port: a graph's own output, or one that is added to a node beside it."""
        kind = port.getType()
        scope = port.getParent().getParent()
        if port.hasAttribute("nodegraph"):
            shown = port.getConnectedOutput()
            if shown is None:
                raise UnknownClosure(f"{port.getNamePath()} is connected to what does not exist")
            return Driven(shown.getNamePath(), CHANNELS.get(kind, 0))
        key = (scope.getNamePath(), port.getNodeName(), port.getOutputString(), kind)
        if key not in self.outputs:
            output = scope.addOutput(f"{_OUTPUT}{len(self.outputs)}", kind)
            output.setNodeName(port.getNodeName())
            if port.getOutputString():
                output.setOutputString(port.getOutputString())
            self.outputs[key] = Driven(output.getNamePath(), CHANNELS.get(kind, 0))
        return self.outputs[key]

    def _decoded(self, port: mx.Input, space: str) -> Driven:
        """A value that generation decodes, such as one in sRGB: shown through a `constant` node."""
        key = (port.getNamePath(), space)
        if key not in self.outputs:
            number = len(self.outputs)
            constant = self.document.addNode("constant", f"{_OUTPUT}{number}_value", port.getType())
            value = constant.addInput("value", port.getType())
            value.setValueString(port.getValueString())
            value.setColorSpace(space)
            output = self.document.addOutput(f"{_OUTPUT}{number}", port.getType())
            output.setNodeName(constant.getName())
            self.outputs[key] = Driven(output.getNamePath(), CHANNELS[port.getType()])
        return self.outputs[key]


def _source(port: mx.Input) -> mx.Node | None:
    """The node that is connected to an input, through graphs and interfaces."""
    port = _outermost(port)
    connected = port.hasAttribute("nodegraph") or port.hasAttribute("nodename")
    return port.getConnectedNode() if connected else None


def _outermost(port: mx.Input) -> mx.Input:
    """The input by which a value comes into the graphs around a port."""
    for _ in range(MOST_LOBES):
        outer = port.getInterfaceInput() if port.hasAttribute("interfacename") else None
        if outer is None:
            return port
        port = outer
    raise UnknownClosure(f"{port.getNamePath()} is its own interface")


def plain_value(port: mx.Input) -> Value:
    """A port's value as numbers, text or a truth value."""
    value = port.getValue()
    if value is None and port.getType() == "string":
        return str(port.getValueString())
    if isinstance(value, mx.Vector2 | mx.Vector3 | mx.Color3):
        return tuple(float(value[i]) for i in range(CHANNELS[port.getType()]))
    return value if isinstance(value, bool | str) else float(value)
