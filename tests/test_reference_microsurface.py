"""Distributions and masking against the identities that define them (Heitz 2014)."""

import math

import numpy as np
import pytest

from mrm_nodes import reference as ref


def direction(theta_degrees, phi=0.7):
    theta = math.radians(theta_degrees)
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


class OverNormals:
    """Integrates a function of normals over the hemisphere, in slopes, split where v stops seeing either
    facet.

    `ax`, `ay`, `rxy` and `mean` only place the nodes; none of the code under test is used for that.
    """

    def __init__(self, v, ax, ay, rxy=0.0, mean=(0.0, 0.0), azimuths=64, radii=48):
        stretch = np.array([[ax, 0.0], [rxy * ay, math.sqrt(1.0 - rxy * rxy) * ay]])
        mean = np.asarray(mean)
        horizontal = stretch.T @ v[:2]
        vertical = v[2] - mean @ v[:2]
        t, w = np.polynomial.legendre.leggauss(azimuths)
        t, w = 0.5 * (t + 1.0), 0.5 * w
        # The ends of each quarter circle are where the split runs to infinity.
        for _ in range(2):
            w = w * 6.0 * t * (1.0 - t)
            t = t * t * (3.0 - 2.0 * t)
        psi = np.concatenate([(k + t) * 0.5 * np.pi for k in range(4)])
        psi_weight = np.tile(w * 0.5 * np.pi, 4)
        psi = psi + math.atan2(horizontal[1], horizontal[0])
        circle = np.stack([np.cos(psi), np.sin(psi)], axis=-1)
        split = vertical / np.maximum(np.abs(circle @ horizontal), 1e-300)
        # Radius over 1 + radius; what lies beyond a million is nothing.
        inside = np.minimum(split, 1e6)[:, None] / (1.0 + np.minimum(split, 1e6)[:, None])
        s, sw = np.polynomial.legendre.leggauss(radii)
        s, sw = 0.5 * (s + 1.0), 0.5 * sw
        rest = np.concatenate([1.0 - inside * s, (1.0 - inside) * (1.0 - s)], axis=1)
        weight = np.concatenate([inside * sw, (1.0 - inside) * sw], axis=1)
        rho = (1.0 - rest) / rest
        weight = weight / rest**2 * rho * psi_weight[:, None]
        slopes = (rho[..., None] * circle[:, None, :]) @ stretch.T + mean
        normals = np.concatenate([-slopes, np.ones((*slopes.shape[:-1], 1))], axis=-1)
        length = np.linalg.norm(normals, axis=-1)
        self.normals = normals / length[..., None]
        self.weights = weight * np.linalg.det(stretch) / length**3

    def __call__(self, values):
        return float((values * self.weights).sum())


SHAPES = [
    pytest.param({"ax": 0.05, "ay": 0.05}, id="0.05"),
    pytest.param({"ax": 0.3, "ay": 0.3}, id="0.3"),
    pytest.param({"ax": 1.0, "ay": 1.0}, id="1"),
    pytest.param({"ax": 0.6, "ay": 0.15}, id="anisotropic"),
]
SKEWED = [
    pytest.param({"ax": 0.6, "ay": 0.2, "slope_correlation": 0.7}, id="correlated"),
    pytest.param({"ax": 0.4, "ay": 0.2, "slope_correlation": -0.5, "mean_slope": (0.1, -0.2)}, id="shifted"),
]
THETAS = [0.0, 30.0, 60.0, 80.0, 89.0]


def visible_total(distribution, shape, theta, masking):
    v = direction(theta)
    over = OverNormals(
        v, shape["ax"], shape["ay"], shape.get("slope_correlation", 0.0), shape.get("mean_slope", (0.0, 0.0))
    )
    return over(distribution(**shape).pdf_visible(v, over.normals, masking))


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("masking", ["smith", "vcavity"])
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_white_furnace(distribution, masking, shape, theta):
    """Visible normals integrate to 1: eq. 18, and with h for m eq. 36 with the light over the whole sphere."""
    assert visible_total(distribution, shape, theta, masking) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("masking", ["smith", "vcavity"])
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_white_furnace_anywhere(distribution, masking):
    """Alpha from 0.05 to 1 up to 4:1, θ from 0° to 89° and any azimuth, the ends among them."""
    rng = np.random.default_rng(11)
    for ax, ay, theta in [(0.05, 0.2, 89.0), (1.0, 0.25, 89.0), (1.0, 1.0, 0.0)] + [
        (*np.clip(ratio * width, 0.05, 1.0), theta)
        for width, ratio, theta in zip(
            np.exp(rng.uniform(math.log(0.05), 0.0, 5)),
            np.stack([np.ones(5), 2.0 ** rng.uniform(-2.0, 2.0, 5)], axis=-1),
            rng.uniform(0.0, 89.0, 5),
            strict=True,
        )
    ]:
        v = direction(theta, rng.uniform(0.0, 2.0 * math.pi))
        # Phong of alpha 1 ends in a corner at the horizon, which takes many radii.
        over = OverNormals(v, ax, ay, azimuths=96, radii=160 if distribution is ref.Phong else 48)
        total = over(distribution(ax, ay).pdf_visible(v, over.normals, masking))
        assert total == pytest.approx(1.0, abs=1e-6), (ax, ay, theta)


@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann])
def test_white_furnace_of_correlated_vcavities(distribution):
    """Correlated slopes keep D(m) = D(Rm), which is all that a cavity asks."""
    for theta in THETAS:
        shape = {"ax": 0.6, "ay": 0.2, "slope_correlation": 0.7}
        assert visible_total(distribution, shape, theta, "vcavity") == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("masking", ["smith", "vcavity"])
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_white_furnace_over_lights(distribution, masking):
    """Eq. 36 as it is printed: ∫ G1(v, h) D(h) / (4 v.n) dl over the whole sphere."""
    v, d = direction(40.0, 0.3), distribution(0.8)
    x, w = np.polynomial.legendre.leggauss(400)
    cos, phi = x, np.arange(512) * 2.0 * np.pi / 512
    # Around the mirror of v, where normals are v itself: the integrand is smooth but for the horizon of normals.
    sin = np.sqrt(1.0 - cos**2)
    local = np.stack(
        np.broadcast_arrays(sin[:, None] * np.cos(phi), sin[:, None] * np.sin(phi), cos[:, None]), -1
    )
    across = np.cross(v, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    l = local @ np.stack([across, np.cross(v, across), v])  # noqa: E741
    h = v + l
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    value = np.where(h[..., 2] > 0.0, d.G1(v, h, masking) * d.D(h) / (4.0 * v[2]), 0.0)
    assert (value * w[:, None]).sum() * 2.0 * np.pi / 512 == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("shape", SKEWED)
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann])
def test_white_furnace_of_skewed_slopes(distribution, shape, theta):
    if direction(theta)[2] <= np.dot(shape.get("mean_slope", (0.0, 0.0)), direction(theta)[:2]):
        pytest.skip("the mesosurface is seen from behind")
    assert visible_total(distribution, shape, theta, "smith") == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("masking", ["implicit", "schlick-smith", "kelemen"])
def test_unphysical_masking_fails_the_furnace(masking):
    """Table 3: no microsurface has these."""
    worst = max(abs(visible_total(ref.GGX, {"ax": 0.5, "ay": 0.5}, theta, masking) - 1.0) for theta in THETAS)
    assert worst > 0.05


def test_shifted_vcavities_fail_the_furnace():
    """A cavity needs both its facets: D(m) = D(Rm)."""
    shape = {"ax": 0.4, "ay": 0.4, "mean_slope": (0.3, 0.0)}
    assert abs(visible_total(ref.GGX, shape, 60.0, "vcavity") - 1.0) > 0.01


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_normals_project_to_the_geometric_area(distribution, shape):
    """∫ D(m) (m.n) dm = 1."""
    over = OverNormals(direction(0.0), shape["ax"], shape["ay"])
    total = over(distribution(**shape).D(over.normals) * over.normals[..., 2])
    assert total == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("theta", THETAS)
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann])
def test_projected_area_is_kept(distribution, theta):
    """∫ G1(v, m) <v, m> D(m) dm = v.n (eq. 14), with G1 and D asked for one at a time."""
    v = direction(theta)
    over = OverNormals(v, 0.5, 0.2)
    d = distribution(0.5, 0.2)
    seen = np.maximum(over.normals @ v, 0.0)
    for masking in ("smith", "vcavity"):
        total = over(d.G1(v, over.normals, masking) * seen * d.D(over.normals))
        assert total == pytest.approx(v[2], abs=1e-6)


@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann])
def test_masking_does_not_change_when_the_surface_is_stretched_or_sheared(distribution):
    """Section 5: slopes and direction scaled or offset together."""
    v = np.stack([direction(t, p) for t in (10.0, 45.0, 80.0) for p in (0.2, 1.3, 4.0)])
    plain = distribution(0.4, 0.2).Lambda(v)
    stretched = v / np.array([1.7, 0.6, 1.0])
    stretched /= np.linalg.norm(stretched, axis=-1, keepdims=True)
    np.testing.assert_allclose(
        distribution(0.4 * 1.7, 0.2 * 0.6).Lambda(stretched), plain, rtol=1e-10, atol=1e-14
    )
    mean = np.array([0.05, -0.1])
    sheared = v.copy()
    sheared[:, 2] += v[:, :2] @ mean
    sheared /= np.linalg.norm(sheared, axis=-1, keepdims=True)
    moved = distribution(0.4, 0.2, mean_slope=mean).Lambda(sheared)
    np.testing.assert_allclose(moved, plain, rtol=1e-10, atol=1e-14)


def test_lambda_of_isotropic_phong_is_that_of_its_quadrature():
    v = np.stack([direction(t) for t in (5.0, 40.0, 75.0, 88.0, 89.94)])
    for alpha in (0.05, 0.5, 1.0):
        closed = ref.Phong(alpha).Lambda(v)
        # An anisotropy too small to matter takes the other way.
        numerical = ref.Phong(alpha, alpha * (1.0 + 1e-9)).Lambda(v)
        np.testing.assert_allclose(numerical, closed, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize("alpha", [(0.5, 0.2), (0.2, 0.5), (1.0, 0.1), (0.1, 0.02)])
def test_lambda_of_anisotropic_phong_is_the_area_of_facets_that_face_away(alpha):
    """∫ <-v, m> D(m) dm = Λ v.n to 1e-6 by a quadrature over slopes, down to n.v = 0.001."""
    for cosine in (1e-3, 0.1, 0.8):
        for phi in (0.0, 0.7, 1.5):
            v = direction(math.degrees(math.acos(cosine)), phi)
            over = OverNormals(v, *alpha, azimuths=256, radii=96)
            d = ref.Phong(*alpha)
            area = over(np.maximum(-(over.normals @ v), 0.0) * d.D(over.normals))
            assert d.Lambda(v) == pytest.approx(area / v[2], rel=1e-6, abs=1e-6)


def phong_facing_away(v, ax, ay, azimuths=8192):
    """∫ <-v, m> D(m) dm over v.n: even azimuths of m, and over its cosine c the tanh-sinh rule in c^(e + 1)."""
    phi = 2.0 * np.pi * np.arange(azimuths) / azimuths
    along = -(v[0] * np.cos(phi) + v[1] * np.sin(phi))
    phi, along = phi[along > 0.0], along[along > 0.0, np.newaxis]
    power = (2.0 * (np.cos(phi) / ax) ** 2 + 2.0 * (np.sin(phi) / ay) ** 2 - 1.0)[:, np.newaxis]
    u = 0.12 * np.arange(-30, 31)
    s = 0.5 * np.pi * np.sinh(u)
    weight = 0.12 * 0.25 * np.pi * np.cosh(u) / np.cosh(s) ** 2
    top = -0.5 * np.log1p((v[2] / along) ** 2)
    log_cosine = top - np.log1p(np.exp(-2.0 * s)) / power
    away = along * np.sqrt(-np.expm1(2.0 * log_cosine)) - v[2] * np.exp(log_cosine)
    total = (np.maximum(away, 0.0) @ weight * (np.exp(power * top) / power)[:, 0]).sum()
    return total * 2.0 * np.pi / azimuths / (np.pi * ax * ay) / v[2]


@pytest.mark.parametrize("alpha", [(1.0, 0.05), (0.05, 1.0), (0.3, 0.015), (0.02, 0.001), (1.0, 0.01)])
def test_lambda_of_phong_holds_to_1e_6_at_20_to_1_and_beyond(alpha):
    for theta in (5.0, 45.0, 75.0, 89.9):
        for phi in (0.0, 1.0, 20.0, 88.0, 90.0):
            v = direction(theta, math.radians(phi))
            expected = phong_facing_away(v, *alpha)
            assert ref.Phong(*alpha).Lambda(v) == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_beckmanns_rational_lambda_is_close_to_the_exact_one():
    v = np.stack([direction(t) for t in np.linspace(0.0, 89.0, 90)])
    up = np.array([0.0, 0.0, 1.0])
    exact, fit = ref.Beckmann(0.5).G1(v, up), ref.BeckmannRational(0.5).G1(v, up)
    assert 1e-5 < np.abs(exact - fit).max() < 5e-3


@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_masking_has_its_limits(distribution):
    """Nothing is hidden at normal incidence or on a smooth surface; everything is from the horizon."""
    up, low = np.array([0.0, 0.0, 1.0]), direction(80.0)
    assert distribution(0.7, 0.3).Lambda(up) == pytest.approx(0.0, abs=1e-15)
    assert distribution(1e-3).Lambda(low) == pytest.approx(0.0, abs=1e-4)
    for masking in ("smith", "vcavity"):
        assert distribution(0.7).G1(up, up, masking) == 1.0
        assert distribution(0.7).G1([1.0, 0.0, 0.0], up, masking) == 0.0
        assert distribution(0.7).pdf_visible([1.0, 0.0, 0.0], up, masking) == 0.0
    # D at its peak; and facets below the horizon there are none.
    assert distribution(0.2, 0.5).D(up) == pytest.approx(1.0 / (np.pi * 0.1), rel=1e-12)
    assert distribution(0.2).D(-up) == 0.0


@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann])
def test_four_masking_shadowing_functions_keep_their_order_and_limits(distribution):
    """Separable shadows most, full correlation is min(G1, G1), and van Ginneken's λ lies between (eqs.
    98-101).
    """
    d = distribution(0.7)
    m = np.array([0.0, 0.0, 1.0])
    v = direction(70.0, 0.0)
    near, far = direction(60.0, 0.0), direction(60.0, math.pi)
    g1 = d.G1(v, m), d.G1(near, m)
    for l in (near, far, direction(60.0, 1.0)):  # noqa: E741
        separable, height = d.G2(v, l, m, correlation="separable"), d.G2(v, l, m)
        assert separable == pytest.approx(g1[0] * g1[1], rel=1e-12)
        assert height == pytest.approx(1.0 / (1.0 / g1[0] + 1.0 / g1[1] - 1.0), rel=1e-12)
        assert separable < height <= d.G2(v, l, m, correlation="height_direction") <= min(g1) + 1e-15
        assert separable <= d.G2(v, l, m, correlation="direction") <= min(g1) + 1e-15
    for correlation in ("direction", "height_direction"):
        assert d.G2(v, near, m, correlation=correlation) == pytest.approx(min(g1), rel=1e-12)
    apart = 4.41 * math.pi / (4.41 * math.pi + 1.0)
    expected = apart * g1[0] * g1[1] + (1.0 - apart) * min(g1)
    assert d.G2(v, far, m, correlation="direction") == pytest.approx(expected, rel=1e-12)


def test_phongs_masking_and_shadowing_is_correlated_as_the_others_is():
    """Eqs. 98 to 101 of its own Λ; across, the average of C^Λ (1 - C)^Λ over the heights' share C (eq. 128)."""
    d, m = ref.Phong(0.6, 0.3), np.array([0.0, 0.0, 1.0])
    v, l = direction(70.0, 0.3), direction(55.0, 1.5)  # noqa: E741
    g1 = d.G1(v, m), d.G1(l, m)
    hidden = d.Lambda(v), d.Lambda(l)
    apart = 4.41 * 1.2 / (4.41 * 1.2 + 1.0)
    expected = {
        "separable": g1[0] * g1[1],
        "height": 1.0 / (1.0 + sum(hidden)),
        "direction": apart * g1[0] * g1[1] + (1.0 - apart) * min(g1),
        "height_direction": 1.0 / (1.0 + max(hidden) + apart * min(hidden)),
    }
    for correlation, value in expected.items():
        assert d.G2(v, l, m, correlation=correlation) == pytest.approx(value, rel=1e-12)
    x, w = np.polynomial.legendre.leggauss(64)
    x = 0.5 * (x + 1.0)
    # The smooth substitution keeps powers at the ends integrable.
    share, weight = x * x * (3.0 - 2.0 * x), 0.5 * w * 6.0 * x * (1.0 - x)
    for distribution in (d, ref.GGX(0.6, 0.3), ref.Beckmann(0.6, 0.3)):
        one, other = distribution.Lambda(v), distribution.Lambda(l)
        through = (share**one * (1.0 - share) ** other * weight).sum()
        for correlation in ("height", "height_direction"):
            assert distribution.G2(v, -l, m, correlation=correlation) == pytest.approx(through, rel=1e-6)
        product = distribution.G1(v, m) * distribution.G1(l, m)
        for correlation in ("separable", "direction"):
            assert distribution.G2(v, -l, m, correlation=correlation) == pytest.approx(product, rel=1e-12)


def test_vcavities_reflect_by_cook_and_torrances_term():
    """min(1, M, S) (article 003, "The Geometric Term")."""
    v, l = direction(70.0, 0.3), direction(50.0, 2.8)  # noqa: E741
    h = (v + l) / np.linalg.norm(v + l)
    expected = min(1.0, 2.0 * h[2] * v[2] / (v @ h), 2.0 * h[2] * l[2] / (l @ h))
    for masking in ("vcavity", "cook-torrance"):
        assert ref.GGX(0.5).G2(v, l, h, masking=masking) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("masking", ["smith", "vcavity"])
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_visible_normals_are_drawn_with_their_density(distribution, masking):
    """Means of two functions over samples and over the density agree to four standard errors."""
    rng = np.random.default_rng(7)
    # Numerical inversion takes its time.
    count = 20_000 if (distribution, masking) == (ref.Phong, "smith") else 200_000
    for theta in (20.0, 85.0):
        v = direction(theta)
        d = distribution(0.5, 0.2)
        m = d.sample_visible(v, rng.random((count, 3)), masking)
        assert np.abs(np.linalg.norm(m, axis=-1) - 1.0).max() < 1e-12
        over = OverNormals(v, 0.5, 0.2)
        density = d.pdf_visible(v, over.normals, masking)
        for value in (lambda n: n[..., 0], lambda n: n[..., 1] * n[..., 2], lambda n: n[..., 2] ** 4):
            drawn = value(m)
            error = drawn.std() / math.sqrt(len(drawn))
            assert drawn.mean() == pytest.approx(over(density * value(over.normals)), abs=4.0 * error)


def test_phongs_visible_normals_do_not_depend_on_the_order_of_views():
    """What is tabulated for one view and width serves no other."""
    rng = np.random.default_rng(8)
    v = np.stack(
        [direction(t, p) for t, p in ((70.0, 0.1), (70.0, 0.1), (10.0, 0.1), (70.0, 2.0), (70.0, 2.0))]
    )
    ax, ay, u = np.array([0.5, 0.2, 0.2, 0.2, 0.6]), np.array([0.3, 0.3, 0.3, 0.4, 0.4]), rng.random((5, 2))
    together = ref.Phong(ax, ay).sample_visible(v, u)
    alone = [ref.Phong(ax[k], ay[k]).sample_visible(v[k], u[k]) for k in range(5)]
    np.testing.assert_array_equal(together, alone)


@pytest.mark.parametrize("masking", ["smith", "vcavity", "implicit"])
@pytest.mark.parametrize("distribution", [ref.GGX, ref.Beckmann, ref.Phong])
def test_diffuse_microfacets_pass_the_white_furnace(distribution, masking):
    """Eq. 37: Lambertian facets without shadowing reflect all, the light over the whole sphere."""
    v = direction(60.0)
    x, w = np.polynomial.legendre.leggauss(24)
    phi = (np.arange(32) + 0.5) * 2.0 * np.pi / 32
    sine = np.sqrt(1.0 - x**2)
    l = np.stack(  # noqa: E741
        [np.outer(sine, np.cos(phi)), np.outer(sine, np.sin(phi)), np.broadcast_to(x[:, None], (24, 32))],
        axis=-1,
    )
    value = ref.diffuse_microfacets(distribution(0.5, 0.3), 1.0, v, l, masking, shadowing=False)[..., 0]
    total = (value * np.abs(l[..., 2]) * w[:, None]).sum() * 2.0 * np.pi / 32
    if masking == "implicit":
        assert abs(total - 1.0) > 0.1
    else:
        assert total == pytest.approx(1.0, abs=2e-3)


def test_diffuse_microfacets_of_many_views_are_those_of_each():
    d, l = ref.GGX(0.5, 0.3), direction(35.0, 2.0)  # noqa: E741
    v = np.stack([direction(50.0), direction(50.0), direction(80.0)])
    together = ref.diffuse_microfacets(d, 0.8, v, l, shadowing=False, resolution=16)
    alone = [ref.diffuse_microfacets(d, 0.8, w, l, shadowing=False, resolution=16) for w in v]
    np.testing.assert_array_equal(together, alone)


def test_diffuse_microfacets_are_reciprocal_and_lambertian_when_smooth():
    v, l = direction(50.0, 0.1), direction(35.0, 2.0)  # noqa: E741
    rough = ref.Beckmann(0.6, 0.2)
    one, other = ref.diffuse_microfacets(rough, 0.8, v, l), ref.diffuse_microfacets(rough, 0.8, l, v)
    np.testing.assert_allclose(one, other, rtol=1e-12)
    np.testing.assert_allclose(ref.diffuse_microfacets(ref.GGX(1e-3), 0.8, v, l), 0.8 / np.pi, rtol=5e-3)
