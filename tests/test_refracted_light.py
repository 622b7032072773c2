"""What is seen through a surface in an environment, as MaterialX's shaders have it: the model, and what it notices."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_material_case import case_of, write

from mrm_nodes import reference as ref
from mrm_nodes.reference.compiled import run
from mrm_nodes.reference.image_light import EXACT
from mrm_nodes.reference.refracted_light import REFRACT, host_index, refracted_samples, transmitted_share
from mrm_nodes.regression.cases.builtin import default_suite
from mrm_nodes.regression.cases.material_case import EnvironmentMap, MaterialCase
from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.closure import LobeNode
from mrm_nodes.regression.truth.image_sum import Surroundings, _joined
from mrm_nodes.regression.truth.material import Value
from mrm_nodes.regression.truth.physics import Points, shade_tree
from mrm_nodes.regression.verdict.compare import compare
from mrm_nodes.render import probe_backends
from mrm_nodes.render.arithmetic import measure
from mrm_nodes.render.environment import Environment, find_environment, sky
from mrm_nodes.render.meshfile import load_mesh
from mrm_nodes.render.renderer import RenderedImage, Renderer
from mrm_nodes.shadergen import Shader, generate_shader

RNG = np.random.default_rng(3)
WHITE = Environment(np.ones((4, 8, 3)))


def unit(vectors: Any) -> Any:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def views(n: int, least: float = 0.1) -> Any:
    cosine, phi = RNG.uniform(least, 1.0, n), RNG.uniform(0, 2 * np.pi, n)
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine], axis=-1)


def frames(n: int) -> Any:
    normal, other = unit(RNG.normal(size=(n, 3))), RNG.normal(size=(n, 3))
    tangent = unit(np.cross(normal, other))
    return np.stack([tangent, np.cross(normal, tangent), normal], axis=1)


def refracted(v: Any, index: Any) -> tuple[Any, Any]:
    indices = np.broadcast_to(np.asarray(index, float).reshape(-1, 1), (len(v), 1))
    (direction, error), _ = run(REFRACT, [v, indices, np.zeros((len(v), 1))], [0], [3, 1])
    return direction.reshape(-1, 3), error.ravel()


def summed(lobe: Any, v: Any, axes: Any, environment: Environment, samples: int, retro: float = 0.0) -> Any:
    around = _joined(environment.levels)
    share = np.array([retro])
    index = host_index(lobe)
    return refracted_samples(lobe, index, share, v, axes, around, samples, len(environment.levels), EXACT)


def test_a_sphere_turns_a_view_by_twice_what_its_surface_does():
    """In at an angle i and on at an angle t, and the same at the exit: Snell's law, from angles alone."""
    v = views(500, 0.02)
    index = RNG.uniform(1.0, 3.0, 500)
    found, _ = refracted(v, index)
    i = np.arccos(v[:, 2])
    turned = i - 2 * (i - np.arcsin(np.sin(i) / index))
    along = unit(v[:, :2])
    expected = np.concatenate([-along * np.sin(turned)[:, None], -np.cos(turned)[:, None]], axis=-1)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_an_index_of_one_turns_nothing_and_below_the_critical_angle_nothing_enters():
    v = views(100)
    np.testing.assert_allclose(refracted(v, 1.0)[0], -v, atol=1e-12)
    grazing = views(100, 0.01)
    grazing = grazing[grazing[:, 2] < 0.8]
    found, _ = refracted(grazing, 0.5)
    # Of what `refract` refuses, MaterialX makes a direction along the normal, which 1 - F then makes black.
    np.testing.assert_allclose(found, [[0.0, 0.0, np.sqrt(0.75)]] * len(grazing), atol=1e-12)


def test_the_error_of_a_direction_holds_for_float32():
    """The same steps in float32, but for what a driver may do better."""
    v = views(4000, 1e-3).astype(np.float32)
    index = RNG.uniform(0.5, 3.0, 4000).astype(np.float32)

    def refract(incident: Any, normal: Any, eta: Any) -> Any:
        cosine = np.sum(incident * normal, axis=-1, keepdims=True, dtype=np.float32)
        k = np.float32(1) - eta * eta * (np.float32(1) - cosine * cosine)
        found = eta * incident - (eta * cosine + np.sqrt(np.maximum(k, 0))) * normal
        return np.where(k < 0, np.float32(0), found)

    up = np.broadcast_to(np.array([0, 0, 1], np.float32), v.shape)
    eta = index[:, None]
    inside = refract(-v, up, np.float32(1) / eta)
    chord = np.sum(inside * up, axis=-1, keepdims=True, dtype=np.float32)
    leaving = unit(inside * chord - up * np.float32(0.5)).astype(np.float32)
    rounded = refract(inside, leaving, eta)
    found, error = refracted(v.astype(float), index)
    sure = np.isfinite(error)
    apart = np.linalg.norm(np.cross(unit(rounded[sure].astype(float)), unit(found[sure])), axis=-1)
    assert sure.mean() > 0.99
    assert (apart <= error[sure]).all()
    assert np.median(error) < 3e-5


@pytest.mark.parametrize(
    "lobe", [ref.Dielectric(1.5, 1e-4), ref.GeneralizedSchlick((0.3, 0.1, 1.2), alpha=1e-4)]
)
def test_a_smooth_surface_in_a_white_map_shows_what_it_does_not_reflect(lobe: Any):
    v = views(50)
    found = summed(lobe, v, frames(50), WHITE, 16)
    if isinstance(lobe, ref.Dielectric):
        reflected = ref.fresnel_dielectric(v[:, 2:], 1.5)
    else:
        # Not clamped: MaterialX takes what a curve lacks of 1, more than 1 or less than 0.
        reflected = np.array([0.3, 0.1, 1.2]) + (1 - np.array([0.3, 0.1, 1.2])) * (1 - v[:, 2:]) ** 5
    np.testing.assert_allclose(found.value, np.broadcast_to(1 - reflected, v.shape), atol=1e-4)
    np.testing.assert_allclose(transmitted_share(lobe, v, by_albedo=False)[0], found.value, atol=1e-4)


def test_the_retro_share_sees_as_the_mirrored_view_does():
    lobe, v, axes = ref.Dielectric(1.4, (0.3, 0.1)), views(40), frames(40)
    mirrored = summed(lobe, v * (-1.0, -1.0, 1.0), axes, sky(), 16).value
    straight = summed(lobe, v, axes, sky(), 16).value
    blended = summed(lobe, v, axes, sky(), 16, retro=0.25).value
    np.testing.assert_allclose(blended, 0.75 * straight + 0.25 * mirrored, rtol=1e-12)


CASES = {case.name: case for case in default_suite() if "through-in-sky" in case.name}
TEXTS = {
    "1e-3 of a level": ("MIP_LEVEL_OFFSET = 1.5", "MIP_LEVEL_OFFSET = 1.501"),
    "a sample left out": ("i < envRadianceSamples;", "i < envRadianceSamples - 1;"),
    "no second surface": ("return refract(R, N1, ior);", "return R;"),
}
VALUES = {
    "2e-5 brighter": {"tint": 1.00002},
    "black": {"tint": 0.0},
    "an index 1e-4 off": {"ior": 1.0001},
    "a blend 1e-4 off": {"retroreflectivity": 1.0002},
    "an alpha 1e-3 off": {"roughness": 1.001},
}
"""Factors on what the shader is given."""


class Seen:
    """A case that transmits only, drawn by one shader after another beside its reference."""

    def __init__(self, case: MaterialCase, backend: str) -> None:
        self.case, self.renderer = case, Renderer(backend)
        given = {name.removeprefix("bsdf/"): value for name, value in case.inputs.items()}
        values = material.complete(case.node, {**given, "scatter_mode": "T"})
        self.uniforms = material.uniform_values(case.node, values)
        assert case.environment is not None
        self.light = find_environment(case.environment.name, **dict(case.environment.options))
        document = material.document(case.node)
        self.shader = generate_shader(document, element=material.MATERIAL, environment=case.method)
        self.sound = self.draw(self.shader)
        mask = self.sound.mask
        position, normal, tangent = (
            each[mask].astype(np.float64)
            for each in (self.sound.position, self.sound.normal, self.sound.tangent)
        )
        points = Points(position, normal, tangent, self.sound.camera.position)
        tree = LobeNode(case.node, "bsdf", {**values, "normal": None, "tangent": None})
        around = Surroundings(self.light, measure(backend), case.method)
        self.reference, self.bounds = shade_tree(tree, points, [], lambda port: port, around)

    def draw(self, shader: Shader, factors: Mapping[str, float] | None = None) -> RenderedImage:
        changed = {
            f"bsdf_{name}": np.multiply(self.uniforms[f"bsdf_{name}"], factor)
            for name, factor in (factors or {}).items()
        }
        return self.renderer.render(
            shader,
            load_mesh(self.case.mesh),
            self.case.camera,
            size=(32, 32),
            uniforms={**self.uniforms, **changed},
            environment=self.light,
        )

    def verdict(self, drawn: RenderedImage) -> str:
        return compare(drawn.image[drawn.mask], self.reference, self.bounds)[0]


@pytest.fixture(scope="module")
def backend(gl: None) -> str:
    return next(probe.backend for probe in probe_backends() if probe.works)


@pytest.fixture(scope="module")
def sampled(backend: str) -> Seen:
    return Seen(CASES["dielectric-through-in-sky"], backend)


OTHERS: dict[str, Value] = {"roughness": (0.4, 0.4), "retroreflectivity": 0.5}


@pytest.fixture(scope="module")
def prefiltered(backend: str) -> Seen:
    case = CASES["dielectric-through-in-sky-prefilter"]
    return Seen(dataclasses.replace(case, inputs={**case.inputs, **OTHERS}), backend)


def test_what_is_sound_passes(sampled: Seen, prefiltered: Seen):
    assert [each.verdict(each.sound) for each in (sampled, prefiltered)] == ["pass", "pass"]


@pytest.mark.parametrize("fault", VALUES)
def test_what_a_surface_is_given_wrong_is_noticed(sampled: Seen, prefiltered: Seen, fault: str):
    for each in (sampled, prefiltered):
        assert each.verdict(each.draw(each.shader, VALUES[fault])) == "fail"


@pytest.mark.parametrize("fault", TEXTS)
def test_what_is_wrong_behind_a_surface_is_noticed(sampled: Seen, fault: str):
    old, new = TEXTS[fault]
    assert old in sampled.shader.pixel
    wrong = dataclasses.replace(sampled.shader, pixel=sampled.shader.pixel.replace(old, new))
    assert sampled.verdict(sampled.draw(wrong)) == "fail"


GLASS = """<{top} name="glass" type="BSDF">
  <input name="ior" type="float" value="1.4" /><input name="roughness" type="vector2" value="0.2, 0.2" />
  <input name="tint" type="color3" value="0.9, 0.8, 0.7" /><input name="scatter_mode" type="string" value="T" />
</{top}>
{below}
<layer name="both" type="BSDF">
  <input name="top" type="BSDF" nodename="glass" /><input name="base" type="{kind}" nodename="below" />
</layer>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="both" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" />
</surfacematerial>"""
BELOW = {
    "another": (
        '<mrm_dielectric_bsdf name="below" type="BSDF"><input name="scatter_mode" type="string" value="RT" />'
        '<input name="roughness" type="vector2" value="0.3, 0.3" /></mrm_dielectric_bsdf>',
        "BSDF",
    ),
    # The logarithm of a colour of which one channel is black.
    "a volume": (
        '<ln name="log" type="vector3"><input name="in" type="vector3" nodename="color" /></ln>'
        '<constant name="color" type="vector3"><input name="value" type="vector3" value="0.9, 0.2, 0" /></constant>'
        '<multiply name="absorbed" type="vector3"><input name="in1" type="vector3" nodename="log" />'
        '<input name="in2" type="float" value="-0.5" /></multiply>'
        '<anisotropic_vdf name="below" type="VDF">'
        '<input name="absorption" type="vector3" nodename="absorbed" /></anisotropic_vdf>',
        "VDF",
    ),
}


@pytest.mark.parametrize(
    ("node", "below"), [("dielectric_bsdf", "another"), ("mrm_dielectric_bsdf", "a volume")]
)
def test_what_lies_below_glass_is_seen_through_it(backend: str, node: str, below: str, tmp_path: Path):
    text, kind = BELOW[below]
    path = write(tmp_path, GLASS.format(top=node, below=text, kind=kind))
    case = dataclasses.replace(case_of(path, environment=EnvironmentMap("sky")), size=(16, 16), lights=())
    outcome = Worker(backend).run(case, tmp_path / "report")
    assert (outcome.message, outcome.truth, outcome.verdict) == ("", "physics", "pass")
    assert outcome.figures is not None and outcome.figures.notices is not None
    assert outcome.figures.notices < 1e-4
