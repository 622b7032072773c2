"""What a target, or a method of evaluating environment light, leaves out of a material."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Iterator

import MaterialX as mx

from mrm_nodes import library, mdl

#: Inputs that only fused code knows, with the value that MaterialX's own nodes stand for.
_FUSED_ONLY = {"distribution": "ggx", "masking": "smith", "retro_transmission": "false"}
#: Inputs that MaterialX's environment functions do not know, with the value that they stand for.
_DIRECT_ONLY = {"distribution": "ggx", "masking": "smith"}


def ignored_inputs(
    document: mx.Document,
    generator_target: str,
    environment: str = "fis",
    libraries: str | os.PathLike[str] | None = None,
) -> list[str]:
    """Name each input of our nodes that a target or an environment method ignores, and what it does instead.

    For MDL, also each BSDF that it does not draw as MaterialX's GLSL does.

    Args:
        document: has its data library set.
        generator_target: MaterialX's own name for the target, such as `genosl`.
        environment: `fis`, `prefilter` or `none`, for targets of the GLSL family.
        libraries: the MaterialX `libraries` folder, by default that of the installed MaterialX.
    """
    found: dict[str, None] = {}
    for bsdf, place in _bsdfs_of(document, generator_target):
        found.update(dict.fromkeys(_ignored_of(bsdf, place, generator_target, environment, libraries)))
    if generator_target == mdl.TARGET:
        found.update(dict.fromkeys(mdl.prepared(document, libraries)[1]))
    return list(found)


def honoured_inputs(
    document: mx.Document, generator_target: str, libraries: str | os.PathLike[str] | None = None
) -> list[str]:
    """Name each weight for retroreflection that MDL draws, and by which module: not every one can.

    Arguments are those of `ignored_inputs`.
    """
    if generator_target != mdl.TARGET or _without_backscatter(libraries):
        return []
    found: dict[str, None] = {}
    for _, inputs in _bsdfs_of(document, generator_target):
        if _is_set(inputs, "retroreflectivity", "0"):
            file = mdl.find_module(_mdl_module(), libraries)
            found[f"{inputs['retroreflectivity'][0]} is drawn by {mdl.TARGET}: {file} has backscatter"] = None
    return list(found)


def _bsdfs_of(document: mx.Document, target: str) -> Iterator[tuple[mx.Node, _Inputs]]:
    nodes = [*document.getNodes(), *(node for graph in _own_graphs(document) for node in graph.getNodes())]
    for node in nodes:
        yield from _our_bsdfs(node, target, {})


def _own_graphs(document: mx.Document) -> list[mx.NodeGraph]:
    """Return the graphs that are part of the material, not those that implement a definition."""
    return [graph for graph in document.getNodeGraphs() if not graph.getNodeDefString()]


#: By input that is set: the path by which a user knows it, and its value; None where it is connected.
_Inputs = dict[str, tuple[str, str | None]]


def _our_bsdfs(node: mx.Node, target: str, outer: _Inputs) -> Iterator[tuple[mx.Node, _Inputs]]:
    """Yield each node of ours that a node stands for, with where its inputs are set and to what.

    outer: the same of the graph that the node is part of, by the graph's input.
    """
    inputs: _Inputs = {}
    for given in node.getInputs():
        interface = given.getInterfaceName()
        if interface:
            if interface in outer:
                inputs[given.getName()] = outer[interface]
            continue
        connected = given.getNodeName() or given.getNodeGraphString() or given.getOutputString()
        inputs[given.getName()] = (given.getNamePath(), None if connected else given.getValueString())
    if node.getCategory() in library.node_names():
        yield node, inputs
        return
    definition = node.getNodeDef(target) or node.getNodeDef()
    implementation = definition.getImplementation(target) if definition is not None else None
    if isinstance(implementation, mx.NodeGraph):
        for inner in implementation.getNodes():
            yield from _our_bsdfs(inner, target, inputs)


def _ignored_of(
    node: mx.Node,
    inputs: _Inputs,
    target: str,
    environment: str,
    libraries: str | os.PathLike[str] | None,
) -> Iterator[str]:
    definition = node.getNodeDef(target) or node.getNodeDef()
    for name, (own, reason) in _left_out(definition, target, environment, libraries).items():
        if _is_set(inputs, name, own):
            yield f"{inputs[name][0]} is ignored {reason}"


def left_out(
    generator_target: str, environment: str = "fis", libraries: str | os.PathLike[str] | None = None
) -> list[str]:
    """Name the inputs of our nodes that a target or an environment method ignores.

    Arguments are those of `ignored_inputs`.
    """
    # The node that has every input that may be ignored.
    definition = library.shared_library().getNodeDef("ND_mrm_dielectric_bsdf")
    return list(_left_out(definition, generator_target, environment, libraries))


def _left_out(
    definition: mx.NodeDef | None,
    target: str,
    environment: str,
    libraries: str | os.PathLike[str] | None,
) -> dict[str, tuple[str, str]]:
    """By input: the value that is rendered anyway, and where it is ignored."""
    implementation = definition.getImplementation(target) if definition is not None else None
    if isinstance(implementation, mx.NodeGraph):
        found = {
            name: (own, f"by {target}: it renders {_meaning(name, own)}") for name, own in _FUSED_ONLY.items()
        }
        reason = ""
        if target in library.host(libraries).forward_targets:
            reason = "it renders the forward lobe only"
        elif target == mdl.TARGET:
            reason = _without_backscatter(libraries)
        return {"retroreflectivity": ("0", f"by {target}: {reason}"), **found} if reason else found
    if environment == "prefilter":
        # Importance sampling goes through our own loop, which knows the node's own lobe.
        where = "in environment light (prefilter): MaterialX's own function renders"
        return {name: (own, f"{where} {_meaning(name, own)}") for name, own in _DIRECT_ONLY.items()}
    return {}


def _without_backscatter(libraries: str | os.PathLike[str] | None) -> str:
    """Say why MDL renders the forward lobe only; empty where it does not."""
    name = _mdl_module()
    file = mdl.find_module(name, libraries)
    if file is None:
        return (
            f"it renders the forward lobe only, unless the renderer's {name}.mdl has backscatter; "
            "there is none here"
        )
    return "" if mdl.has_backscatter(file) else f"it renders the forward lobe only; {file} has no backscatter"


@functools.cache
def _mdl_module() -> str:
    """The name of MaterialX's MDL module of closures that generated code imports, such as pbrlib_1_10."""
    from mrm_nodes.shadergen import generate_shader

    document = mx.createDocument()
    node = document.addNode("constant", "grey", "color3")
    document.addOutput("out", "color3").setConnectedNode(node)
    found = re.search(r"::materialx::(pbrlib_\w+)", generate_shader(document, "mdl").pixel)
    return found[1] if found else "pbrlib"


def _is_set(inputs: _Inputs, name: str, default: str) -> bool:
    """Whether an input is connected, or has another value than the default."""
    if name not in inputs:
        return False
    value = inputs[name][1]
    if value is None:
        return True
    try:
        return float(value) != float(default)
    except ValueError:
        return value != default


def _meaning(name: str, value: str) -> str:
    return {"retro_transmission": "transmission straight ahead"}.get(name, value)
