"""The table of targets: what compiles each, what runs it here, and how far it is from the evaluator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from mrm_nodes import compilers, shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.cloud import Cloud, attributes_of, run_cloud
from mrm_nodes.regression.truth import material


@dataclass(frozen=True)
class TargetRow:
    """One target on one machine. Errors are the worst of every node, distribution and masking."""

    target: str
    compiled_by: str
    run_on: str = ""
    """Empty where nothing here runs it."""
    used: float | None = None
    """Largest share of its bound that an error takes, without a thin film."""
    used_film: float | None = None
    error: float | None = None
    """Largest relative error at alpha of 0.1 and more, without a thin film."""


def _gl(backend: str) -> Callable[[], Any]:
    def make() -> Any:
        from mrm_nodes.render.renderer import shared_renderer

        return shared_renderer(backend)

    return make


def _webgl() -> Any:
    from mrm_nodes.render.webgl import WebGLRenderer

    return WebGLRenderer()


def _webgpu() -> Any:
    from mrm_nodes.render.webgpu import WebGPURenderer

    return WebGPURenderer()


def _slang() -> Any:
    from mrm_nodes.render.slang import SlangRenderer

    return SlangRenderer()


_RUNNERS = {
    "glsl": (_gl("egl"), _gl("osmesa")),
    "essl": (_webgl,),
    "wgsl": (_webgpu,),
    "slang": (_slang,),
}


def table(configurations: int) -> list[TargetRow]:
    """Compile each node in every target, and run `configurations` of it wherever this machine can."""
    rows = []
    for target in shadergen.supported_targets():
        compiled_by = _compiled_by(target)
        ran = False
        for make in _RUNNERS.get(target, ()):
            try:
                renderer = make()
            except MrmError:
                continue
            rows.append(_run(target, compiled_by, renderer, configurations))
            ran = True
        if not ran:
            rows.append(TargetRow(target, compiled_by))
    return rows


def _compiled_by(target: str) -> str:
    checks = [compilers.check_material(material.document(node), target) for node in material.NODES]
    worst = next((check for check in checks if check.status != "compiled"), checks[0])
    return worst.compiler if worst.status == "compiled" else worst.status


def _run(target: str, compiled_by: str, renderer: Any, configurations: int) -> TargetRow:
    decades: list[dict[str, Any]] = []
    each = max(1, configurations // len(material.PAIRS))
    for node in material.NODES:
        document = material.document(node, attributes=attributes_of(node))
        shader = shadergen.generate_shader(document, target)
        for pair in material.PAIRS:
            decades += run_cloud(Cloud(node, *pair, configurations=each), renderer, shader).decades
    bare, film = ([decade for decade in decades if decade["film"] is has_film] for has_film in (False, True))
    return TargetRow(
        target,
        compiled_by,
        f"{renderer.backend}: {renderer.device}",
        used=max(decade["max_used"] for decade in bare),
        used_film=max(decade["max_used"] for decade in film),
        error=max(decade["max_rel"] for decade in bare if decade["alpha"][0] >= 0.1),
    )
