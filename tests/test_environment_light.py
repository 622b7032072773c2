"""Environment light in generated shaders: against albedo, mirror symmetry, MaterialX's own nodes, and the integral."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.environment_reference import (
    compensation,
    environment_image,
    reflected_radiance,
)
from mrm_nodes.regression.truth.reference_image import evaluator, shading_frame
from mrm_nodes.render.context import probe_backends
from mrm_nodes.render.environment import Environment, load_environment, sky, studio
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.shadergen import generate_shader

DATA = Path(__file__).parents[2] / "shared" / "data"
CONDUCTOR, DIELECTRIC, SCHLICK = material.NODES
EYE = (0.0, 0.0, 0.0)
WHITE = Environment(np.ones((16, 32, 3)))

LOBES = [
    (CONDUCTOR, {"roughness": (0.3, 0.3)}),
    (CONDUCTOR, {"roughness": (0.3, 0.08), "retroreflectivity": 0.5}),
    (SCHLICK, {"roughness": (0.2, 0.2), "distribution": "beckmann", "retroreflectivity": 1.0}),
    (
        DIELECTRIC,
        {"roughness": (0.4, 0.1), "distribution": "phong", "masking": "vcavity", "retroreflectivity": 0.3},
    ),
    (CONDUCTOR, {"roughness": (0.2, 0.5), "masking": "vcavity", "retroreflectivity": 0.7}),
]


def points(n, seed=0, normal=None):
    """Points around the eye, their normals within about 80 degrees of the view."""
    rng = np.random.default_rng(seed)
    view = rng.normal(size=(n, 3))
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    normals = view + 0.6 * rng.normal(size=(n, 3)) if normal is None else np.broadcast_to(normal, (n, 3))
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    # Not too near the horizon, where few samples count.
    keep = np.abs(np.sum(normals * view, axis=1)) > 0.17
    tangents = rng.normal(size=(n, 3))
    data = {"position": -view, "normal": normals, "tangent": tangents}
    return {name: value[keep].astype(np.float32) for name, value in data.items()}


@pytest.fixture(scope="module")
def draw():
    """Shade points with a node: the image, and view and frame as the evaluator sees them."""
    working = [probe.backend for probe in probe_backends() if probe.works]
    if not working:
        pytest.skip("no backend works")
    renderer = Renderer(working[0])
    shaders = {}

    def draw_points(node, inputs, environment, placed, *, method="fis", by_host=False):
        key = (node, method, by_host)
        if key not in shaders:
            shader = generate_shader(material.document(node), environment=method)
            if by_host:
                # A shader whose compiler was not told the method calls the host's own function for each lobe.
                value = {"fis": 1, "prefilter": 2}[method]
                told = f"#define MRM_ENVIRONMENT {value}\n"
                assert told in shader.pixel
                shader = replace(shader, pixel=shader.pixel.replace(told, "", 1))
            shaders[key] = shader
        uniforms = material.uniform_values(node, inputs)
        drawn = renderer.draw_points(shaders[key], placed, EYE, [], uniforms, environment)
        view, frame = shading_frame(drawn["position"], drawn["normal"], drawn["tangent"], EYE)
        return drawn["image"].astype(np.float64), view, frame

    return draw_points


def local(view, frame):
    v = np.einsum("nij,nj->ni", frame, view)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize(("node", "inputs"), LOBES, ids=str)
def test_a_white_environment_gives_the_albedo_times_the_compensation(draw, node, inputs):
    values = material.complete(node, inputs)
    errors = {}
    for samples in (128, 2048):
        image, view, frame = draw(node, inputs, replace(WHITE, samples=samples), points(300))
        albedo = evaluator(node, values, compensated=False).albedo(local(view, frame))
        errors[samples] = (
            np.abs(image - albedo * compensation(node, values, view, frame)).mean() / albedo.mean()
        )
    assert errors[2048] < 1.5e-3
    assert errors[2048] < 0.5 * errors[128]


@pytest.mark.parametrize("inputs", [{"roughness": (0.3, 0.3)}, {"roughness": (0.1, 0.4)}], ids=str)
@pytest.mark.parametrize("environment", [sky, studio], ids=lambda make: make.__name__)
def test_retro_in_a_map_is_forward_in_the_map_turned_about_the_normal(draw, environment, inputs):
    placed = points(500, normal=(0.0, 1.0, 0.0))
    placed["normal"] = np.where(placed["position"][:, 1:2] < 0.0, placed["normal"], -placed["normal"])
    light = replace(environment(), samples=64)
    turned = {
        "by its matrix": replace(light, rotation=180.0),
        "by its texels": replace(light, radiance=np.roll(light.radiance, 128, axis=1)),
    }
    retro, _, _ = draw(SCHLICK, {**inputs, "retroreflectivity": 1.0}, light, placed)
    same, _, _ = draw(SCHLICK, inputs, light, placed)
    scale = np.abs(retro).mean()
    assert np.abs(retro - same).mean() > 0.1 * scale
    for way, map_turned in turned.items():
        forward, _, _ = draw(SCHLICK, inputs, map_turned, placed)
        assert np.abs(forward - retro).max() <= 1e-6 * max(scale, np.abs(retro).max()), way


def test_the_hosts_own_function_keeps_the_mirror_identity_to_its_sampling_error(draw):
    placed = points(300, normal=(0.0, 1.0, 0.0))
    inputs, errors = {"roughness": (0.3, 0.3)}, []
    for samples in (64, 1024):
        light = replace(studio(), samples=samples, filtered=False)
        retro, _, _ = draw(SCHLICK, {**inputs, "retroreflectivity": 1.0}, light, placed, by_host=True)
        forward, _, _ = draw(SCHLICK, inputs, replace(light, rotation=180.0), placed, by_host=True)
        errors.append(np.abs(forward - retro).mean() / retro.mean())
    assert 1e-5 < errors[1] < 0.5 * errors[0]
    assert errors[1] < 0.03


@pytest.mark.parametrize("node", material.NODES)
@pytest.mark.parametrize("alpha", [0.05, 0.3, 1.0])
def test_isotropic_ggx_is_materialx_sample_by_sample(draw, node, alpha):
    light = replace(studio(), samples=64)
    ours, _, _ = draw(node, {"roughness": (alpha, alpha)}, light, points(400))
    theirs, _, _ = draw(node.removeprefix("mrm_"), {"roughness": (alpha, alpha)}, light, points(400))
    error = np.abs(ours - theirs) / theirs.mean()
    assert np.quantile(error, 0.99) < 2e-5
    assert error.mean() < 5e-6


@pytest.mark.parametrize("method", ["fis", "prefilter"])
@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_the_host_neutral_nodes_are_materialx_own(draw, weight, method):
    placed, light = points(400), replace(studio(), samples=32)
    inputs = {"roughness": (0.2, 0.2), "retroreflectivity": weight}
    ours, _, _ = draw(CONDUCTOR, inputs, light, placed, method=method, by_host=True)
    own = {"roughness": (0.2, 0.2), "retroreflective": bool(weight)}
    theirs, _, _ = draw("conductor_bsdf", own, light, placed, method=method)
    assert np.quantile(np.abs(ours - theirs), 0.99) < 1e-5 * theirs.mean()


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
def test_prefiltered_light_is_what_the_hosts_function_gives(draw, weight):
    placed = points(400)
    inputs = {"roughness": (0.3, 0.1), "retroreflectivity": weight}
    ours, _, _ = draw(CONDUCTOR, inputs, studio(), placed, method="prefilter")
    theirs, _, _ = draw(CONDUCTOR, inputs, studio(), placed, method="prefilter", by_host=True)
    assert np.abs(ours - theirs).max() < 1e-5 * theirs.max()


@pytest.mark.parametrize(("node", "inputs"), LOBES[1:4], ids=str)
def test_many_samples_agree_with_the_integral(draw, node, inputs):
    """Without the mip filter the mean error lies within both sampling errors; the filter's bias is on top of that."""
    values = material.complete(node, inputs)
    placed, light = points(40, seed=3), replace(studio(), filtered=False)
    images = {}
    for samples in (1024, 2048):
        images[samples], view, frame = draw(node, inputs, replace(light, samples=samples), placed)
    truth = environment_image(node, values, view, frame, light, samples=1024, replicates=6)
    scale = truth.mean.mean()
    # Half the samples have about twice the error.
    own_error = np.abs(images[2048] - images[1024]).mean() / scale
    reference_error = truth.standard_error.mean() / scale
    difference = np.abs(images[2048] - truth.mean).mean() / scale
    assert own_error < 0.02
    assert reference_error < 0.02
    assert difference <= 2.0 * (own_error + reference_error)

    filtered, _, _ = draw(node, inputs, replace(light, samples=2048, filtered=True), placed)
    bias = np.abs(filtered - images[2048]).mean() / scale
    coarse, _, _ = draw(node, inputs, replace(light, samples=128, filtered=True), placed)
    assert bias < 0.03
    assert bias < np.abs(coarse - truth.mean).mean() / scale


@pytest.mark.parametrize("name", ["san_giuseppe_bridge.hdr", "goegap.hdr"])
def test_measured_maps_agree_with_the_integral(draw, name):
    if not (DATA / name).is_file():
        pytest.skip(f"{DATA / name} is not here")
    node, inputs = CONDUCTOR, {"roughness": (0.3, 0.1), "retroreflectivity": 0.5}
    light = load_environment(DATA / name, samples=1024, rotation=25.0)
    image, view, frame = draw(node, inputs, light, points(40))
    truth = environment_image(node, material.complete(node, inputs), view, frame, light, 1024, 6)
    assert np.abs(image - truth.mean).mean() < 0.01 * truth.mean.mean()


def test_the_host_masks_anisotropic_lobes_by_their_mean(draw):
    inputs = {"roughness": (0.6, 0.05), "retroreflectivity": 0.5}
    values = material.complete(CONDUCTOR, inputs)
    light = replace(WHITE, samples=2048)
    errors = {}
    for by_host in (False, True):
        image, view, frame = draw(CONDUCTOR, inputs, light, points(300), by_host=by_host)
        albedo = evaluator(CONDUCTOR, values, compensated=False).albedo(local(view, frame))
        errors[by_host] = np.abs(image / compensation(CONDUCTOR, values, view, frame) - albedo).max()
    assert errors[False] < 5e-3
    assert errors[True] > 10.0 * errors[False]


def test_the_reference_knows_its_error():
    """Independent runs spread as their standard errors say, about the albedo in a white environment."""
    bsdf = evaluator(
        CONDUCTOR,
        material.complete(CONDUCTOR, {"roughness": (0.3, 0.1), "retroreflectivity": 0.4}),
        compensated=False,
    )
    placed = points(200)
    view, frame = shading_frame(placed["position"], placed["normal"], placed["tangent"], EYE)
    estimate = reflected_radiance(bsdf, view, frame, WHITE, samples=512, replicates=16)
    deviation = (estimate.mean - bsdf.albedo(local(view, frame))) / estimate.standard_error
    # Student's t with 15 degrees of freedom has a standard deviation of 1.07; colours of a point are not independent.
    assert 0.7 < np.sqrt(np.mean(deviation**2)) < 1.4
    assert abs(deviation.mean()) < 0.3
