"""MaterialX shader generation for every target that the installed MaterialX has."""

from __future__ import annotations

import difflib
import functools
import importlib
import math
import os
import pkgutil
import re
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import MaterialX as mx
import MaterialX.PyMaterialXGenShader as mx_gen_shader

from mrm_nodes import cycles, external, library
from mrm_nodes.errors import MrmError, MrmWarning

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
_INTERFACES = {"complete": "SHADER_INTERFACE_COMPLETE", "reduced": "SHADER_INTERFACE_REDUCED"}


@dataclass(frozen=True)
class Shader:
    """A generated shader: source text per stage, and MaterialX's own object for whoever binds its inputs."""

    name: str
    target: str
    vertex: str
    pixel: str
    mx: Any  # MaterialX.PyMaterialXGenShader.Shader
    document: mx.Document  # the shader's uniforms refer to its elements
    search_path: mx.FileSearchPath  # where textures are looked for


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
        raise MrmError(_unknown("target", target, supported_targets()))
    return str(_generators()[target].create().getTarget())  # type: ignore[attr-defined]


def read_document(
    path: str | os.PathLike[str],
    libraries: str | os.PathLike[str] | None = None,
    allow_external: bool = False,
) -> mx.Document:
    """Read a .mtlx file, with MaterialX's standard libraries and ours beside it.

    libraries: a MaterialX `libraries` folder in place of the installed MaterialX's.
    allow_external: whether it may include documents and name images outside of its folder and the node libraries.

    Raises:
        MrmError: the file is missing, is not MaterialX, or names a file that it may not read.
    """
    file = Path(path)
    if not file.is_file():
        raise MrmError(f"{file}: no such file")
    external.check_includes(file, allow_external)
    document = mx.createDocument()
    try:
        mx.readFromXmlFile(document, str(file), mx.FileSearchPath(str(file.resolve().parent)))
    except Exception as error:  # MaterialX's own exception types differ between versions
        raise MrmError(f"{file}: not a MaterialX document: {_one_line(error)}") from None
    external.check_images(document, file, allow_external)
    document.setDataLibrary(library.shared_library(libraries))
    cycles.check_cycles(document, str(file))
    return document


def generate_shader(
    path_or_document: str | os.PathLike[str] | mx.Document,
    target: str = "glsl",
    element: str | None = None,
    *,
    environment: str = "fis",
    interface: str = "complete",
    max_lights: int = 4,
    libraries: str | os.PathLike[str] | None = None,
    allow_external: bool = False,
) -> Shader:
    """Generate the shader of one renderable element.

    Args:
        path_or_document: a .mtlx file or a document.
        target: one of `supported_targets()`.
        element: name path of a material, a shader or an output, as `my_material` or `my_graph/out`; needed
            where the document has several materials.
        environment: how image light is evaluated in the GLSL family: `fis`, `prefilter` or `none`.
        interface: `complete` makes every input a uniform, `reduced` only those that the document sets.
        max_lights: size of the light array of the GLSL family.
        libraries: a MaterialX `libraries` folder to use in place of the installed MaterialX's.
        allow_external: as in `read_document`.

    Raises:
        MrmError: unreadable document, unknown node, target, element or option, or a value that is no number.
    """
    generator_class = _generators().get(target)
    if generator_class is None:
        raise MrmError(_unknown("target", target, supported_targets()))
    for option, value, known in (
        ("environment", environment, _ENVIRONMENTS),
        ("interface", interface, _INTERFACES),
    ):
        if value not in known:
            raise MrmError(_unknown(option, value, known))
    if max_lights < 0:
        raise MrmError(f"max_lights {max_lights} is negative")

    if isinstance(path_or_document, mx.Document):
        document, where = path_or_document, path_or_document.getSourceUri() or "document"
        folder = Path(path_or_document.getSourceUri()).parent
        if not document.hasDataLibrary() and document.getNodeDef("ND_conductor_bsdf") is None:
            document.setDataLibrary(library.shared_library(libraries))
    else:
        document = read_document(path_or_document, libraries, allow_external)
        where = os.fspath(path_or_document)
        folder = Path(path_or_document).resolve().parent
    check_document(document, where)
    renderable = find_renderable(document, where, element)
    if target == "mdl":
        path = renderable.getNamePath()
        document = _without_distributions(document)
        renderable = document.getDescendant(path)

    generator = generator_class.create()  # type: ignore[attr-defined]
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
    if isinstance(generator, mx_gen_shader.HwShaderGenerator):
        for node, number in LIGHT_TYPES.items():
            definition = library.shared_library(libraries).getNodeDef(f"ND_{node}")
            mx_gen_shader.HwShaderGenerator.bindLightShader(definition, number, context)

    name = mx.createValidName(renderable.getNamePath().replace("/", "_"))
    try:
        shader = generator.generate(name, renderable, context)
    except Exception as error:  # MaterialX's own exception types differ between versions
        reason = _without_implementation(document, generator.getTarget()) or _one_line(error)
        raise MrmError(f"{where}: {target} shader of {renderable.getNamePath()}: {reason}") from None
    image_path = library.search_path(libraries)
    image_path.prepend(mx.FilePath(str(folder.resolve())))
    return Shader(
        name=name,
        target=target,
        vertex=_source(shader, "vertex"),
        pixel=_knowing_environment(_source(shader, "pixel"), environment),
        mx=shader,
        document=document,
        search_path=image_path,
    )


def _knowing_environment(source: str, environment: str) -> str:
    """Define the macro that tells our nodes the environment method, where they are part of the source."""
    if _ENVIRONMENT_MACRO not in source or environment not in _ENVIRONMENT_VALUES:
        return source
    define = f"#define {_ENVIRONMENT_MACRO} {_ENVIRONMENT_VALUES[environment]}\n"
    # Nothing but comments may come before GLSL's version.
    version = re.search(r"^#version.*\n", source, re.MULTILINE)
    place = version.end() if version else 0
    return source[:place] + define + source[place:]


def _without_distributions(document: mx.Document) -> mx.Document:
    """Return a copy in which our nodes leave `distribution` alone.

    MaterialX's MDL generator takes such an input for its own type of that name, which knows ggx only; the
    portable graphs, which MDL renders, do not use it.
    """
    copy = mx.createDocument()
    copy.copyContentFrom(document)
    if document.hasDataLibrary():
        copy.setDataLibrary(document.getDataLibrary())
    for node in _nodes(copy):
        if node.getCategory().startswith("mrm_") and node.getType() == "BSDF":
            node.removeInput("distribution")
    return copy


def _without_implementation(document: mx.Document, target: str) -> str:
    """Name the first node that a target has no implementation for; empty where each has one."""
    for node in _nodes(document):
        definition = node.getNodeDef(target) or node.getNodeDef()
        if definition is not None and definition.getImplementation(target) is None:
            return f"node {node.getNamePath()}: {node.getCategory()} has no implementation for this target"
    return ""


def _source(shader: Any, stage: str) -> str:
    return shader.getSourceCode(stage) if shader.hasStage(stage) else ""


def find_renderable(document: mx.Document, where: str, element: str | None) -> mx.Element:
    """Return the element to generate: the one named, or the only one that can be rendered.

    Raises:
        MrmError: no such element, none that can be rendered, or several.
    """
    # A graph that implements a definition, as the library's do, is not the document's own output.
    renderables = [
        found
        for found in mx_gen_shader.findRenderableElements(document)
        if not found.getParent().getAttribute("nodedef")
    ]
    names = [renderable.getNamePath() for renderable in renderables]
    if element is not None:
        found = document.getDescendant(element) if element else None
        if found is None:
            raise MrmError(f"{where}: {_unknown('element', element, names)}")
        return found
    if not renderables:
        raise MrmError(f"{where}: nothing to render: no material, shader or output")
    if len(renderables) > 1:
        raise MrmError(
            f"{where}: several elements can be rendered; name one with --element: {', '.join(names)}"
        )
    return renderables[0]


#: Where a literal value of our nodes' inputs is clamped, and why; MaterialX's own nodes clamp the same way.
_RANGES: dict[str, tuple[float, float]] = {
    "roughness": (1e-8, 1.0),
    "retroreflectivity": (0.0, 1.0),
    "tint": (0.0, math.inf),
    "color0": (0.0, math.inf),
    "color82": (0.0, math.inf),
    "color90": (0.0, math.inf),
}

#: Types whose values are numbers, and what such a value is.
_NUMBERS = {
    "boolean": "true or false",
    "integer": "an integer",
    "float": "a finite number",
    **{f"{kind}{n}": f"{n} finite numbers" for kind in ("vector", "color") for n in (2, 3, 4)},
    "matrix33": "9 finite numbers",
    "matrix44": "16 finite numbers",
}


def check_document(document: mx.Document, where: str = "document") -> None:
    """Check that every node, input, value and connection is sound; warn of values that the nodes will clamp.

    Raises:
        MrmError: an unknown node; an input that its node does not have, or of another type; a value that is
            malformed, NaN or infinite; a connection to something that does not exist or has another type.
    """
    for node in _nodes(document):
        if node.getNodeDef() is None:
            raise MrmError(f"{where}: node {node.getNamePath()}: {_why_undefined(node, document)}")
    for port in _ports(document):
        _check_port(port, f"{where}: {port.getNamePath()}")


def _own(document: mx.Document) -> list[mx.Element]:
    """Return the elements of a document that are no library's."""
    shared = library.shared_library()
    return [child for child in document.getChildren() if shared.getChild(child.getName()) is None]


def _nodes(document: mx.Document) -> Iterator[mx.Node]:
    for child in _own(document):
        if child.isA(mx.NodeGraph):
            yield from child.getNodes()
        elif child.isA(mx.Node):
            yield child


def _ports(document: mx.Document) -> Iterator[mx.Input | mx.Output]:
    """Yield the inputs and outputs of the document itself, of node graphs and, last, of nodes."""
    for child in _own(document):
        if child.isA(mx.NodeGraph):
            yield from child.getInputs()
            yield from child.getOutputs()
        elif child.isA(mx.Input) or child.isA(mx.Output):
            yield child
    for node in _nodes(document):
        yield from node.getInputs()


def _why_undefined(node: mx.Node, document: mx.Document) -> str:
    """Say what keeps a node from having a definition: its name, its type, or one of its inputs."""
    category = node.getCategory()
    definitions = {definition.getName(): definition for definition in document.getNodeDefs()}
    definitions |= {each.getName(): each for each in library.shared_library().getNodeDefs()}
    alike = [each for each in definitions.values() if each.getNodeString() == category]
    if not alike:
        return _unknown("node", category, {each.getNodeString() for each in definitions.values()})
    of_type = [each for each in alike if each.getType() == node.getType()]
    if not of_type:
        return f"{category} has no type {node.getType()}; known: {_listed(each.getType() for each in alike)}"
    for port in node.getInputs():
        name = port.getName()
        types = {each.getActiveInput(name).getType() for each in of_type if each.getActiveInput(name)}
        if not types:
            known = {each.getName() for definition in of_type for each in definition.getActiveInputs()}
            return f"{category}: {_unknown('input', name, known)}"
        if port.getType() not in types:
            return f"input {name} has type {port.getType()}, not {_listed(types)}"
    return f"no {category} has these inputs together"


def _listed(names: Iterable[str]) -> str:
    return " or ".join(sorted(set(names)))


def _check_port(port: mx.Input | mx.Output, place: str) -> None:
    text = port.getValueString()
    if text and port.getValue() is None and port.getType() in _NUMBERS:
        raise MrmError(f"{place}: {text} is not {_NUMBERS[port.getType()]}")
    source = port.getAttribute("nodename") or port.getAttribute("nodegraph")
    # Generation would go on without it, or end in the compiler. Other complaints it can live with.
    if source and "port connection" in port.validate()[1]:
        output = port.getOutputString()
        raise MrmError(
            f"{place}: connected to {source}{'/' + output if output else ''}, "
            f"which does not exist here or is no {port.getType()}"
        )
    node = port.getParent()
    if text and port.isA(mx.Input) and node.isA(mx.Node) and port.getType() == "string":
        choices = node.getNodeDef().getActiveInput(port.getName()).getAttribute("enum")
        known = [choice.strip() for choice in choices.split(",")] if choices else [text]
        if text not in known:
            raise MrmError(f"{place}: {_unknown('value', text, known)}")
    if node.getCategory().startswith("mrm_") and port.getName() in _RANGES:
        _warn_of_clamping(port, place)


def _warn_of_clamping(port: mx.Input, place: str) -> None:
    low, high = _RANGES[port.getName()]
    # Through a graph's interface, what is set there reaches the node.
    source = port.getInterfaceInput() or port
    text = source.getValueString() if source.getValue() is not None else ""
    if any(not low <= float(number) <= high for number in text.replace(",", " ").split()):
        limits = f"{low:g} to {high:g}" if math.isfinite(high) else f"at least {low:g}"
        warnings.warn(f"{place}: {text} is clamped to its range, {limits}", MrmWarning, stacklevel=5)


def _unknown(what: str, name: str, known: Any) -> str:
    close = difflib.get_close_matches(name, list(known), n=3)
    hint = f"did you mean {' or '.join(close)}?" if close else f"known: {', '.join(sorted(known))}"
    return f"unknown {what} {name}; {hint}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
