"""An image case: rendered, shaded by the evaluator at the same points, and compared."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import MaterialX as mx
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.builtin import ImageCase
from mrm_nodes.regression.cases.material_case import as_text
from mrm_nodes.regression.cases.pictures import write_pictures
from mrm_nodes.regression.cases.workshop import Workshop
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.closure import DIFFUSE_NODE, LayerNode, LobeNode, Port, Tree, reflecting
from mrm_nodes.regression.truth.reference_image import shading_frame
from mrm_nodes.regression.verdict.compare import (
    Bounds,
    Figures,
    Verdict,
    compare,
    decided,
    relative_error,
    why_undecided,
)
from mrm_nodes.regression.verdict.outcome import Outcome, timed
from mrm_nodes.render.arithmetic import measure
from mrm_nodes.render.environment import Environment
from mrm_nodes.render.mesh import Mesh
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import RenderedImage
from mrm_nodes.render.scene import Camera
from mrm_nodes.shadergen import Shader

if TYPE_CHECKING:
    from mrm_nodes.regression.truth import physics

Array = NDArray[np.float64]

MIRROR_ERROR = 1e-6
"""Relative error of retro light in a map against forward light in the map turned about the normal."""


class JudgedImage(NamedTuple):
    """A compared image `(h, w, 3)`, its reference `(n, 3)` where its mask `(h, w)` is, and what came of it."""

    image: NDArray[Any]
    reference: Array
    mask: NDArray[np.bool_]
    verdict: Verdict
    figures: Figures
    tolerance: Mapping[str, float]
    used: Array
    """`(h, w)`: error as a share of its bound."""


def judge(case: ImageCase, workshop: Workshop, outcome: Outcome, folder: Path) -> None:
    """Render a case, compare it, and write its pictures below `folder`."""
    values = material.complete(case.node, case.inputs)
    mesh = floor() if case.mesh == "floor" else load_mesh(case.mesh)
    shader = _shader(case, workshop, outcome, case.structure)

    def draw(**others: Any) -> RenderedImage:
        return _render(case, workshop, outcome, shader, mesh, lights=case.lights, **others)

    free = {name: value for name, value in values.items() if name not in case.patterns}
    uniforms = material.uniform_values(case.node, free)
    if case.base:
        uniforms["base_color"] = case.base
    if case.mirrored:
        judged = _beside_mirror(case, outcome, draw, uniforms)
    elif case.environment is not None:
        drawn = draw(uniforms=uniforms, environment=_light(case))
        judged = _in_environment(case, workshop, outcome, drawn, values)
    else:
        drawn = draw(uniforms=uniforms)
        driven = {name: _input_points(case, workshop, outcome, name, mesh) for name in case.patterns}
        with timed(outcome, "reference"):
            reference, bounds = reference_points(case, {**values, **driven}, drawn.camera, *_points(drawn))
            if case.layering == "exact":
                outcome.details = {"layering": _layering(case, {**values, **driven}, drawn, reference)}
        with timed(outcome, "compare"):
            judged = _within(drawn, reference, bounds)
    outcome.verdict, outcome.figures, outcome.tolerance = judged.verdict, judged.figures, judged.tolerance
    if outcome.verdict == "undecided" and not outcome.message:
        outcome.message = why_undecided(judged.figures)
    with timed(outcome, "compare"):
        place = Path("cases") / outcome.backend / case.name
        (folder / place).mkdir(parents=True, exist_ok=True)
        shown = _spread(judged.reference, judged.mask)
        written = write_pictures(
            folder / place, judged.image, shown, judged.mask, judged.used, None, source_of(case)
        )
        outcome.files = {
            name: (place / file).as_posix() if isinstance(file, str) else file
            for name, file in written.items()
        }


def _within(drawn: RenderedImage, reference: Array, bounds: Bounds) -> JudgedImage:
    """Compare with bounds that differ from point to point."""
    mask = drawn.mask
    verdict, figures = compare(drawn.image[mask], reference, bounds)
    error = decided(relative_error(drawn.image[mask], reference), bounds.max_rel)
    used = np.max(error / bounds.max_rel, axis=-1)
    return JudgedImage(drawn.image, reference, mask, verdict, figures, bounds.loosest(), _spread(used, mask))


def _in_environment(
    case: ImageCase, workshop: Workshop, outcome: Outcome, drawn: RenderedImage, values: Mapping[str, Any]
) -> JudgedImage:
    """Compare with the shader's own sum over the map, and say how far that is from the integral."""
    # A run that finds all in the cache has no need of numba.
    from mrm_nodes.regression.truth.environment_reference import beside_integral, some_of
    from mrm_nodes.regression.truth.image_sum import Surroundings
    from mrm_nodes.regression.truth.physics import beside_exact, light_tree, shade_both, shade_tree

    light = _light(case)
    around = Surroundings(light, measure(workshop.renderer.backend), case.method)
    points, tree = _shaded(case, values, drawn)

    def resolve(port: Port) -> Any:
        return port

    lights = [each.data(drawn.camera) for each in case.lights]
    with timed(outcome, "reference"):
        if case.layering == "exact":
            reference, bounds, exact = shade_both(tree, points, lights, resolve, around)
            outcome.details = {"layering": beside_exact(reference, exact)}
        else:
            reference, bounds = shade_tree(tree, points, lights, resolve, around)
        some, reflected = points.at(some_of(len(reference))), reflecting(tree)
        seen, _ = shade_tree(reflected, some, [], resolve, around)
        truth = light_tree(reflected, some, light, resolve)
        about = {"image_light": beside_integral(seen, truth, light.samples)}
        outcome.details = {**outcome.details, **about}
    with timed(outcome, "compare"):
        return _within(drawn, reference, bounds)


def _layering(
    case: ImageCase, values: Mapping[str, Any], drawn: RenderedImage, reference: Array
) -> dict[str, float]:
    """What MaterialX's rule of layering costs a case in direct light; reference: `(n, 3)`, by that rule."""
    from mrm_nodes.regression.truth.physics import beside_exact, shade_both

    points, tree = _shaded(case, values, drawn)
    lights = [each.data(drawn.camera) for each in case.lights]
    return beside_exact(reference, shade_both(tree, points, lights, lambda port: port)[2])


def _shaded(case: ImageCase, values: Mapping[str, Any], drawn: RenderedImage) -> tuple[physics.Points, Tree]:
    """The covered points, and what lies there: the node, over its base where it has one."""
    from mrm_nodes.regression.truth.physics import Points

    position, normal, tangent = (each.astype(np.float64) for each in _points(drawn))
    tree: Tree = LobeNode(case.node, material.BSDF, {**values, "normal": None, "tangent": None})
    if case.base is not None:
        base = material.complete(DIFFUSE_NODE, {"color": case.base})
        tree = LayerNode(tree, LobeNode(DIFFUSE_NODE, "base", {**base, "normal": None}))
    return Points(position, normal, tangent, drawn.camera.position), tree


def _beside_mirror(
    case: ImageCase, outcome: Outcome, draw: Callable[..., RenderedImage], uniforms: Mapping[str, Any]
) -> JudgedImage:
    """Compare with the other lobe in the map turned about the normal."""
    light = _light(case)
    other = 1.0 - float(uniforms["bsdf_retroreflectivity"])
    drawn = draw(uniforms=uniforms, environment=light)
    turned = replace(light, rotation=light.rotation + 180.0)
    twin = draw(uniforms={**uniforms, "bsdf_retroreflectivity": other}, environment=turned)
    with timed(outcome, "compare"):
        allowed = np.array(MIRROR_ERROR)
        return _within(drawn, twin.image[drawn.mask].astype(np.float64), Bounds(allowed, allowed))


def _light(case: ImageCase) -> Environment:
    if case.environment is None:
        raise MrmError(f"{case.name}: there is no environment to turn")
    return case.environment.load()


def floor() -> Mesh:
    """The built-in plane, turned to face +y: its normal is the pole of every map."""
    flat = load_mesh("plane")

    def turned(vectors: NDArray[Any]) -> NDArray[Any]:
        swapped: NDArray[Any] = vectors[:, [0, 2, 1]]
        return swapped * (1.0, 1.0, -1.0)

    return replace(
        flat,
        name="floor",
        positions=turned(flat.positions),
        normals=turned(flat.normals),
        tangents=turned(flat.tangents),
    )


def _points(drawn: RenderedImage) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Position, normal and tangent, each `(n, 3)`, of the covered pixels."""
    return drawn.position[drawn.mask], drawn.normal[drawn.mask], drawn.tangent[drawn.mask]


def _shader(
    case: ImageCase, workshop: Workshop, outcome: Outcome, key: Any, element: str | None = None
) -> Shader:
    with timed(outcome, "generate"):
        return workshop.shader(key, lambda: _document(case), element, environment=case.method)


def _document(case: ImageCase) -> mx.Document:
    base = "oren_nayar_diffuse_bsdf" if case.base else None
    return material.document(case.node, patterns=case.patterns, base=base)


def source_of(case: ImageCase) -> str:
    """What is rendered, as a MaterialX document with the case's values: its shader has them as uniforms."""
    document = _document(case)
    node, inputs = document.getNode(material.BSDF), material.inputs_of(case.node)
    for name, value in case.inputs.items():
        if name in case.patterns:
            continue
        kind = inputs[name].type
        node.addInput(name, kind).setValueString(as_text(value, kind, f"{material.BSDF}/{name}"))
    if case.base is not None:
        document.getNode("base").addInput("color", "color3").setValueString(
            as_text(case.base, "color3", "base")
        )
    return str(mx.writeToXmlString(document))


def _input_points(case: ImageCase, workshop: Workshop, outcome: Outcome, name: str, mesh: Mesh) -> Array:
    """What a graph gives an input at each covered pixel: its own output, rendered as an image."""
    key = ("pattern", case.structure, name)
    shader = _shader(case, workshop, outcome, key, element=f"{case.patterns[name]}/out")
    drawn = _render(case, workshop, outcome, shader, mesh)
    seen = drawn.image[drawn.mask].astype(np.float64)
    channels = material.CHANNELS[material.inputs_of(case.node)[name].type]
    return seen[:, 0] if channels == 1 else seen[:, :channels]


def _render(
    case: ImageCase, workshop: Workshop, outcome: Outcome, shader: Shader, mesh: Mesh, **others: Any
) -> RenderedImage:
    drawn = workshop.renderer.render(shader, mesh, case.camera, size=case.size, **others)
    for stage, seconds in drawn.seconds.items():
        outcome.seconds[stage] += seconds
    return drawn


def reference_points(
    case: ImageCase,
    values: Mapping[str, Any],
    camera: Camera,
    position: ArrayLike,
    normal: ArrayLike,
    tangent: ArrayLike,
) -> tuple[Array, Bounds]:
    """The reference of n points, `(n, 3)`, and the bounds on the image there."""
    view, frame = shading_frame(position, normal, tangent, camera.position)
    lights = [light.data(camera) for light in case.lights]
    from mrm_nodes.regression.truth.physics import shade_node

    return shade_node(case.node, values, view, frame, np.asarray(position, np.float64), lights, case.base)


def _spread(points: Array, mask: NDArray[np.bool_]) -> Array:
    """Values of the covered pixels `(n, ...)` put back into an image `(h, w, ...)`, zero elsewhere."""
    image = np.zeros(mask.shape + points.shape[1:])
    image[mask] = points
    return image
