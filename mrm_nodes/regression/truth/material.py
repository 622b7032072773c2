"""MaterialX documents for the regression: one of our nodes under a surface, its inputs free to be driven.

A document fixes what makes a shader another shader: the node, and which inputs a graph or a vertex attribute
drives. Values are uniforms: `uniform_values` gives them, under the names that shader generation uses.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import MaterialX as mx
import numpy as np

from mrm_nodes.errors import MrmError
from mrm_nodes.library import node_names, shared_library

Value = float | bool | str | tuple[float, ...]

NODES = node_names()
"""Ours, conductor, dielectric and generalised Schlick."""
BSDF = "bsdf"
"""Name of our node in each document."""
MATERIAL = "material"
"""Name of the material in each document."""
PATTERNS = Path(__file__).with_name("patterns.mtlx")

CHANNELS = {"float": 1, "vector2": 2, "vector3": 3, "color3": 3}


@dataclass(frozen=True)
class Input:
    """What a node's definition says of one input."""

    type: str
    default: Value | None
    """None: the geometry gives it (normal, tangent)."""
    choices: tuple[str, ...]
    """Of a string, in the order of the numbers that stand for them in GLSL."""
    varying: bool


@functools.cache
def inputs_of(node: str) -> dict[str, Input]:
    """The inputs of a node of ours or of MaterialX, by name, in the definition's order.

    Raises:
        MrmError: no such node.
    """
    definition = shared_library().getNodeDef(f"ND_{node}")
    if definition is None:
        raise MrmError(f"unknown node {node}; the regression knows {', '.join(NODES)}")
    return {each.getName(): _input(each) for each in definition.getActiveInputs()}


def _input(element: mx.Input) -> Input:
    choices = element.getAttribute("enum")
    default = element.getValue()
    if isinstance(default, mx.Vector2 | mx.Vector3 | mx.Color3):
        default = tuple(default[i] for i in range(CHANNELS[element.getType()]))
    return Input(
        type=element.getType(),
        default=None if element.getAttribute("defaultgeomprop") else default,
        choices=tuple(name.strip() for name in choices.split(",")) if choices else (),
        varying=element.getAttribute("uniform") != "true",
    )


def _pairs() -> tuple[tuple[str, str], ...]:
    inputs = inputs_of(NODES[0])
    all_pairs = itertools.product(inputs["distribution"].choices, inputs["masking"].choices)
    return tuple(pair for pair in all_pairs if pair != ("phong", "smith"))


PAIRS = _pairs()
"""Each distribution with each masking that is another lobe: Phong has one."""


def complete(node: str, values: Mapping[str, Value]) -> dict[str, Value]:
    """Every value of a node: those given, and the defaults of the others.

    Raises:
        MrmError: an input or a choice that the node does not have, or a wrong number of channels.
    """
    inputs = inputs_of(node)
    for name, value in values.items():
        if name not in inputs:
            raise MrmError(f"{node} has no input {name}; it has {', '.join(inputs)}")
        _check(node, name, inputs[name], value)
    defaults = {name: each.default for name, each in inputs.items() if each.default is not None}
    return {**defaults, **values}


def _check(node: str, name: str, spec: Input, value: Value) -> None:
    if spec.type == "string":
        if value not in spec.choices:
            raise MrmError(f"{node}/{name}: unknown value {value}; it is one of {', '.join(spec.choices)}")
    elif spec.type in CHANNELS and np.size(value) != CHANNELS[spec.type]:
        raise MrmError(f"{node}/{name}: {value} is no {spec.type} ({CHANNELS[spec.type]} numbers)")


def document(
    node: str,
    patterns: Mapping[str, str] | None = None,
    attributes: Iterable[str] = (),
    base: str | None = None,
    called: str = MATERIAL,
) -> mx.Document:
    """A material whose surface is one node.

    Args:
        node: the BSDF node.
        patterns: by input, the name of the graph of patterns.mtlx that drives it.
        attributes: inputs that vertex attributes of the same name drive.
        base: a BSDF node of MaterialX to lie under ours.
        called: the name of the material.
    """
    doc = mx.createDocument()
    doc.setDataLibrary(shared_library())
    inputs = inputs_of(node)
    bsdf = doc.addNode(node, BSDF, "BSDF")
    for name, pattern in (patterns or {}).items():
        if name not in inputs:
            raise MrmError(f"{node} has no input {name}; it has {', '.join(inputs)}")
        _copy_pattern(doc, pattern)
        driven = bsdf.addInput(name, inputs[name].type)
        driven.setNodeGraphString(pattern)
        driven.setOutputString("out")
    for name in attributes:
        attribute = doc.addNode("geompropvalue", f"attribute_{name}", inputs[name].type)
        attribute.setInputValue("geomprop", name)
        bsdf.addInput(name, inputs[name].type).setConnectedNode(attribute)

    top = bsdf
    if base is not None:
        top = doc.addNode("layer", "layered", "BSDF")
        top.addInput("top", "BSDF").setConnectedNode(bsdf)
        top.addInput("base", "BSDF").setConnectedNode(doc.addNode(base, "base", "BSDF"))
    surface = doc.addNode("surface", "surface", "surfaceshader")
    surface.addInput("bsdf", "BSDF").setConnectedNode(top)
    material = doc.addNode("surfacematerial", called, "material")
    material.addInput("surfaceshader", "surfaceshader").setConnectedNode(surface)
    return doc


@functools.cache
def _patterns() -> mx.Document:
    doc = mx.createDocument()
    mx.readFromXmlFile(doc, str(PATTERNS))
    return doc


def _copy_pattern(doc: mx.Document, name: str) -> None:
    """Copy one graph of patterns.mtlx into a document, once."""
    graph = _patterns().getNodeGraph(name)
    if graph is None:
        known = ", ".join(each.getName() for each in _patterns().getNodeGraphs())
        raise MrmError(f"unknown pattern {name}; known: {known}")
    if doc.getNodeGraph(name) is None:
        doc.addNodeGraph(name).copyContentFrom(graph)


def uniform_values(node: str, values: Mapping[str, Value], prefix: str = BSDF) -> dict[str, Any]:
    """Values under the names and in the form that the generated shader has them: a choice as its number."""
    inputs = inputs_of(node)
    return {
        f"{prefix}_{name}": inputs[name].choices.index(value) if isinstance(value, str) else value
        for name, value in values.items()
    }


def as_float32(value: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The value that a shader sees: rounded to float32, given in float64."""
    return np.asarray(value, np.float32).astype(np.float64)
