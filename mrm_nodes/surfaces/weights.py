"""What drives a weight: a number, a node of the document, or an image file."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from pathlib import Path

import MaterialX as mx

from mrm_nodes import filenames
from mrm_nodes.errors import MrmError, MrmWarning, suggestion
from mrm_nodes.substitution import known_surfaces

Weight = float | str
"""A number from 0 to 1, or text that names a node or an image file."""


def check_weights(weights: Mapping[str, Weight], known: list[str] | None = None) -> None:
    """Check that each weight is of an input of ours, and that its number is from 0 to 1.

    Raises:
        MrmError: one is not.
    """
    known = known or sorted({surface.input for surface in known_surfaces().values()})
    for name, weight in weights.items():
        if name not in known:
            raise MrmError(f"unknown input {name}; one that can be set is {' or '.join(known)}")
        if not isinstance(weight, str) and not (math.isfinite(weight) and 0.0 <= weight <= 1.0):
            raise MrmError(f"{name}: {weight:g} is not from 0 to 1")


def find_image(name: str, text: str) -> str:
    """Return the name of an image file from the folder in which the program runs; empty where there is none.

    Raises:
        MrmError: there is one, but it is no image that can be read.
    """
    from mrm_nodes.render.images import read_pixels

    files = filenames.find(text, []).all()
    for file in files[:1]:
        try:
            read_pixels(file)
        except MrmError as error:
            raise MrmError(f"--set {name}={text}: {error}") from None
    return text if files else ""


def relative(name: str, folder: Path) -> str:
    """The name of a file from another folder than the one in which the program runs, with slashes."""
    return Path(os.path.relpath(Path(name).absolute(), folder.resolve())).as_posix()


def node_setting(scope: mx.GraphElement, name: str, text: str) -> dict[str, str] | None:
    """Return the attributes of an input that connect it to `node` or `node/output`; None where there is no such node.

    Args:
        scope: the document or graph that the input's node is in; an input of the graph can be named too.

    Raises:
        MrmError: it has no such output, several, or is no float.
    """
    where = f"--set {name}={text}"
    node, _, output = text.partition("/")
    found = scope.getChild(node)
    if found is None or found.getParent() != scope:
        return None
    if found.isA(mx.Input) and not output:
        kind, setting = found.getType(), {"interfacename": node}
    elif found.isA(mx.Node) or found.isA(mx.NodeGraph):
        ports = found.getOutputs() if found.isA(mx.NodeGraph) else found.getActiveOutputs()
        if not ports and found.isA(mx.Node) and found.getNodeDef() is not None:
            ports = found.getNodeDef().getActiveOutputs()
        outputs = {port.getName(): port.getType() for port in ports}
        if output and output not in outputs:
            raise MrmError(f"{where}: {node} has no output {output}; {suggestion(output, outputs)}")
        if not output and len(outputs) > 1:
            raise MrmError(
                f"{where}: {node} has several outputs: write {' or '.join(f'{node}/{each}' for each in outputs)}"
            )
        chosen = output or next(iter(outputs), "")
        kind = outputs.get(chosen, found.getType())
        setting = {"nodegraph" if found.isA(mx.NodeGraph) else "nodename": node}
        if found.isA(mx.NodeGraph) or len(outputs) > 1:
            setting["output"] = chosen
    else:
        return None
    if kind != "float":
        raise MrmError(f"{where}: {text} is a {kind or 'graph without outputs'}; a weight is a float")
    return setting


def names_beside(scope: mx.GraphElement) -> list[str]:
    """What could be named beside a surface: floats."""
    return [node.getName() for node in scope.getNodes() if node.getType() == "float"]


def warn_of_both(name: str, text: str) -> None:
    warnings.warn(
        f"--set {name}={text}: is a node and a file; the node is taken: write ./{text} for the file",
        MrmWarning,
        stacklevel=2,
    )


def is_path(text: str) -> bool:
    """Whether text can only be the name of a file."""
    return text.startswith((".", "/", "~")) or "\\" in text or filenames.is_absolute(text)
