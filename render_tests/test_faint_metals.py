"""A film over a metal of which one colour hardly absorbs: rounding in that colour is seen in all three."""

from mrm_nodes.regression.cases import cloud
from mrm_nodes.regression.truth import material
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import generate_shader

NODE = "mrm_conductor_bsdf"
ordinary = cloud.random_inputs


def faint(node, rng, n):
    """Ordinary inputs, but for an index below 1, hardly any extinction, and a film."""
    inputs = ordinary(node, rng, n)
    inputs["ior"][:, 0] = 10 ** rng.uniform(-1, 0, n)
    inputs["extinction"][:, 0] = 10 ** rng.uniform(-5, -2, n)
    inputs["thinfilm_thickness"] = material.as_float32(rng.uniform(100, 1000, n))
    return inputs


def test_it_is_within_its_bounds_and_they_say_something(working_backend, monkeypatch):
    monkeypatch.setattr(cloud, "random_inputs", faint)
    shader = generate_shader(
        material.document(NODE, attributes=cloud.attributes_of(NODE)), element=material.MATERIAL
    )
    drawn = cloud.run_cloud(cloud.Cloud(NODE, configurations=100_000), Renderer(working_backend), shader)
    assert drawn.verdict == "pass", drawn.worst[0]
    # Bounds without need would be far from used.
    assert 0.3 < drawn.figures.used < 1
