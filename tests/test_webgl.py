"""ESSL in a browser: the nodes agree with the evaluator there too, as far as the driver's functions are right."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from mrm_nodes import shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.cloud import DECADES, Cloud, attributes_of, run_cloud
from mrm_nodes.regression.truth import material
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
    assert len(bare) == len(DECADES)
    assert [decade for decade in bare if decade["max_used"] > 1] == []
    # A percentile of so few points is not the cloud's own.
    assert [decade for decade in bare if decade["p999_used"] > 1.5] == []


# ---- thin films: MaterialX's sum takes cosines of phases, and phases by arctangents


#: Functions of the browser's software driver, which are coarse or wrong, in float32's own precision.
RIGHT_FUNCTIONS = """
float right_sin(float x)
{
    float x2 = x * x;
    return x * (1.0 - x2 / 6.0 * (1.0 - x2 / 20.0 * (1.0 - x2 / 42.0 * (1.0 - x2 / 72.0 * (1.0 - x2 / 110.0)))));
}
float right_cos(float x)
{
    float turns = round(x / 6.283185307);
    float s = right_sin(0.5 * ((x - turns * 6.28125) - turns * 0.0019353071795864769));
    return 1.0 - 2.0 * s * s;
}
vec3 right_cos(vec3 x) { return vec3(right_cos(x.x), right_cos(x.y), right_cos(x.z)); }
float right_atan(float x) { return atan(x); }
float right_atan(float y, float x) { return atan(y + 1e-30, x); }
vec3 right_atan(vec3 y, vec3 x) { return atan(y + vec3(1e-30), x); }
#define mx_cos right_cos
#define mx_atan right_atan
"""


@pytest.mark.parametrize("node", material.NODES)
def test_a_thin_film_keeps_the_bounds_where_cosine_and_arctangent_are_right(node: str) -> None:
    shader = essl(node, attributes_of(node))
    own = "#define mx_cos cos\n", "#define mx_atan atan\n"
    assert all(define in shader.pixel for define in own)
    mended = shader.pixel.replace(own[0], "").replace(own[1], RIGHT_FUNCTIONS)
    cloud = Cloud(node, configurations=12_000)
    decades = run_cloud(cloud, WebGLRenderer(), replace(shader, pixel=mended)).decades
    assert [decade for decade in decades if decade["max_used"] > 1] == []
    assert [decade for decade in decades if decade["p999_used"] > 1.5] == []


def measured(expression: str, x: np.ndarray) -> np.ndarray:
    """The driver's own value of an expression of `x`, at each x."""
    varyings = "".join(f"in vec3 {name}World;\n" for name in ("position", "normal", "tangent"))
    body = f"void main()\n{{\n    float x = positionWorld.x;\n    value = vec4({expression});\n}}\n"
    pixel = f"#version 300 es\nprecision highp float;\n{varyings}out vec4 value;\n{body}"
    points = {name: np.zeros((len(x), 3), np.float32) for name in ("position", "normal", "tangent")}
    points["position"][:, 0] = x
    shader = replace(essl("mrm_conductor_bsdf", ()), pixel=pixel)
    return WebGLRenderer().draw_points(shader, points, (0.0, 0.0, 5.0))["image"][:, 0].astype(np.float64)


def test_the_driver_s_cosine_is_coarse_at_any_argument() -> None:
    """So a film's share of 99.9 % within 1e-5 cannot be had from it; Vulkan allows 2^-11."""
    x = np.linspace(-60.0, 60.0, 6_001, dtype=np.float32)
    error = np.abs(measured("cos(x)", x) - np.cos(x.astype(np.float64)))
    assert error.max() < 2.0**-11
    assert error.max() > 1e-4, "the driver has mended its cosine"
    assert error[np.abs(x) < np.pi].max() == pytest.approx(error.max(), rel=0.01), "no matter of range"


def test_the_driver_s_arctangent_is_half_a_turn_off_at_a_negative_zero() -> None:
    """The phase of a film on a lossless dielectric is the arctangent of one."""
    x = np.array([0.5, 1.0, 9.0], np.float32)
    assert measured("atan(1e-30, x)", x) == pytest.approx(np.zeros(3), abs=1e-6)
    assert measured("atan(-abs(positionWorld.y), x)", x) == pytest.approx(np.full(3, np.pi), abs=1e-6), (
        "the driver has mended its arctangent"
    )


def test_a_shader_that_the_browser_refuses_is_quoted() -> None:
    shader = essl("mrm_conductor_bsdf", ())
    spoilt = replace(shader, pixel=shader.pixel.replace("float weight", "float wieght"))
    points = {name: np.eye(3, dtype=np.float32) for name in ("position", "normal", "tangent")}
    with pytest.raises(MrmError, match=r"WebGL: ERROR: .*'weight' : undeclared"):
        WebGLRenderer().draw_points(spoilt, points, (0.0, 0.0, 5.0))


def test_only_essl_is_taken() -> None:
    shader = shadergen.generate_shader(material.document("mrm_conductor_bsdf"), "glsl")
    with pytest.raises(MrmError, match="WebGL runs essl, not glsl"):
        WebGLRenderer().draw_points(shader, {"position": np.zeros((1, 3))}, (0.0, 0.0, 0.0))
