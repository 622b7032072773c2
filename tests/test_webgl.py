"""ESSL in a browser: the nodes agree with the evaluator there too."""

from __future__ import annotations

import os

import numpy as np
import pytest

from mrm_nodes import shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression import material
from mrm_nodes.regression.cloud import Cloud, attributes_of, place, random_inputs, run_cloud
from mrm_nodes.render.scene import DirectionalLight
from mrm_nodes.render.webgl import INSTALL, WebGLRenderer, find_browser

if find_browser() is None:
    assert "essl" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), INSTALL
    pytest.skip(INSTALL, allow_module_level=True)


def essl(node: str, attributes: tuple[str, ...]) -> shadergen.Shader:
    return shadergen.generate_shader(material.document(node, attributes=attributes), "essl")


@pytest.mark.parametrize(
    ("node", "distribution", "masking"),
    [
        ("mrm_conductor_bsdf", "ggx", "smith"),
        ("mrm_dielectric_bsdf", "beckmann", "smith"),
        ("mrm_generalized_schlick_bsdf", "phong", "vcavity"),
        ("mrm_generalized_schlick_bsdf", "ggx", "vcavity"),
    ],
)
def test_the_cloud_s_bounds_hold_in_a_browser(node: str, distribution: str, masking: str) -> None:
    cloud = Cloud(node, distribution, masking, configurations=8_000)
    decades = run_cloud(cloud, WebGLRenderer(), essl(node, attributes_of(node))).decades
    # Thin films: see below.
    bare = [decade for decade in decades if not decade["film"]]
    assert len(bare) == 3
    assert [decade for decade in bare if decade["max_used"] > 1] == []
    # A percentile of so few points is not the cloud's own.
    assert [decade for decade in bare if decade["p999_used"] > 1.5] == []


def test_a_thin_film_is_as_good_as_the_browser_lets_materialx_be() -> None:
    """Sines and arcus tangents of a browser's software driver are coarse; MaterialX's film sums many of them."""
    rng = np.random.default_rng(4)
    n = 4_000
    inputs = random_inputs("mrm_dielectric_bsdf", rng, n)
    inputs["thinfilm_thickness"] = rng.uniform(50.0, 1000.0, n).astype(np.float32)
    inputs["roughness"] = np.repeat(rng.uniform(0.05, 1.0, (n, 1)).astype(np.float32), 2, axis=-1)
    inputs["retroreflectivity"] = np.zeros(n)
    v, light = (_upper_half(rng, n) for _ in range(2))
    to_light = np.array([0.0, 0.0, 1.0])
    geometry = place(v, light, to_light, np.zeros(3), rng)
    lamp = DirectionalLight(direction=tuple(-to_light))
    images = []
    for node in ("mrm_dielectric_bsdf", "dielectric_bsdf"):
        names = tuple(
            name for name in attributes_of("mrm_dielectric_bsdf") if name in material.inputs_of(node)
        )
        attributes = {**geometry, **{name: inputs[name] for name in names}}
        drawn = WebGLRenderer().draw_points(essl(node, names), attributes, (0.0, 0.0, 0.0), [lamp])
        images.append(drawn["image"])
    ours, theirs = images
    assert theirs.max() > 0
    error = np.abs(ours - theirs) / np.maximum(np.abs(theirs), 1e-4)
    assert np.quantile(error, 0.999) < 1e-4


def _upper_half(rng: np.random.Generator, n: int) -> np.ndarray:
    w = rng.normal(size=(n, 3))
    w[:, 2] = np.abs(w[:, 2]) + 0.1
    return w / np.linalg.norm(w, axis=-1, keepdims=True)


def test_a_shader_that_the_browser_refuses_is_quoted() -> None:
    from dataclasses import replace

    shader = essl("mrm_conductor_bsdf", ())
    spoilt = replace(shader, pixel=shader.pixel.replace("float weight", "float wieght"))
    points = {name: np.eye(3, dtype=np.float32) for name in ("position", "normal", "tangent")}
    with pytest.raises(MrmError, match=r"WebGL: ERROR: .*'weight' : undeclared"):
        WebGLRenderer().draw_points(spoilt, points, (0.0, 0.0, 5.0))


def test_only_essl_is_taken() -> None:
    shader = shadergen.generate_shader(material.document("mrm_conductor_bsdf"), "glsl")
    with pytest.raises(MrmError, match="WebGL runs essl, not glsl"):
        WebGLRenderer().draw_points(shader, {"position": np.zeros((1, 3))}, (0.0, 0.0, 0.0))
