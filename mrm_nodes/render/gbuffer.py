"""Rewrites a generated shader so that one draw gives the image and the geometry that it was shaded with.

The generated `main` functions are kept whole under another name and called from new ones, so that nothing
between MaterialX's text and the compiler changes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mrm_nodes.errors import MrmError

#: Render targets, in order: the image; position and coverage; normal and texture u; tangent and texture v.
TARGETS = 4

#: Draws point i at pixel i of a target `mrm_grid.x` pixels wide.
_POINT_PLACEMENT = """    ivec2 mrm_pixel = ivec2(gl_VertexID % mrm_grid.x, gl_VertexID / mrm_grid.x);
    gl_Position = vec4((vec2(mrm_pixel) + 0.5) / vec2(mrm_grid) * 2.0 - 1.0, 0.0, 1.0);
"""


@dataclass(frozen=True)
class _Stream:
    """Vertex data that the geometry targets need, and MaterialX's own expression for it."""

    member: str
    type: str
    attribute: str
    uniform: str
    expression: str


# GlslShaderGenerator's vertex stage (PositionNodeGlsl, NormalNodeGlsl, TangentNodeGlsl, TexCoordNodeGlsl)
_STREAMS = (
    _Stream(
        "positionWorld",
        "vec3",
        "vec3 i_position",
        "u_worldMatrix",
        "(u_worldMatrix * vec4(i_position, 1.0)).xyz",
    ),
    _Stream(
        "normalWorld",
        "vec3",
        "vec3 i_normal",
        "u_worldInverseTransposeMatrix",
        "normalize((u_worldInverseTransposeMatrix * vec4(i_normal, 0.0)).xyz)",
    ),
    _Stream(
        "tangentWorld",
        "vec3",
        "vec3 i_tangent",
        "u_worldMatrix",
        "normalize((u_worldMatrix * vec4(i_tangent, 0.0)).xyz)",
    ),
    _Stream("texcoord_0", "vec2", "vec2 i_texcoord_0", "", "i_texcoord_0"),
)

_MAIN = re.compile(r"^void main\(\)", re.MULTILINE)
_OUTPUT = re.compile(r"^out vec4 (\w+);", re.MULTILINE)
_VERTEX_DATA = re.compile(r"^(?:in|out) VertexData\s*\{([^}]*)\}\s*(\w+);", re.MULTILINE)
_UNIFORM_VALUE = re.compile(r"^(uniform [^=;]*?)\s*=[^;]*;", re.MULTILINE)


def patch(vertex: str, pixel: str, *, points: bool = False) -> tuple[str, str]:
    """Return both stages with the geometry targets added, and without the default values of their uniforms.

    Without those, cases that differ only in values have the same text: the renderer uploads every value.

    Args:
        points: place vertex i at pixel i, in rows of `mrm_grid.x` from the bottom.

    Raises:
        MrmError: not GLSL as MaterialX's generator for it writes.
    """
    if len(_MAIN.findall(vertex)) != 1 or len(_MAIN.findall(pixel)) != 1 or len(_OUTPUT.findall(pixel)) != 1:
        raise MrmError("this shader is not what MaterialX generates for GLSL; generate it with target glsl")
    block = _VERTEX_DATA.search(pixel)
    members = set(re.findall(r"(\w+)\s*;", block[1])) if block else set()
    instance = block[2] if block else ""

    declared, computed, seen = [], [], {}
    for stream in _STREAMS:
        if stream.member in members:
            seen[stream.member] = f"{instance}.{stream.member}"
            continue
        name = f"mrm_{stream.member}"
        seen[stream.member] = name
        if not _declares(vertex, stream.attribute.split()[1]):
            declared.append(f"in {stream.attribute};")
        if stream.uniform and not _declares(vertex, stream.uniform):
            uniform = f"uniform mat4 {stream.uniform};"
            declared += [] if uniform in declared else [uniform]
        declared.append(f"out {stream.type} {name};")
        computed.append(f"    {name} = {stream.expression};")
    placement = _POINT_PLACEMENT if points else ""
    if points:
        declared.append("uniform ivec2 mrm_grid;")

    vertex = _MAIN.sub("void mrm_materialx_main()", _without_values(vertex))
    vertex += "\n".join(
        [*declared, "void main()", "{", "    mrm_materialx_main();", *computed, placement + "}", ""]
    )

    inputs = [f"in {stream.type} mrm_{stream.member};" for stream in _STREAMS if stream.member not in members]
    pixel = _MAIN.sub("void mrm_materialx_main()", _without_values(pixel))
    pixel = _OUTPUT.sub(r"layout(location = 0) out vec4 \1;", pixel)
    pixel += "\n".join(
        [
            *inputs,
            "layout(location = 1) out vec4 mrm_position;",
            "layout(location = 2) out vec4 mrm_normal;",
            "layout(location = 3) out vec4 mrm_tangent;",
            "void main()",
            "{",
            "    mrm_materialx_main();",
            f"    mrm_position = vec4({seen['positionWorld']}, 1.0);",
            f"    mrm_normal = vec4({seen['normalWorld']}, {seen['texcoord_0']}.x);",
            f"    mrm_tangent = vec4({seen['tangentWorld']}, {seen['texcoord_0']}.y);",
            "}",
            "",
        ]
    )
    return vertex, pixel


def _without_values(source: str) -> str:
    return _UNIFORM_VALUE.sub(r"\1;", source)


def _declares(source: str, name: str) -> bool:
    return re.search(rf"^(?:in|uniform) \w+ {name}\b", source, re.MULTILINE) is not None
