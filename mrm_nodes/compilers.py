"""Generated shaders through real compilers: one for each target that has one on Linux."""

from __future__ import annotations

import functools
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import MaterialX as mx

from mrm_nodes import library
from mrm_nodes.errors import MrmError
from mrm_nodes.shadergen import Shader, generate_shader

#: Signatures of Metal's standard library, which exists on macOS only.
METAL_STUB = Path(__file__).parent / "metal_stub"

#: compiled: a real compiler took it; failed: it did not; upstream: nor does it take MaterialX's own nodes;
#: generated: no compiler for this target is known; unchecked: the compiler is not installed;
#: not generated: MaterialX stopped.
Status = Literal["compiled", "failed", "upstream", "generated", "unchecked", "not generated"]

_TIMEOUT_SECONDS = 300


@dataclass(frozen=True)
class Compiler:
    """What compiles a target's source here."""

    name: str
    install: str
    """How to get it."""
    is_installed: Callable[[], bool]
    complaints: Callable[[Shader], list[str]]
    """One line per complaint; empty where the shader compiles."""


@dataclass(frozen=True)
class Check:
    """What became of one target."""

    target: str
    status: Status
    compiler: str = ""
    complaints: tuple[str, ...] = ()

    @property
    def is_fault(self) -> bool:
        """Whether our nodes, or the user's graph, are to blame."""
        return self.status in ("failed", "not generated")


def check_shader(shader: Shader) -> Check:
    """Compile a generated shader with its target's compiler, as far as there is one."""
    compiler = COMPILERS.get(shader.target)
    if compiler is None:
        return Check(shader.target, "generated")
    if not compiler.is_installed():
        return Check(shader.target, "unchecked", compiler.name, (f"not installed; {compiler.install}",))
    complaints = tuple(compiler.complaints(shader))
    return Check(shader.target, "failed" if complaints else "compiled", compiler.name, complaints)


def check_material(
    path_or_document: str | os.PathLike[str] | mx.Document,
    target: str,
    element: str | None = None,
    **options: Any,
) -> Check:
    """Generate a material for a target and compile it. Options are those of `generate_shader`.

    Where it does not compile, and does not either with MaterialX's own nodes in place of ours, the fault is
    upstream.
    """
    try:
        shader = generate_shader(path_or_document, target, element, **options)
    except MrmError as error:
        return Check(target, "not generated", complaints=(str(error),))
    check = check_shader(shader)
    if check.status == "failed" and upstream_complaints(shader.document, target, element, **options):
        return replace(check, status="upstream")
    return check


def upstream_complaints(
    document: mx.Document, target: str, element: str | None = None, **options: Any
) -> tuple[str, ...]:
    """What a target's compiler says of a document with MaterialX's own nodes in place of ours."""
    own = mx.createDocument()
    own.copyContentFrom(document)
    if document.hasDataLibrary():
        own.setDataLibrary(document.getDataLibrary())
    for node in own.traverseTree():
        if not isinstance(node, mx.Node) or not node.getCategory().startswith("mrm_"):
            continue
        node.setCategory(node.getCategory().removeprefix("mrm_"))
        declared = own.getMatchingNodeDefs(node.getCategory())
        known = {each.getName() for definition in declared for each in definition.getActiveInputs()}
        for given in node.getInputs():
            if given.getName() not in known:
                node.removeInput(given.getName())
        # Their distribution has one value.
        node.removeInput("distribution")
    try:
        return check_shader(generate_shader(own, target, element, **options)).complaints
    except MrmError:
        return ()  # no such document without ours


def add_up(document: mx.Document, lobes: list[mx.Node], name: str) -> mx.Node:
    """Add BSDFs up under a surface and a material of this name, and return the material."""
    total = lobes[0]
    for index, lobe in enumerate(lobes[1:]):
        added = document.addNode("add", f"{name}_add_{index}", "BSDF")
        added.addInput("in1", "BSDF").setConnectedNode(total)
        added.addInput("in2", "BSDF").setConnectedNode(lobe)
        total = added
    surface = document.addNode("surface", f"{name}_surface", "surfaceshader")
    surface.addInput("bsdf", "BSDF").setConnectedNode(total)
    material = document.addNode("surfacematerial", name, "material")
    material.addInput("surfaceshader", "surfaceshader").setConnectedNode(surface)
    return material


def _has_commands(*names: str) -> Callable[[], bool]:
    return lambda: all(shutil.which(name) for name in names)


def _has_module(name: str) -> Callable[[], bool]:
    return lambda: importlib.util.find_spec(name) is not None


def _run(*command: str | Path) -> list[str]:
    """Run a compiler and return its complaints, none where it exits with status 0."""
    finished = subprocess.run(
        [os.fspath(part) for part in command], capture_output=True, text=True, timeout=_TIMEOUT_SECONDS
    )
    if finished.returncode == 0:
        return []
    lines = [line.strip() for line in (finished.stdout + finished.stderr).splitlines()]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or [f"{command[0]} exits with status {finished.returncode}"])[:5]


def _write_stages(shader: Shader, folder: Path) -> tuple[Path, Path]:
    """Write both stages, under the endings by which compilers tell them apart."""
    vertex, pixel = folder / "shader.vert", folder / "shader.frag"
    vertex.write_text(shader.vertex, encoding="utf-8")
    pixel.write_text(shader.pixel, encoding="utf-8")
    return vertex, pixel


def glslang_complaints(shader: Shader) -> list[str]:
    """What glslang says of a shader in GLSL or ESSL."""
    with tempfile.TemporaryDirectory() as folder:
        return _run("glslangValidator", "-l", *_write_stages(shader, Path(folder)))


def _spirv(shader: Shader) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        return _compile_spirv(shader, Path(folder))[1]


def _compile_spirv(shader: Shader, folder: Path) -> tuple[list[Path], list[str]]:
    modules, complaints = [], []
    for stage in _write_stages(shader, folder):
        module = stage.with_suffix(f"{stage.suffix}.spv")
        found = _run("glslangValidator", "-V", "-o", module, stage) or _run("spirv-val", module)
        complaints += found
        modules.append(module)
    return modules, complaints


def spirv_instructions(shader: Shader) -> Counter[str]:
    """Count the instructions of each stage of a Vulkan shader, after `spirv-opt -O`.

    Raises:
        MrmError: it does not compile.
    """
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        modules, complaints = _compile_spirv(shader, Path(folder))
        for stage, module in zip(("vertex", "pixel"), modules, strict=True):
            complaints = complaints or _run("spirv-opt", "-O", module, "-o", module)
            if complaints:
                raise MrmError(f"{shader.name}: {'; '.join(complaints)}")
            words = memoryview(module.read_bytes()).cast("I")
            position = 5  # the header
            while position < len(words):
                position += words[position] >> 16
                counts[stage] += 1
    return counts


def _driver(shader: Shader) -> list[str]:
    from mrm_nodes.render.context import get_context

    try:
        gl = get_context("auto")
        gl.run(lambda: gl.ctx.program(vertex_shader=shader.vertex, fragment_shader=shader.pixel).release())
    except Exception as error:  # moderngl raises its own type for every complaint of the driver
        return [line for line in str(error).splitlines() if "error" in line.lower()][:5] or [str(error)]
    return []


def _has_driver() -> bool:
    from mrm_nodes.render.context import get_context

    try:
        get_context("auto")
    except MrmError:
        return False
    return True


@functools.cache
def _wgpu_device() -> Any:
    import wgpu

    # Mesa's Vulkan loader complains where a session has no runtime folder.
    os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    return wgpu.gpu.request_adapter_sync(power_preference="high-performance").request_device_sync()


def _has_naga() -> bool:
    if not _has_module("wgpu")():
        return False
    try:
        _wgpu_device()
    except Exception:  # no Vulkan and no GL: wgpu's own exception types
        return False
    return True


def _naga(shader: Shader) -> list[str]:
    complaints = []
    for stage, source in (("vert", shader.vertex), ("frag", shader.pixel)):
        try:
            # naga reads the stage from the label's ending.
            _wgpu_device().create_shader_module(label=f"shader.{stage}", code=source)
        except Exception as error:  # wgpu's own exception types
            complaints += [line.strip() for line in str(error).splitlines() if line.strip()][:5]
    return complaints


def _slang(shader: Shader) -> list[str]:
    from mrm_nodes.render.slang import device

    session = device().create_slang_session(compiler_options={"include_paths": []})
    try:
        modules = [
            session.load_module_from_source(stage, source)
            for stage, source in (("vertex_stage", shader.vertex), ("pixel_stage", shader.pixel))
        ]
        session.link_program(modules, [entry for module in modules for entry in module.entry_points])
    except Exception as error:  # slangpy's own exception types
        # A paragraph for each complaint, with the source below the message.
        paragraphs = [" ".join(paragraph.split()) for paragraph in str(error).split("\n\n")]
        return [paragraph for paragraph in paragraphs if "error[" in paragraph][:5] or paragraphs[:1]
    return []


def _metal(shader: Shader) -> list[str]:
    with tempfile.TemporaryDirectory() as folder:
        return [
            line
            for stage in _write_stages(shader, Path(folder))
            for line in _run(
                *("clang++", "-x", "c++", "-std=c++17", "-fsyntax-only", "-nostdinc", "-nostdinc++"),
                *("-isystem", METAL_STUB, "-Xclang", "-cl-single-precision-constant"),
                *("-fno-lax-vector-conversions", "-Wno-unknown-attributes", "-Wno-c++11-narrowing"),
                stage,
            )
        ]


_BLENDER = "import bpy, _cycles, sys; sys.exit(not _cycles.osl_compile(*sys.argv[1:]))"


def _osl(shader: Shader) -> list[str]:
    includes = library.own_libraries() / "stdlib" / "genosl" / "include"
    with tempfile.TemporaryDirectory() as folder:
        source, compiled = Path(folder) / "shader.osl", Path(folder) / "shader.oso"
        # Blender's compiler takes no search path.
        source.write_text(
            shader.pixel.replace('"mx_funcs.h"', f'"{includes / "mx_funcs.h"}"'), encoding="utf-8"
        )
        if shutil.which("oslc"):
            return _run("oslc", "-q", "-o", compiled, source)
        return _run(sys.executable, "-c", _BLENDER, source, compiled)


def _has_osl() -> bool:
    return shutil.which("oslc") is not None or _has_module("bpy")()


_APT = "Debian, Ubuntu: apt-get install"
_PIP = "pip install 'mrm-nodes[targets]'"

#: By target; a target that is not here is generated and no more.
COMPILERS: dict[str, Compiler] = {
    "glsl": Compiler("OpenGL driver", f"{_APT} libegl1 libgl1-mesa-dri", _has_driver, _driver),
    "essl": Compiler(
        "glslang", f"{_APT} glslang-tools", _has_commands("glslangValidator"), glslang_complaints
    ),
    "vulkan": Compiler(
        "glslang, spirv-val",
        f"{_APT} glslang-tools spirv-tools",
        _has_commands("glslangValidator", "spirv-val", "spirv-opt"),
        _spirv,
    ),
    "wgsl": Compiler("naga", f"{_PIP}; {_APT} mesa-vulkan-drivers", _has_naga, _naga),
    "slang": Compiler("slang", _PIP, _has_module("slangpy"), _slang),
    "msl": Compiler("clang, stub of metal_stdlib", f"{_APT} clang", _has_commands("clang++"), _metal),
    "osl": Compiler("OSL", "oslc of Open Shading Language, or Blender's: pip install bpy", _has_osl, _osl),
}
