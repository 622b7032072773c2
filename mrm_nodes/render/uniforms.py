"""The uniforms of a generated shader: their values in the material, and a user's values in their stead."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import MaterialX as mx
import numpy as np

from mrm_nodes import colorspaces, filenames
from mrm_nodes.errors import MrmError
from mrm_nodes.shadergen import Shader

_INTEGER_TYPES = ("integer", "boolean", "string")
_COMPONENTS = {
    "float": 1,
    "integer": 1,
    "boolean": 1,
    "vector2": 2,
    "vector3": 3,
    "vector4": 4,
    "color3": 3,
    "color4": 4,
    "matrix33": 9,
    "matrix44": 16,
}


@dataclass(frozen=True)
class Uniform:
    """One uniform: its name in GLSL, the material's input that it stands for, and its value."""

    name: str
    path: str
    type: str
    value: Any  # list of numbers; for `filename` the name of the file; None where the material gives none


def uniforms_of(shader: Shader, overrides: Mapping[str, Any] | None = None) -> dict[str, Uniform]:
    """Return every uniform of both stages by its name in GLSL.

    Args:
        overrides: values by the path of the material's input (`graph/node/input`) or by the name in GLSL; an
            enum takes its name or its number.

    Raises:
        MrmError: an unknown name, a value of the wrong kind, NaN or infinite.
    """
    found = {uniform.name: uniform for uniform in _ports(shader)}
    for name, value in (overrides or {}).items():
        matches = [u for u in found.values() if name == u.name or (u.path and name == u.path)]
        if not matches:
            known = sorted({u.path or u.name for u in found.values()} | set(found))
            close = difflib.get_close_matches(name, known, n=3)
            hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(known)}"
            raise MrmError(f"{shader.name}: no uniform {name}; {hint}")
        for uniform in matches:
            given = _override(shader, uniform, value)
            if uniform.type in ("color3", "color4") and uniform.path in shader.spaces:
                given = colorspaces.linear(given, shader.spaces[uniform.path]).tolist()
            found[uniform.name] = Uniform(uniform.name, uniform.path, uniform.type, given)
    for uniform in found.values():
        if isinstance(uniform.value, list) and not all(map(math.isfinite, uniform.value)):
            raise MrmError(f"{shader.name}: {uniform.path or uniform.name} is NaN or infinite")
    return found


def _ports(shader: Shader) -> Iterator[Uniform]:
    for stage_name in ("vertex", "pixel"):
        blocks = shader.mx.getStage(stage_name).getUniformBlocks()
        for block_name, block in blocks.items():
            # The members of the light array are set light by light.
            if block_name == "LightData":
                continue
            for index in range(block.size()):
                port = block[index]
                kind = port.getType().getName()
                value = port.getValue()
                if value is not None and not hasattr(value, "getData"):
                    yield from _members(shader, port.getVariable(), kind, value.getValueString())
                    continue
                data = None if value is None else _data(kind, value.getData())
                path = shader.path_given(port.getPath())
                if kind == "filename":
                    data = _file_name(shader, path, data)
                yield Uniform(port.getVariable(), path, kind, data)


def _members(shader: Shader, name: str, kind: str, text: str) -> Iterator[Uniform]:
    """The members of a structure, each a uniform in GLSL; its value is written `{0.1;0.2, 0.3;{…}}`."""
    parts, depth = [""], 0
    for letter in text.strip()[1:-1]:
        depth += (letter == "{") - (letter == "}")
        if letter == ";" and depth == 0:
            parts.append("")
        else:
            parts[-1] += letter
    for member, part in zip(shader.document.getTypeDef(kind).getMembers(), parts, strict=False):
        of_member = f"{name}.{member.getName()}"
        if part.strip().startswith("{"):
            yield from _members(shader, of_member, member.getType(), part)
        elif member.getType() == "boolean":
            yield Uniform(of_member, "", "boolean", [int(part.strip() == "true")])
        else:
            yield Uniform(of_member, "", member.getType(), [float(number) for number in part.split(",")])


def _file_name(shader: Shader, path: str, given: Any) -> str | None:
    """The name of a file that an input gives: its element is asked, since releases differ in what they prefix."""
    port = _input_at(shader, path)
    if port is not None:
        return filenames.resolved(port)
    return None if given is None else str(given)


def _input_at(shader: Shader, path: str) -> mx.ValueElement | None:
    """The input that a uniform's value comes from: one that is set, or its node's default."""
    port = shader.element_at(path)
    if port is None:
        definition = _definition_at(shader, path)
        port = None if definition is None else definition.getActiveInput(path.rpartition("/")[2])
    return port if isinstance(port, mx.ValueElement) else None


def _definition_at(shader: Shader, path: str) -> mx.NodeDef | None:
    """The definition of the node that has the input of a path."""
    node = shader.element_at(path.rpartition("/")[0])
    return node.getNodeDef() if isinstance(node, mx.Node) else None


def _data(kind: str, data: Any) -> Any:
    if kind == "filename":
        return str(data)
    if kind == "string":
        return None  # a string that is no enum means nothing to GLSL, which has 0 for it
    if isinstance(data, mx.Matrix33 | mx.Matrix44):
        size = 3 if isinstance(data, mx.Matrix33) else 4
        return [float(data[row, column]) for row in range(size) for column in range(size)]
    if isinstance(data, bool | int | float | str):
        return [int(data) if kind in _INTEGER_TYPES else float(data)]
    return [float(number) for number in data]


def _override(shader: Shader, uniform: Uniform, value: Any) -> Any:
    where = f"{shader.name}: {uniform.path or uniform.name}"
    if uniform.type == "filename":
        port = _input_at(shader, uniform.path)
        return str(value) if port is None else filenames.resolved(port, str(value))
    if isinstance(value, str):
        value = _enum_index(shader, uniform, value)
    try:
        numbers = np.asarray(value, dtype=np.float64).ravel().tolist()
    except (TypeError, ValueError):
        raise MrmError(f"{where}: {value!r} is not a value of type {uniform.type}") from None
    expected = _COMPONENTS.get(uniform.type, len(uniform.value or numbers))
    if len(numbers) != expected:
        raise MrmError(f"{where}: {len(numbers)} numbers for type {uniform.type}, which has {expected}")
    if not all(map(math.isfinite, numbers)):
        raise MrmError(f"{where}: {value} is NaN or infinite")
    return [int(number) for number in numbers] if uniform.type in _INTEGER_TYPES else numbers


def _enum_index(shader: Shader, uniform: Uniform, text: str) -> int:
    """Return the number that stands in GLSL for the name of an enum, from the node's definition."""
    definition, name = _definition_at(shader, uniform.path), uniform.path.rpartition("/")[2]
    declared = definition.getActiveInput(name) if definition is not None else None
    names = (
        [entry.strip() for entry in declared.getAttribute("enum").split(",")] if declared is not None else []
    )
    if text not in names:
        known = f"known: {', '.join(names)}" if any(names) else "it takes numbers"
        raise MrmError(f"{shader.name}: {uniform.path or uniform.name}: {text!r} is no value of it; {known}")
    return names.index(text)
