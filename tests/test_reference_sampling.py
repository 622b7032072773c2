"""Samples against their density, for every lobe: a chi-square test on a grid over the sphere."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from mrm_nodes import reference as ref
from mrm_nodes.reference import kernels


class ChiSquare:
    """Pearson's test of `sample` against `pdf` for one view direction.

    The sphere is cut into cells even in cos θ and φ; a cell's expected count is the density's integral over
    it, by Gauss-Legendre quadrature, and one more cell holds the samples that were rejected. Cells with few
    expected counts are pooled. A failure says which cells were off."""

    COSINES, AZIMUTHS, ORDER = 24, 32, 8

    def __init__(self, bsdf, v, count=60_000, seed=1):
        self.bsdf, self.v, self.count = bsdf, np.asarray(v), count
        u = np.random.default_rng(seed).random((count, 3))
        self.sample = bsdf.sample(self.v, u)

    def observed(self):
        kept = self.sample.pdf > 0.0
        l = self.sample.l[kept]  # noqa: E741
        phi = np.arctan2(l[:, 1], l[:, 0])
        grid, *_ = np.histogram2d(
            l[:, 2], phi, bins=(self.COSINES, self.AZIMUTHS), range=((-1.0, 1.0), (-math.pi, math.pi))
        )
        return np.append(grid.ravel(), self.count - kept.sum())

    def expected(self):
        x, w = np.polynomial.legendre.leggauss(self.ORDER)
        x, w = 0.5 * (x + 1.0), 0.5 * w
        z = -1.0 + 2.0 * (np.arange(self.COSINES)[:, None] + x) / self.COSINES
        phi = -math.pi + 2.0 * math.pi * (np.arange(self.AZIMUTHS)[:, None] + x) / self.AZIMUTHS
        z, phi = z[:, None, :, None], phi[None, :, None, :]
        sin = np.sqrt(1.0 - z**2)
        l = np.stack(np.broadcast_arrays(sin * np.cos(phi), sin * np.sin(phi), z), axis=-1)  # noqa: E741
        density = np.einsum("abij,i,j->ab", self.bsdf.pdf(self.v, l), w, w)
        mass = density * 4.0 * math.pi / (self.COSINES * self.AZIMUTHS)
        return np.append(mass.ravel(), 1.0 - mass.sum()) * self.count

    def check(self, tests):
        """Fails at 1 % after Šidák's correction for the number of tests."""
        observed, expected = self.observed(), self.expected()
        expected = np.maximum(expected, 0.0)
        small = expected < 8.0
        expected = np.append(expected[~small], expected[small].sum())
        observed = np.append(observed[~small], observed[small].sum())
        if expected[-1] < 1.0:
            assert observed[-1] <= 6, "samples where the density is 0"
            expected, observed = expected[:-1], observed[:-1]
        residual = (observed - expected) / np.sqrt(expected)
        p = stats.chi2.sf((residual**2).sum(), len(expected) - 1)
        limit = 1.0 - (1.0 - 0.01) ** (1.0 / tests)
        worst = np.argsort(-np.abs(residual))[:5]
        assert p > limit, (
            f"p = {p:.2e} <= {limit:.2e}; residuals in standard deviations {residual[worst].round(1)}"
            f" where {expected[worst].round(1)} were expected"
        )


OUTSIDE, GRAZING = (0.48, 0.36, 0.8), (0.96, 0.0, 0.28)
INSIDE = (0.48, -0.36, -0.8)
SCHLICK = {"color0": (0.9, 0.4, 0.1), "alpha": (0.5, 0.25)}


def lobes():
    def case(name, bsdf, v):
        return pytest.param(bsdf, v, id=name)

    for distribution, masking in (
        ("ggx", "smith"),
        ("beckmann", "smith"),
        ("ggx", "vcavity"),
        ("beckmann", "vcavity"),
        ("phong", "vcavity"),
    ):
        common = {"distribution": distribution, "masking": masking}
        for share in (0.0, 0.35, 1.0):
            name = f"{distribution}-{masking}-retro {share}"
            retro = common | {"retroreflectivity": share}
            yield case(name, ref.Conductor(0.2, 3.9, (0.5, 0.25), **retro), OUTSIDE)
            glass = ref.Dielectric(1.5, (0.4, 0.3), scatter_mode="RT", **retro)
            yield case(f"{name}-glass", glass, OUTSIDE)
            yield case(f"{name}-glass from inside", glass, INSIDE)
            tape = ref.GeneralizedSchlick(**SCHLICK, exponent=4.0, scatter_mode="RT", **retro)
            yield case(f"{name}-schlick", tape, OUTSIDE)
            yield case(f"{name}-schlick from inside", tape, INSIDE)
        both = common | {"retroreflectivity": 0.4, "retro_transmission": True}
        yield case(
            f"{distribution}-{masking}-both turned",
            ref.Dielectric(1.5, 0.4, scatter_mode="RT", **both),
            OUTSIDE,
        )
        yield case(f"{distribution}-{masking}-grazing", ref.GeneralizedSchlick(**SCHLICK, **common), GRAZING)
    for distribution in ("ggx", "beckmann"):
        skew = {"distribution": distribution, "slope_correlation": 0.6}
        yield case(
            f"{distribution}-correlated",
            ref.GeneralizedSchlick(**SCHLICK, **skew, retroreflectivity=0.5),
            OUTSIDE,
        )
        skew["mean_slope"] = (0.2, -0.1)
        yield case(f"{distribution}-shifted", ref.GeneralizedSchlick(**SCHLICK, **skew), OUTSIDE)
        yield case(
            f"{distribution}-shifted-through", ref.Dielectric(1.5, 0.4, scatter_mode="T", **skew), INSIDE
        )
    yield case("air in glass", ref.Dielectric(0.67, 0.4, scatter_mode="RT", retroreflectivity=0.3), OUTSIDE)
    for correlation in ("separable", "direction", "height_direction"):
        common = {"correlation": correlation, "scatter_mode": "RT", "retroreflectivity": 0.4}
        for v in (OUTSIDE, INSIDE):
            yield case(f"{correlation}-{v[2]}", ref.Dielectric(1.5, (0.5, 0.3), **common), v)
    for masking in ("implicit", "schlick-smith", "kelemen"):
        yield case(masking, ref.Conductor(0.2, 3.9, (0.5, 0.3), masking=masking), OUTSIDE)
    yield case("film", ref.Dielectric(1.5, 0.4, scatter_mode="RT", thinfilm_thickness=400.0), OUTSIDE)
    rough = {"alpha": (0.9, 0.2), "slope_correlation": 0.3, "energy_compensation": "kulla-conty"}
    yield case("kulla-conty, anisotropic", ref.Conductor(0.2, 3.9, retroreflectivity=0.4, **rough), OUTSIDE)
    yield case(
        "kulla-conty",
        ref.Conductor(0.2, 3.9, 0.8, retroreflectivity=0.4, energy_compensation="kulla-conty"),
        OUTSIDE,
    )


LOBES = list(lobes())


@pytest.mark.parametrize(("bsdf", "v"), LOBES)
def test_samples_follow_the_density_and_average_to_the_albedo(bsdf, v):
    test = ChiSquare(bsdf, v)
    test.check(len(LOBES))
    sample = test.sample
    eta = float(np.ravel(bsdf._parameters.a)[0]) if isinstance(bsdf, ref.Dielectric) else 1.0
    if isinstance(bsdf, ref.GeneralizedSchlick):
        f0 = math.sqrt(sum(SCHLICK["color0"]) / 3.0)
        eta = (1.0 + f0) / (1.0 - f0)
    # A radiance weight times eta_l² / eta_v² is a share of energy.
    through = sample.l[:, 2] * v[2] < 0.0
    factor = np.where(through, eta**2 if v[2] > 0.0 else eta**-2, 1.0)
    energy = sample.weight * factor[:, None]
    error = energy.std(axis=0) / math.sqrt(len(energy))
    assert (np.abs(energy.mean(axis=0) - bsdf.albedo(v)) <= 4.5 * error + 3e-4).all()


@pytest.mark.parametrize("correlation", ["height", "separable", "direction", "height_direction"])
@pytest.mark.parametrize(
    ("distribution", "masking"),
    [
        ("ggx", "smith"),
        ("beckmann", "smith"),
        ("ggx", "vcavity"),
        ("beckmann", "vcavity"),
        ("phong", "vcavity"),
    ],
)
def test_no_sample_weighs_more_than_1(distribution, masking, correlation):
    """F G2 / G1 over the chance of the choice, in energy: with the chi-square tests no energy can be made."""
    rng = np.random.default_rng(3)
    z = rng.uniform(-1.0, 1.0, 4000)
    phi, alpha = rng.uniform(0.0, 2.0 * math.pi, 4000), np.exp(rng.uniform(math.log(1e-3), 0.0, (4000, 2)))
    v = np.stack([np.sqrt(1.0 - z**2) * np.cos(phi), np.sqrt(1.0 - z**2) * np.sin(phi), z], axis=-1)
    common = {"distribution": distribution, "masking": masking, "correlation": correlation}
    white = ref.GeneralizedSchlick(1.0, alpha=alpha, retroreflectivity=0.5, **common)
    assert white.sample(v, rng.random((4000, 3))).weight.max() <= 1.0 + 1e-9
    glass = ref.Dielectric(1.5, alpha, scatter_mode="RT", retroreflectivity=0.5, **common)
    drawn = glass.sample(v, rng.random((4000, 3)))
    energy = (
        np.where(drawn.l[:, 2] * z < 0.0, np.where(z > 0.0, 1.5**2, 1.5**-2), 1.0)[:, None] * drawn.weight
    )
    assert energy.max() <= 1.0 + 1e-9
    # Of a coloured interface one reflectance, the mean, decides for all three.
    tape = ref.GeneralizedSchlick(
        (1.0, 0.1, 0.0), 1.0, (1.0, 0.5, 0.0), alpha=alpha, scatter_mode="RT", retroreflectivity=0.5, **common
    )
    drawn = tape.sample(v, rng.random((4000, 3)))
    root = math.sqrt(1.1 / 3.0)
    index = (1.0 + root) / (1.0 - root)
    across = np.where(z > 0.0, index**2, index**-2)
    energy = np.where(drawn.l[:, 2] * z < 0.0, across, 1.0)[:, None] * drawn.weight
    assert energy.mean(axis=-1).max() <= 1.0 + 1e-9
    assert 2.0 < energy.max() <= 3.0 + 1e-9


class VisibleNormals:
    """A distribution's visible normals as something that the instrument can ask."""

    def __init__(self, distribution, masking):
        self.distribution, self.masking = distribution, masking

    def sample(self, v, u):
        m = self.distribution.sample_visible(v, u, self.masking)
        return ref.BsdfSample(m, np.ones_like(m), np.ones(len(m)), np.zeros(len(m), bool))

    def pdf(self, v, m):
        return self.distribution.pdf_visible(v, m, self.masking)


NORMALS = [
    (distribution, masking, shape, v)
    for distribution in (ref.GGX, ref.Beckmann, ref.Phong)
    for masking in ("smith", "vcavity")
    for shape in ((0.5, 0.5), (0.6, 0.3))
    for v in (OUTSIDE, GRAZING)
]


@pytest.mark.parametrize(("distribution", "masking", "shape", "v"), NORMALS)
def test_visible_normals_follow_their_density(distribution, masking, shape, v):
    ChiSquare(VisibleNormals(distribution(*shape), masking), v, count=20_000).check(len(NORMALS))


def test_the_instrument_sees_visible_normals_of_another_view():
    test = ChiSquare(VisibleNormals(ref.Phong(0.5, 0.3), "smith"), OUTSIDE, count=20_000)
    test.v = np.array([-0.48, 0.36, 0.8])
    with pytest.raises(AssertionError, match="p = "):
        test.check(len(NORMALS))


def test_the_instrument_sees_a_wrong_density():
    """A density of another roughness, and one of the forward lobe alone, are refused."""
    right = ref.Conductor(0.2, 3.9, 0.4, retroreflectivity=0.3)
    for wrong in (
        ref.Conductor(0.2, 3.9, 0.42, retroreflectivity=0.3),
        ref.Conductor(0.2, 3.9, 0.4, retroreflectivity=0.34),
    ):
        test = ChiSquare(right, OUTSIDE)
        test.bsdf = wrong
        with pytest.raises(AssertionError, match="p = "):
            test.check(len(LOBES))


def test_the_refractive_jacobian_is_the_one_for_l():
    """001 eq. 5 prints ηv²; differentiating h_t with respect to l numerically gives ηl² (article 002)."""
    eta = 1.5
    v = np.array([0.48, 0.36, 0.8])
    l = np.array([-0.2, -0.35, -math.sqrt(1.0 - 0.04 - 0.1225)])  # noqa: E741

    def half(direction):
        h = -(v + eta * direction)
        return h / np.linalg.norm(h)

    across = np.cross(l, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(l, across)
    step = 1e-5
    moves = []
    for axis in (across, other):
        ends = [(l + s * axis) / np.linalg.norm(l + s * axis) for s in (step, -step)]
        moves.append((half(ends[0]) - half(ends[1])) / (2.0 * step))
    numerical = np.linalg.norm(np.cross(*moves))
    h = half(l)
    printed = abs(l @ h) / (v @ h + eta * (l @ h)) ** 2
    assert numerical == pytest.approx(eta**2 * printed, rel=1e-6)
    # And the density that sampling has is the visible normals' times that.
    d = ref.GGX(0.4)
    m = h if h[2] > 0.0 else -h
    density = d.pdf_visible(v, m) * numerical
    assert ref.Dielectric(eta, 0.4, scatter_mode="T").pdf(v, l) == pytest.approx(density, rel=1e-6)


@pytest.mark.parametrize("u", list(itertools.product((0.0, 1.0), repeat=3)))
@pytest.mark.parametrize(
    ("distribution", "masking"), [("ggx", "smith"), ("beckmann", "smith"), ("ggx", "vcavity")]
)
def test_uniforms_at_their_ends_draw_directions_of_unit_length(distribution, masking, u):
    lobe = ref.Conductor(0.2, 3.9, 1.0, distribution=distribution, masking=masking)
    drawn = lobe.sample((0.0, 0.0, 1.0), u)
    assert np.linalg.norm(drawn.l) == pytest.approx(1.0, abs=1e-9)


def test_a_density_that_has_lost_its_digits_is_rejected():
    """One over a number below float64's normal ones is infinite, and so would be a sample's weight."""
    assert kernels.sound(1e-309) == 0.0
    assert kernels.sound(3e-308) == 3e-308


@pytest.mark.parametrize("masking", ["smith", "vcavity"])
def test_uniforms_that_do_not_vary_are_the_same_in_every_block(masking):
    """What is drawn must not take their place for the views that come after."""
    rng = np.random.default_rng(2)
    v = rng.normal(size=(300, 3))
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    u = np.array([0.3, 0.6, 0.2])
    lobe = ref.Dielectric(1.5, 0.3, 0.5, masking=masking, scatter_mode="RT", retro_transmission=True)
    for one, each in zip(lobe.sample(v, u), lobe.sample(v, np.tile(u, (300, 1))), strict=True):
        assert np.array_equal(one, each)
    up = np.abs(v)
    normals = ref.GGX(0.4, 0.2).sample_visible(up, u, masking)
    assert np.array_equal(normals, ref.GGX(0.4, 0.2).sample_visible(up, np.tile(u, (300, 1)), masking))
