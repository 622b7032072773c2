"""Ordinary materials under lights that have a place: what float32 makes of a cone's edge, a fall-off, a terminator, an
angle of total reflection and a driver's arc cosine is within the bounds, and little else is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import MaterialX as mx
import numpy as np
import pytest
from test_material_case import case_of, write

from mrm_nodes.regression.run.worker import Worker
from mrm_nodes.regression.truth.reference_image import light_at, light_errors
from mrm_nodes.render import (
    CameraLight,
    DirectionalLight,
    PointLight,
    SpotLight,
    parse_camera,
    probe_backends,
    render,
)

LIGHTS = {
    "cone": SpotLight((0.0, 0.0, 3.0), (0.0, 0.0, -1.0)),
    "cone aside": SpotLight((1.0, 1.0, 2.0), (-0.5, -0.3, -1.0), (3.0, 2.0, 1.0)),
    "falling off": PointLight((0.2, 0.1, 1.05), decay_rate=2.0),
    "camera": CameraLight(),
}


def of_node(node: str, inputs: str) -> str:
    return f"""<{node} name="b" type="BSDF">{inputs}</{node}>
<surface name="s" type="surfaceshader"><input name="bsdf" type="BSDF" nodename="b" /></surface>
<surfacematerial name="m" type="material">
  <input name="surfaceshader" type="surfaceshader" nodename="s" /></surfacematerial>"""


def number(name: str, value: float) -> str:
    return f'<input name="{name}" type="float" value="{value}" />'


COLOUR = '<input name="color" type="color3" value="0.8, 0.7, 0.6" />'
LOBE = '<input name="roughness" type="vector2" value="0.3, 0.2" />' + number("retroreflectivity", 0.5)
SCHLICK = '<input name="color0" type="color3" value="0.3, 1.2, 0.1" />' + LOBE
MATERIALS = {
    "lambert": of_node("oren_nayar_diffuse_bsdf", COLOUR),
    "oren-nayar, compensated": of_node(
        "oren_nayar_diffuse_bsdf",
        COLOUR
        + number("roughness", 0.7)
        + '<input name="energy_compensation" type="boolean" value="true" />',
    ),
    "oren-nayar, compensated, brighter than white": of_node(
        "oren_nayar_diffuse_bsdf",
        '<input name="color" type="color3" value="1.5, 3, 5.5" />'
        + number("roughness", 1.0)
        + '<input name="energy_compensation" type="boolean" value="true" />',
    ),
    "total reflection": of_node("mrm_dielectric_bsdf", number("ior", 0.7) + LOBE),
    "an index of 1.01": of_node("mrm_dielectric_bsdf", number("ior", 1.01) + LOBE),
    "no extinction": of_node(
        "mrm_conductor_bsdf",
        LOBE
        + '<input name="ior" type="color3" value="0.6, 1, 2" />'
        + '<input name="extinction" type="color3" value="0, 0, 0" />',
    ),
    "an exponent of 0": of_node("mrm_generalized_schlick_bsdf", number("exponent", 0.0) + SCHLICK),
    "an exponent of 0.1": of_node("mrm_generalized_schlick_bsdf", number("exponent", 0.1) + SCHLICK),
    "an exponent of 10": of_node("mrm_generalized_schlick_bsdf", number("exponent", 10.0) + SCHLICK),
    "a film of 1.05": of_node(
        "mrm_dielectric_bsdf", number("thinfilm_thickness", 500.0) + number("thinfilm_ior", 1.05) + LOBE
    ),
    "as wide as it goes": of_node(
        "mrm_conductor_bsdf",
        '<input name="roughness" type="vector2" value="1, 1" />' + number("retroreflectivity", 0.5),
    ),
}


@pytest.fixture(scope="module")
def workers(gl: None) -> list[Worker]:
    return [Worker(probe.backend) for probe in probe_backends() if probe.works]


@pytest.mark.parametrize("material", MATERIALS)
def test_an_ordinary_material_passes_and_would_notice_a_thousandth(
    material: str, workers: list[Worker], tmp_path: Path
):
    case = case_of(write(tmp_path, MATERIALS[material]))
    for number, (name, light) in enumerate(LIGHTS.items()):
        lit = replace(case, lights=(light,), size=(40, 40))
        outcome = workers[number % len(workers)].run(lit, tmp_path / name)
        assert (outcome.message, outcome.verdict) == ("", "pass"), (name, outcome.figures)
        assert outcome.figures is not None and outcome.figures.notices is not None
        # What reflects a 40,000th is not far above what rounding makes of its Fresnel factor.
        assert outcome.figures.notices < (2e-3 if material == "an index of 1.01" else 1e-3), name


MAPPED = (
    '<constant name="texel" type="vector3"><input name="value" type="vector3" value="0.64, 0.385, 0.95" /></constant>'
    '<normalmap name="n" type="vector3"><input name="in" type="vector3" nodename="texel" /></normalmap>'
)


@pytest.mark.parametrize("node", ["conductor_bsdf", "dielectric_bsdf", "generalized_schlick_bsdf"])
@pytest.mark.parametrize("is_retro", [False, True])
def test_what_materialxs_nodes_leak_far_below_a_mapped_horizon(
    node: str, is_retro: bool, workers: list[Worker], tmp_path: Path
):
    """A light behind the mapped normal and a view almost along it: the half vector is opposite the normal, where D is
    as large as along it."""
    inputs = '<input name="roughness" type="vector2" value="0.07, 0.07" />'
    inputs += '<input name="normal" type="vector3" nodename="n" />'
    if is_retro:
        if mx.getVersionIntegers() < (1, 39, 5):
            pytest.skip("this MaterialX has no retroreflective BSDFs")
        inputs += '<input name="retroreflective" type="boolean" value="true" />'
    case = case_of(write(tmp_path, MAPPED + of_node(node, inputs)))
    lights = (PointLight((-1.66, -0.03, 3.1)), DirectionalLight((0.9, 0.2, -0.4)))
    lit = replace(case, lights=lights, size=(64, 64))
    outcome = workers[is_retro % len(workers)].run(lit, tmp_path / "report")
    assert (outcome.message, outcome.verdict) == ("", "pass"), outcome.figures
    # A bound without need would be far from used.
    assert outcome.figures is not None and (outcome.figures.used > 0.1 or not is_retro)


@pytest.mark.parametrize("count", [6, 40])
def test_more_lights_than_usual_just_work(count: int, workers: list[Worker], tmp_path: Path):
    lights = tuple((LIGHTS | {"sun": DirectionalLight((0.3, -0.2, -1.0))}).values()) * (count // 5 + 1)
    path = write(tmp_path, MATERIALS["no extinction"])
    case = replace(case_of(path), lights=lights[:count], size=(24, 24))
    for worker in workers:
        outcome = worker.run(case, tmp_path / worker.backend)
        assert (outcome.message, outcome.verdict) == ("", "pass")
        assert outcome.figures is not None and (outcome.figures.notices or 1.0) < 1e-3
    # And of the other ways to an image, without a word of how many there are.
    one, all_of_them = (
        render(path, lights=some, size=(24, 24)).image for some in (lights[0], lights[:count])
    )
    each = sum(render(path, lights=light, size=(24, 24)).image.astype(float) for light in lights[:5])
    assert not np.allclose(one, all_of_them)
    if count % 5 == 0:
        np.testing.assert_allclose(all_of_them, each * (count // 5), rtol=1e-4, atol=1e-6)


def as_shaded(light: dict, position: np.ndarray) -> np.ndarray:
    """The intensity as MaterialX's nodes have it, each operation rounded to float32."""
    one, f = np.float32, {name: np.float32(value) for name, value in light.items()}
    away = (f["position"] - position).astype(one)
    squares = away * away
    distance = np.sqrt((squares[:, 0] + squares[:, 1]) + squares[:, 2]) + one(1e-8)
    power = f["decay_rate"] * np.log2(distance + one(1.0))
    intensity = (f["color"] * f["intensity"])[None] / np.exp2(power.astype(one))[:, None]
    if light["type"] == 3:
        products = (away / distance[:, None]) * -f["direction"]
        cosine = (products[:, 0] + products[:, 1]) + products[:, 2]
        low, high = np.minimum(f["inner_angle"], f["outer_angle"]), f["inner_angle"]
        t = np.clip((cosine - low) / (high - low), one(0.0), one(1.0))
        intensity = intensity * (t * t * (one(3.0) - one(2.0) * t))[:, None]
    assert intensity.dtype == one
    return intensity.astype(np.float64)


@pytest.mark.parametrize(
    "light",
    [
        PointLight((1.0, 2.0, 3.0), (5.0, 1.0, 0.1), decay_rate=2.0),
        PointLight((0.1, 0.0, 1.0), decay_rate=0.5),
        SpotLight((0.0, 0.0, 3.0), (0.0, 0.0, -1.0)),
        SpotLight((2.0, -1.0, 1.5), (-0.6, 0.3, -0.5), intensity=40.0, inner_angle=0.999, outer_angle=0.99),
        SpotLight((0.0, 30.0, 30.0), (0.0, -1.0, -1.0), decay_rate=0.0, inner_angle=0.9999, outer_angle=0.9997),
    ],
)  # fmt: skip
def test_float32_is_within_what_is_said_of_a_light_and_not_far_from_it(light):
    rng = np.random.default_rng(5)
    position = rng.uniform(-1.0, 1.0, (200_000, 3)).astype(np.float32)
    data = light.data(parse_camera("0,0,3"))
    _, exact = light_at(data, position)
    errors = light_errors(data, position)
    wrong = np.abs(as_shaded(data, position) - exact)
    lit = exact > 0
    assert (wrong <= errors.most)[lit].all()
    assert np.mean((wrong <= errors.usual)[lit]) > 0.999
    # A bound that is far from what happens would hide what else goes wrong.
    assert np.quantile((wrong / np.maximum(errors.usual, 1e-300))[lit], 0.999) > 0.1


def test_a_light_that_is_given_adds_no_error():
    data = DirectionalLight((0.3, 0.2, -1.0)).data(parse_camera("0,0,3"))
    errors = light_errors(data, np.zeros((2, 3)))
    assert not errors.most.any() and not errors.usual.any() and errors.cosine == 0.0
