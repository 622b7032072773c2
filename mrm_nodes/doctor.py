"""What this machine can do: versions, the node library, OpenGL, and a first render."""

from __future__ import annotations

import importlib.metadata
import platform
import time

import numpy as np
from rich.console import Console
from rich.markup import escape

from mrm_nodes import library
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.material import NODES, document
from mrm_nodes.render.context import BACKENDS, probe_backends
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.render.scene import CameraLight, Framing
from mrm_nodes.shadergen import generate_shader, supported_targets

VERSIONED = ("mrm-nodes", "MaterialX", "moderngl", "OpenImageIO", "numpy", "numba")


def examine(backend: str = "auto", console: Console | None = None) -> int:
    """Print what was found, each fault with how to mend it, and return 0 where `backend` renders.

    Raises:
        MrmError: an unknown backend, or one that does not render.
    """
    if backend not in ("auto", *BACKENDS):
        raise MrmError(f"unknown backend {backend}; known: auto, {', '.join(BACKENDS)}")
    console = console or Console(highlight=False, soft_wrap=True)
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in VERSIONED)
    console.print(f"versions  Python {platform.python_version()}, {versions}")
    console.print(f"library   {escape(str(library.library_path()))}: {', '.join(NODES)}")
    console.print(f"targets   {', '.join(supported_targets())}")

    probes = {probe.backend: probe for probe in probe_backends()}
    for name, probe in probes.items():
        if probe.works:
            console.print(
                f"{name:<9} [green]works[/]: {escape(probe.renderer)}, OpenGL {escape(probe.version)}"
            )
        else:
            console.print(f"{name:<9} [yellow]missing[/]: {escape(probe.reason)}; {escape(probe.hint)}")
    working = [name for name, probe in probes.items() if probe.works and backend in ("auto", name)]
    if not working:
        wanted = "no backend works" if backend == "auto" else f"backend {backend} does not work"
        raise MrmError(f"{wanted} here; see above for what to install")
    console.print(f"render    [green]works[/] on {working[0]}: {_first_render(working[0])}")
    return 0


def _first_render(backend: str) -> str:
    """Render a retroreflective sphere and say how long it took.

    Raises:
        MrmError: the picture is black or not finite.
    """
    start = time.perf_counter()
    shader = generate_shader(document(NODES[0]))
    drawn = Renderer(backend).render(shader, load_mesh("sphere"), Framing(), (CameraLight(),), (64, 64))
    seen = drawn.image[drawn.mask]
    if not (seen.size and np.isfinite(seen).all() and seen.max() > 0):
        raise MrmError(f"backend {backend} draws a lit sphere black or with values that are not finite")
    seconds = time.perf_counter() - start
    return f"a sphere of {len(seen)} pixels in {seconds:.1f} s, compilation included"
