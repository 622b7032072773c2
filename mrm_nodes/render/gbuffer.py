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
#: MaterialX's uniform below which a fragment of a transparent surface is not drawn. On a mesh, such a surface has a
#: fifth target for the texture coordinates: what is blended by its fourth number has to have a 1 there.
ALPHA_THRESHOLD = "u_alphaThreshold"

#: How many textures the vertex data of points may take: as many as every OpenGL draws into at once.
_MAX_SHEETS = 8

#: Puts point i at pixel i of a target `mrm_grid.x` pixels wide.
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
_VERTEX_DATA = re.compile(r"^in VertexData\s*\{([^}]*)\}\s*(\w+);", re.MULTILINE)
_MEMBER = re.compile(r"^\s*(?:flat\s+)?(\w+)\s+(\w+)\s*;", re.MULTILINE)
#: What the generated `main` is called in our stages.
MATERIALX_MAIN = re.compile(r"^void mrm_materialx_main\(\)", re.MULTILINE)
#: How MaterialX's vertex stage makes a bitangent: its sign is not part of it.
_BITANGENT = re.compile(r"(\bbitangent(?:World|Object) = )(?=cross\()")
#: The vertex attribute that turns bitangents.
BITANGENT_SIGN = "i_mrm_bitangent_sign"
_UNIFORM_VALUE = re.compile(r"^(uniform [^=;]*?)\s*=[^;]*;", re.MULTILINE)

#: The types of vertex data, and how many floats hold one.
_WIDTHS = {"float": 1, "int": 1, "vec2": 2, "vec3": 3, "vec4": 4}

_ONE_TRIANGLE = """#version 400
void main()
{
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""


@dataclass(frozen=True)
class Stages:
    """The source of a program; `sheets` counts the textures of vertex data that it reads or draws."""

    vertex: str
    pixel: str
    sheets: int = 0
    targets: int = TARGETS


@dataclass(frozen=True)
class _VertexData:
    """What the pixel stage gets from the vertex stage: MaterialX's block, and what is added beside it."""

    block: str  # MaterialX's declaration in the pixel stage, "" where the shader uses no vertex data
    instance: str
    members: tuple[tuple[str, str], ...]  # type and name
    added: tuple[_Stream, ...]

    def expression(self, member: str) -> str:
        """Return how the pixel stage reads a member."""
        own = any(name == member for _, name in self.members)
        return f"{self.instance}.{member}" if own else f"mrm_{member}"

    def types(self) -> list[tuple[str, str]]:
        """Return type and expression of every member."""
        own = [(kind, f"{self.instance}.{name}") for kind, name in self.members]
        return own + [(stream.type, f"mrm_{stream.member}") for stream in self.added]


def _vertex_data(vertex: str, pixel: str) -> _VertexData:
    if any(
        len(pattern.findall(source)) != 1
        for pattern, source in ((_MAIN, vertex), (_MAIN, pixel), (_OUTPUT, pixel))
    ):
        raise MrmError("this shader is not what MaterialX generates for GLSL; generate it with target glsl")
    found = _VERTEX_DATA.search(pixel)
    members = tuple(_MEMBER.findall(found[1])) if found else ()
    names = {name for _, name in members}
    added = tuple(stream for stream in _STREAMS if stream.member not in names)
    return _VertexData(found[0] if found else "", found[2] if found else "", members, added)


def mesh_stages(vertex: str, pixel: str) -> Stages:
    """Return both stages with the geometry targets added, and without the default values of their uniforms.

    Without those, cases that differ only in values have the same text: the renderer uploads every value.

    Raises:
        MrmError: not GLSL as MaterialX's generator for it writes.
    """
    data = _vertex_data(vertex, pixel)
    blends = ALPHA_THRESHOLD in pixel
    return Stages(
        _vertex_stage(vertex, data, points=False),
        _pixel_stage(pixel, data, blends=blends),
        targets=TARGETS + blends,
    )


def point_stages(vertex: str, pixel: str) -> Stages:
    """Return the stages as `mesh_stages` does, but with vertex i at pixel i, in rows of `mrm_grid.x`.

    Raises:
        MrmError: not GLSL as MaterialX's generator for it writes.
    """
    data = _vertex_data(vertex, pixel)
    return Stages(_vertex_stage(vertex, data, points=True), _pixel_stage(pixel, data))


def sheet_stages(vertex: str, pixel: str) -> tuple[Stages, Stages] | None:
    """Return `point_stages` in two programs, of which the second shades all points as one triangle.

    A software driver shades blocks of 16 pixels, 15 of them for nothing where each point is drawn by itself.
    So the first program only draws what the vertex stage gives each point into textures (`mrm_sheet_…`), bit
    for bit, and the second reads it from there. None where the vertex data does not fit, or where the pixel
    stage compares neighbouring pixels.

    Raises:
        MrmError: not GLSL as MaterialX's generator for it writes.
    """
    data = _vertex_data(vertex, pixel)
    floats: list[str] = []
    loads: list[str] = []
    for kind, expression in data.types():
        width = _WIDTHS.get(kind)
        if width is None:
            return None
        suffixes = [f".{axis}" for axis in "xyzw"[:width]] if width > 1 else [""]
        places = [
            f"mrm_texel_{place // 4}.{'xyzw'[place % 4]}" for place in range(len(floats), len(floats) + width)
        ]
        loads.append(f"    {expression} = {kind}({', '.join(places)});")
        floats += [f"float({expression}{suffix})" for suffix in suffixes]
    sheets = -(-len(floats) // 4)
    if sheets > _MAX_SHEETS or re.search(r"\b(?:dFd[xy]|fwidth)\b", pixel):
        return None
    floats += ["0.0"] * (4 * sheets - len(floats))
    store = [
        "#version 400",
        data.block,
        *(f"in {stream.type} mrm_{stream.member};" for stream in data.added),
        *(f"layout(location = {i}) out vec4 mrm_sheet_{i};" for i in range(sheets)),
        "void main()",
        "{",
        *(f"    mrm_sheet_{i} = vec4({', '.join(floats[4 * i : 4 * i + 4])});" for i in range(sheets)),
        "}",
        "",
    ]
    loads = [
        *(
            f"    vec4 mrm_texel_{i} = texelFetch(mrm_sheet_{i}, ivec2(gl_FragCoord.xy), 0);"
            for i in range(sheets)
        ),
        *loads,
    ]
    variables = [
        *(f"uniform sampler2D mrm_sheet_{i};" for i in range(sheets)),
        *(f"{stream.type} mrm_{stream.member};" for stream in data.added),
    ]
    if data.block:
        members = " ".join(f"{kind} {name};" for kind, name in data.members)
        pixel = pixel.replace(
            data.block, f"struct MrmVertexData {{ {members} }};\nMrmVertexData {data.instance};"
        )
    return (
        Stages(_vertex_stage(vertex, data, points=True), "\n".join(store), sheets),
        Stages(_ONE_TRIANGLE, _pixel_stage(pixel, data, variables, loads), sheets),
    )


def _vertex_stage(source: str, data: _VertexData, *, points: bool) -> str:
    declared, computed = [], []
    for stream in data.added:
        if not _declares(source, stream.attribute.split()[1]):
            declared.append(f"in {stream.attribute};")
        if stream.uniform and not _declares(source, stream.uniform):
            declared.append(f"uniform mat4 {stream.uniform};")
        declared.append(f"out {stream.type} mrm_{stream.member};")
        computed.append(f"    mrm_{stream.member} = {stream.expression};")
    if points:
        declared.append("uniform ivec2 mrm_grid;")
        computed.append(_POINT_PLACEMENT)
    source = _MAIN.sub("void mrm_materialx_main()", _without_values(source))
    if not points:
        source, turned = _BITANGENT.subn(rf"\1{BITANGENT_SIGN} * ", source)
        if turned:
            source = MATERIALX_MAIN.sub(rf"in float {BITANGENT_SIGN};\n\g<0>", source)
    # Two streams may need the same matrix.
    declared = list(dict.fromkeys(declared))
    return source + "\n".join(
        [*declared, "void main()", "{", "    mrm_materialx_main();", *computed, "}", ""]
    )


def _pixel_stage(
    source: str,
    data: _VertexData,
    inputs: list[str] | None = None,
    loads: list[str] | None = None,
    blends: bool = False,
) -> str:
    if inputs is None:
        inputs = [f"in {stream.type} mrm_{stream.member};" for stream in data.added]
    position, normal, tangent, texcoord = (data.expression(stream.member) for stream in _STREAMS)
    source = _MAIN.sub("void mrm_materialx_main()", _without_values(source))
    source = _OUTPUT.sub(r"layout(location = 0) out vec4 \1;", source)
    return source + "\n".join(
        [
            *inputs,
            "layout(location = 1) out vec4 mrm_position;",
            "layout(location = 2) out vec4 mrm_normal;",
            "layout(location = 3) out vec4 mrm_tangent;",
            *(["layout(location = 4) out vec4 mrm_texcoord;"] if blends else []),
            "void main()",
            "{",
            *(loads or []),
            "    mrm_materialx_main();",
            f"    mrm_position = vec4({position}, 1.0);",
            f"    mrm_normal = vec4({normal}, {'1.0' if blends else f'{texcoord}.x'});",
            f"    mrm_tangent = vec4({tangent}, {'1.0' if blends else f'{texcoord}.y'});",
            *([f"    mrm_texcoord = vec4({texcoord}, 0.0, 1.0);"] if blends else []),
            "}",
            "",
        ]
    )


def _without_values(source: str) -> str:
    return _UNIFORM_VALUE.sub(r"\1;", source)


def _declares(source: str, name: str) -> bool:
    return re.search(rf"^(?:in|uniform) \w+ {name}\b", source, re.MULTILINE) is not None
