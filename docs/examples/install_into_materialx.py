"""Into MaterialX itself: the nodes are installed in a `libraries` folder, and MaterialX alone does the rest.

Copies MaterialX's libraries to resources/libraries, as a program brings them along, installs the nodes there, and
writes cone.frag: the code that MaterialX's own generator makes of a traffic cone. mrm_nodes has no part in that.
"""

import shutil
from pathlib import Path

import MaterialX as mx
from MaterialX import PyMaterialXGenGlsl as mx_gen_glsl
from MaterialX import PyMaterialXGenShader as mx_gen_shader

from mrm_nodes.library import install, materials_path, own_libraries

shutil.copytree(own_libraries(), "resources/libraries", dirs_exist_ok=True)
print(f"{len(install('resources/libraries'))} files in resources/libraries/mrm")

search_path = mx.FileSearchPath(str(Path("resources").resolve()))
library = mx.createDocument()
mx.loadLibraries(["libraries"], search_path, library)
document = mx.createDocument()
mx.readFromXmlFile(document, str(materials_path() / "traffic_cone.mtlx"))
document.setDataLibrary(library)
valid, message = document.validate()
print(f"valid: {valid} {message}")

generator = mx_gen_glsl.GlslShaderGenerator.create()
context = mx_gen_shader.GenContext(generator)
context.registerSourceCodeSearchPath(search_path)
(material,) = mx_gen_shader.findRenderableElements(document)
shader = generator.generate("cone", material, context)
code = shader.getSourceCode(mx_gen_shader.PIXEL_STAGE)
Path("cone.frag").write_text(code)
print(f"cone.frag: {len(code.splitlines())} lines, {code.count('mrm_')} times mrm_")
