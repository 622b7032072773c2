"""MaterialX's GLSL for WebGPU, run: the nodes agree with the evaluator there too."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest

from mrm_nodes import shadergen
from mrm_nodes.errors import MrmError
from mrm_nodes.regression.cases.cloud import Cloud, attributes_of, run_cloud
from mrm_nodes.regression.truth import material
from mrm_nodes.render.webgpu import INSTALL, WebGPURenderer, device

if "wgsl" not in shadergen.supported_targets():
    pytest.skip("this MaterialX has no wgsl", allow_module_level=True)
try:
    device()
except MrmError as missing:
    assert "wgsl" not in os.environ.get("MRM_REQUIRE_COMPILERS", "").split(","), missing
    pytest.skip(INSTALL, allow_module_level=True)


@pytest.mark.parametrize(
    ("node", "distribution", "masking"),
    [
        ("mrm_conductor_bsdf", "beckmann", "smith"),
        ("mrm_dielectric_bsdf", "ggx", "smith"),
        ("mrm_generalized_schlick_bsdf", "phong", "vcavity"),
        ("mrm_generalized_schlick_bsdf", "ggx", "vcavity"),
    ],
)
def test_the_cloud_s_bounds_hold_in_webgpu(node: str, distribution: str, masking: str) -> None:
    shader = shadergen.generate_shader(material.document(node, attributes=attributes_of(node)), "wgsl")
    cloud = Cloud(node, distribution, masking, configurations=30_000)
    assert run_cloud(cloud, WebGPURenderer(), shader).verdict == "pass"


def test_another_distribution_is_told_apart() -> None:
    """So the test above proves something."""
    node = "mrm_conductor_bsdf"
    shader = shadergen.generate_shader(material.document(node, attributes=attributes_of(node)), "wgsl")
    assert "#define MRM_BECKMANN 1" in shader.pixel
    spoilt = replace(shader, pixel=shader.pixel.replace("#define MRM_BECKMANN 1", "#define MRM_BECKMANN 7"))
    cloud = Cloud(node, "beckmann", configurations=5_000)
    assert run_cloud(cloud, WebGPURenderer(), spoilt).verdict == "fail"


def test_a_shader_that_naga_refuses_is_quoted() -> None:
    shader = shadergen.generate_shader(material.document("mrm_conductor_bsdf"), "wgsl")
    spoilt = replace(shader, pixel=shader.pixel.replace("float weight", "float wieght"))
    points = {name: np.eye(3, dtype=np.float32) for name in ("position", "normal", "tangent")}
    with pytest.raises(MrmError, match=r"naga: .*weight"):
        WebGPURenderer().draw_points(spoilt, points, (0.0, 0.0, 5.0))


def test_only_wgsl_is_taken() -> None:
    shader = shadergen.generate_shader(material.document("mrm_conductor_bsdf"), "glsl")
    with pytest.raises(MrmError, match="WebGPU runs wgsl, not glsl"):
        WebGPURenderer().draw_points(shader, {"position": np.zeros((1, 3))}, (0.0, 0.0, 0.0))
