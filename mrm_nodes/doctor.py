"""What this machine can do: versions, the node library, each target's compiler, OpenGL, and a first render."""

from __future__ import annotations

import importlib.metadata
import platform
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from mrm_nodes import cachefolder, compilers, library, limits
from mrm_nodes.errors import MrmError
from mrm_nodes.host import Host
from mrm_nodes.reference import Conductor, warmup
from mrm_nodes.regression.truth.material import NODES, document
from mrm_nodes.render.context import BACKENDS, probe_backends, unknown_backend
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.render.scene import CameraLight, Framing
from mrm_nodes.shadergen import generate_shader, generator_target, supported_targets

VERSIONED = ("mrm-nodes", "MaterialX", "moderngl", "OpenImageIO", "numpy", "numba")


def examine(backend: str = "auto", console: Console | None = None) -> int:
    """Print what was found, each fault with how to mend it, and return 0 where `backend` renders.

    Raises:
        MrmError: an unknown backend, or one that does not render.
    """
    if backend not in ("auto", *BACKENDS):
        raise MrmError(unknown_backend(backend, ("auto", *BACKENDS)))
    console = console or Console(highlight=False, soft_wrap=True)
    versions = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in VERSIONED)
    console.print(f"versions  Python {platform.python_version()}, {versions}")
    console.print(f"library   {escape(str(library.library_path()))}: {', '.join(NODES)}")
    _print_rules(console)
    _print_targets(console)
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
    _print_evaluation(console)
    return 0


def _print_evaluation(console: Console) -> None:
    """Evaluate a lobe, and print where what costs time is kept, or that it is not.

    Raises:
        MrmError: the value is not that of the papers.
    """
    start = time.perf_counter()
    up = np.array([0.0, 0.0, 1.0])
    # At the mirror angle F = ((n - 1)² + k²) / ((n + 1)² + k²), D = 1 / (π alpha²) and G = 1: f = F D / 4.
    value = Conductor(1.5, 2.0, 0.5).eval(up, up)
    if not np.allclose(value, (4.25 / 10.25) / np.pi, rtol=1e-12, atol=0.0):
        raise MrmError(f"the evaluator gives {value[0]:.6g} where it is {4.25 / 10.25 / np.pi:.6g}")
    seconds = time.perf_counter() - start
    console.print(f"evaluator [green]works[/]: a value in {seconds:.1f} s, compilation included")
    code = warmup.folder()
    _print_kept(console, "compiled evaluator", code, "each process compiles anew; set NUMBA_CACHE_DIR")
    results = cachefolder.of_user() or cachefolder.private()
    place = None if results is None else results / "results"
    _print_kept(
        console, "results of cases", place, "each is rendered anew; name a folder with regress --cache"
    )


def _print_kept(console: Console, what: str, folder: Path | None, otherwise: str) -> None:
    if folder is None:
        console.print(f"          {what}: [yellow]not kept[/]: {otherwise}")
        return
    brief = ", [yellow]which may not last[/]" if folder.is_relative_to(tempfile.gettempdir()) else ""
    console.print(f"          {what}: kept in {escape(str(folder))}{brief}")


def _print_rules(console: Console) -> None:
    rules = library.host()
    console.print(
        f"rules     energy compensation of {rules.compensation}: {escape(str(library.own_libraries()))}"
    )
    if rules.compensation != Host().compensation:
        console.print(
            f"          [yellow]note[/]: loaded by its folder, without `mrm-nodes install` or "
            f"mrm_nodes.library_path(), the node library follows {Host().compensation}"
        )


def _print_targets(console: Console) -> None:
    """Print each target's compiler, or what to install, and what a target or a method of image light ignores."""
    for target in supported_targets():
        compiler = compilers.COMPILERS.get(target)
        if compiler is None:
            state = "generated; no compiler of it is known here"
        elif compiler.is_installed():
            state = f"[green]compiled[/] by {escape(compiler.name)}"
        else:
            state = f"[yellow]unchecked[/]: no {escape(compiler.name)}; {escape(compiler.install)}"
        console.print(f"{target:<9} {state}")
        ignored = limits.left_out(generator_target(target))
        if ignored:
            console.print(f"          ignores {', '.join(ignored)}")
    ignored = limits.left_out("genglsl", environment="prefilter")
    console.print(f"prefilter this method of image light ignores {', '.join(ignored)}")


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
