"""A look at OpenGL's state just before a draw: that nothing is left over from what came before.

It asks the driver and not our own records. The tests switch it on; it costs some queries a draw.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import moderngl

from mrm_nodes.render.context import GLContext

#: Where it is set and not empty, every draw is checked: in this process and in those that it starts.
CHECK_VARIABLE = "MRM_CHECK_DRAWS"

_GL_ACTIVE_TEXTURE, _GL_TEXTURE0, _GL_TEXTURE_BINDING_2D, _GL_SAMPLER_BINDING = 0x84E0, 0x84C0, 0x8069, 0x8919

#: Integer state that every draw wants, by the name in OpenGL: pname and values. Only the depth test varies.
_STATE = {
    "GL_BLEND": (0x0BE2, (0,)),
    "GL_CULL_FACE": (0x0B44, (0,)),
    "GL_SCISSOR_TEST": (0x0C11, (0,)),
    "GL_STENCIL_TEST": (0x0B90, (0,)),
    "GL_RASTERIZER_DISCARD": (0x8C89, (0,)),
    "GL_COLOR_LOGIC_OP": (0x0BF2, (0,)),
    "GL_POLYGON_OFFSET_FILL": (0x8037, (0,)),
    "GL_DEPTH_CLAMP": (0x864F, (0,)),
    "GL_FRAMEBUFFER_SRGB": (0x8DB9, (0,)),
    "GL_POLYGON_MODE": (0x0B40, (0x1B02,)),  # GL_FILL
    "GL_FRONT_FACE": (0x0B46, (0x0901,)),  # GL_CCW
    "GL_DEPTH_FUNC": (0x0B74, (0x0201,)),  # GL_LESS
    "GL_DEPTH_WRITEMASK": (0x0B72, (1,)),
    "GL_COLOR_WRITEMASK": (0x0C23, (1, 1, 1, 1)),
    "GL_POINT_SIZE": (0x0B11, (1,)),
    "GL_PIXEL_UNPACK_BUFFER_BINDING": (0x88EF, (0,)),
    "GL_PIXEL_PACK_BUFFER_BINDING": (0x88ED, (0,)),
}


def check_draw(
    gl: GLContext,
    samplers: Mapping[str, Any],
    framebuffer: moderngl.Framebuffer,
    textures: Mapping[str, moderngl.Texture],
    unusual: Mapping[str, tuple[int, ...]],
) -> None:
    """Compare OpenGL's state with what a draw is meant to depend on.

    Args:
        samplers: the program's, `moderngl.Uniform`s by their names.
        textures: what each of them is meant to read.
        unusual: what of the state this draw wants otherwise than every other, by its name in OpenGL.

    Raises:
        AssertionError: something else is bound or switched on, or OpenGL refused a call since the draw before.
    """
    error = gl.ctx.error
    assert error == "GL_NO_ERROR", f"before a draw: an earlier call to OpenGL failed ({error})"

    def state(pname: int, count: int = 1) -> tuple[int, ...]:
        values = (ctypes.c_int * 16)()
        gl.call("glGetIntegerv", pname, values)
        return tuple(values[:count])

    found = {name: state(pname, len(values)) for name, (pname, values) in _STATE.items()}
    meant = {name: values for name, (_, values) in _STATE.items()} | dict(unusual)
    found["GL_DRAW_FRAMEBUFFER_BINDING"], meant["GL_DRAW_FRAMEBUFFER_BINDING"] = (
        state(0x8CA6),
        (framebuffer.glo,),
    )
    found["GL_VIEWPORT"], meant["GL_VIEWPORT"] = state(0x0BA2, 4), (0, 0, *framebuffer.size)
    drawn_into = {attachment.glo for attachment in framebuffer.color_attachments}
    (active,) = state(_GL_ACTIVE_TEXTURE)
    for name, texture in textures.items():
        unit = int(samplers[name].value)
        gl.call("glActiveTexture", _GL_TEXTURE0 + unit)
        found[name], meant[name] = state(_GL_TEXTURE_BINDING_2D), (texture.glo,)
        found[f"the sampler object of {name}"] = state(_GL_SAMPLER_BINDING)
        meant[f"the sampler object of {name}"] = (0,)
        assert unit != gl.upload_unit, f"before a draw: {name} reads the unit for uploads"
        assert texture.glo not in drawn_into, f"before a draw: {name} reads what is drawn into"
    gl.call("glActiveTexture", active)
    wrong = [f"{name} is {found[name]}, not {meant[name]}" for name in meant if found[name] != meant[name]]
    assert not wrong, f"before a draw: {'; '.join(wrong)}"
