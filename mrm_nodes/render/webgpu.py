"""MaterialX's GLSL for WebGPU, run: through naga and wgpu, on Vulkan or on its software driver."""

from __future__ import annotations

import functools
import math
import os
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.points import Floats, stream, uniform_values
from mrm_nodes.render.scene import Light
from mrm_nodes.shadergen import Shader

INSTALL = (
    "install wgpu (pip install 'mrm-nodes[targets]') and a Vulkan driver (Debian, Ubuntu: apt-get install "
    "mesa-vulkan-drivers)"
)

_ATTRIBUTE = r"^layout \(location = (\d+)\) in (\w+) (\w+);"
_RESULTS = ("image", "position", "normal", "tangent")
#: By GLSL type: how many numbers, their kind, and std140's alignment in bytes.
_STD140 = {
    "float": (1, np.float32, 4),
    "int": (1, np.int32, 4),
    "bool": (1, np.int32, 4),
    "vec2": (2, np.float32, 8),
    "vec3": (3, np.float32, 16),
    "vec4": (4, np.float32, 16),
    "mat3": (12, np.float32, 16),
    "mat4": (16, np.float32, 16),
}

_VERTEX_MAIN = """
void main()
{{
    mrm_materialx_main();
    int i = int(gl_VertexIndex);
    vec2 pixel = vec2(float(i % {width}), float(i / {width})) + vec2(0.5);
    gl_Position = vec4(pixel.x / {width}.0 * 2.0 - 1.0, 1.0 - pixel.y / {height}.0 * 2.0, 0.0, 1.0);
}}
"""

_PIXEL_MAIN = """
layout (location = 1) out vec4 mrm_position;
layout (location = 2) out vec4 mrm_normal;
layout (location = 3) out vec4 mrm_tangent;
void main()
{
    mrm_materialx_main();
    mrm_position = vec4(vd.positionWorld, 1.0);
    mrm_normal = vec4(vd.normalWorld, 1.0);
    mrm_tangent = vec4(vd.tangentWorld, 1.0);
}
"""


@dataclass(frozen=True)
class _Member:
    """A number or vector in a uniform block, by the name that a user has for it."""

    name: str
    type: str
    offset: int


@functools.cache
def device() -> Any:
    """Return the wgpu device of this process.

    Raises:
        MrmError: wgpu is missing, or finds no driver.
    """
    # Mesa's Vulkan loader complains where a session has no runtime folder.
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    try:
        import wgpu

        adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
        # Four float32 targets are more than every WebGPU has to give.
        return adapter.request_device_sync(required_limits={"max-color-attachment-bytes-per-sample": 64})
    except Exception as error:  # wgpu's own exception types, or no such package
        raise MrmError(f"no WebGPU here ({' '.join(str(error).split())}); {INSTALL}") from None


class WebGPURenderer:
    """Shades points by WebGPU, as `Renderer.draw_points` does on OpenGL.

    Raises:
        MrmError: no WebGPU.
    """

    backend = "webgpu"

    def __init__(self) -> None:
        info = device().adapter.info
        self.device = f"{info['device']}, {info['backend_type']}"

    def draw_points(
        self,
        shader: Shader,
        attributes: Mapping[str, NDArray[Any]],
        camera_position: Sequence[float],
        lights: Sequence[Light] = (),
        uniforms: Mapping[str, Any] | None = None,
    ) -> dict[str, Floats]:
        """Shade n points, each with its own vertex data; as `Renderer.draw_points`.

        Raises:
            MrmError: no WGSL dialect, vertex data is missing, or naga refuses the shader.
        """
        import wgpu

        if shader.target != "wgsl":
            raise MrmError(f"{shader.name}: WebGPU runs wgsl, not {shader.target}")
        vertex = _rename_attributes(shader.vertex)
        streams = []
        for location, kind, name in re.findall(_ATTRIBUTE, vertex, re.MULTILINE):
            data = stream(attributes, re.sub(r"^(?:i|a_geomprop)_", "", name))
            streams.append((int(location), kind, data))
        count = len(streams[0][2])
        width = math.isqrt(count - 1) + 1
        size = (width, -(-count // width))

        values = _values(shader, uniforms, camera_position, lights)
        gpu = device()
        layout, group = _bind(gpu, shader, values)
        buffers = [
            gpu.create_buffer_with_data(data=data.tobytes(), usage=wgpu.BufferUsage.VERTEX)
            for _, _, data in streams
        ]
        pipeline = gpu.create_render_pipeline(
            layout=gpu.create_pipeline_layout(bind_group_layouts=[layout]),
            vertex={
                "module": _module(gpu, shader, "vert", _vertex_source(vertex, size)),
                "entry_point": "main",
                "buffers": [
                    {
                        "array_stride": 4 * data.shape[1],
                        "attributes": [
                            {
                                "format": "float32" if kind == "float" else f"float32x{data.shape[1]}",
                                "offset": 0,
                                "shader_location": location,
                            }
                        ],
                    }
                    for location, kind, data in streams
                ],
            },
            primitive={"topology": "point-list"},
            fragment={
                "module": _module(gpu, shader, "frag", _rename_main(shader.pixel) + _PIXEL_MAIN),
                "entry_point": "main",
                "targets": [{"format": "rgba32float"} for _ in _RESULTS],
            },
        )
        usage = wgpu.TextureUsage.RENDER_ATTACHMENT | wgpu.TextureUsage.COPY_SRC
        targets = [gpu.create_texture(size=(*size, 1), format="rgba32float", usage=usage) for _ in _RESULTS]
        encoder = gpu.create_command_encoder()
        render_pass = encoder.begin_render_pass(
            color_attachments=[
                {
                    "view": target.create_view(),
                    "load_op": "clear",
                    "store_op": "store",
                    "clear_value": (0.0, 0.0, 0.0, 0.0),
                }
                for target in targets
            ]
        )
        render_pass.set_pipeline(pipeline)
        render_pass.set_bind_group(0, group)
        for slot, buffer in enumerate(buffers):
            render_pass.set_vertex_buffer(slot, buffer)
        render_pass.draw(count)
        render_pass.end()
        gpu.queue.submit([encoder.finish()])
        return {name: _read(gpu, target, size, count) for name, target in zip(_RESULTS, targets, strict=True)}


def _read(gpu: Any, target: Any, size: tuple[int, int], count: int) -> Floats:
    width, height = size
    data = gpu.queue.read_texture(
        {"texture": target}, {"bytes_per_row": 16 * width, "rows_per_image": height}, (width, height, 1)
    )
    return np.frombuffer(data, np.float32).reshape(-1, 4)[:count, :3].copy()


def _rename_attributes(source: str) -> str:
    """Give an attribute of a `geompropvalue` another name than the vertex data that it is handed on as.

    naga takes the one for the other where both have MaterialX's one name: nothing arrives.
    """
    source = re.sub(
        r"^(layout .* in \w+) i_geomprop_(\w+);", r"\1 a_geomprop_\2;", source, flags=re.MULTILINE
    )
    return re.sub(r"= i_geomprop_(\w+);", r"= a_geomprop_\1;", source)


def _rename_main(source: str) -> str:
    return re.sub(r"^void main\(\)", "void mrm_materialx_main()", source, flags=re.MULTILINE)


def _vertex_source(source: str, size: tuple[int, int]) -> str:
    return _rename_main(source) + _VERTEX_MAIN.format(width=size[0], height=size[1])


def _module(gpu: Any, shader: Shader, stage: str, source: str) -> Any:
    try:
        # naga reads the stage from the label's ending.
        return gpu.create_shader_module(label=f"{shader.name}.{stage}", code=source)
    except Exception as error:  # wgpu's own exception types
        raise MrmError(f"{shader.name}: naga: {' '.join(str(error).split())}") from None


def _bind(gpu: Any, shader: Shader, values: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return layout and group of every uniform block, texture and sampler of both stages; textures are black."""
    import wgpu

    layouts, entries = [], []
    black = gpu.create_texture(size=(1, 1, 1), format="rgba8unorm", usage=wgpu.TextureUsage.TEXTURE_BINDING)
    for stage, source in (
        (wgpu.ShaderStage.VERTEX, shader.vertex),
        (wgpu.ShaderStage.FRAGMENT, shader.pixel),
    ):
        for binding, block in _blocks(source):
            data = _pack(source, block, values)
            buffer = gpu.create_buffer_with_data(data=data, usage=wgpu.BufferUsage.UNIFORM)
            layouts.append({"binding": binding, "visibility": stage, "buffer": {"type": "uniform"}})
            entries.append(
                {"binding": binding, "resource": {"buffer": buffer, "offset": 0, "size": len(data)}}
            )
        for binding, kind in re.findall(
            r"^layout \(binding=(\d+)\) uniform (\w+) \w+;", source, re.MULTILINE
        ):
            is_texture = kind == "texture2D"
            what: dict[str, Any] = (
                {"texture": {"sample_type": "float"}} if is_texture else {"sampler": {"type": "filtering"}}
            )
            layouts.append({"binding": int(binding), "visibility": stage, **what})
            resource = black.create_view() if is_texture else gpu.create_sampler()
            entries.append({"binding": int(binding), "resource": resource})
    layout = gpu.create_bind_group_layout(entries=layouts)
    return layout, gpu.create_bind_group(layout=layout, entries=entries)


def _blocks(source: str) -> list[tuple[int, str]]:
    """Return binding and body of each uniform block."""
    found = re.findall(
        r"^layout \(std140, binding=(\d+)\) uniform \w+\s*\{(.*?)^\};", source, re.MULTILINE | re.DOTALL
    )
    return [(int(binding), body) for binding, body in found]


def _pack(source: str, block: str, values: Mapping[str, Any]) -> bytes:
    """Lay out a block's values as std140 wants them; what has no value is zero."""
    members, size = _layout(source, block, "", 0)
    data = np.zeros(-(-size // 16) * 4, np.uint32)
    for member in members:
        if member.name in values:
            numbers, kind, _ = _STD140[member.type]
            given = np.ravel(values[member.name]).astype(kind)[:numbers]
            data[member.offset // 4 : member.offset // 4 + len(given)] = given.view(np.uint32)
    return data.tobytes()


def _layout(source: str, body: str, prefix: str, offset: int) -> tuple[list[_Member], int]:
    """Return the members of a block or structure, and the offset behind it."""
    members: list[_Member] = []
    declared = re.sub(r"#define.*", "", body)
    for kind, name, length in re.findall(r"(\w+) (\w+)(?:\[(\w+)\])?;", declared):
        if kind in _STD140:
            numbers, _, alignment = _STD140[kind]
            offset = -(-offset // alignment) * alignment
            members.append(_Member(prefix + name, kind, offset))
            offset += 4 * numbers
            continue
        structure = re.search(rf"struct {kind}\s*\{{(.*?)\}}", source, re.DOTALL)
        if structure is None:
            raise MrmError(f"a uniform block has a member of unknown type {kind}")
        for index in range(_length(source, length)):
            offset = -(-offset // 16) * 16
            inner = f"{prefix}{name}[{index}]." if length else f"{prefix}{name}."
            found, offset = _layout(source, structure[1], inner, offset)
            members += found
            offset = -(-offset // 16) * 16
    return members, offset


def _length(source: str, text: str) -> int:
    if not text:
        return 1
    if text.isdigit():
        return int(text)
    found = re.search(rf"#define {text} (\d+)", source)
    if found is None:
        raise MrmError(f"a uniform block has an array of unknown length {text}")
    return int(found[1])


def _values(
    shader: Shader,
    uniforms: Mapping[str, Any] | None,
    camera_position: Sequence[float],
    lights: Sequence[Light],
) -> dict[str, Any]:
    values = uniform_values(shader, uniforms, camera_position, lights)
    # MaterialX's name for it in this dialect.
    return {re.sub(r"(u_lightData\[\d+\])\.type", r"\1.light_type", name): values[name] for name in values}
