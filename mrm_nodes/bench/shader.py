"""What the blended nodes cost, beside MaterialX's own node and the mix of two that people would write instead."""

from __future__ import annotations

import functools
import os
import shutil
import statistics
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import MaterialX as mx
import moderngl
import numpy as np

from mrm_nodes.library import shared_library
from mrm_nodes.regression.truth.material import NODES
from mrm_nodes.render.context import GLContext, get_context
from mrm_nodes.render.environment import Environment, EnvironmentTextures, studio
from mrm_nodes.render.renderer import render
from mrm_nodes.shadergen import Shader, generate_shader

#: What is measured: MaterialX's forward node, its mix of both lobes, and ours at three weights.
SUBJECTS = ("single", "mix", "ours 0", "ours 0.5", "ours 1")

#: Environment method, and samples for each lobe. Direct light has a black environment, as a renderer without one.
LIGHTS = {"direct": ("prefilter", 0), "fis": ("fis", 16)}
INTERFACES = ("complete", "reduced")
FILM_NANOMETERS = 400.0

_GRID = 8


@dataclass(frozen=True)
class ShaderRow:
    """One configuration: milliseconds a frame by subject, and instructions of SPIR-V where the tools are here."""

    node: str
    light: str
    interface: str
    film: bool
    milliseconds: dict[str, float]
    instructions: dict[str, int]

    @property
    def ratios(self) -> dict[str, float]:
        """The blend against the mix, and weight 0 and 1 against the single node."""
        single, mix = self.milliseconds["single"], self.milliseconds["mix"]
        return {
            "mix / single": mix / single,
            "0.5 / mix": self.milliseconds["ours 0.5"] / mix,
            "0 / single": self.milliseconds["ours 0"] / single,
            "1 / single": self.milliseconds["ours 1"] / single,
        }


def bench_shaders(
    backend: str = "auto",
    size: int = 256,
    rounds: int = 21,
    nodes: Sequence[str] = NODES,
    lights: Sequence[str] = tuple(LIGHTS),
    interfaces: Sequence[str] = INTERFACES,
    films: Sequence[bool] = (False, True),
    instructions: bool = False,
) -> Iterator[ShaderRow]:
    """Measure every configuration; the frames of its subjects take turns, and each subject has its median.

    On software GL a frame's time is what it takes of the processor, which other programs disturb least; on a GPU
    it is the time on the GPU.
    """
    context = get_context(backend)
    for light in lights:
        for interface in interfaces:
            for node in nodes:
                for film in films:
                    shaders = {
                        subject: _shader(node, subject, light, interface, film, "glsl")
                        for subject in SUBJECTS
                    }
                    work = functools.partial(_frame_times, context, shaders, light, size, rounds)
                    times = context.run(work)
                    counts = (
                        {
                            subject: count
                            for subject in SUBJECTS
                            if (
                                count := spirv_instructions(
                                    _shader(node, subject, light, interface, film, "vulkan")
                                )
                            )
                        }
                        if instructions
                        else {}
                    )
                    yield ShaderRow(node, light, interface, film, times, counts)


def _shader(node: str, subject: str, light: str, interface: str, film: bool, target: str) -> Shader:
    document = mx.createDocument()
    document.setDataLibrary(shared_library())
    own = node.removeprefix("mrm_")

    def add(category: str, name: str) -> mx.Node:
        bsdf = document.addNode(category, name, "BSDF")
        if film:
            bsdf.setInputValue("thinfilm_thickness", FILM_NANOMETERS)
        return bsdf

    if subject == "mix":
        bsdf = document.addNode("mix", "blend", "BSDF")
        for end, retroreflective in (("bg", False), ("fg", True)):
            lobe = add(own, end)
            lobe.setInputValue("retroreflective", retroreflective)
            bsdf.addInput(end, "BSDF").setConnectedNode(lobe)
        bsdf.setInputValue("mix", 0.5)
    elif subject == "single":
        bsdf = add(own, "bsdf")
    else:
        bsdf = add(node, "bsdf")
        bsdf.setInputValue("retroreflectivity", float(subject.split()[1]))
    surface = document.addNode("surface", "surface", "surfaceshader")
    surface.addInput("bsdf", "BSDF").setConnectedNode(bsdf)
    material = document.addNode("surfacematerial", "material", "material")
    material.addInput("surfaceshader", "surfaceshader").setConnectedNode(surface)
    return generate_shader(document, target, environment=LIGHTS[light][0], interface=interface, max_lights=1)


def _frame_times(
    context: GLContext, shaders: dict[str, Shader], light: str, size: int, rounds: int
) -> dict[str, float]:
    """Return the median milliseconds of each shader's frame."""
    ctx = context.ctx
    made: list[Any] = []
    picture, depth = ctx.texture((size, size), 4, dtype="f4"), ctx.depth_renderbuffer((size, size))
    target = ctx.framebuffer([picture], depth)
    target.use()
    ctx.enable_only(moderngl.DEPTH_TEST)
    around = studio()
    textures = EnvironmentTextures.upload(context, around)
    black = ctx.texture((1, 1), 3, np.zeros(3, np.float32), alignment=1, dtype="f4")
    made += [target, picture, depth, textures, black]
    arrays = {subject: _patch_array(ctx, shader, light, around, made) for subject, shader in shaders.items()}
    (textures.radiance if LIGHTS[light][1] else black).use(0)
    software = "llvmpipe" in context.renderer.lower() or "softpipe" in context.renderer.lower()
    times: dict[str, list[float]] = {subject: [] for subject in shaders}
    for number in range(rounds + 2):
        for subject, array in arrays.items():
            target.clear()
            ctx.finish()
            if software:
                start = time.process_time()
                array.render()
                ctx.finish()
                taken = time.process_time() - start
            else:
                query = ctx.query(time=True)
                with query:
                    array.render()
                ctx.finish()
                taken = query.elapsed * 1e-9
            # The first frames compile.
            if number >= 2:
                times[subject].append(1e3 * taken)
    ctx.screen.use()  # moderngl binds again and again what is bound, although it may be gone
    for item in made:
        item.release()
    return {subject: statistics.median(values) for subject, values in times.items()}


def _patch_array(
    ctx: moderngl.Context, shader: Shader, light: str, around: Environment, made: list[Any]
) -> moderngl.VertexArray:
    """Return a slightly curved patch that fills the picture, lit by one directional light.

    What has to be released goes into `made`.
    """
    program = ctx.program(vertex_shader=shader.vertex, fragment_shader=shader.pixel)
    samples = LIGHTS[light][1]
    identity = tuple(np.eye(4).ravel().tolist())
    values: dict[str, Any] = around.uniforms() | {
        "u_worldMatrix": identity,
        "u_worldInverseTransposeMatrix": identity,
        "u_viewProjectionMatrix": identity,
        "u_viewPosition": (0.3, 0.2, 3.0),
        "u_numActiveLightSources": 1,
        "u_lightData[0].type": 1,
        "u_lightData[0].direction": (0.0, -0.6, -0.8),
        "u_lightData[0].color": (1.0, 1.0, 1.0),
        "u_lightData[0].intensity": 1.0,
        "u_envRadianceSamples": samples,
        "u_envRadiance": 0,
        "u_envIrradiance": 0,
    }
    for name, value in values.items():
        if name in program:
            uniform = program[name]
            kind = np.float32 if uniform.fmt.endswith("f") else np.int32  # type: ignore[union-attr]
            uniform.write(np.asarray(value, kind))  # type: ignore[union-attr]
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, _GRID + 1), np.linspace(-1.0, 1.0, _GRID + 1))
    normals = np.stack([0.6 * x, 0.6 * y, np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    streams = {
        "i_position": np.stack([x, y, 0.0 * x], axis=-1),
        "i_normal": normals,
        "i_tangent": np.broadcast_to((1.0, 0.0, 0.0), normals.shape),
    }
    content = [
        (ctx.buffer(np.ascontiguousarray(data, np.float32)), "3f", name)
        for name, data in streams.items()
        if name in program
    ]
    corner = (np.arange(_GRID)[:, None] * (_GRID + 1) + np.arange(_GRID)).ravel()
    quads = np.stack([corner, corner + 1, corner + _GRID + 2, corner, corner + _GRID + 2, corner + _GRID + 1])
    indices = ctx.buffer(np.ascontiguousarray(quads.T, np.int32))
    array = ctx.vertex_array(program, content, indices)
    made += [array, indices, *(buffer for buffer, *_ in content), program]
    return array


def spirv_instructions(shader: Shader) -> int | None:
    """Return how many instructions a pixel stage has in SPIR-V after `spirv-opt -O`; None without those tools."""
    tools = [shutil.which(name) for name in ("glslangValidator", "spirv-opt")]
    compiler, optimizer = tools
    if compiler is None or optimizer is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        source, plain, small = (Path(folder) / name for name in ("shader.frag", "plain.spv", "small.spv"))
        source.write_text(shader.pixel, encoding="utf-8")
        quiet: dict[str, Any] = {"check": True, "capture_output": True}
        subprocess.run([compiler, "--quiet", "-V", "-o", plain, source], **quiet)
        subprocess.run([optimizer, "-O", plain, "-o", small], **quiet)
        words = np.fromfile(small, np.uint32)
    # Khronos, SPIR-V 1.6, section 2.3: a header of five words, then each instruction starts with its length.
    count, place, inside = 0, 5, False
    while place < len(words):
        length, opcode = int(words[place]) >> 16, int(words[place]) & 0xFFFF
        inside |= opcode == 54  # OpFunction: declarations come before the first
        count += inside
        place += length
    return count


def bench_threads(
    backend: str = "auto", size: int = 128, count: int = 40, rounds: int = 5
) -> dict[int, list[float]]:
    """Return the seconds of each round for `count` renders of one material from one thread, and from four.

    The shader is generated anew for each, as `render` does with a file; the rounds take turns.
    """
    with tempfile.TemporaryDirectory() as folder:
        material = Path(folder, "material.mtlx")
        document = mx.createDocument()
        document.setDataLibrary(shared_library())
        surface = document.addNode("mrm_standard_surface", "surface", "surfaceshader")
        node = document.addNode("surfacematerial", "material", "material")
        node.addInput("surfaceshader", "surfaceshader").setConnectedNode(surface)
        mx.writeToXmlFile(document, str(material))

        def draw(_: int) -> None:
            render(material, lights=["camera"], size=(size, size), backend=backend)

        draw(0)
        seconds: dict[int, list[float]] = {1: [], 4: []}
        for _ in range(rounds):
            for threads, taken in seconds.items():
                with ThreadPoolExecutor(threads) as pool:
                    start = time.perf_counter()
                    list(pool.map(draw, range(count)))
                    taken.append(time.perf_counter() - start)
    return seconds


def describe_machine(backend: str = "auto") -> dict[str, str]:
    """Return what the figures belong to: driver, processor, versions."""
    context = get_context(backend)
    names = [
        line.split(":", 1)[1].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    info = context.ctx.info
    return {
        "renderer": str(info["GL_RENDERER"]),
        "driver": str(info["GL_VERSION"]),
        "processor": f"{len(os.sched_getaffinity(0))} × {names[0] if names else 'unknown'}",
        "MaterialX": mx.getVersionString(),
    }


def as_json(rows: Sequence[ShaderRow], machine: dict[str, str]) -> dict[str, Any]:
    """Return the figures as JSON has them."""
    return {"machine": machine, "rows": [{**asdict(row), "ratios": row.ratios} for row in rows]}
