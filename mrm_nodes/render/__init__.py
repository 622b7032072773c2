"""Headless rendering of generated shaders: contexts, meshes, cameras, lights, images.

The package can be called: `mrm_nodes.render(material, ...)` is `mrm_nodes.render.render(material, ...)`.
"""

import inspect
import sys
import types
from typing import Any

from mrm_nodes.render.context import BACKENDS, BackendReport, get_context, probe_backends
from mrm_nodes.render.environment import Environment, find_environment
from mrm_nodes.render.images import read_image, write_exr, write_png
from mrm_nodes.render.mesh import BUILT_IN, Mesh, baluster, plane, sphere
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.picture import Development
from mrm_nodes.render.renderer import RenderedImage, Renderer, render, shared_renderer
from mrm_nodes.render.scene import (
    CAMERA_SYNTAX,
    LIGHT_SYNTAX,
    Camera,
    CameraLight,
    DirectionalLight,
    Framing,
    Light,
    PointLight,
    SpotLight,
    parse_camera,
    parse_light,
)

__all__ = [
    "BACKENDS",
    "BUILT_IN",
    "CAMERA_SYNTAX",
    "LIGHT_SYNTAX",
    "BackendReport",
    "Camera",
    "CameraLight",
    "Development",
    "DirectionalLight",
    "Environment",
    "Framing",
    "Light",
    "Mesh",
    "PointLight",
    "RenderedImage",
    "Renderer",
    "SpotLight",
    "baluster",
    "find_environment",
    "get_context",
    "load_mesh",
    "parse_camera",
    "parse_light",
    "plane",
    "probe_backends",
    "read_image",
    "render",
    "shared_renderer",
    "sphere",
    "write_exr",
    "write_png",
]


class _CallablePackage(types.ModuleType):
    """A package of the same name as its main function."""

    __signature__ = inspect.signature(render)

    def __call__(self, *args: Any, **kwargs: Any) -> RenderedImage:
        return render(*args, **kwargs)


sys.modules[__name__].__class__ = _CallablePackage
# `help(mrm_nodes.render)` is about the function too.
__doc__ = f"{__doc__}\nrender{inspect.signature(render)}\n\n{inspect.getdoc(render)}\n"
