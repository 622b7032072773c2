"""What a task is judged with: a renderer, and the shaders that were generated for it so far."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import MaterialX as mx

from mrm_nodes.regression import material
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import Shader, generate_shader


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
        self._shaders: dict[Any, Shader] = {}

    def shader(self, key: Any, document: Callable[[], mx.Document], element: str | None = None) -> Shader:
        """The shader of a key; `document` makes what it is generated from where there is none yet."""
        if key not in self._shaders:
            self._shaders[key] = self._edit(generate_shader(document(), element=element or material.MATERIAL))
        return self._shaders[key]
