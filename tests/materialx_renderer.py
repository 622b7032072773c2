"""Renders a material with MaterialX's own GlslRenderer, which needs a display: run it under xvfb-run.

Arguments: a .mtlx file, an .obj file, a JSON file (`size`, `view` and `projection` by columns, `direction`, `color`)
and the .npy file to write: (h, w, 4) float32, row 0 at the top.
"""

from __future__ import annotations

import ctypes
import json
import sys
from pathlib import Path

import MaterialX as mx
import MaterialX.PyMaterialXGenGlsl as mx_gen_glsl
import MaterialX.PyMaterialXGenShader as mx_gen_shader
import MaterialX.PyMaterialXRender as mx_render
import MaterialX.PyMaterialXRenderGlsl as mx_render_glsl
import numpy as np

from mrm_nodes import library


def main(material: str, mesh: str, scene: dict, output: str) -> None:
    width, height = scene["size"]
    document = mx.createDocument()
    mx.readFromXmlFile(document, material)
    document.importLibrary(library.load_library())
    lamp = document.addNode("directional_light", "lamp", "lightshader")
    lamp.setInputValue("direction", mx.Vector3(*scene["direction"]))
    lamp.setInputValue("color", mx.Color3(*scene["color"]))
    lamp.setInputValue("intensity", 1.0)

    generator = mx_gen_glsl.GlslShaderGenerator.create()
    context = mx_gen_shader.GenContext(generator)
    context.registerSourceCodeSearchPath(library.search_path())

    renderer = mx_render_glsl.GlslRenderer.create(width, height, mx_render.BaseType.FLOAT)
    renderer.initialize()
    images = mx_render_glsl.GLTextureHandler.create(mx_render.StbImageLoader.create())
    renderer.setImageHandler(images)

    geometry = mx_render.GeometryHandler.create()
    geometry.addLoader(mx_render.TinyObjLoader.create())
    geometry.loadGeometry(mx.FilePath(mesh), False)
    renderer.setGeometryHandler(geometry)

    camera = mx_render.Camera.create()
    camera.setWorldMatrix(mx.Matrix44.IDENTITY)
    camera.setViewMatrix(mx.Matrix44(*scene["view"]))
    camera.setProjectionMatrix(mx.Matrix44(*scene["projection"]))
    renderer.setCamera(camera)

    lights = mx_render.LightHandler.create()
    lights.registerLights(document, [lamp], context)
    lights.setLightSources([lamp])
    black = mx_render.createUniformImage(2, 1, 3, mx_render.BaseType.FLOAT, mx.Color4(0.0, 0.0, 0.0, 1.0))
    lights.setEnvRadianceMap(black)
    lights.setEnvIrradianceMap(black)
    renderer.setLightHandler(lights)

    shader = generator.generate("material", document.getMaterialNodes()[0], context)
    renderer.createProgram(shader)
    renderer.validateInputs()
    renderer.render()
    image = renderer.captureImage(None)

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
    np.save(output, pixels.reshape(height, width, channels)[::-1])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], json.loads(Path(sys.argv[3]).read_text()), sys.argv[4])
