"""docs/model.md: its equations, as its blocks of Python have them, are what the evaluator computes."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.reference.albedo_fit import split_sum

PAGE = Path(__file__).parents[1] / "docs/model.md"
COUNT = 500
AX, AY = 0.4, 0.15


@pytest.fixture(scope="module")
def page():
    """What the page's blocks define, run one after another."""
    names = {}
    for block in re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), names)
    return SimpleNamespace(**names)


@pytest.fixture(scope="module")
def pairs():
    """Views and lights above the surface, half of the lights where a lobe of these widths sends them."""
    rng = np.random.default_rng(3)
    both = rng.normal(size=(2, COUNT, 3))
    both[..., 2] = abs(both[..., 2])
    v, l = both / np.linalg.norm(both, axis=-1, keepdims=True)  # noqa: E741
    drawn = ref.Conductor(0.2, 3.9, (AX, AY), retroreflectivity=0.5).sample(v, rng.random((COUNT, 3)))
    on_lobe = (drawn.pdf > 0.0) & (np.arange(COUNT) % 2 == 0)
    return v, np.where(on_lobe[:, None], drawn.l, l)


DISTRIBUTIONS = {"ggx": ref.GGX, "beckmann": ref.Beckmann, "phong": ref.Phong}
CONDUCTOR, DIELECTRIC = np.array([0.2 + 3.9j, 0.92 + 2.45j, 1.1 + 2.14j]), 1.5


def parts(page, name, masking, correlation="height"):
    """D, G2 and G1 of the page for a lobe of the evaluator."""

    def normals(m):
        return getattr(page, name)(m, AX, AY)

    if masking == "vcavity" or name == "phong":
        return (
            normals,
            page.vcavity,
            lambda v, m: np.minimum(1.0, 2.0 * m[..., 2] * v[..., 2] / page.dot(v, m)),
        )
    unseen = {"ggx": page.lambda_ggx, "beckmann": page.lambda_beckmann}[name]

    def both(v, l, m):  # noqa: E741
        return page.smith(v, l, lambda w: unseen(w, AX, AY), correlation)

    return normals, both, lambda v, m: 1.0 / (1.0 + unseen(v, AX, AY))


def agree(found, expected, rtol=1e-11):
    assert np.count_nonzero(expected) > np.size(expected) / 4
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=1e-15)


@pytest.mark.parametrize("masking", ["smith", "vcavity"])
@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
def test_the_blend_and_its_density(page, pairs, name, masking, weight):
    v, l = pairs  # noqa: E741
    lobe = ref.Conductor(
        CONDUCTOR.real, CONDUCTOR.imag, (AX, AY), retroreflectivity=weight, distribution=name, masking=masking
    )
    d, g2, g1 = parts(page, name, masking)
    found = page.blend(v, l, weight, d, g2, lambda c: page.fresnel(c[..., None], CONDUCTOR))
    agree(found, lobe.eval(v, l))
    agree(page.density(v, l, weight, d, g1), lobe.pdf(v, l))


@pytest.mark.parametrize("correlation", ["separable", "direction", "height_direction"])
def test_the_correlations(page, pairs, correlation):
    v, l = pairs  # noqa: E741
    d, g2, _ = parts(page, "beckmann", "smith", correlation)
    found = page.blend(v, l, 0.5, d, g2, lambda c: page.fresnel(c[..., None], DIELECTRIC))
    lobe = ref.Dielectric(
        1.5, (AX, AY), retroreflectivity=0.5, distribution="beckmann", correlation=correlation
    )
    agree(found, np.broadcast_to(lobe.eval(v, l)[..., :1], found.shape))


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_distributions(page, pairs, name):
    m = pairs[1]
    agree(getattr(page, name)(m, AX, AY), DISTRIBUTIONS[name](AX, AY).D(m))


def test_the_virtual_mirror_is_about_any_normal(page, pairs):
    v, n = pairs
    turned = page.mirror(v, n)
    np.testing.assert_allclose(page.dot(turned, n), page.dot(v, n), rtol=1e-12)
    np.testing.assert_allclose(turned + v, 2.0 * page.dot(v, n)[:, None] * n, atol=1e-15)
    np.testing.assert_array_equal(page.mirror(v), v * [-1.0, -1.0, 1.0])


def test_fresnels_reflectances(page):
    c = np.linspace(0.001, 1.0, 400)
    agree(page.fresnel(c, 1.5), ref.fresnel_dielectric(c, 1.5), 1e-12)
    agree(page.fresnel(c, 1.0 / 1.5), ref.fresnel_dielectric(c, 1.0 / 1.5), 1e-12)
    agree(page.fresnel(c, 0.2 + 3.9j), ref.fresnel_conductor(c, 0.2, 3.9), 1e-12)
    agree(page.schlick(c, 0.19, 0.0, 0.9, 4.0), ref.fresnel_schlick(c, 0.19, 0.0, 0.9, 4.0), 1e-12)


@pytest.mark.parametrize("thickness", [90.0, 350.0, 800.0])
@pytest.mark.parametrize(
    "substrate", [CONDUCTOR, np.full(3, DIELECTRIC + 0j)], ids=["conductor", "dielectric"]
)
def test_the_thin_film(page, thickness, substrate):
    """The evaluator's from a mirrored pair of directions, whose half vector is the normal, beside a white lobe's."""
    c = np.linspace(0.05, 1.0, 60)
    v = np.stack([np.sqrt(1.0 - c**2), np.zeros_like(c), c], axis=-1)
    film = {"thinfilm_thickness": thickness, "thinfilm_ior": 1.6}
    coated = ref.Conductor(substrate.real, substrate.imag, 0.3, **film).eval(v, page.mirror(v))
    white = ref.GeneralizedSchlick(1.0, alpha=0.3).eval(v, page.mirror(v))
    np.testing.assert_allclose(page.film(c, thickness, 1.6, substrate), coated / white, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("name", "masking"), [("ggx", "smith"), ("beckmann", "smith"), ("phong", "vcavity")])
def test_transmission(page, pairs, name, masking, turned):
    v = pairs[0]
    lobe = ref.Dielectric(
        1.5, (AX, AY), scatter_mode="T", retro_transmission=turned, retroreflectivity=float(turned),
        distribution=name, masking=masking,
    )  # fmt: skip
    drawn = lobe.sample(v, np.random.default_rng(4).random((COUNT, 3)))
    v, l = v[drawn.pdf > 0.0], drawn.l[drawn.pdf > 0.0]  # noqa: E741
    d, _, _ = parts(page, name, masking)
    unseen = {"ggx": page.lambda_ggx, "beckmann": page.lambda_beckmann}.get(name)

    def both(v, l, m):  # noqa: E741
        smith = masking == "smith"
        return page.smith_across(v, l, lambda w: unseen(w, AX, AY)) if smith else page.vcavity_across(v, l, m)

    view = page.mirror(v) if turned else v
    found = page.transmission(view, l, 1.5, d, both, lambda c: page.fresnel(c[..., None], 1.5))
    agree(found, lobe.eval(v, l)[..., :1], 1e-9)


def compensated(v, l, scheme, weight):  # noqa: E741
    """A rough conductor's eval with a scheme, and without, and its E."""
    bare, whole = (
        ref.Conductor(0.2, 3.9, 0.6, retroreflectivity=weight, energy_compensation=each).eval(v, l)[..., 0]
        for each in (None, scheme)
    )
    return whole, bare


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_the_factors_of_compensation(page, pairs, weight):
    v, l = pairs  # noqa: E741
    f0 = page.fresnel(1.0, 0.2 + 3.9j)
    fit = sum(split_sum(("ggx", "smith"), v[..., 2:], np.full(1, 0.6)))[..., 0]
    half = page.half_vector(page.mirror(v) if weight else v, l)
    for scheme, reflectance, energy in (
        ("turquin", f0, ref.white_albedo(v[..., 2], 0.6)),
        ("materialx-1.39.5", page.fresnel(page.dot(half, l), 0.2 + 3.9j), fit),
        ("materialx-1.39.6", f0 + (1.0 - f0) / 21.0, fit),
    ):
        whole, bare = compensated(v, l, scheme, weight)
        agree(whole, bare * page.factor(reflectance, energy), 1e-10)


def test_the_term_of_kulla_and_conty(page, pairs):
    v, l = pairs  # noqa: E741
    whole, bare = compensated(v, l, "kulla-conty", 0.5)
    x, weight = np.polynomial.legendre.leggauss(12)
    mean = (page.fresnel(np.sqrt(0.5 * (x + 1.0)), 0.2 + 3.9j) * 0.5 * weight).sum()
    energy = [ref.white_albedo(d[..., 2], 0.6) for d in (v, l)]
    found = page.kulla_conty(*energy, ref.average_albedo(0.6), mean)
    agree(found, whole - bare, 1e-9)


@pytest.mark.parametrize("scheme", ["materialx-1.39.5", "materialx-1.39.6"])
def test_layering(page, pairs, scheme):
    v, l = pairs  # noqa: E741
    top = ref.Dielectric(1.5, 0.3, retroreflectivity=0.4, energy_compensation=scheme)
    base = ref.Lambert(0.5)
    a, b = (each[..., 0] for each in split_sum(("ggx", "smith"), v[..., 2:], np.full(1, 0.3)))
    f0 = page.fresnel(1.0, 1.5)
    by_light = [page.fresnel(page.dot(page.half_vector(w, l), l), 1.5) for w in (v, page.mirror(v))]
    each = by_light if scheme.endswith("5") else [f0 + (1.0 - f0) / 21.0] * 2
    through = page.throughput(0.7, 0.4, *(page.factor(f, a + b) for f in each), f0 * a + b)
    closure = ref.Layer(ref.Leaf(top, 0.7), ref.Leaf(base))
    agree(through, ref.Leaf(top, 0.7).throughput(v, l)[..., 0])
    found = page.layer(0.7 * top.eval(v, l), through[:, None], base.eval(v, l))
    agree(found, closure.eval(v, l))
