"""MaterialX's Slang, run: by the compiler's own CPU device, which needs no driver."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.points import Floats, stream, uniform_values
from mrm_nodes.render.scene import Light
from mrm_nodes.shadergen import Shader

INSTALL = "install slangpy (pip install 'mrm-nodes[targets]')"

_ENTRY = '[shader("fragment")]\nfloat4 fragmentMain(VertexData _vd) : SV_Target'

#: Feeds the pixel stage from buffers, as the rasterizer feeds it vertex data: a CPU has no rasterizer.
_COMPUTE = """
StructuredBuffer<float> mrm_points;
RWStructuredBuffer<float4> mrm_image;
[shader("compute")]
[numthreads(1, 1, 1)]
void mrm_shade(uint3 id : SV_DispatchThreadID)
{{
    uint at = id.x * {stride};
    VertexData data;
    data.SV_Position = float4(0.0);
{members}
    mrm_image[id.x] = fragmentMain(data);
}}
"""


@functools.cache
def device() -> Any:
    """Return slangpy's CPU device of this process.

    Raises:
        MrmError: slangpy is missing, or cannot make one.
    """
    try:
        import slangpy

        # It warns that a CPU has no shader model.
        slangpy.Logger.get().level = slangpy.LogLevel.error
        return slangpy.Device(type=slangpy.DeviceType.cpu, enable_rhi_validation=False)
    except Exception as error:  # slangpy's own exception types, or no such package
        raise MrmError(f"no Slang here ({' '.join(str(error).split())}); {INSTALL}") from None


class SlangRenderer:
    """Shades points by Slang's pixel stage, as `Renderer.draw_points` does on OpenGL; without images.

    Raises:
        MrmError: no slangpy.
    """

    backend = "slang"
    device = "CPU"

    def __init__(self) -> None:
        device()

    def draw_points(
        self,
        shader: Shader,
        attributes: Mapping[str, NDArray[Any]],
        camera_position: Sequence[float],
        lights: Sequence[Light] = (),
        uniforms: Mapping[str, Any] | None = None,
    ) -> dict[str, Floats]:
        """Shade n points, each with its own vertex data; arguments and result as those of `Renderer.draw_points`.

        Raises:
            MrmError: no Slang, vertex data is missing, or the compiler refuses the shader.
        """
        if shader.target != "slang":
            raise MrmError(f"{shader.name}: Slang's device runs slang, not {shader.target}")
        geometry = {name: stream(attributes, name) for name in ("position", "normal", "tangent")}
        # As MaterialX's vertex stage, which does nothing else where matrices are identities.
        for name in ("normal", "tangent"):
            geometry[name] = geometry[name] / np.linalg.norm(geometry[name], axis=-1, keepdims=True)
        handed_on = {f"{name}World": data for name, data in geometry.items()}
        members: list[str] = []
        columns: list[Floats] = []
        for kind, name in _members(shader.pixel, "struct VertexData"):
            if name != "SV_Position":
                data = handed_on[name] if name in handed_on else stream(attributes, _bare(name))
                start = sum(column.shape[1] for column in columns)
                reads = ", ".join(f"mrm_points[at + {start + i}]" for i in range(data.shape[1]))
                members.append(f"    data.{name} = {kind}({reads});")
                columns.append(data)
        points = np.concatenate(columns, axis=-1).astype(np.float32)
        image = _run(
            shader,
            _COMPUTE.format(stride=points.shape[1], members="\n".join(members)),
            points,
            uniform_values(shader, uniforms, camera_position, lights),
        )
        return {"image": image, **geometry}


def _bare(name: str) -> str:
    return name.removeprefix("i_geomprop_")


def _members(source: str, block: str) -> Iterator[tuple[str, str]]:
    """Yield type and name of each member of a structure or constant buffer; an array's name has its length."""
    body = re.search(rf"^{block}\s*\{{(.*?)^\}}", source, re.MULTILINE | re.DOTALL)
    if body is not None:
        yield from re.findall(r"^\s*(?:uniform )?(\w+) (\w+)(?:\[\w+\])?(?: : \w+)?;", body[1], re.MULTILINE)


def _run(shader: Shader, entry: str, points: Floats, values: Mapping[str, Any]) -> Floats:
    import slangpy

    source = shader.pixel.replace(_ENTRY, _ENTRY.partition("\n")[2].removesuffix(" : SV_Target")) + entry
    cpu = device()
    try:
        module = cpu.create_slang_session().load_module_from_source(shader.name, source)
        program = module.session.link_program([module], [module.entry_point("mrm_shade")])
        pipeline = cpu.create_compute_pipeline(program)
    except Exception as error:  # slangpy's own exception types
        raise MrmError(f"{shader.name}: slang: {' '.join(str(error).split())}") from None
    usage = slangpy.BufferUsage.shader_resource | slangpy.BufferUsage.unordered_access
    given, image = (
        cpu.create_buffer(element_count=data.size, struct_size=4, usage=usage, data=data)
        for data in (points, np.zeros((len(points), 4), np.float32))
    )
    encoder = cpu.create_command_encoder()
    with encoder.begin_compute_pass() as compute:
        cursor = slangpy.ShaderCursor(compute.bind_pipeline(pipeline))
        cursor["mrm_points"], cursor["mrm_image"] = given, image
        known = {name: kind for kind, name in _members(shader.pixel, "cbuffer pixelCB")}
        lamp = {name: kind for kind, name in _members(shader.pixel, "struct LightData")}
        for name, value in values.items():
            light = re.fullmatch(r"u_lightData\[(\d+)\]\.(\w+)", name)
            if light:
                cursor["pixelCB"]["u_lightData"][int(light[1])][light[2]] = _typed(lamp[light[2]], value)
            elif name in known:
                cursor["pixelCB"][name] = _typed(known[name], value)
        compute.dispatch([len(points), 1, 1])
    cpu.submit_command_buffer(encoder.finish())
    cpu.wait_for_idle()
    pixels: Floats = image.to_numpy().view(np.float32).reshape(-1, 4)[:, :3].copy()
    return pixels


def _typed(kind: str, value: Any) -> Any:
    """A value in the form that a shader cursor takes."""
    numbers = np.ravel(value).tolist()
    if kind in ("float", "int", "bool"):
        return {"float": float, "int": int, "bool": bool}[kind](numbers[0])
    if kind == "float4x4":
        import slangpy

        return slangpy.float4x4(np.reshape(numbers, (4, 4)).astype(np.float32))
    return [float(number) for number in numbers]
