"""The albedo tables of all lobes, and the energy compensations that read them."""

import math

import numpy as np
import pytest

from mrm_nodes import reference as ref
from mrm_nodes.reference.energy import TABLE_ERROR

TURN = np.array([-1.0, -1.0, 1.0])

#: Every pair of distribution and masking, and two other correlations.
PAIRS = [
    ("ggx", "smith", "height"),
    ("ggx", "smith", "height_direction"),
    ("beckmann", "smith", "height"),
    ("beckmann", "smith", "direction"),
    ("ggx", "vcavity", "height"),
    ("beckmann", "vcavity", "height"),
    ("phong", "vcavity", "height"),
]


def anywhere(rng, count):
    """Cosines down to grazing, half of them about the larger alpha, where E falls; azimuths; and pairs of alphas from
    1e-6 to 1, isotropic to 20 to 1.
    """
    alpha = np.exp(rng.uniform(math.log(1e-6), 0.0, count))
    about = np.minimum(alpha * np.exp(rng.uniform(-5.0, 3.0, count)), 1.0)
    cosine = np.where(np.arange(count) % 2, rng.random(count) ** 2, about)
    azimuth = rng.uniform(0.0, 2.0 * math.pi, count)
    other = np.where(np.arange(count) % 3, alpha * np.exp(rng.uniform(-math.log(20.0), 0.0, count)), alpha)
    pair = np.where(rng.random((count, 1)) < 0.5, np.stack([alpha, other], -1), np.stack([other, alpha], -1))
    return cosine, azimuth, pair


def correlated(rng, pair):
    """The same ellipses of slopes along other axes: alphas and correlation, at most 0.95."""
    angle = rng.uniform(0.0, math.pi, len(pair))
    c, s, (x, y) = np.cos(angle), np.sin(angle), pair.T
    one, other = np.hypot(c * x, s * y), np.hypot(s * x, c * y)
    skew = c * s * (x * x - y * y) / (one * other)
    narrow = np.abs(skew) > 0.95
    alpha = np.where(narrow[:, np.newaxis], pair, np.stack([one, other], axis=-1))
    return alpha, np.where(narrow, 0.0, skew)


def direction(cosine, azimuth):
    sine = np.sqrt(1.0 - cosine**2)
    return np.stack(np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine), axis=-1)


def mean_of_table(alpha, pair):
    """The cosine-weighted mean of `white_albedo` by another quadrature than the one it is made with."""
    x, w = np.polynomial.legendre.leggauss(96)
    root, azimuth = 0.5 * (x[:, np.newaxis, np.newaxis] + 1.0), 0.5 * np.pi * (np.arange(24) + 0.5) / 24
    cosine = root**3
    at = ref.white_albedo(cosine, alpha[:, 0], *pair, alpha_y=alpha[:, 1], azimuth=azimuth[:, np.newaxis])
    return np.einsum("ijk,i->k", at, (3.0 * cosine * root**2)[:, 0, 0] * w / 24)


def named(pair):
    return dict(zip(("distribution", "masking", "correlation"), pair, strict=True))


@pytest.mark.parametrize("pair", PAIRS)
def test_tables_keep_to_their_error_and_compensation_gives_back_all_energy(pair):
    """E by the table against quadrature off its grid; with it, white albedo is 1, by both schemes."""
    rng = np.random.default_rng(11)
    count = 160
    cosine, azimuth, alpha = anywhere(rng, count)
    v, straight = direction(cosine, azimuth), np.arange(count) < count // 2
    turned, skew = correlated(rng, alpha)
    skew = np.where(straight, 0.0, skew) if pair[0] != "phong" else np.zeros(count)
    turned = np.where(skew[:, np.newaxis] == 0.0, alpha, turned)
    white = {"color0": 1.0, "alpha": turned, "slope_correlation": skew, **named(pair)}
    exact = ref.GeneralizedSchlick(**white).albedo(v)[:, 0]
    for scheme in ("turquin", "kulla-conty"):
        total = ref.GeneralizedSchlick(**white, energy_compensation=scheme).albedo(v)
        assert np.abs(total - 1.0).max() <= TABLE_ERROR, scheme
    plain = skew == 0.0
    table = ref.white_albedo(cosine, turned[:, 0], *pair, alpha_y=turned[:, 1], azimuth=azimuth)
    assert np.abs(table - exact)[plain].max() <= TABLE_ERROR
    # `albedo` takes it that Kulla and Conty's term gives back all that the table says is lost.
    mean = ref.average_albedo(turned[:, 0], *pair, alpha_y=turned[:, 1])
    given = exact + (1.0 - table) * (1.0 - mean_of_table(turned, pair)) / (1.0 - mean)
    assert np.abs(given - 1.0)[plain].max() <= TABLE_ERROR


def test_an_isotropic_lobe_reads_what_its_anisotropic_neighbours_do():
    """No step in E, in its average or in a compensated lobe where both alphas become equal."""
    rng = np.random.default_rng(17)
    cosine, azimuth, pair = anywhere(rng, 400)
    alpha, next_to = pair[:, 0], pair[:, 0] * (1.0 - 1e-9)
    for one, other in (
        [ref.white_albedo(cosine, alpha, alpha_y=each, azimuth=azimuth) for each in (None, next_to)],
        [ref.average_albedo(alpha, alpha_y=each) for each in (None, next_to)],
    ):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("pair", [("ggx", "smith", "height"), ("phong", "vcavity", "height")])
def test_kulla_and_contys_term_integrates_to_what_is_lost(pair):
    """What the term adds, integrated over l, on top of the albedo without it."""
    x, w = np.polynomial.legendre.leggauss(48)
    cosine, azimuth = (0.5 * (x + 1.0)) ** 2, 2.0 * np.pi * np.arange(64) / 64
    l = direction(cosine[:, np.newaxis], azimuth)  # noqa: E741
    weight = (0.5 * (x + 1.0) * w * cosine * 2.0 * np.pi / 64)[:, np.newaxis, np.newaxis]
    v = direction(np.array([0.05, 0.3, 0.9]), np.array([0.0, 0.7, 1.5]))
    for alpha in ((0.9, 0.3), (0.05, 1.0), (0.2, 0.04)):
        white = {"color0": 1.0, "alpha": alpha, **named(pair)}
        bare = ref.GeneralizedSchlick(**white)
        full = ref.GeneralizedSchlick(**white, energy_compensation="kulla-conty")
        at = v[:, np.newaxis, np.newaxis]
        given = ((full.eval(at, l) - bare.eval(at, l)) * weight).sum(axis=(1, 2))
        assert np.abs(bare.albedo(v) + given - 1.0).max() <= TABLE_ERROR
        np.testing.assert_allclose(full.albedo(v), bare.albedo(v) + given, atol=TABLE_ERROR)


def test_kulla_and_conty_is_reciprocal_with_anisotropic_and_correlated_slopes():
    rng = np.random.default_rng(12)
    for distribution, masking, skew in (
        ("ggx", "smith", 0.6),
        ("beckmann", "vcavity", 0.0),
        ("phong", "vcavity", 0.0),
    ):
        for retro in (0.0, 0.4, 1.0):
            v, l = (direction(*anywhere(rng, 2000)[:2]) for _ in range(2))  # noqa: E741
            lobe = ref.Conductor(
                0.2, 3.9, (0.9, 0.1), retro, distribution, masking,
                energy_compensation="kulla-conty", slope_correlation=skew,
            )  # fmt: skip
            np.testing.assert_allclose(lobe.eval(v, l), lobe.eval(l, v), rtol=1e-12)


def test_forward_and_retro_lobes_read_the_same_anisotropic_table():
    rng = np.random.default_rng(13)
    v, l = (direction(*anywhere(rng, 500)[:2]) for _ in range(2))  # noqa: E741
    for scheme in ("turquin", "kulla-conty"):
        forward, retro = (
            ref.Conductor(0.2, 3.9, (0.8, 0.2), r, energy_compensation=scheme, slope_correlation=0.3)
            for r in (0.0, 1.0)
        )
        assert forward._table is retro._table
        np.testing.assert_allclose(retro.eval(v, l), forward.eval(v * TURN, l), rtol=1e-12)
        np.testing.assert_allclose(retro.albedo(v[:20]), forward.albedo(v[:20]), rtol=1e-12)


def test_swapping_the_axes_of_a_lobe_mirrors_its_table():
    rng = np.random.default_rng(14)
    cosine, azimuth, alpha = anywhere(rng, 500)
    one = ref.white_albedo(cosine, alpha[:, 0], alpha_y=alpha[:, 1], azimuth=azimuth)
    other = ref.white_albedo(cosine, alpha[:, 1], alpha_y=alpha[:, 0], azimuth=0.5 * math.pi - azimuth)
    np.testing.assert_allclose(one, other, rtol=1e-12)
    means = [ref.average_albedo(alpha[:, k], alpha_y=alpha[:, 1 - k]) for k in (0, 1)]
    np.testing.assert_allclose(means[0], means[1], rtol=1e-12)


def test_an_isotropic_pixel_of_an_anisotropic_image_is_the_isotropic_lobe():
    rng = np.random.default_rng(15)
    v, l = (direction(*anywhere(rng, 200)[:2]) for _ in range(2))  # noqa: E741
    alpha = np.where(np.arange(200)[:, np.newaxis] % 2, 0.4, np.array([0.4, 0.1]))
    for scheme in ("turquin", "kulla-conty"):
        image = ref.Conductor(0.2, 3.9, alpha, energy_compensation=scheme).eval(v, l)
        plain = ref.Conductor(0.2, 3.9, 0.4, energy_compensation=scheme).eval(v, l)
        assert np.array_equal(image[1::2], plain[1::2])


def test_materialx_compensates_by_the_mean_alpha():
    rng = np.random.default_rng(16)
    v, l = (direction(*anywhere(rng, 200)[:2]) for _ in range(2))  # noqa: E741

    def factor(alpha):
        with_it, without = (
            ref.Conductor(0.2, 3.9, alpha, energy_compensation=c).eval(v, l)
            for c in ("materialx-1.39.6", None)
        )
        return with_it / without

    np.testing.assert_allclose(factor((0.8, 0.2)), factor(0.4), rtol=1e-12)


def test_tables_refuse_slopes_that_are_not_centred():
    for scheme in ("turquin", "kulla-conty"):
        with pytest.raises(ValueError, match=f"mean_slope must be 0 with energy_compensation '{scheme}'"):
            ref.Conductor(0.2, 3.9, 0.4, energy_compensation=scheme, mean_slope=(0.1, 0.0))
    with pytest.raises(ValueError, match="alpha_y must be finite, above 0, not -1"):
        ref.white_albedo(0.5, 0.4, alpha_y=-1.0)
    with pytest.raises(ValueError, match="azimuth must be finite"):
        ref.white_albedo(0.5, 0.4, alpha_y=0.2, azimuth=math.inf)
