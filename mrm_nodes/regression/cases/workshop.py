"""What a task is judged with: a renderer, and the shaders that were generated for it so far."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import MaterialX as mx
import moderngl
import numpy as np

from mrm_nodes.regression.truth import material
from mrm_nodes.render.context import get_context
from mrm_nodes.render.recent import Recent
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import USUAL_LIGHTS, Shader, generate_shader

_KEPT_SHADERS = 64


class Workshop:
    """A GL context with the shaders generated so far; shaders are shared by all tasks of one structure.

    Args:
        backend: `egl` or `osmesa`.
        edit: changes each generated shader before it is compiled: for tests that plant faults.

    Raises:
        MrmError: the backend does not work here.
    """

    def __init__(self, backend: str, edit: Callable[[Shader], Shader] = lambda shader: shader) -> None:
        self.renderer = Renderer(backend)
        self._edit = edit
        self._shaders: Recent[Any, Shader] = Recent(_KEPT_SHADERS, lambda shader: None)

    def shader(
        self,
        key: Any,
        document: Callable[[], mx.Document],
        element: str | None = None,
        varying: Iterable[str] = (),
        max_lights: int = USUAL_LIGHTS,
        environment: str = "fis",
    ) -> Shader:
        """The shader of a key; `document` makes what it is generated from where there is none yet.

        varying, max_lights, environment: as in `generate_shader`; tasks of one key may have different values of
        varying inputs.
        """

        def make() -> Shader:
            return self._edit(
                generate_shader(
                    document(),
                    element=element or material.MATERIAL,
                    varying=varying,
                    max_lights=max_lights,
                    environment=environment,
                )
            )

        return self._shaders.get(key, make)

    def still_draws(self) -> bool:
        """Whether the context is there, and holds what is drawn with it."""
        gl = get_context(self.renderer.backend)
        try:
            return gl.run(lambda: _holds_what_is_drawn(gl.ctx))
        except Exception:  # moderngl raises its own error and bare ones
            return False


def _holds_what_is_drawn(ctx: moderngl.Context) -> bool:
    gray = (0.25, 0.5, 0.75, 1.0)
    texture = ctx.texture((1, 1), 4, dtype="f4")
    framebuffer = ctx.framebuffer([texture])
    framebuffer.clear(*gray)
    seen = np.frombuffer(framebuffer.read(components=4, dtype="f4"), np.float32)
    framebuffer.release()
    texture.release()
    return tuple(seen) == gray and ctx.error not in ("GL_OUT_OF_MEMORY", "GL_CONTEXT_LOST")
