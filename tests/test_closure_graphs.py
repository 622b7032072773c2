"""Our nodes mixed, layered, added and multiplied with MaterialX's own, each lobe in a frame of its own: as the
evaluator has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import MaterialX as mx
import numpy as np
import pytest

import mrm_nodes
from mrm_nodes import library, shadergen
from mrm_nodes.reference import materialx
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.reference_image import evaluator, light_at, shading_frame
from mrm_nodes.render.context import probe_backends
from mrm_nodes.render.renderer import RenderedImage
from mrm_nodes.render.scene import DirectionalLight

pytestmark = pytest.mark.skipif(
    not any(probe.works for probe in probe_backends()), reason="needs OpenGL: see `mrm-nodes doctor`"
)

SIZE = (96, 96)

#: Patterns: how much is retroreflective, a bumpy normal, and a tangent turned about it.
PATTERNS = """
  <texcoord name="uv" type="vector2" />
  <multiply name="fine" type="vector2">
    <input name="in1" type="vector2" nodename="uv" /><input name="in2" type="vector2" value="25, 17" />
  </multiply>
  <sin name="waves" type="vector2"><input name="in" type="vector2" nodename="fine" /></sin>
  <dotproduct name="share" type="float">
    <input name="in1" type="vector2" nodename="uv" /><input name="in2" type="vector2" value="0.5, 0.5" />
  </dotproduct>
  <separate2 name="wave" type="multioutput"><input name="in" type="vector2" nodename="waves" /></separate2>
  <combine3 name="texel" type="vector3">
    <input name="in1" type="float" nodename="wave" output="outx" />
    <input name="in2" type="float" nodename="wave" output="outy" />
    <input name="in3" type="float" value="1" />
  </combine3>
  <multiply name="flatter" type="vector3">
    <input name="in1" type="vector3" nodename="texel" /><input name="in2" type="vector3" value="0.1, 0.1, 0.5" />
  </multiply>
  <add name="colour" type="vector3">
    <input name="in1" type="vector3" nodename="flatter" /><input name="in2" type="vector3" value="0.5, 0.5, 0.5" />
  </add>
  <normalmap name="bumps" type="vector3"><input name="in" type="vector3" nodename="colour" /></normalmap>
  <tangent name="along" type="vector3"><input name="space" type="string" value="world" /></tangent>
  <rotate3d name="turned" type="vector3">
    <input name="in" type="vector3" nodename="along" /><input name="amount" type="float" value="30" />
    <input name="axis" type="vector3" nodename="bumps" />
  </rotate3d>
"""
GRAPH = f"""<?xml version="1.0"?>
<materialx version="1.39">
  {PATTERNS}
  <mrm_conductor_bsdf name="tape" type="BSDF">
    <input name="roughness" type="vector2" value="0.3, 0.15" />
    <input name="retroreflectivity" type="float" nodename="share" />
    <input name="normal" type="vector3" nodename="bumps" />
    <input name="tangent" type="vector3" nodename="turned" />
  </mrm_conductor_bsdf>
  <conductor_bsdf name="theirs" type="BSDF">
    <input name="roughness" type="vector2" value="0.2, 0.2" />
    <input name="normal" type="vector3" nodename="bumps" />
  </conductor_bsdf>
  <mix name="mixed" type="BSDF">
    <input name="fg" type="BSDF" nodename="tape" /><input name="bg" type="BSDF" nodename="theirs" />
    <input name="mix" type="float" value="0.4" />
  </mix>
  <mrm_dielectric_bsdf name="coat" type="BSDF">
    <input name="roughness" type="vector2" value="0.25, 0.25" />
    <input name="retroreflectivity" type="float" nodename="share" />
    <input name="distribution" type="string" value="beckmann" />
    <input name="masking" type="string" value="vcavity" />
  </mrm_dielectric_bsdf>
  <oren_nayar_diffuse_bsdf name="cloth" type="BSDF">
    <input name="color" type="color3" value="0.7, 0.3, 0.2" /><input name="roughness" type="float" value="0.4" />
  </oren_nayar_diffuse_bsdf>
  <layer name="coated" type="BSDF">
    <input name="top" type="BSDF" nodename="coat" /><input name="base" type="BSDF" nodename="cloth" />
  </layer>
  <dielectric_bsdf name="lacquer" type="BSDF">
    <input name="weight" type="float" value="0.6" /><input name="roughness" type="vector2" value="0.35, 0.35" />
  </dielectric_bsdf>
  <layer name="lacquered" type="BSDF">
    <input name="top" type="BSDF" nodename="lacquer" /><input name="base" type="BSDF" nodename="coated" />
  </layer>
  <mrm_generalized_schlick_bsdf name="tint" type="BSDF">
    <input name="color0" type="color3" value="0.6, 0.5, 0.1" />
    <input name="roughness" type="vector2" value="0.4, 0.4" />
    <input name="retroreflectivity" type="float" value="1" />
    <input name="tangent" type="vector3" nodename="turned" />
  </mrm_generalized_schlick_bsdf>
  <multiply name="dimmed" type="BSDF">
    <input name="in1" type="BSDF" nodename="tint" /><input name="in2" type="float" value="0.25" />
  </multiply>
  <add name="both" type="BSDF">
    <input name="in1" type="BSDF" nodename="mixed" /><input name="in2" type="BSDF" nodename="lacquered" />
  </add>
  <add name="all" type="BSDF">
    <input name="in1" type="BSDF" nodename="both" /><input name="in2" type="BSDF" nodename="dimmed" />
  </add>
  <surface name="surface" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="all" /></surface>
  <surfacematerial name="material" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface" />
  </surfacematerial>
</materialx>"""


@dataclass(frozen=True)
class InFrame:
    """A lobe in a frame of its own, rows tangent, bitangent, normal: directions in world space, cosine included."""

    lobe: Any
    frame: np.ndarray

    def eval(self, v: np.ndarray, l: np.ndarray) -> np.ndarray:  # noqa: E741  the field's own name
        lit = self._local(l)
        above = lit[..., 2:] > 0
        facing = np.where(above, lit, [0.0, 0.0, 1.0])
        return np.where(above, self.lobe.eval(self._local(v), facing) * lit[..., 2:], 0.0)

    def throughput(self, v: np.ndarray, l: np.ndarray, weight: float = 1.0) -> np.ndarray:  # noqa: E741
        lit = self._local(l)
        facing = np.where(lit[..., 2:] > 0, lit, [0.0, 0.0, 1.0])
        return materialx.Leaf(self.lobe, weight).throughput(self._local(v), facing)

    def _local(self, w: np.ndarray) -> np.ndarray:
        local = np.einsum("nij,nj->ni", self.frame, w)
        return local / np.linalg.norm(local, axis=-1, keepdims=True)


def graph() -> mx.Document:
    doc = mx.createDocument()
    mx.readFromXmlString(doc, GRAPH)
    doc.setDataLibrary(library.shared_library())
    return doc


def reference(
    seen: RenderedImage, patterns: dict[str, np.ndarray], lights: tuple[DirectionalLight, ...]
) -> np.ndarray:
    """The same closure tree in the evaluator, at the points and with the patterns that the renderer drew."""
    position, normal, tangent = (
        getattr(seen, name)[seen.mask].astype(np.float64) for name in ("position", "normal", "tangent")
    )
    doc = graph()

    def frame(normal: np.ndarray, tangent: np.ndarray) -> np.ndarray:
        return shading_frame(position, normal, tangent, seen.camera.position)[1]

    def lobe(name: str, frame: np.ndarray, weight: float = 1.0) -> materialx.Leaf:
        node = doc.getNode(name)
        own = node.getCategory()
        ours = own if own.startswith("mrm_") else f"mrm_{own}"
        given = {
            each.getName(): _value(each, patterns) for each in node.getInputs() if each.getName() in VALUED
        }
        bsdf = evaluator(ours, material.complete(ours, {}) | given)
        return materialx.Leaf(InFrame(bsdf, frame), weight)

    smooth, bumpy = frame(normal, tangent), frame(patterns["bumps"], tangent)
    turned = frame(patterns["bumps"], patterns["turned"])
    cloth = materialx.OrenNayar((0.7, 0.3, 0.2), 0.4)
    tree = materialx.Add(
        materialx.Add(
            materialx.Mix(lobe("tape", turned), lobe("theirs", bumpy), 0.4),
            materialx.Layer(
                lobe("lacquer", smooth, 0.6),
                materialx.Layer(lobe("coat", smooth), materialx.Leaf(InFrame(cloth, smooth))),
            ),
        ),
        materialx.Multiply(lobe("tint", frame(normal, patterns["turned"])), 0.25),
    )
    view = shading_frame(position, normal, tangent, seen.camera.position)[0]
    total = np.zeros(view.shape)
    for light in lights:
        direction, intensity = light_at(light.data(seen.camera), position)
        unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
        total += tree.eval(view, unit) * intensity
    return total


VALUED = {"roughness", "retroreflectivity", "distribution", "masking", "color0"}


def _value(given: mx.Input, patterns: dict[str, np.ndarray]) -> Any:
    if given.getNodeName():
        return patterns[given.getNodeName()][:, 0]
    value = given.getValue()
    return value if isinstance(value, str | float) else value.asTuple()


def lights_from(z: float) -> tuple[DirectionalLight, ...]:
    """Two, from the side of the camera."""
    sun = DirectionalLight((-0.3, -0.4, -0.85 * z), color=(1.0, 0.9, 0.8))
    return (sun, DirectionalLight((0.5, -0.2, -0.6 * z), color=(0.2, 0.3, 0.4)))


@pytest.mark.client("one graph with MaterialX's own nodes, normal map, turned tangent: the evaluator's image")
@pytest.mark.parametrize(
    ("mesh", "camera", "side"), [("sphere", "1.2,0.8,3", 1.0), ("plane", "0.8,0.5,-2.5", -1.0)]
)
def test_a_tree_of_closures_with_bumps_and_turned_tangents_is_the_evaluators(
    mesh: str, camera: str, side: float
) -> None:
    """The plane is seen from behind: its normals point away from the camera."""
    lights = lights_from(side)

    def drawn(element: str) -> RenderedImage:
        """The material, or a pattern that drives an input: the node's value as an image."""
        shader = shadergen.generate_shader(graph(), element=element)
        return mrm_nodes.render(shader, mesh, f"{camera}:0,0,0", lights, SIZE)

    seen = drawn("material")
    to_camera = np.array(seen.camera.position) - seen.position[seen.mask]
    facing = np.sum(seen.normal[seen.mask] * to_camera, -1) > 0
    assert facing.mean() > 0.9 if side > 0 else not facing.any()
    patterns = {name: drawn(name).image[seen.mask] for name in ("share", "bumps", "turned")}
    expected = reference(seen, patterns, lights)
    image = seen.image[seen.mask]
    assert np.mean(expected > 0.01) > 0.5
    error = np.abs(image - expected) / np.maximum(np.abs(expected), 1e-4)
    assert error.max() < 1e-5
