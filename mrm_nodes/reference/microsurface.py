"""The scalar formulas of a microsurface: slopes, normal distributions, projected areas, masking and
shadowing.

Equation numbers are those of Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based
BRDFs", unless another source is named. Directions point away from the surface; the normal is +z.

A slope distribution here is always a standard one (alpha = 1, isotropic, centred) after the linear map
slope = mean + L s, with L the lower triangle of the stretching matrix of eq. 88. Masking does not change
under such a map when directions are carried along (Section 5), so each Λ and each visible-normal sampler is
written once, for the standard configuration."""

import math

from .compiled import formula
from .elementary import exponential, gaussian_excess

GGX = 0
BECKMANN = 1
PHONG = 2
BECKMANN_RATIONAL = 3

SMITH = 0
VCAVITY = 1
IMPLICIT = 2
SCHLICK_SMITH = 3
KELEMEN = 4

HEIGHT = 0
SEPARABLE = 1
DIRECTION = 2
HEIGHT_DIRECTION = 3

SQRT_PI = math.sqrt(math.pi)


@formula
def slope_norm_squared(
    x: float, y: float, z: float, ax: float, ay: float, correlation: float, mean_x: float, mean_y: float
) -> float:
    """z² times the squared norm of a normal's slope in the stretched metric (eqs. 90, 92 and 95)."""
    u = (x + mean_x * z) / ax
    v = ((y + mean_y * z) / ay - correlation * u) ** 2 / (1.0 - correlation * correlation)
    return u * u + v


@formula
def stretched_sine_squared(x: float, y: float, ax: float, ay: float, correlation: float) -> float:
    """alpha_o² sin² θ: the roughness projected on a direction, times its sine, squared (eqs. 80, 93 and
    97).
    """
    u = ax * x
    v = ay * y
    return max(u * u + v * v + 2.0 * correlation * u * v, 0.0)


@formula
def stretched_azimuth(x: float, y: float, ax: float, ay: float, correlation: float) -> tuple[float, float]:
    """Lᵀ on a direction's x and y: its horizontal part in the standard configuration (eq. 77)."""
    return ax * x + correlation * ay * y, math.sqrt(1.0 - correlation * correlation) * ay * y


@formula
def ggx_normals(x: float, y: float, z: float, squared_length: float, ax: float, ay: float) -> float:
    """D of GGX (eq. 85) for a normal of any length.

    1 / (π ax ay cos⁴ (1 + tan² (cos²/ax² + sin²/ay²))²) over one denominator; sums of squares do not cancel.
    """
    area = ax * ay
    u = x * ay
    v = y * ax
    w = z * area
    q = u * u + v * v + w * w
    return squared_length * squared_length * (area * area * area) / (math.pi * q * q)


@formula
def ggx_skewed_normals(
    z: float, norm: float, squared_length: float, ax: float, ay: float, correlation: float
) -> float:
    """D of GGX with the slope's norm of eqs. 92 and 95, which is given times z²."""
    determinant = ax * ay * math.sqrt(1.0 - correlation * correlation)
    denominator = z * z + norm
    return squared_length * squared_length / (math.pi * determinant * denominator * denominator)


@formula
def beckmann_normals(
    z: float, norm: float, squared_length: float, ax: float, ay: float, correlation: float
) -> float:
    """D of Beckmann (eq. 82, with eqs. 92 and 95) for a normal of any length: `norm` is the slope's times z².

    cos⁴, where the extracted eq. 68 prints cos².
    """
    determinant = ax * ay * math.sqrt(1.0 - correlation * correlation)
    z2 = z * z
    ratio = squared_length / z2
    return ratio * ratio / (math.pi * determinant) * exponential(-norm / z2)


@formula
def phong_exponent(alpha: float) -> float:
    """The exponent that has the same curvature at the peak as Beckmann's alpha (Walter et al. 2007)."""
    return 2.0 / (alpha * alpha) - 2.0


@formula
def phong_normals(x: float, y: float, z: float, squared_length: float, ax: float, ay: float) -> float:
    """D of Blinn-Phong, (e + 2) / 2π cos^e (article 003), anisotropic as Ashikhmin and Shirley's."""
    across = x * x + y * y
    z2 = z * z
    # e cos²φ + f sin²φ, with φ of no consequence at the pole.
    mixed = (x * x / (ax * ax) + y * y / (ay * ay)) * 2.0 / across - 2.0 if across > 0.0 else 0.0
    # ln cos θ from sin²/cos², which keeps its precision near the pole.
    return math.exp(-0.5 * mixed * math.log1p(across / z2)) / (math.pi * ax * ay) if z2 > 0.0 else 0.0


@formula
def ggx_projected_area(cosine: float, sine_squared: float) -> float:
    """cos θ (1 + Λ), the area of all facets projected on a direction (eqs. 41, 86), from its stretched
    sine².
    """
    return 0.5 * (cosine + math.sqrt(cosine * cosine + sine_squared))


@formula
def beckmann_projected_area(cosine: float, sine: float) -> float:
    """cos θ (1 + Λ) of Beckmann (eqs. 41 and 83): cos θ (1 + erf a) / 2 + sine e^(-a²) / (2 sqrt π), a = cos
    θ / sine >= 0.
    """
    a = max(cosine, 0.0) / max(sine, 1e-300)
    return cosine + sine * gaussian_excess(a)


@formula
def beckmann_rational_projected_area(cosine: float, sine: float) -> float:
    """cos θ (1 + Λ) with Walter's rational fit of Beckmann's Λ (the unnumbered equation after eq. 69)."""
    a = cosine / max(sine, 1e-300)
    fit = (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a)
    return cosine * (1.0 + (fit if a < 1.6 else 0.0))


@formula
def projected_area(distribution: int, cosine: float, sine_squared: float) -> float:
    """cos θ (1 + Λ) of the named distribution, from the stretched sine²."""
    if distribution == GGX:
        return ggx_projected_area(cosine, sine_squared)
    if distribution == BECKMANN:
        return beckmann_projected_area(cosine, math.sqrt(sine_squared))
    if distribution == BECKMANN_RATIONAL:
        return beckmann_rational_projected_area(cosine, math.sqrt(sine_squared))
    raise NotImplementedError("a projected area of this distribution")


@formula
def schlick_smith_area(cosine: float, sine: float) -> float:
    """cos θ / G1 of Schlick's rational masking (Schlick 1994, eq. 19): k is sqrt(2/π) times the RMS slope."""
    k = sine / math.sqrt(max(1.0 - cosine * cosine, 1e-300)) / SQRT_PI
    return cosine * (1.0 - k) + k


@formula
def vcavity_masking(normal: float, cosine: float, across: float) -> float:
    """G1 of a V-cavity (eq. 49): `normal` = n.m, `cosine` = n.w, `across` = w.m > 0."""
    return min(1.0, 2.0 * normal * cosine / across)


# What follows is G2 / (cos v cos l), the form in which nothing divides by a vanishing cosine. For Smith it is
# written with the projected areas cos θ (1 + Λ); for slopes off the normal the cosines are those with the
# mesosurface.


@formula
def height_visibility(cv: float, cl: float, area_v: float, area_l: float) -> float:
    """1 / (1 + Λv + Λl), height-correlated (eq. 99)."""
    return 1.0 / (area_v * cl + area_l * cv - cv * cl)


@formula
def separable_visibility(area_v: float, area_l: float) -> float:
    """G1 G1 (eq. 98)."""
    return 1.0 / (area_v * area_l)


@formula
def ginneken(vx: float, vy: float, lx: float, ly: float) -> float:
    """van Ginneken's λ = 4.41 φ / (4.41 φ + 1), φ the azimuth between two directions (below eq. 101)."""
    azimuth = math.atan2(abs(vx * ly - vy * lx), vx * lx + vy * ly)
    return 4.41 * azimuth / (4.41 * azimuth + 1.0)


@formula
def direction_visibility(cv: float, cl: float, area_v: float, area_l: float, decorrelation: float) -> float:
    """λ G1 G1 + (1 - λ) min(G1, G1) (eq. 100)."""
    return decorrelation / (area_v * area_l) + (1.0 - decorrelation) / max(area_v * cl, area_l * cv)


@formula
def height_direction_visibility(
    cv: float, cl: float, area_v: float, area_l: float, decorrelation: float
) -> float:
    """1 / (1 + max(Λv, Λl) + λ min(Λv, Λl)) (eq. 101)."""
    lambda_v = area_v * cl - cv * cl
    lambda_l = area_l * cv - cv * cl
    return 1.0 / (cv * cl + max(lambda_v, lambda_l) + decorrelation * min(lambda_v, lambda_l))


@formula
def beta_visibility(cv: float, cl: float, area_v: float, area_l: float) -> float:
    """B(1 + Λv, 1 + Λl): height correlation where the two directions are on opposite sides.

    Below the surface a point at height h is unmasked with probability (1 - C)^Λ instead of C^Λ (eq. 128),
    and the average over C of the product is the Beta function."""
    a = area_v / cv
    b = area_l / cl
    return math.exp(math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)) / (cv * cl)


@formula
def smith_visibility(
    correlation: int,
    across: bool,
    cv: float,
    cl: float,
    area_v: float,
    area_l: float,
    vx: float,
    vy: float,
    lx: float,
    ly: float,
) -> float:
    """G2 / (cos v cos l) of Smith's masking (eqs. 98 to 101), `across` where v and l are on opposite sides.

    cv, cl, area_v, area_l: of v and of l, or of -l. vx to ly: of the directions themselves.
    """
    if across and (correlation in (HEIGHT, HEIGHT_DIRECTION)):
        return beta_visibility(cv, cl, area_v, area_l)
    if correlation == SEPARABLE or (across and correlation == DIRECTION):
        return separable_visibility(area_v, area_l)
    if correlation == HEIGHT:
        return height_visibility(cv, cl, area_v, area_l)
    if correlation == DIRECTION:
        return direction_visibility(cv, cl, area_v, area_l, ginneken(vx, vy, lx, ly))
    if correlation == HEIGHT_DIRECTION:
        return height_direction_visibility(cv, cl, area_v, area_l, ginneken(vx, vy, lx, ly))
    raise NotImplementedError("masking of this correlation")
