"""What hardly absorbs, or hardly differs from air: near total reflection rounding decides, and the bounds know it."""

import pytest

from mrm_nodes.regression.cases import cloud
from mrm_nodes.regression.truth import material
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import generate_shader

METAL = "mrm_conductor_bsdf"
ordinary = cloud.random_inputs


def covered(node, rng, n):
    """An index below 1, hardly any extinction, and a film, which shows its rounding in the other colours too."""
    inputs = ordinary(node, rng, n)
    inputs["ior"][:, 0] = 10 ** rng.uniform(-1, 0, n)
    inputs["extinction"][:, 0] = 10 ** rng.uniform(-5, -2, n)
    inputs["thinfilm_thickness"] = material.as_float32(rng.uniform(100, 1000, n))
    return inputs


def like_air(node, rng, n):
    """An index near 1, and no extinction."""
    inputs = ordinary(node, rng, n)
    index = material.as_float32(1.0 - 10 ** rng.uniform(-6, -3, n))
    if node == METAL:
        inputs["ior"][:, 0] = index
        inputs["extinction"][:, 0] = 0.0
    else:
        inputs["ior"] = index
    inputs["thinfilm_thickness"][:] = 0.0
    return inputs


@pytest.mark.parametrize(
    ("node", "kind", "least"),
    [(METAL, covered, 0.3), (METAL, like_air, 0.3), ("mrm_dielectric_bsdf", like_air, 0.05)],
)
def test_they_are_within_their_bounds_which_say_something(working_backend, monkeypatch, node, kind, least):
    monkeypatch.setattr(cloud, "random_inputs", kind)
    shader = generate_shader(
        material.document(node, attributes=cloud.attributes_of(node)), element=material.MATERIAL
    )
    drawn = cloud.run_cloud(cloud.Cloud(node, configurations=100_000), Renderer(working_backend), shader)
    assert drawn.verdict == "pass", drawn.worst[0]
    # Bounds without need would be far from used.
    assert least < drawn.figures.used < 1
