"""An image case: rendered, shaded by the evaluator at the same points, and compared."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.regression import material
from mrm_nodes.regression.cases import Case
from mrm_nodes.regression.compare import Bounds, bounds_for, compare, relative_error
from mrm_nodes.regression.outcome import Outcome, timed
from mrm_nodes.regression.pictures import write_pictures
from mrm_nodes.regression.reference_image import DiffuseBase, evaluator, shade, shading_frame, white_evaluator
from mrm_nodes.regression.workshop import Workshop
from mrm_nodes.render.mesh import Mesh
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import RenderedImage
from mrm_nodes.render.scene import Camera
from mrm_nodes.shadergen import Shader

Array = NDArray[np.float64]


def judge(case: Case, workshop: Workshop, outcome: Outcome, folder: Path) -> None:
    """Render a case, compare it, and write its pictures below `folder`."""
    values = material.complete(case.node, case.inputs)
    mesh = load_mesh(case.mesh)
    shader = _shader(case, workshop, outcome, case.structure)
    free = {name: value for name, value in values.items() if name not in case.patterns}
    uniforms = material.uniform_values(case.node, free)
    if case.base:
        uniforms["base_color"] = case.base
    drawn = _render(case, workshop, outcome, shader, mesh, uniforms=uniforms, lights=case.lights)
    mask, camera = drawn.mask, drawn.camera
    driven = {name: _input_points(case, workshop, outcome, name, mesh) for name in case.patterns}
    with timed(outcome, "reference"):
        points = drawn.position[mask], drawn.normal[mask], drawn.tangent[mask]
        reference, bounds = reference_points(case, {**values, **driven}, camera, *points)
    with timed(outcome, "compare"):
        outcome.verdict, outcome.figures = compare(drawn.image[mask], reference, bounds)
        outcome.tolerance = bounds.loosest()
        used = np.max(relative_error(drawn.image[mask], reference) / bounds.max_rel, axis=-1)
        place = Path("cases") / outcome.backend / case.name
        (folder / place).mkdir(parents=True, exist_ok=True)
        written = write_pictures(
            folder / place, drawn.image, _spread(reference, mask), mask, _spread(used, mask)
        )
        outcome.files = {
            name: (place / file).as_posix() if isinstance(file, str) else file
            for name, file in written.items()
        }


def _shader(case: Case, workshop: Workshop, outcome: Outcome, key: Any, element: str | None = None) -> Shader:
    base = "oren_nayar_diffuse_bsdf" if case.base else None
    with timed(outcome, "generate"):
        return workshop.shader(
            key, lambda: material.document(case.node, patterns=case.patterns, base=base), element
        )


def _input_points(case: Case, workshop: Workshop, outcome: Outcome, name: str, mesh: Mesh) -> Array:
    """What a graph gives an input at each covered pixel: its own output, rendered as an image."""
    key = ("pattern", case.structure, name)
    shader = _shader(case, workshop, outcome, key, element=f"{case.patterns[name]}/out")
    drawn = _render(case, workshop, outcome, shader, mesh)
    seen = drawn.image[drawn.mask].astype(np.float64)
    channels = material.CHANNELS[material.inputs_of(case.node)[name].type]
    return seen[:, 0] if channels == 1 else seen[:, :channels]


def _render(
    case: Case, workshop: Workshop, outcome: Outcome, shader: Shader, mesh: Mesh, **others: Any
) -> RenderedImage:
    drawn = workshop.renderer.render(shader, mesh, case.camera, size=case.size, **others)
    for stage, seconds in drawn.seconds.items():
        outcome.seconds[stage] += seconds
    return drawn


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
