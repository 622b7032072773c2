"""Slang, run on its compiler's CPU device: the nodes agree with the evaluator there too."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from mrm_nodes import shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.cloud import Cloud, attributes_of, run_cloud
from mrm_nodes.regression.truth import material
from mrm_nodes.render.slang import SlangRenderer

if "slang" not in shadergen.supported_targets():
    pytest.skip("this MaterialX has no slang", allow_module_level=True)
try:
    RENDERER = SlangRenderer()
except MrmError as missing:
    assert "slang" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), missing
    pytest.skip(str(missing), allow_module_level=True)


def slang(node: str, attributes: tuple[str, ...] = ()) -> shadergen.Shader:
    return shadergen.generate_shader(material.document(node, attributes=attributes), "slang")


@pytest.mark.parametrize(
    ("node", "distribution", "masking"),
    [
        ("mrm_conductor_bsdf", "ggx", "vcavity"),
        ("mrm_dielectric_bsdf", "beckmann", "smith"),
        ("mrm_generalized_schlick_bsdf", "phong", "vcavity"),
    ],
)
def test_the_cloud_s_bounds_hold_in_slang(node: str, distribution: str, masking: str) -> None:
    cloud = Cloud(node, distribution, masking, configurations=30_000)
    assert run_cloud(cloud, RENDERER, slang(node, attributes_of(node))).verdict == "pass"


def test_another_distribution_is_told_apart() -> None:
    """So the test above proves something."""
    node = "mrm_conductor_bsdf"
    shader = slang(node, attributes_of(node))
    assert "#define MRM_BECKMANN 1" in shader.pixel
    spoilt = replace(shader, pixel=shader.pixel.replace("#define MRM_BECKMANN 1", "#define MRM_BECKMANN 7"))
    assert run_cloud(Cloud(node, "beckmann", configurations=5_000), RENDERER, spoilt).verdict == "fail"


def test_a_shader_that_slang_refuses_is_quoted() -> None:
    shader = slang("mrm_conductor_bsdf")
    spoilt = replace(shader, pixel=shader.pixel.replace("float weight", "float wieght"))
    points = {name: np.eye(3, dtype=np.float32) for name in ("position", "normal", "tangent")}
    with pytest.raises(MrmError, match=r"slang: .*weight"):
        RENDERER.draw_points(spoilt, points, (0.0, 0.0, 5.0))


def test_vertex_data_that_is_missing_is_named() -> None:
    with pytest.raises(MrmError, match="the shader needs the attribute normal"):
        RENDERER.draw_points(slang("mrm_conductor_bsdf"), {"position": np.zeros((1, 3))}, (0.0, 0.0, 0.0))


def test_only_slang_is_taken() -> None:
    shader = shadergen.generate_shader(material.document("mrm_conductor_bsdf"), "glsl")
    with pytest.raises(MrmError, match="runs slang, not glsl"):
        RENDERER.draw_points(shader, {"position": np.zeros((1, 3))}, (0.0, 0.0, 0.0))
