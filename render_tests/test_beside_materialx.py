"""Our nodes beside MaterialX's own, drawn in the same run: never further from physics.

Isotropic GGX with Smith, in direct light above the horizon, at weight 0 and 1, is MaterialX's own but for rounding, of
which ours has less. Anisotropic lobes differ: MaterialX masks with the mean of the two alphas.
"""

import math

import numpy as np
import pytest

from mrm_nodes.regression.cases.cloud import attributes_of, place, random_directions, random_inputs
from mrm_nodes.regression.truth import material
from mrm_nodes.regression.truth.reference_image import evaluator, shade, shading_frame, white_evaluator
from mrm_nodes.regression.verdict.compare import FLOOR, relative_error
from mrm_nodes.render.renderer import Renderer
from mrm_nodes.render.scene import Camera, DirectionalLight
from mrm_nodes.shadergen import generate_shader

N = 30_000
TO_LIGHT = material.as_float32((0.48, -0.6, 0.64))
LIGHT = DirectionalLight(tuple(-TO_LIGHT))
EYE = (0.5, -0.25, 1.0)
CLEAR = 0.1
"""Cosine of light and view from which on the masking of anisotropic lobes is compared."""
GRAZING = 0.01
"""The same for isotropic lobes: below it what is left is the rounding of the view, which both are given."""


@pytest.fixture(scope="module")
def draw(working_backend):
    """Draw points with a node of ours or of MaterialX."""
    renderer = Renderer(working_backend)
    shaders = {}

    def draw_points(node, inputs, placed, **uniforms):
        names = [name for name in attributes_of(node) if name in inputs]
        if node not in shaders:
            document = material.document(node, attributes=names)
            shaders[node] = generate_shader(document, element=material.MATERIAL)
        values = {**placed, **{name: inputs[name] for name in names}}
        numbers = material.uniform_values(node, uniforms)
        return renderer.draw_points(shaders[node], values, EYE, [LIGHT], numbers)

    return draw_points


def configurations(node, retro, alpha):
    """Random inputs at one weight and one pair of alphas, without a film, with lights on the lobe and anywhere."""
    rng = np.random.default_rng(7)
    inputs = random_inputs(node, rng, N)
    inputs["roughness"] = material.as_float32(np.broadcast_to(alpha, (N, 2)))
    inputs["retroreflectivity"] = np.full(N, retro)
    inputs["thinfilm_thickness"] = np.zeros(N)
    # Ordinary ones: at an angle of total reflection, or with a small exponent at the mirror angle, both have the same
    # error, of the half angle's cosine.
    for name, least in (("ior", 1.1), ("extinction", 0.5), ("exponent", 1.0)):
        if name in inputs:
            inputs[name] = np.maximum(inputs[name], material.as_float32(least))
    values = {**material.complete(node, {}), **inputs}
    bsdf = evaluator(node, values)
    v, light, _ = random_directions(bsdf, rng, N)
    return inputs, bsdf, place(v, light, TO_LIGHT, np.array(EYE), rng)


def both(draw, node, retro, alpha):
    """Ours, MaterialX's own and the evaluator's response above the horizon, that for F = 1, and the smaller of n.l and
    n.v.
    """
    inputs, bsdf, placed = configurations(node, retro, alpha)
    ours = draw(node, inputs, placed)
    theirs = draw(node.removeprefix("mrm_"), inputs, placed, retroreflective=bool(retro))
    view, frame = shading_frame(ours["position"], ours["normal"], ours["tangent"], EYE)
    data = LIGHT.data(Camera(position=EYE))
    white = white_evaluator({**material.complete(node, {}), **inputs})
    truth, lobe = (
        shade(each, inputs["weight"], view, frame, ours["position"], [data]) for each in (bsdf, white)
    )
    cosine = np.minimum(frame[:, 2] @ TO_LIGHT, np.einsum("nj,nj->n", frame[:, 2], view))
    lit = cosine > 0.0
    return ours["image"][lit], theirs["image"][lit], truth[lit], lobe[lit], cosine[lit]


@pytest.mark.parametrize("retro", [0.0, 1.0], ids=["forward", "retro"])
@pytest.mark.parametrize("alpha", [0.007, 0.05, 0.25, 0.6, 1.0])
@pytest.mark.parametrize("node", material.NODES)
def test_isotropic_nodes_are_nearer_to_the_evaluator_than_materialx_own(draw, node, alpha, retro):
    """In the mean and at most, relative to the lobe: a tint at 82 degrees leaves of F what may be nothing."""
    ours, theirs, truth, lobe, cosine = both(draw, node, retro, (alpha, alpha))
    # That tint can make MaterialX's Fresnel factor negative; ours is clamped.
    assert ours[theirs < 0].max(initial=0.0) == 0
    theirs = np.maximum(theirs, 0.0)
    kept = cosine > GRAZING
    assert kept.sum() > N / 3
    size = np.maximum(lobe, FLOOR)[kept]
    mine, others, difference = (
        np.abs(np.subtract(*pair, dtype=np.float64))[kept] / size
        for pair in ((ours, truth), (theirs, truth), (ours, theirs))
    )
    assert mine.mean() < others.mean()
    assert mine.max() <= others.max()
    # Both are the same model: they differ by these errors, as if those were independent.
    assert difference.mean() <= np.hypot(mine.mean(), others.mean())
    assert difference.max() <= mine.max() + others.max()


ANISOTROPIC = ((0.3, 0.08), (0.6, 0.1), (0.5, 0.02))


@pytest.mark.parametrize("retro", [0.0, 1.0], ids=["forward", "retro"])
@pytest.mark.parametrize("alpha", ANISOTROPIC, ids=str)
def test_anisotropic_nodes_are_closer_to_the_evaluator(draw, alpha, retro, record_property):
    ours, theirs, truth, _, cosine = both(draw, "mrm_conductor_bsdf", retro, alpha)
    ours, theirs, truth = (each[cosine > CLEAR] for each in (ours, theirs, truth))
    table = {
        "ours vs evaluator": np.quantile(relative_error(ours, truth), [0.5, 0.99, 1.0]),
        "ours vs MaterialX": np.quantile(relative_error(ours, theirs), [0.5, 0.99, 1.0]),
        "evaluator vs MaterialX": np.quantile(relative_error(truth, theirs), [0.5, 0.99, 1.0]),
    }
    print(f"\nalpha {alpha}, {'retro' if retro else 'forward'}: relative error, median, 99 %, largest")
    for pair, (median, p99, largest) in table.items():
        print(f"  {pair:<24} {median:8.1e} {p99:8.1e} {largest:8.1e}")
        record_property(pair, [float(median), float(p99), float(largest)])
    assert table["ours vs evaluator"][2] < 5e-6 / min(alpha)
    assert table["ours vs MaterialX"][1] > 0.01
    assert table["ours vs MaterialX"] == pytest.approx(table["evaluator vs MaterialX"], rel=1e-2)


def test_a_light_below_the_horizon_gives_nothing_where_materialx_leaks(draw):
    inputs, _, _ = configurations("mrm_conductor_bsdf", 0.0, (0.5, 0.5))
    rng = np.random.default_rng(1)
    v = np.array([[math.sin(t), 0.0, math.cos(t)] for t in rng.uniform(0.2, 1.2, N)])
    light = np.array([[-math.sin(t), 0.0, math.cos(t)] for t in rng.uniform(1.6, 1.8, N)])
    placed = place(v, light, TO_LIGHT, np.array(EYE), rng)
    assert draw("mrm_conductor_bsdf", inputs, placed)["image"].max() == 0
    assert draw("conductor_bsdf", inputs, placed, retroreflective=False)["image"].max() > 0
