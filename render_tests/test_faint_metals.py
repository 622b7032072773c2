"""What hardly absorbs, or hardly differs from air: near total reflection rounding decides, and the bounds know it."""

import numpy as np
import pytest

from mrm_nodes.regression.cases import cloud
from mrm_nodes.regression.truth import material
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import generate_shader

METAL, CURVE = "mrm_conductor_bsdf", "mrm_generalized_schlick_bsdf"
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


def of_its_film(node, rng, n):
    """One colour's index is its film's to the last digits, so that rounding decides about half a turn of its phase."""
    inputs = ordinary(node, rng, n)
    root = np.sqrt(material.as_float32(rng.uniform(0.02, 0.3, n)))
    inputs["color0"][:, 1] = material.as_float32(root**2)
    inputs["thinfilm_ior"] = material.as_float32((1.0 + root) / (1.0 - root))
    inputs["thinfilm_thickness"] = material.as_float32(rng.uniform(100, 1000, n))
    return inputs


def thin_air(node, rng, n):
    """A film that is hardly denser than air."""
    inputs = ordinary(node, rng, n)
    inputs["thinfilm_ior"] = material.as_float32(1.0 + 10 ** rng.uniform(-7, -3, n))
    inputs["thinfilm_thickness"] = material.as_float32(rng.uniform(100, 1000, n))
    return inputs


@pytest.mark.parametrize(
    ("node", "kind", "least"),
    [
        (METAL, covered, 0.3),
        (METAL, like_air, 0.3),
        ("mrm_dielectric_bsdf", like_air, 0.05),
        (CURVE, of_its_film, 0.05),
        (CURVE, thin_air, 0.3),
        (METAL, thin_air, 0.3),
        ("mrm_dielectric_bsdf", thin_air, 0.3),
    ],
)
def test_none_is_beyond_its_bound_which_says_something(working_backend, monkeypatch, node, kind, least):
    monkeypatch.setattr(cloud, "random_inputs", kind)
    shader = generate_shader(
        material.document(node, attributes=cloud.attributes_of(node)), element=material.MATERIAL
    )
    drawn = cloud.run_cloud(cloud.Cloud(node, configurations=100_000), Renderer(working_backend), shader)
    # Bounds without need would be far from used.
    assert least < drawn.worst[0]["used"] < 1, drawn.worst[0]
    if node == METAL or kind is thin_air:
        assert drawn.verdict == "pass"
