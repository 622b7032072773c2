"""MaterialX shader generation for every target that the installed MaterialX has."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import pkgutil
import re
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes import external, filenames, library, mdl, shipped, units, values
from mrm_nodes.documents import one_line, read_document
from mrm_nodes.elements import check_document, find_renderable, used_by
from mrm_nodes.errors import MrmError, MrmWarning, unknown
from mrm_nodes.naming import named_apart, named_for_code
from mrm_nodes.transparency import may_be_transparent

#: Light nodes as every shader of ours knows them, by the number that LightData.type carries.
LIGHT_TYPES = {"directional_light": 1, "point_light": 2, "spot_light": 3}

#: Our names for MaterialX's generators, by the target that the generator itself names.
_TARGET_NAMES = {"genglsl": "glsl", "essl": "essl", "genvk": "vulkan"}

_ENVIRONMENTS = {
    "none": "SPECULAR_ENVIRONMENT_NONE",
    "fis": "SPECULAR_ENVIRONMENT_FIS",
    "prefilter": "SPECULAR_ENVIRONMENT_PREFILTER",
}
#: The GLSL macro by which our nodes learn the method, and its value: one loop then serves both lobes.
_ENVIRONMENT_MACRO = "MRM_ENVIRONMENT"
_ENVIRONMENT_VALUES = {"fis": 1, "prefilter": 2}
#: How many lights a shader has room for where nobody asks for more.
USUAL_LIGHTS = 4
_INTERFACES = {"complete": "SHADER_INTERFACE_COMPLETE", "reduced": "SHADER_INTERFACE_REDUCED"}


@dataclass(frozen=True)
class Shader:
    """A generated shader: source text per stage, and MaterialX's own object for whoever binds its inputs."""

    name: str
    """Of the function that it is generated as."""
    target: str
    """One of `supported_targets()`."""
    vertex: str
    """Source text of the vertex stage; empty where the target has none."""
    pixel: str
    """Source text of the pixel stage."""
    mx: Any
    """`MaterialX.PyMaterialXGenShader.Shader`."""
    document: mx.Document
    """What the shader's uniforms refer to."""
    search_path: tuple[Path, ...]
    """Folders in which textures are looked for, in this order."""
    spaces: Mapping[str, str] = field(default_factory=dict)
    """Colour spaces by the path of an input: see `values.Settled`."""
    sampling: Mapping[str, Any] = field(default_factory=dict)
    """How images are read, where no uniform says it."""
    renamed: Mapping[str, str] = field(default_factory=dict)
    """By the path of a node as given: its path in `document`."""

    def __repr__(self) -> str:
        return f"<Shader {self.name!r} for {self.target}, {len(self.pixel.splitlines())} lines of its pixel stage>"

    def element_at(self, path: str) -> mx.Element | None:
        """The element of `document` that stands for a node or an input, by its path in the document as given."""
        node, _, name = path.rpartition("/")
        own = f"{self.renamed[node]}/{name}" if node in self.renamed else self.renamed.get(path, path)
        return self.document.getDescendant(own) if own else None

    def path_given(self, path: str) -> str:
        """The path in the document as given of an input in `document`."""
        node, _, name = path.rpartition("/")
        given = {own: before for before, own in self.renamed.items()}.get(node)
        return path if given is None else f"{given}/{name}"


def supported_targets() -> list[str]:
    """Return the names of the targets that the installed MaterialX can generate, such as `glsl` and `osl`."""
    return list(_generators())


@functools.cache
def _generators() -> dict[str, type]:
    """Find every `…ShaderGenerator` class of the installed MaterialX that can be created, by target name."""
    found: dict[str, type] = {}
    for module_info in pkgutil.iter_modules(mx.__path__):
        if not module_info.name.startswith("PyMaterialXGen") or module_info.name == "PyMaterialXGenShader":
            continue
        module = importlib.import_module(f"MaterialX.{module_info.name}")
        for class_name, cls in vars(module).items():
            if class_name.endswith("ShaderGenerator") and hasattr(cls, "create"):
                found[_target_name(class_name)] = cls
    order = ["glsl", "essl", "vulkan", "wgsl", "msl", "slang", "osl", "mdl"]
    return dict(
        sorted(
            found.items(),
            key=lambda item: (order.index(item[0]) if item[0] in order else len(order), item[0]),
        )
    )


def _target_name(class_name: str) -> str:
    stem = class_name.removesuffix("ShaderGenerator").lower()
    return {"vk": "vulkan", "vkresourcebinding": "vulkan"}.get(stem, stem)


def generator_target(target: str) -> str:
    """Return MaterialX's own name for a target, by which it chooses implementations: `genosl` for `osl`.

    Raises:
        MrmError: an unknown target.
    """
    if target not in _generators():
        raise MrmError(unknown("target", target, supported_targets()))
    return str(_generators()[target].create().getTarget())  # type: ignore[attr-defined]


def generate_shader(
    path_or_document: str | os.PathLike[str] | mx.Document,
    target: str = "glsl",
    element: str | None = None,
    *,
    environment: str = "fis",
    interface: str = "complete",
    max_lights: int = USUAL_LIGHTS,
    libraries: str | os.PathLike[str] | None = None,
    allow_external: bool = False,
    varying: Iterable[str] = (),
) -> Shader:
    """Generate the shader of one renderable element.

    A surface that may be transparent by MaterialX's own test gets MaterialX's code for it: alpha, and `discard` below
    `u_alphaThreshold`. Warns (MrmWarning) of what a material has beside its surface, such as displacement: no target
    draws it.

    Args:
        path_or_document: a .mtlx file, the name of a finished material (`traffic_cone`), or a document.
        target: one of `supported_targets()`.
        element: name path of a material, a shader or an output, as `my_material` or `my_graph/out`; needed
            where the document has several materials.
        environment: how image light is evaluated in the GLSL family: `fis`, `prefilter` or `none`.
        interface: `complete` makes every input a uniform, `reduced` only those that the document sets.
        max_lights: size of the light array of the GLSL family; `room_for` says what so many lights need.
        libraries: a MaterialX `libraries` folder to use in place of the installed MaterialX's.
        allow_external: as in `read_document`.
        varying: inputs, by path or by their uniforms' names, that will get other values than the document's: a
            surface which is transparent with some of them counts as one.

    Raises:
        MrmError: unreadable document, unknown node, target, element or option, or a value that is no number.
    """
    generator_class = _generators().get(target)
    if generator_class is None:
        raise MrmError(unknown("target", target, supported_targets()))
    for option, value, known in (
        ("environment", environment, _ENVIRONMENTS),
        ("interface", interface, _INTERFACES),
    ):
        if value not in known:
            raise MrmError(unknown(option, value, known))
    if max_lights < 0:
        raise MrmError(f"max_lights {max_lights} is negative")

    if isinstance(path_or_document, mx.Document):
        document, where = path_or_document, path_or_document.getSourceUri() or "document"
        folder = filenames.folder_of(Path(path_or_document.getSourceUri() or "document"))
        if not document.hasDataLibrary() and document.getNodeDef("ND_conductor_bsdf") is None:
            document.setDataLibrary(library.shared_library(libraries))
    else:
        file = shipped.material_file(path_or_document)
        document = read_document(file, libraries, allow_external)
        where = str(file)
        folder = filenames.folder_of(file)
    renderable = find_renderable(document, where, element)
    generator = generator_class.create()  # type: ignore[attr-defined]
    check_document(document, where, renderable, generator.getTarget())
    for name in _undrawn(renderable):
        warnings.warn(
            f"{where}: {renderable.getNamePath()}: its {name} is not drawn", MrmWarning, stacklevel=2
        )
    is_hardware = isinstance(generator, mx_gen_shader.HwShaderGenerator)
    transparent = is_hardware and may_be_transparent(renderable, generator.getTarget(), varying)
    document, renderable = named_for_code(document, renderable)
    settled = values.settle(document, renderable, where)
    for note in settled.unapplied:
        warnings.warn(f"{where}: {note}", MrmWarning, stacklevel=2)
    document, renderable = settled.document, settled.document.getDescendant(renderable.getNamePath())
    document, renderable, renamed = named_apart(document, renderable, generator.getTarget())
    if target == "mdl":
        path = renderable.getNamePath()
        document, _ = mdl.prepared(values.explicit(document), libraries)
        renderable = document.getDescendant(path)

    context = mx_gen_shader.GenContext(generator)
    search_path = library.search_path(libraries)
    context.registerSourceCodeSearchPath(search_path)
    # Decodes what a document tags, such as an srgb_texture image.
    colors = mx_gen_shader.DefaultColorManagementSystem.create(generator.getTarget())
    colors.loadLibrary(library.shared_library(libraries))
    generator.setColorManagementSystem(colors)
    options = context.getOptions()
    options.targetColorSpaceOverride = "lin_rec709"
    options.hwMaxActiveLightSources = max_lights
    options.hwSpecularEnvironmentMethod = getattr(
        mx_gen_shader.HwSpecularEnvironmentMethod, _ENVIRONMENTS[environment]
    )
    options.shaderInterfaceType = getattr(mx_gen_shader.ShaderInterfaceType, _INTERFACES[interface])
    # MaterialX loads images bottom row first for GL; our renderer hands them over top row first.
    options.fileTextureVerticalFlip = True
    if target == "mdl" and hasattr(options, "distributeLayerOverBsdfMix"):
        # Done already, with more on top than mixes; MaterialX's own takes a volume below a mix for a BSDF.
        options.distributeLayerOverBsdfMix = False
    options.hwTransparency = transparent
    if is_hardware:
        for node, number in LIGHT_TYPES.items():
            definition = library.shared_library(libraries).getNodeDef(f"ND_{node}")
            mx_gen_shader.HwShaderGenerator.bindLightShader(definition, number, context)

    name = mx.createValidName(renderable.getNamePath().replace("/", "_"))
    converting = (
        units.unit_system(generator, context, settled.definitions)
        if settled.definitions is not None
        else contextlib.nullcontext()
    )
    sampling: dict[str, Any] = {}
    try:
        generator.registerTypeDefs(document)
        with converting:
            shader = generator.generate(name, renderable, context)
            if interface == "reduced":
                # That leaves out what is no part of the code: how images are read.
                options.shaderInterfaceType = mx_gen_shader.ShaderInterfaceType.SHADER_INTERFACE_COMPLETE
                sampling = _sampling(generator.generate(name, renderable, context))
    except Exception as error:  # MaterialX's own exception types differ between versions
        said = one_line(error)
        reason = _without_implementation(renderable, generator.getTarget()) or said
        # MaterialX names a file that is not there, and not which one asks for it.
        for absent, asking in external.absent_source(document, Path(where)).items():
            if f"'{absent}'" in said or f'"{absent}"' in said:
                reason = f"{asking} asks for {absent}, which is not there ({said})"
        raise MrmError(f"{where}: {target} shader of {renderable.getNamePath()}: {reason}") from None
    return Shader(
        name=name,
        target=target,
        vertex=_source(shader, "vertex"),
        pixel=_knowing_environment(_source(shader, "pixel"), environment),
        mx=shader,
        document=document,
        search_path=tuple(filenames.image_folders(folder)),
        spaces=settled.spaces,
        sampling=sampling,
        renamed=renamed,
    )


def room_for(lights: int) -> int:
    """`max_lights` for so many lights: the usual number where that is enough, so that shaders are shared."""
    return max(USUAL_LIGHTS, lights)


def _undrawn(element: mx.Element) -> list[str]:
    """Name what a material has beside its surface."""
    if not isinstance(element, mx.Node) or element.getType() != "material":
        return []
    names = [port.getName() for port in element.getInputs() if port.getConnectedNode() is not None]
    return [name.removesuffix("shader") for name in names if name != "surfaceshader"]


def _sampling(shader: Any) -> dict[str, Any]:
    """The values beside each image's file, by the names of their uniforms."""
    block = shader.getStage("pixel").getUniformBlocks().get("PublicUniforms")
    ports = [] if block is None else [block[index] for index in range(block.size())]
    stems = {
        port.getVariable().rpartition("_")[0] for port in ports if port.getType().getName() == "filename"
    }
    beside = {
        port.getVariable(): port.getValue().getData()
        for port in ports
        if port.getValue() is not None and port.getVariable().rpartition("_")[0] in stems
    }
    return {name: [data] if isinstance(data, int | float) else data for name, data in beside.items()}


def _knowing_environment(source: str, environment: str) -> str:
    """Define the macro that tells our nodes the environment method, where they are part of the source."""
    if _ENVIRONMENT_MACRO not in source or environment not in _ENVIRONMENT_VALUES:
        return source
    define = f"#define {_ENVIRONMENT_MACRO} {_ENVIRONMENT_VALUES[environment]}\n"
    # Nothing but comments may come before GLSL's version.
    version = re.search(r"^#version.*\n", source, re.MULTILINE)
    place = version.end() if version else 0
    return source[:place] + define + source[place:]


def _without_implementation(element: mx.Element, target: str) -> str:
    """Name the first node that a target has no implementation for; empty where each has one."""
    for node in used_by([element], target):
        definition = (node.getNodeDef(target) or node.getNodeDef()) if node.isA(mx.Node) else None
        if definition is not None and definition.getImplementation(target) is None:
            return f"node {node.getNamePath()}: {node.getCategory()} has no implementation for this target"
    return ""


def _source(shader: Any, stage: str) -> str:
    return shader.getSourceCode(stage) if shader.hasStage(stage) else ""
