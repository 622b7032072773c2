"""Whether a surface may let through what lies behind it, so that its shader has to say how much."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes.elements import descendant

#: Values of no opacity and no transmission that MaterialX takes for an opaque surface's.
_NEITHER = {"float": "0.5", "color3": "0.5, 0.5, 0.5"}


def may_be_transparent(element: mx.Element, target: str, varying: Iterable[str] = ()) -> bool:
    """Whether MaterialX's own test calls a surface transparent, whatever drives its inputs.

    The test alone calls a surface opaque whose opacity comes from a node of some groups (`adjustment`, `channel`).

    Args:
        element: a material, a shader or an output; anything else is opaque.
        target: MaterialX's own name for it, such as `genglsl`.
        varying: inputs that get their values after generation, by path or by their uniforms' names.
    """
    if mx_gen_shader.isTransparentSurface(element, target):
        return True
    document = element.getDocument()
    copy = mx.createDocument()
    copy.copyContentFrom(document)
    if document.hasDataLibrary():
        copy.setDataLibrary(document.getDataLibrary())
    names = set(varying)
    for holder, name, kind in list(_inputs(copy)):
        port = holder.getInput(name)
        path = f"{holder.getNamePath()}/{name}"
        varies = not names.isdisjoint({path, path.replace("/", "_")})
        if kind in _NEITHER and (varies or (port is not None and port.getConnectedNode() is not None)):
            holder.removeInput(name)
            holder.addInput(name, kind).setValueString(_NEITHER[kind])
    return bool(mx_gen_shader.isTransparentSurface(descendant(copy, element.getNamePath()), target))


def _inputs(document: mx.Document) -> Iterator[tuple[mx.Node | mx.NodeGraph, str, str]]:
    """Yield the holder, the name and the type of every input that graphs and surfaces have, set or not."""
    for holder in document.traverseTree():
        if isinstance(holder, mx.NodeGraph):
            ports = holder.getInputs()
        elif isinstance(holder, mx.Node) and holder.getType() == "surfaceshader":
            definition = holder.getNodeDef()
            ports = definition.getActiveInputs() if definition is not None else []
        else:
            continue
        yield from ((holder, port.getName(), port.getType()) for port in ports)
