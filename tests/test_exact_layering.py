"""Layers by the exact rule: what a top leaves to its base is what it does not scatter, summed up apart from ours."""

import math

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.photometry.retroreflector import ClearTop, Retroreflector

COSINES = np.array([0.15, 0.5, 0.85, 1.0])
SINES = np.sqrt(1.0 - COSINES**2)
#: Towards four heights, at an azimuth that no axis has.
V = np.stack([SINES * math.cos(0.4), SINES * math.sin(0.4), COSINES], axis=-1)
FILM = {"thinfilm_thickness": 400.0, "thinfilm_ior": 1.35}
#: Wide enough for a plain sum over directions.
WIDE = (0.7, 0.4)

CLEAR = {
    "dielectric": ref.Dielectric(1.5, WIDE),
    "dielectric, film, retro": ref.Dielectric(1.7, WIDE, retroreflectivity=0.6, **FILM),
    "dielectric, tint, compensation": ref.Dielectric(
        1.5, 0.5, tint=(1.0, 0.5, 0.2), energy_compensation="materialx-1.39.5"
    ),
    "dielectric, beckmann": ref.Dielectric(1.5, WIDE, distribution="beckmann", retroreflectivity=1.0),
    "schlick, F82": ref.GeneralizedSchlick((0.19, 0.13, 0.003), 0.0, (1.0, 0.66, 0.016), alpha=WIDE),
    "schlick, film, phong": ref.GeneralizedSchlick(
        (0.3, 0.2, 0.1), (0.2, 0.9, 1.0), exponent=3.0, alpha=0.5, distribution="phong", **FILM
    ),
    "schlick, vcavity, retro": ref.GeneralizedSchlick(
        (0.9, 0.5, 0.1), 0.3, alpha=WIDE, masking="vcavity", retroreflectivity=0.3
    ),
}
METAL = ref.Conductor((0.2, 0.92, 1.1), (3.9, 2.45, 2.14), WIDE, retroreflectivity=0.5, **FILM)
WHITE = ref.Leaf(ref.Lambert(1.0))


def integral(f, side=1.0, cosines=96, azimuths=96):
    """∫ f cos dl over the hemisphere of one side: a plain sum over its directions, apart from the evaluator's."""
    x, w = np.polynomial.legendre.leggauss(cosines)
    cos = 0.5 * (x + 1.0)
    phi = 2.0 * np.pi * (np.arange(azimuths) + 0.5) / azimuths
    ring = [np.outer(np.sqrt(1.0 - cos**2), each(phi)) for each in (np.cos, np.sin)]
    l = np.stack([*ring, np.broadcast_to(side * cos[:, None], ring[0].shape)], axis=-1)  # noqa: E741
    weight = (np.pi / azimuths * w * cos)[:, None, None]
    return np.stack([(f(v, l) * weight).sum(axis=(0, 1)) for v in V])


@pytest.mark.parametrize("name", CLEAR)
def test_a_lobe_leaves_what_it_does_not_reflect(name):
    lobe = CLEAR[name]
    reflected = integral(lobe.eval)
    np.testing.assert_allclose(ref.Leaf(lobe).exact_throughput(V), 1.0 - reflected, atol=1e-3)
    for weight in (0.0, 0.3, 1.5):
        expected = np.maximum(1.0 - weight * reflected, 0.0)
        np.testing.assert_allclose(ref.Leaf(lobe, weight).exact_throughput(V), expected, atol=1.5e-3)


def test_what_is_opaque_leaves_nothing():
    for lobe in (METAL, ref.Lambert(0.5), ref.OrenNayar(0.5, 0.3)):
        for weight in (0.0, 0.4, 1.0):
            assert not ref.Leaf(lobe, weight).exact_throughput(V).any()
            assert not ref.Multiply(ref.Leaf(lobe), weight).exact_throughput(V).any()


@pytest.mark.parametrize("mode", ["T", "RT"])
def test_what_is_transmitted_is_not_left_to_a_base_as_well(mode):
    """Light that an interface shows from behind it would be there twice."""
    lobe = ref.Leaf(ref.Dielectric(1.5, 0.4, scatter_mode=mode, tint=(1.0, 0.9, 0.8)))
    above, below = integral(lobe.eval), integral(lobe.eval, side=-1.0) * 1.5**2
    np.testing.assert_allclose(lobe.exact_throughput(V), 1.0 - above - below, atol=2e-3)
    assert (lobe.throughput(V) > lobe.exact_throughput(V) + 0.4)[:, 0].all()


def test_closures_have_the_albedo_of_what_they_are_made_of():
    """Albedo is linear: each against the integral of its own response."""
    one, other = (ref.Leaf(CLEAR[name]) for name in ("dielectric, film, retro", "schlick, F82"))
    factor = np.array([0.9, 0.5, 0.1])
    layered = ref.Layer(one, other, "exact")
    for closure in (
        ref.Mix(one, other, 0.3),
        ref.Add(one, ref.Leaf(other.lobe, 0.6)),
        ref.Multiply(other, factor),
        ref.Multiply(ref.Multiply(ref.Add(one, other), factor), 0.5),
        ref.Multiply(ref.Mix(one, layered, 0.3), factor),
        ref.Multiply(layered, factor),
        ref.Layer(ref.Multiply(other, factor), layered, "exact"),
    ):
        np.testing.assert_allclose(closure.exact_throughput(V), 1.0 - integral(closure.eval), atol=2e-3)
    # What is opaque takes its share of the surface with it, dimmed or not.
    half = ref.Mix(ref.Leaf(METAL), other, 0.25)
    clear = 1.0 - integral(other.eval)
    np.testing.assert_allclose(half.exact_throughput(V), 0.75 * clear, atol=1e-3)
    dimmed = 0.75 * (1.0 - factor * (1.0 - clear))
    np.testing.assert_allclose(ref.Multiply(half, factor).exact_throughput(V), dimmed, atol=1e-3)
    dimmed_layer = ref.Multiply(ref.Layer(half, ref.Add(one, half)), factor).exact_throughput(V)
    assert (dimmed_layer < 0.75 * 0.75).all() and (
        dimmed_layer > ref.Layer(half, half).exact_throughput(V) - 1
    ).all()
    assert not ref.Add(ref.Leaf(METAL), other).exact_throughput(V).any()


@pytest.mark.parametrize("name", CLEAR)
def test_a_coat_on_white_reflects_all_light(name):
    """The white furnace: what comes back is all there is, of any coat that itself makes no light."""
    coat = ref.Leaf(CLEAR[name])
    np.testing.assert_allclose(integral(ref.Layer(coat, WHITE, "exact").eval), 1.0, atol=1e-3)
    twice = ref.Layer(coat, ref.Layer(ref.Leaf(CLEAR["dielectric"], 0.8), WHITE, "exact"), "exact")
    np.testing.assert_allclose(integral(twice.eval), 1.0, atol=1.5e-3)


def test_a_white_coat_hides_its_base_up_to_what_it_loses():
    white = ref.Leaf(ref.GeneralizedSchlick(1.0, alpha=WIDE))
    assert (white.exact_throughput(V) < 0.4).all()
    np.testing.assert_allclose(integral(ref.Layer(white, WHITE, "exact").eval), 1.0, atol=1e-3)
    bright = ref.Leaf(ref.GeneralizedSchlick(1.0, alpha=0.5, energy_compensation="materialx-1.39.5"), 1.2)
    assert not bright.exact_throughput(V).any()
    dark = ref.Layer(ref.Leaf(CLEAR["schlick, F82"]), ref.Leaf(METAL), "exact")
    assert (integral(dark.eval) < 1.0).all()


def test_materialxs_rule_misses_the_tint_at_82_degrees():
    """The coat of the paper's yellow tape: the fit knows F0 and F90 only."""
    tape = ref.Leaf(ref.GeneralizedSchlick(0.19, 0.0, 1.0, alpha=0.0529, retroreflectivity=1.0))
    cosine = np.linspace(0.02, 1.0, 50)
    v = np.stack([np.sqrt(1.0 - cosine**2), 0.0 * cosine, cosine], axis=-1)
    apart = np.abs(tape.exact_throughput(v) - tape.throughput(v))
    assert 0.4 < apart.max() < 0.6
    layered = ref.Layer(tape, ref.Leaf(ref.Lambert(0.5)))
    exact = ref.Layer(layered.top, layered.base, "exact")
    l = v[::-1]  # noqa: E741
    base = layered.base.eval(v, l)
    np.testing.assert_allclose(
        exact.eval(v, l) - layered.eval(v, l),
        base * (tape.exact_throughput(v) - tape.throughput(v, l)),
        atol=1e-14,
    )


def test_shapes_and_errors():
    lobe = ref.Dielectric(np.array([1.4, 1.5, 1.6])[:, None], 0.3)
    assert ref.Leaf(lobe).exact_throughput(V).shape == (3, 4, 3)
    assert ref.Leaf(lobe, np.array([[0.5], [1.0], [0.0]])).exact_throughput(V).shape == (3, 4, 3)
    metal = ref.Leaf(ref.Conductor(np.full((3, 1, 3), 0.2), 3.9, 0.3))
    assert metal.exact_throughput(V).shape == metal.throughput(V).shape == (3, 4, 3)
    assert Retroreflector(0.1, 0.5, top=ClearTop(0.1, 0.04), film=0.5).exact_throughput(V).shape == (4, 3)
    with pytest.raises(ValueError, match="layering must be one of 'materialx', 'exact', not 'precise'"):
        ref.Layer(WHITE, WHITE, "precise")
    with pytest.raises(ValueError, match="weight must be finite, at least 0, not -1"):
        ref.Leaf(lobe).exact_throughput(V, -1.0)
    with pytest.raises(ValueError, match="v must be of unit length"):
        ref.Leaf(METAL).exact_throughput(2.0 * V)
    with pytest.raises(ValueError, match="v must be of unit length"):
        ref.Leaf(lobe).exact_throughput(2.0 * V, 0.0)
