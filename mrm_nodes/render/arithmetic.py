"""What a driver makes of the functions and the texture units that image light is made of, measured by drawing.

No specification says it closely: Vulkan allows an arc sine to be off by 5e-4, Mesa's software driver uses nearly all of
that, and a texture unit may read between two texels in sixteen steps.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.render.context import GLContext, get_context

Array = NDArray[np.float64]

_SIDE = 256
_VERTEX = """
#version 400
void main()
{
    gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}
"""
_FUNCTIONS = """
#version 400
uniform sampler2D u_arguments;
out vec4 result;
void main()
{
    vec4 x = texelFetch(u_arguments, ivec2(gl_FragCoord.xy), 0);
    result = vec4(asin(x.x), atan(x.y, x.z), sin(x.w), log2(abs(x.x)));
}
"""
_STEPS = """
#version 400
uniform sampler2D u_ramp;
out vec4 result;
void main()
{
    ivec2 pixel = ivec2(gl_FragCoord.xy);
    float share = (float(pixel.x + 256 * pixel.y) + 0.5) / 65536.0;
    float texel = textureLod(u_ramp, vec2(0.25 + 0.5 * share, 0.5), 0.0).r;
    float level = textureLod(u_ramp, vec2(0.25, 0.5), share).r;
    result = vec4(texel, level, 0.0, 0.0);
}
"""

ALLOWED = 4096 * 2.0**-23
"""Error of an arc sine or tangent that Vulkan allows, relative, which drivers keep in OpenGL too."""

_NODES = 4097


@dataclass(frozen=True)
class Arithmetic:
    """Errors of a driver's own functions, absolute, and the steps of its texture units."""

    arc_sine: Array
    """By the angle, evenly from -π/2 to π/2."""
    arc_tangent: Array
    """Of two arguments, by the angle, evenly from -π to π."""
    sine: float
    """The largest, of an argument up to 2π."""
    logarithm: float
    """The largest of the binary logarithm of a number from 2^-16 to 1."""
    texel: float
    """By how much what is read between two texels of a float32 texture is off, as a share of their difference."""
    level: float
    """Likewise between two mip levels."""


def measure(backend: str) -> Arithmetic:
    """Measure a driver, once for a process.

    Raises:
        MrmError: the backend does not work, or its arc functions are further off than Vulkan allows.
    """
    context = get_context(backend)
    return _measured(context)


@functools.lru_cache(maxsize=4)
def _measured(context: GLContext) -> Arithmetic:
    return context.run(lambda: _measure(context.ctx))


def _measure(ctx: moderngl.Context) -> Arithmetic:
    share = (np.arange(_SIDE * _SIDE) + 0.5) / (_SIDE * _SIDE)
    turn = np.pi * (2.0 * share - 1.0)
    arguments = np.stack([np.sin(0.5 * turn), np.sin(turn), np.cos(turn), np.pi + turn], axis=-1).astype(
        np.float32
    )
    found = _drawn(ctx, _FUNCTIONS, arguments.reshape(_SIDE, _SIDE, 4))
    x, y, z, w = arguments.astype(np.float64).T
    steps = _drawn(ctx, _STEPS, np.array([[0.0, 1.0]], np.float32)[..., None])
    exact = np.arcsin(x), np.arctan2(y, z)
    errors = [found[:, k] - exact[k] for k in range(2)]
    for name, error, angle in zip(("sine", "tangent"), errors, exact, strict=True):
        wrong = np.abs(error) > ALLOWED * np.maximum(np.abs(angle), ALLOWED)
        if wrong.any():
            raise MrmError(
                f"this driver's arc {name} is off by {np.abs(error).max():.3g}, more than Vulkan allows: what it "
                "shows of an environment cannot be compared; take another backend"
            )
    nodes = np.linspace(-1.0, 1.0, _NODES)
    return Arithmetic(
        arc_sine=np.interp(nodes, exact[0] / (0.5 * np.pi), errors[0]),
        arc_tangent=np.interp(nodes, exact[1] / np.pi, errors[1]),
        sine=float(np.abs(found[:, 2] - np.sin(w)).max()),
        logarithm=float(np.abs(found[:, 3] - np.log2(np.abs(x))).max()),
        texel=float(np.abs(steps[:, 0] - share).max()),
        level=float(np.abs(steps[:, 1] - 0.5 * share).max()) * 2.0,
    )


def _drawn(ctx: moderngl.Context, pixel: str, values: NDArray[np.float32]) -> Array:
    """What a fragment shader makes of a texture, `(65536, 4)`."""
    program = ctx.program(vertex_shader=_VERTEX, fragment_shader=pixel)
    height, width, channels = values.shape
    source = ctx.texture((width, height), channels, np.ascontiguousarray(values), alignment=1, dtype="f4")
    if channels == 1:
        # The next level of two texels, 0 and 1, is their mean.
        source.build_mipmaps()
        source.write(np.array([0.5], np.float32), level=1, alignment=1)
        source.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    else:
        source.filter = (moderngl.NEAREST, moderngl.NEAREST)
    target = ctx.texture((_SIDE, _SIDE), 4, dtype="f4")
    frame = ctx.framebuffer([target])
    triangle = ctx.vertex_array(program, [])
    try:
        frame.use()
        ctx.enable_only(moderngl.NOTHING)
        source.use(0)
        triangle.render(moderngl.TRIANGLES, vertices=3)
        pixels = np.frombuffer(frame.read(components=4, dtype="f4"), np.float32)
        return pixels.reshape(-1, 4).astype(np.float64)
    finally:
        ctx.screen.use()
        for each in (triangle, frame, target, source, program):
            each.release()
