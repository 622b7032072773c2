"""One process's share of a run: renders, evaluates and judges, a task at a time."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression import material
from mrm_nodes.regression.cases import Case
from mrm_nodes.regression.cloud import Cloud, attributes_of, run_cloud
from mrm_nodes.regression.compare import Bounds, Figures, Verdict, bounds_for, compare, relative_error
from mrm_nodes.regression.pictures import write_pictures
from mrm_nodes.regression.reference_image import DiffuseBase, evaluator, shade, shading_frame, white_evaluator
from mrm_nodes.render.mesh import Mesh
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import RenderedImage, Renderer
from mrm_nodes.render.scene import Camera
from mrm_nodes.shadergen import Shader, generate_shader

Array = NDArray[np.float64]
Task = Case | Cloud

STAGES = ("generate", "compile", "render", "reference", "compare")


@dataclass
class Outcome:
    """What became of one task on one backend: a line of the report."""

    name: str
    node: str
    backend: str
    verdict: Verdict
    kind: str = "image"
    """`image` or `cloud`."""
    target: str = "glsl"
    message: str = ""
    """Why, where the verdict is error or skipped."""
    figures: Figures | None = None
    tolerance: Mapping[str, float] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))
    files: Mapping[str, Any] = field(default_factory=dict)
    """File names, relative to the report's folder, and the pictures' exposure."""
    setup: Mapping[str, Any] = field(default_factory=dict)
    """What the task was, in words and numbers."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """A cloud's figures by decade, its worst configuration, its counts."""


def describe(task: Task) -> dict[str, Any]:
    """What a task is, for the report."""
    if isinstance(task, Cloud):
        return {
            "distribution": task.distribution,
            "masking": task.masking,
            "configurations": task.configurations,
            "seed": task.seed,
        }
    return {
        "inputs": dict(task.inputs),
        "patterns": dict(task.patterns),
        "base": task.base,
        "mesh": task.mesh,
        "camera": repr(task.camera),
        "lights": [repr(light) for light in task.lights],
        "size": list(task.size),
    }


def outcome_of(task: Task, backend: str, verdict: Verdict, **others: Any) -> Outcome:
    """An outcome that says which task it belongs to."""
    kind = "cloud" if isinstance(task, Cloud) else "image"
    target = task.target if isinstance(task, Case) else "glsl"
    return Outcome(task.name, task.node, backend, verdict, kind, target, setup=describe(task), **others)


class Worker:
    """A GL context with the shaders generated so far; shaders are shared by all tasks of one structure.

    Args:
        backend: `egl` or `osmesa`.
        edit: changes each generated shader before it is compiled: for tests that plant faults.

    Raises:
        MrmError: the backend does not work here.
    """

    def __init__(self, backend: str, edit: Callable[[Shader], Shader] = lambda shader: shader) -> None:
        self.backend = backend
        self.renderer = Renderer(backend)
        self._edit = edit
        self._shaders: dict[Any, Shader] = {}

    def run(self, task: Task, folder: Path) -> Outcome:
        """Run a task and write its files below `folder`; a fault becomes the verdict, never an exception."""
        outcome = outcome_of(task, self.backend, "error")
        try:
            if isinstance(task, Cloud):
                self._run_cloud(task, outcome)
            else:
                self._run_case(task, outcome, folder)
        except MrmError as error:
            outcome.message = str(error)
        except Exception as error:  # one broken case must not cost the others
            outcome.message = f"{type(error).__name__}: {error}"
        if outcome.message:
            outcome.verdict = "error"
        return outcome

    def _run_cloud(self, cloud: Cloud, outcome: Outcome) -> None:
        with _timed(outcome, "generate"):
            shader = self._shader(cloud.structure, cloud.node, attributes=attributes_of(cloud.node))
        start = time.perf_counter()
        result = run_cloud(cloud, self.renderer, shader)
        outcome.seconds["reference"] += time.perf_counter() - start - result.render_seconds
        outcome.seconds["render"] += result.render_seconds
        outcome.verdict, outcome.figures, outcome.tolerance = result.verdict, result.figures, result.bounds
        outcome.details = {"decades": result.decades, "worst": result.worst, "counts": result.counts}

    def _run_case(self, case: Case, outcome: Outcome, folder: Path) -> None:
        values = material.complete(case.node, case.inputs)
        mesh = load_mesh(case.mesh)
        with _timed(outcome, "generate"):
            base = "oren_nayar_diffuse_bsdf" if case.base else None
            shader = self._shader(case.structure, case.node, patterns=case.patterns, base=base)
        free = {name: value for name, value in values.items() if name not in case.patterns}
        uniforms = material.uniform_values(case.node, free)
        if case.base:
            uniforms["base_color"] = case.base
        drawn = self._render(outcome, shader, mesh, case, uniforms=uniforms, lights=case.lights)
        mask, camera = drawn.mask, drawn.camera
        driven = {name: self._input_points(outcome, case, name, mesh) for name in case.patterns}
        with _timed(outcome, "reference"):
            points = drawn.position[mask], drawn.normal[mask], drawn.tangent[mask]
            reference, bounds = reference_points(case, {**values, **driven}, camera, *points)
        with _timed(outcome, "compare"):
            outcome.verdict, outcome.figures = compare(drawn.image[mask], reference, bounds)
            outcome.tolerance = bounds.loosest()
            used = np.max(relative_error(drawn.image[mask], reference) / bounds.max_rel, axis=-1)
            place = Path("cases") / self.backend / case.name
            (folder / place).mkdir(parents=True, exist_ok=True)
            written = write_pictures(
                folder / place, drawn.image, _spread(reference, mask), mask, _spread(used, mask)
            )
            outcome.files = {
                name: (place / file).as_posix() if isinstance(file, str) else file
                for name, file in written.items()
            }

    def _input_points(self, outcome: Outcome, case: Case, name: str, mesh: Mesh) -> Array:
        """What a graph gives an input at each covered pixel: its own output, rendered as an image."""
        key = ("pattern", case.structure, name)
        element = f"{case.patterns[name]}/out"
        with _timed(outcome, "generate"):
            shader = self._shader(key, case.node, patterns=case.patterns, element=element)
        drawn = self._render(outcome, shader, mesh, case)
        seen = drawn.image[drawn.mask].astype(np.float64)
        channels = material.CHANNELS[material.inputs_of(case.node)[name].type]
        return seen[:, 0] if channels == 1 else seen[:, :channels]

    def _render(
        self, outcome: Outcome, shader: Shader, mesh: Mesh, case: Case, **others: Any
    ) -> RenderedImage:
        drawn = self.renderer.render(shader, mesh, case.camera, size=case.size, **others)
        for stage, seconds in drawn.seconds.items():
            outcome.seconds[stage] += seconds
        return drawn

    def _shader(self, key: Any, node: str, element: str | None = None, **structure: Any) -> Shader:
        if key not in self._shaders:
            document = material.document(node, **structure)
            self._shaders[key] = self._edit(generate_shader(document, element=element or material.MATERIAL))
        return self._shaders[key]


def reference_points(
    case: Case,
    values: Mapping[str, Any],
    camera: Camera,
    position: ArrayLike,
    normal: ArrayLike,
    tangent: ArrayLike,
) -> tuple[Array, Bounds]:
    """The reference of n points, `(n, 3)`, and the bounds on the image there."""
    view, frame = shading_frame(position, normal, tangent, camera.position)
    points = view, frame, position, [light.data(camera) for light in case.lights]
    bsdf = evaluator(case.node, values)
    reference, grazing = shade(bsdf, values["weight"], *points)
    white, _ = shade(white_evaluator(values), values["weight"], *points)
    if case.base is not None:
        base, _ = shade(DiffuseBase(bsdf, values["weight"], case.base), 1.0, *points)
        reference = reference + base
    alpha = np.clip(material.as_float32(values["roughness"]), 1e-8, 1.0).min(axis=-1)
    film = np.asarray(values["thinfilm_thickness"]) > 0
    return reference, bounds_for(alpha, values["distribution"], reference, grazing, white, film)


def _spread(points: Array, mask: NDArray[np.bool_]) -> Array:
    """Values of the covered pixels `(n, ...)` put back into an image `(h, w, ...)`, zero elsewhere."""
    image = np.zeros(mask.shape + points.shape[1:])
    image[mask] = points
    return image


@contextmanager
def _timed(outcome: Outcome, stage: str) -> Iterator[None]:
    """Add the time that the block takes to a stage of the outcome."""
    start = time.perf_counter()
    try:
        yield
    finally:
        outcome.seconds[stage] += time.perf_counter() - start
