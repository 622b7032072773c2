"""Renders materials with MaterialX's own GlslRenderer, which needs a display: run it under xvfb-run.

Argument: a JSON file with `size`, `view` and `projection` by columns, `direction` and `color` of a lamp, `around`
(radiance from everywhere), `samples` of it, `mesh` (.obj), and `jobs`: each a `material` (.mtlx), an `element` of it
(by default its first material), folders to `search`, the shader's `interface` (by default complete), and the
`output`, a .npy file: (h, w, 4) float32, row 0 at the top. Where a job fails, a .txt beside says why.
"""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXGenGlsl as mx_gen_glsl
import MaterialX.PyMaterialXGenShader as mx_gen_shader
import MaterialX.PyMaterialXRender as mx_render
import MaterialX.PyMaterialXRenderGlsl as mx_render_glsl
import numpy as np

from mrm_nodes import library


class Studio:
    """One renderer with its geometry, camera and light, for one material after the other."""

    def __init__(self, scene: dict[str, Any]) -> None:
        self._scene = scene
        self._libraries = library.load_library()
        self._renderer = mx_render_glsl.GlslRenderer.create(*scene["size"], mx_render.BaseType.FLOAT)
        self._renderer.initialize()
        geometry = mx_render.GeometryHandler.create()
        geometry.addLoader(mx_render.TinyObjLoader.create())
        geometry.loadGeometry(mx.FilePath(scene["mesh"]), False)
        self._renderer.setGeometryHandler(geometry)
        camera = mx_render.Camera.create()
        camera.setWorldMatrix(mx.Matrix44.IDENTITY)
        camera.setViewMatrix(mx.Matrix44(*scene["view"]))
        camera.setProjectionMatrix(mx.Matrix44(*scene["projection"]))
        self._renderer.setCamera(camera)

    def draw(self, job: dict[str, Any]) -> np.ndarray:
        document, path = self._read(job)
        try:
            return self._draw(document, path, job, units=True)
        except LookupError as error:
            # With a unit system, MaterialX 1.39.5 has no implementation of any angle's unit.
            if "unit" not in str(error).lower():
                raise
            return self._draw(document, path, job, units=False)

    def _read(self, job: dict[str, Any]) -> tuple[mx.Document, mx.FileSearchPath]:
        document = mx.createDocument()
        path = mx.FileSearchPath(str(Path(job["material"]).parent))
        for folder in job.get("search", ()):
            path.append(folder)
        mx.readFromXmlFile(document, job["material"], path)
        document.setDataLibrary(self._libraries)
        return document, path

    def _draw(
        self, document: mx.Document, path: mx.FileSearchPath, job: dict[str, Any], units: bool
    ) -> np.ndarray:
        scene, renderer = self._scene, self._renderer
        images = mx_render_glsl.GLTextureHandler.create(mx_render.StbImageLoader.create())
        images.setSearchPath(path)
        # The sphere's texture coordinates lie in the first tile.
        resolver = document.createStringResolver()
        resolver.setFilePrefix("")  # names come with it
        resolver.setUdimString("1001")
        images.setFilenameResolver(resolver)
        renderer.setImageHandler(images)

        lamp = document.addNode("directional_light", "mrm_sweep_lamp", "lightshader")
        lamp.setInputValue("direction", mx.Vector3(*scene["direction"]))
        lamp.setInputValue("color", mx.Color3(*scene["color"]))
        lamp.setInputValue("intensity", 1.0)
        generator = mx_gen_glsl.GlslShaderGenerator.create()
        context = self._context(generator, job.get("interface", "complete"), units)
        lights = mx_render.LightHandler.create()
        lights.registerLights(document, [lamp], context)
        lights.setLightSources([lamp])
        around = mx_render.createUniformImage(
            2, 1, 3, mx_render.BaseType.FLOAT, mx.Color4(*scene["around"], 1.0)
        )
        lights.setEnvRadianceMap(around)
        lights.setEnvIrradianceMap(around)
        lights.setEnvSampleCount(scene["samples"])
        renderer.setLightHandler(lights)

        element = job.get("element")
        wanted = document.getDescendant(element) if element else document.getMaterialNodes()[0]
        try:
            if hasattr(generator, "registerTypeDefs"):
                generator.registerTypeDefs(document)
            shader = generator.generate("material", wanted, context)
        except Exception as error:
            raise LookupError(str(error)) from error
        renderer.createProgram(shader)
        renderer.validateInputs()
        renderer.render()
        document.removeNode("mrm_sweep_lamp")
        return _pixels(renderer.captureImage(None), *scene["size"])

    def _context(self, generator: Any, interface: str, units: bool) -> Any:
        context = mx_gen_shader.GenContext(generator)
        context.registerSourceCodeSearchPath(library.search_path())
        colors = mx_gen_shader.DefaultColorManagementSystem.create(generator.getTarget())
        colors.loadLibrary(self._libraries)
        generator.setColorManagementSystem(colors)
        if units:
            system = mx_gen_shader.UnitSystem.create(generator.getTarget())
            system.loadLibrary(self._libraries)
            registry = mx.UnitConverterRegistry.create()
            for kind in ("distance", "angle"):
                definition = self._libraries.getUnitTypeDef(kind)
                registry.addUnitConverter(definition, mx.LinearUnitConverter.create(definition))
            system.setUnitConverterRegistry(registry)
            generator.setUnitSystem(system)
        options = context.getOptions()
        options.targetColorSpaceOverride = "lin_rec709"
        options.targetDistanceUnit = "meter"
        options.fileTextureVerticalFlip = True
        options.shaderInterfaceType = getattr(
            mx_gen_shader.ShaderInterfaceType, f"SHADER_INTERFACE_{interface.upper()}"
        )
        return context


def _pixels(image: Any, width: int, height: int) -> np.ndarray:
    address = image.getResourceBuffer()
    if not isinstance(address, int):  # a PyCapsule before 1.39.5
        ctypes.pythonapi.PyCapsule_GetPointer.restype = ctypes.c_void_p
        ctypes.pythonapi.PyCapsule_GetPointer.argtypes = [ctypes.py_object, ctypes.c_char_p]
        address = ctypes.pythonapi.PyCapsule_GetPointer(address, None)
    channels = image.getChannelCount()
    numbers = width * height * channels
    kind = {mx_render.BaseType.FLOAT: ctypes.c_float, mx_render.BaseType.UINT8: ctypes.c_uint8}[
        image.getBaseType()
    ]
    pixels = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), (numbers,)).copy()
    return pixels.reshape(height, width, channels)[::-1]


def main(scene: dict[str, Any]) -> None:
    studio = Studio(scene)
    for job in scene["jobs"]:
        output = Path(job["output"])
        try:
            np.save(output, studio.draw(job))
        except Exception as error:
            output.with_suffix(".txt").write_text(" ".join(f"{type(error).__name__}: {error}".split())[:2000])


if __name__ == "__main__":
    main(json.loads(Path(sys.argv[1]).read_text()))
