"""The papers' equations once more, in plain NumPy and as printed: the compiled lobes are what they say.

Numbers are Heitz's 2014; 001 is "The Minimal Retroreflective Microfacet Model", 003 is Mally's course. Nothing here is
taken from the evaluator. Fresnel's equations are the amplitudes of complex numbers, slopes are matrices.
"""

import functools
import math

import mpmath
import numpy as np
import pytest
from scipy import special

from mrm_nodes import reference as ref
from mrm_nodes.reference import energy_formulas as energy


class Slopes:
    """A distribution of slopes: standard, stretched by the quadric of eq. 88, and offset (eq. 94)."""

    def __init__(self, name, ax, ay, correlation=0.0, mean=(0.0, 0.0)):
        self.name, self.ax, self.ay, self.mean = name, ax, ay, np.asarray(mean)
        self.inverse = np.array([[ax * ax, correlation * ax * ay], [correlation * ax * ay, ay * ay]])

    def normals(self, m):
        """D(m): eqs. 64, 81 and 84; Blinn's from 003, anisotropic as Ashikhmin and Shirley's."""
        if self.name == "phong":
            ex, ey = 2.0 / self.ax**2 - 2.0, 2.0 / self.ay**2 - 2.0
            phi = np.arctan2(m[:, 1], m[:, 0])
            power = ex * np.cos(phi) ** 2 + ey * np.sin(phi) ** 2
            return math.sqrt((ex + 2.0) * (ey + 2.0)) / (2.0 * math.pi) * m[:, 2] ** power
        offset = -m[:, :2] / m[:, 2:] - self.mean
        norm = np.einsum("ni,ij,nj->n", offset, np.linalg.inv(self.inverse), offset)
        area = math.pi * math.sqrt(np.linalg.det(self.inverse))
        slopes = 1.0 / (area * (1.0 + norm) ** 2) if self.name == "ggx" else np.exp(-norm) / area
        return slopes / m[:, 2] ** 4

    def ratio(self, w):
        """a of eqs. 79 and 96 for directions above the surface."""
        along = w[:, :2] / np.linalg.norm(w[:, :2], axis=-1, keepdims=True)
        cot = w[:, 2] / np.linalg.norm(w[:, :2], axis=-1)
        return (cot - along @ self.mean) / np.sqrt(np.einsum("ni,ij,nj->n", along, self.inverse, along))

    def hidden(self, w):
        """Λ: eqs. 83 and 86, and Walter's fit."""
        a = self.ratio(w)
        if self.name == "ggx":
            value = (-1.0 + np.sqrt(1.0 + 1.0 / a**2)) / 2.0
        elif self.name == "beckmann":
            value = (special.erf(a) - 1.0) / 2.0 + np.exp(-a * a) / (2.0 * a * math.sqrt(math.pi))
        else:
            value = (1.0 - 1.259 * a + 0.396 * a**2) / (3.535 * a + 2.181 * a**2)
            value = np.where(a < 1.6, value, 0.0)
        return np.where(a > 0.0, value, np.inf)

    def meso_cosine(self, w):
        """The mesosurface's projected area (Section 5.5): its normal is (-mean, 1), normalised."""
        normal = np.array([-self.mean[0], -self.mean[1], 1.0])
        normal /= np.linalg.norm(normal)
        return w @ normal / normal[2]

    def seen(self, masking, w, m):
        """G1(w, m) for w above the surface: eqs. 43, 49, 56 and 59, and Schlick's of 1994."""
        facing = (w * m).sum(axis=-1)
        cosine = w[:, 2]
        if masking == "smith":
            value = 1.0 / (1.0 + self.hidden(w))
        elif masking == "vcavity":
            value = np.minimum(1.0, 2.0 * m[:, 2] * cosine / facing)
        elif masking == "implicit":
            value = cosine
        elif masking == "kelemen":
            value = cosine / facing
        else:
            rms = np.sqrt(self.ax**2 * w[:, 0] ** 2 + self.ay**2 * w[:, 1] ** 2)
            rms = rms / np.linalg.norm(w[:, :2], axis=-1) / math.sqrt(2.0)
            k = math.sqrt(2.0 / math.pi) * rms
            value = cosine / (cosine * (1.0 - k) + k)
        return np.where(facing > 0.0, value, 0.0)

    def seen_from_both(self, masking, correlation, v, l, m):  # noqa: E741
        """G2: eqs. 98 to 101 and 55, min(1, M, S) of 003; across, what the papers leave open."""
        across = l[:, 2] < 0.0
        side = np.where(across, -1.0, 1.0)[:, None]
        one, other = self.seen(masking, v, m), self.seen(masking, side * l, m)
        if masking == "vcavity":
            return np.where(across, np.maximum(0.0, one + other - 1.0), np.minimum(one, other))
        if masking != "smith" or correlation == "separable":
            return one * other
        both = (one > 0.0) & (other > 0.0)
        lv, ll = np.where(both, self.hidden(v), 1.0), np.where(both, self.hidden(side * l), 1.0)
        beta = special.beta(1.0 + lv, 1.0 + ll)
        phi = np.abs(np.arctan2(v[:, 1], v[:, 0]) - np.arctan2(l[:, 1], l[:, 0]))
        phi = np.minimum(phi, 2.0 * math.pi - phi)
        apart = 4.41 * phi / (4.41 * phi + 1.0)
        if correlation == "height":
            value, through = 1.0 / (1.0 + lv + ll), beta
        elif correlation == "direction":
            value, through = apart * one * other + (1.0 - apart) * np.minimum(one, other), one * other
        else:
            value, through = 1.0 / (1.0 + np.maximum(lv, ll) + apart * np.minimum(lv, ll)), beta
        return np.where(both, np.where(across, through, value), 0.0)


def fresnel(cosine, index):
    """The mean of |r|² over both polarisations for a complex index, far over near (003, "Fresnel's Law")."""
    refracted = np.sqrt(index**2 - 1.0 + cosine**2 + 0j)
    perpendicular = (cosine - refracted) / (cosine + refracted)
    parallel = (index**2 * cosine - refracted) / (index**2 * cosine + refracted)
    return 0.5 * (np.abs(perpendicular) ** 2 + np.abs(parallel) ** 2)


def schlick(cosine, f0, f82, f90, exponent):
    """Hoffman 2023: Schlick's curve less a lobe that makes it `f82` times as bright where cos = 1/7."""
    base = f0 + (f90 - f0) * (1.0 - cosine) ** exponent
    at_82 = f0 + (f90 - f0) * (6.0 / 7.0) ** exponent
    lobe = cosine * (1.0 - cosine) ** 6 / (1.0 / 7.0 * (6.0 / 7.0) ** 6)
    return np.clip(base - at_82 * (1.0 - f82) * lobe, 0.0, 1.0)


class Surface:
    """Eqs. 1, 2, 4, 5 and 10 of 001 for a conductor, a dielectric or a Schlick interface.

    `reflectance(cosine)` is that from outside, (n, 3); `index` is that of the inside, `shares` what of the reflection
    and of the transmission is turned.
    """

    def __init__(self, slopes, reflectance, index, masking, correlation, shares, modes, opaque=False):
        self.slopes, self.reflectance, self.index = slopes, reflectance, index
        self.masking, self.correlation, self.shares, self.modes = masking, correlation, shares, modes
        self.opaque = opaque

    def _lobe(self, v, l, side, refracts):  # noqa: E741
        """f and density of one lobe, v above; `side` is -1 where that is the inside."""
        near, far = np.where(side > 0.0, 1.0, self.index), np.where(side > 0.0, self.index, 1.0)
        h = -(near[:, None] * v + far[:, None] * l) if refracts else v + l
        h = h / np.linalg.norm(h, axis=-1, keepdims=True)
        h = h * np.where(h[:, 2:] < 0.0, -1.0, 1.0)
        vh, lh = (v * h).sum(axis=-1), (l * h).sum(axis=-1)
        lit = ((l[:, 2] < 0.0) & (vh > 0.0) & (lh < 0.0)) if refracts else (l[:, 2] > 0.0)
        if self.opaque:
            lit = lit & (side > 0.0)
        # Fresnel's reflectance is the same from both sides; beyond the critical angle there is no outer cosine.
        squared = np.where(side > 0.0, vh**2, 1.0 - self.index**2 * (1.0 - vh**2))
        f = self.reflectance(np.sqrt(np.maximum(squared, 0.0)))
        f = np.where((squared > 0.0)[:, None], f, 1.0)
        d = self.slopes.normals(h)
        g2 = self.slopes.seen_from_both(self.masking, self.correlation, v, l, h)
        g1 = self.slopes.seen("vcavity" if self.masking == "vcavity" else "smith", v, h)
        cosine = self.slopes.meso_cosine(v)
        if refracts:
            below = (near * vh + far * lh) ** 2
            value = np.abs(vh * lh) * near**2 * d * g2 / (cosine * np.abs(l[:, 2]) * below)
            value = value[:, None] * (1.0 - f)
            jacobian = far**2 * np.abs(lh) / below
        else:
            value = (d * g2 / (4.0 * cosine * l[:, 2]))[:, None] * f
            jacobian = 1.0 / (4.0 * vh)
        chance = 1.0
        if self.modes == "RT":
            chance = f.mean(axis=-1)
            chance = 1.0 - chance if refracts else chance
        density = chance * g1 * vh * d / cosine * jacobian
        lit = lit & (cosine > 0.0)
        return np.where(lit[:, None], value, 0.0), np.where(lit, density, 0.0)

    def __call__(self, v, l):  # noqa: E741
        """f (n, 3) and density (n)."""
        side = np.where(v[:, 2] > 0.0, 1.0, -1.0)
        v, l = side[:, None] * v, side[:, None] * l  # noqa: E741
        turned = -v + 2.0 * v[:, 2:] * np.array([0.0, 0.0, 1.0])
        value, density = np.zeros((len(v), 3)), np.zeros(len(v))
        for refracts, mode, retro in zip((False, True), "RT", self.shares, strict=True):
            if mode not in self.modes:
                continue
            for view, share in ((v, 1.0 - retro), (turned, retro)):
                if share > 0.0:
                    f, p = self._lobe(view, l, side, refracts)
                    value += share * f
                    density += share * p
        return value, density


def directions(rng, count, sides):
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    d[:, 2] = np.abs(d[:, 2]) * rng.choice(sides, size=count)
    return d


COUNT = 1500


def agree(lobe, surface, seed=1, rtol=1e-9):
    """Random directions from both sides, half of the lights drawn from the lobe."""
    rng = np.random.default_rng(seed)
    v, l = directions(rng, COUNT, (1, -1)), directions(rng, COUNT, (1, -1))  # noqa: E741
    drawn = lobe.sample(v, rng.random((COUNT, 3)))
    on_lobe = (drawn.pdf > 0.0) & (np.arange(COUNT) % 2 == 0)
    assert on_lobe.sum() > COUNT / 10
    l[on_lobe] = drawn.l[on_lobe]
    value, density = surface(v, l)
    np.testing.assert_allclose(lobe.eval(v, l), value, rtol=rtol, atol=1e-13)
    np.testing.assert_allclose(lobe.pdf(v, l), density, rtol=rtol, atol=1e-13)
    assert (value > 0.0).any(axis=-1).sum() > COUNT / 4


NAMES = {"ggx": "ggx", "beckmann": "beckmann", "beckmann-rational": "rational", "phong": "phong"}
PAIRS = [
    *((d, "smith", c) for d in ("ggx", "beckmann", "beckmann-rational")
      for c in ("height", "separable", "direction", "height_direction")),
    *((d, "vcavity", "height") for d in ("ggx", "beckmann", "phong")),
]  # fmt: skip
METAL = (np.array([0.2, 0.92, 1.1]), np.array([3.9, 2.45, 0.0]))
TAPE = (np.array([0.9, 0.4, 0.1]), np.array([0.6, 1.0, 0.2]), np.array([1.0, 0.8, 0.9]))


def metal(cosine):
    return fresnel(cosine[:, None], METAL[0] + 1j * METAL[1])


def glass(index):
    return lambda cosine: np.repeat(fresnel(cosine, index)[:, None], 3, axis=1)


@pytest.mark.parametrize("shape", [(0.3, 0.3, 0.0), (0.6, 0.15, 0.0), (0.2, 0.5, -0.6)])
@pytest.mark.parametrize(("distribution", "masking", "correlation"), PAIRS)
def test_lobes_are_equations_1_2_and_10(distribution, masking, correlation, shape):
    ax, ay, skew = shape
    if distribution == "phong" and skew:
        pytest.skip("Phong's slopes are not correlated")
    slopes = Slopes(NAMES[distribution], ax, ay, skew)
    common = {
        "alpha": (ax, ay), "distribution": distribution, "masking": masking, "correlation": correlation,
        "slope_correlation": skew,
    }  # fmt: skip
    for retro in (0.0, 0.35, 1.0):
        lobe = ref.Conductor(*METAL, retroreflectivity=retro, **common)
        agree(lobe, Surface(slopes, metal, 1.0, masking, correlation, (retro, 0.0), "R", opaque=True))
    for retro, through, index in ((0.35, False, 1.5), (0.6, True, 1.5), (0.0, False, 0.7), (1.0, True, 1.33)):
        lobe = ref.Dielectric(
            index, scatter_mode="RT", retroreflectivity=retro, retro_transmission=through, **common
        )
        shares = (retro, retro if through else 0.0)
        agree(lobe, Surface(slopes, glass(index), index, masking, correlation, shares, "RT"))
    f0 = TAPE[0].mean()
    index = (1.0 + math.sqrt(f0)) / (1.0 - math.sqrt(f0))
    for mode, exponent in (("RT", 5.0), ("R", 3.5), ("T", 5.0)):
        lobe = ref.GeneralizedSchlick(*TAPE, exponent, scatter_mode=mode, retroreflectivity=0.25, **common)

        def tape(cosine, exponent=exponent):
            return schlick(cosine[:, None], *TAPE, exponent)

        agree(lobe, Surface(slopes, tape, index, masking, correlation, (0.25, 0.0), mode))


@pytest.mark.parametrize("distribution", ["ggx", "beckmann", "beckmann-rational"])
def test_lobes_of_shifted_slopes_have_the_mesosurfaces_cosine(distribution):
    slopes = Slopes(NAMES[distribution], 0.5, 0.3, 0.4, (0.2, -0.15))
    common = {
        "alpha": (0.5, 0.3), "distribution": distribution, "slope_correlation": 0.4, "mean_slope": (0.2, -0.15),
    }  # fmt: skip
    for correlation in ("height", "separable", "direction", "height_direction"):
        lobe = ref.Conductor(*METAL, correlation=correlation, **common)
        agree(lobe, Surface(slopes, metal, 1.0, "smith", correlation, (0.0, 0.0), "R", opaque=True))
        lobe = ref.Dielectric(1.5, scatter_mode="RT", correlation=correlation, **common)
        agree(lobe, Surface(slopes, glass(1.5), 1.5, "smith", correlation, (0.0, 0.0), "RT"))


@pytest.mark.parametrize("masking", ["implicit", "schlick-smith", "kelemen"])
def test_unphysical_lobes_are_what_table_3_names(masking):
    """Eqs. 55 to 60; normals are still drawn as Smith's."""
    slopes = Slopes("ggx", 0.5, 0.2)
    lobe = ref.Conductor(*METAL, (0.5, 0.2), 0.35, masking=masking)
    agree(lobe, Surface(slopes, metal, 1.0, masking, "height", (0.35, 0.0), "R", opaque=True))


def test_the_tint_multiplies_both_lobes():
    tint = np.array([0.5, 0.2, 2.0])
    plain, tinted = (ref.Dielectric(1.5, 0.3, t, "RT", retroreflectivity=0.3) for t in (1.0, tint))
    rng = np.random.default_rng(5)
    v, l = directions(rng, 200, (1, -1)), directions(rng, 200, (1, -1))  # noqa: E741
    np.testing.assert_allclose(tinted.eval(v, l), tint * plain.eval(v, l), rtol=1e-14)
    np.testing.assert_allclose(tinted.albedo(v[:5]), tint * plain.albedo(v[:5]), rtol=1e-14)
    u = rng.random((200, 3))
    np.testing.assert_allclose(tinted.sample(v, u).weight, tint * plain.sample(v, u).weight, rtol=1e-13)


@pytest.mark.parametrize("masking", ["smith", "vcavity", "implicit", "schlick-smith", "kelemen"])
@pytest.mark.parametrize(
    ("make", "name"), [(ref.GGX, "ggx"), (ref.Beckmann, "beckmann"), (ref.BeckmannRational, "rational")]
)
def test_distributions_are_heitzs(make, name, masking):
    """D, Λ, G1, G2 and the visible normals of eqs. 16, 43 to 60, 67 to 101."""
    rng = np.random.default_rng(6)
    v, l, m = directions(rng, 500, (1,)), directions(rng, 500, (1, -1)), directions(rng, 500, (1,))  # noqa: E741
    for skew, mean in ((0.0, (0.0, 0.0)), (0.5, (0.0, 0.0)), (-0.3, (0.1, 0.2))):
        if masking != "smith" and (skew or any(mean)):
            continue
        made, slopes = make(0.5, 0.2, skew, mean), Slopes(name, 0.5, 0.2, skew, mean)
        np.testing.assert_allclose(made.D(m), slopes.normals(m), rtol=1e-11, atol=1e-300)
        np.testing.assert_allclose(made.Lambda(v), slopes.hidden(v), rtol=1e-9, atol=1e-15)
        g1 = slopes.seen(masking, v, m)
        np.testing.assert_allclose(made.G1(v, m, masking), g1, rtol=1e-11)
        cosine = slopes.meso_cosine(v)
        visible = g1 * np.maximum((v * m).sum(axis=-1), 0.0) * slopes.normals(m) / cosine
        np.testing.assert_allclose(
            made.pdf_visible(v, m, masking), np.where(cosine > 0.0, visible, 0.0), rtol=1e-10, atol=1e-300
        )
        for correlation in ("height", "separable", "direction", "height_direction"):
            both = slopes.seen_from_both(masking, correlation, v, l, m)
            np.testing.assert_allclose(made.G2(v, l, m, masking, correlation), both, rtol=1e-10, atol=1e-300)


def exact_fresnel(cosine, n, k):
    """`fresnel` in numbers of 50 digits."""
    c, squared = mpmath.mpf(cosine), mpmath.mpc(n, k) ** 2
    refracted = mpmath.sqrt(squared - 1 + c * c)
    perpendicular = (c - refracted) / (c + refracted)
    parallel = (squared * c - refracted) / (squared * c + refracted)
    return (abs(perpendicular) ** 2 + abs(parallel) ** 2) / 2


def test_fresnels_reflectance_is_exact_to_14_digits_at_any_index():
    """Near index 1 too, where both amplitudes are small, and of a metal that absorbs next to nothing."""
    rng = np.random.default_rng(7)
    count = 600
    cosine = rng.choice([rng.random(count), 10.0 ** rng.uniform(-9.0, 0.0, count), np.ones(count)])
    near_1 = 1.0 + 10.0 ** rng.uniform(-12.0, -1.0, count) * rng.choice([-1.0, 1.0], count)
    n = rng.choice([rng.uniform(0.1, 5.0, count), 10.0 ** rng.uniform(-6.0, 6.0, count), near_1])
    k = rng.choice([rng.uniform(0.0, 9.0, count), 10.0 ** rng.uniform(-12.0, 6.0, count)])
    cosine, n, k = (np.stack([a, b]).ravel() for a, b in ((cosine, np.full(count, 0.8)), (n, near_1), (k, k)))
    with mpmath.workdps(50):
        absorbing = [float(exact_fresnel(*each)) for each in zip(cosine, n, k, strict=True)]
        clear = [float(exact_fresnel(*each, 0.0)) for each in zip(cosine, n, strict=True)]
    np.testing.assert_allclose(ref.fresnel_conductor(cosine, n, k), absorbing, rtol=1e-14)
    np.testing.assert_allclose(ref.fresnel_dielectric(cosine, n), clear, rtol=1e-14)
    np.testing.assert_allclose(ref.fresnel_conductor(cosine, n, 0.0), clear, rtol=1e-14)


def test_the_public_reflectance_is_that_of_the_lobes():
    """A facet that lies flat, seen and lit at its own mirror angle."""
    rng = np.random.default_rng(8)
    v = directions(rng, 200, (1,))
    n, k, f0, f82 = 1.0 + 10.0 ** rng.uniform(-9.0, 0.5, 200), *rng.random((3, 200))
    cosine = 0.5 * np.linalg.norm(v + v * [-1.0, -1.0, 1.0], axis=-1)

    def seen(lobe):
        return lobe._reflectance(cosine[:, None], energy.NONE)[:, 0]

    np.testing.assert_allclose(seen(ref.Dielectric(n, 0.3)), ref.fresnel_dielectric(cosine, n), rtol=1e-15)
    metal = ref.Conductor(*(each[:, None] for each in (n, k)), 0.3)
    np.testing.assert_allclose(seen(metal), ref.fresnel_conductor(cosine, n, k), rtol=1e-15)
    for exponent in (5.0, 0.5):
        tape = ref.GeneralizedSchlick(f0[:, None], f82[:, None], 0.9, exponent, 0.3)
        np.testing.assert_allclose(
            seen(tape), ref.fresnel_schlick(cosine, f0, f82, 0.9, exponent), rtol=1e-15
        )


def test_schlicks_curve_is_as_printed():
    cosine = np.concatenate([np.random.default_rng(7).random(2000), [0.0, 1.0, 1e-9]])
    for exponent in (0.5, 3.0, 5.0):
        np.testing.assert_allclose(
            ref.fresnel_schlick(cosine, 0.3, 0.2, 0.9, exponent), schlick(cosine, 0.3, 0.2, 0.9, exponent),
            atol=1e-15,
        )  # fmt: skip


def interference(outer, under, path):
    """Airy's sum for amplitudes of both interfaces: its mean, and the first two orders of what oscillates.

    The orders are those of a Fourier transform over the phase; the path's phase is then put in for each wavelength of
    Belcour and Barla's sensitivities, whose sum over wavelengths stands for the transform that the evaluator has in
    closed form. They are Gaussians of 1 / wavelength with twice the variance that is printed for the transform.
    """
    phase = 2.0 * math.pi * np.arange(512) / 512
    turn = np.exp(1j * phase)
    orders = np.fft.fft(np.abs((outer + under * turn) / (1.0 + outer * under * turn)) ** 2) / 512
    wave = np.linspace(0.9e6, 3.0e6, 8001)
    spectrum = sum((2.0 * orders[m] * np.exp(2j * math.pi * m * path * wave)).real for m in (1, 2))

    def gauss(value, position, variance):
        return value / math.sqrt(2.0) * np.exp(-((wave - position) ** 2) / (4.0 * variance)) / 1.0685e-7

    xyz = np.stack(
        [
            gauss(5.4856e-13, 1.6810e06, 4.3278e09) + gauss(9.7470e-14, 2.2399e06, 4.5282e09),
            gauss(4.4201e-13, 1.7953e06, 9.3046e09),
            gauss(5.2481e-13, 2.2084e06, 6.6121e09),
        ]
    )
    return orders[0].real + (xyz * spectrum).sum(axis=-1) * (wave[1] - wave[0])


def film_rgb(cosine, film, thickness, under):
    """RGB of a film; `under(inside)` gives the amplitudes (perpendicular, parallel) of what lies under it."""
    inside = math.sqrt(1.0 - (1.0 - cosine**2) / film**2)
    path = 2.0 * film * inside * thickness * 1e-9
    outer = (
        (cosine - film * inside) / (cosine + film * inside),
        (film * cosine - inside) / (film * cosine + inside),
    )
    xyz = 0.5 * sum(interference(a, b, path) for a, b in zip(outer, under(inside), strict=True))
    to_rgb = [
        [2.3706743, -0.9000405, -0.4706338],
        [-0.5138850, 1.4253036, 0.0885814],
        [0.0052982, -0.0146949, 1.0093968],
    ]
    return np.clip(to_rgb @ xyz, 0.0, 1.0)


def film_reflectance(make, cosine, film, thickness):
    """What a coated lobe reflects at facets that lie flat, from eval of a mirrored pair of directions."""
    v, up = np.array([math.sqrt(1.0 - cosine**2), 0.0, cosine]), np.array([0.0, 0.0, 1.0])
    l, d = v * [-1.0, 1.0, 1.0], ref.GGX(0.1)  # noqa: E741
    lobe = make(alpha=0.1, thinfilm_thickness=thickness, thinfilm_ior=film)
    return lobe.eval(v, l) * 4.0 * cosine**2 / (d.D(up) * d.G2(v, l, up))


@pytest.mark.parametrize("thickness", [60.0, 250.0, 480.0, 900.0])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.4])
def test_thin_films_interfere_as_amplitudes_do(cosine, thickness):
    """Belcour and Barla's two terms, in MaterialX's form, from Airy's sum."""

    def substrate(index, film):
        def amplitudes(inside):
            below = np.sqrt(index**2 - film**2 * (1.0 - inside**2) + 0j)
            return (film * inside - below) / (film * inside + below), (
                (index**2 * inside - film * below) / (index**2 * inside + film * below)
            )

        return amplitudes

    for index, film in ((1.9, 1.4), (1.2, 1.4), (0.9 + 2.0j, 1.3), (0.2 + 3.9j, 1.8)):
        make = (
            functools.partial(ref.Conductor, index.real, index.imag)
            if isinstance(index, complex)
            else functools.partial(ref.Dielectric, index)
        )
        expected = film_rgb(cosine, film, thickness, substrate(index, film))
        np.testing.assert_allclose(film_reflectance(make, cosine, film, thickness), expected, atol=1e-9)
    # Half of a Schlick lobe's reflectance goes to each polarisation, with the signs of a thinner or a denser medium.
    for f0, film, sign in ((0.04, 1.8, 1.0), (0.3, 1.2, -1.0)):

        def half(inside, f0=f0, sign=sign):
            amplitude = sign * math.sqrt(0.5 * float(schlick(inside, f0, 0.7, 0.9, 4.0)))
            return amplitude, -amplitude

        make = functools.partial(ref.GeneralizedSchlick, f0, 0.7, 0.9, 4.0)
        expected = film_rgb(cosine, film, thickness, half)
        np.testing.assert_allclose(film_reflectance(make, cosine, film, thickness), expected, atol=1e-9)
