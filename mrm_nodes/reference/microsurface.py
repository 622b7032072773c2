"""Microsurfaces: how their normals are distributed, and how much of them a direction sees.

Equation numbers are those of Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based
BRDFs", unless another source is named. Directions point away from the surface; the normal is +z.

A distribution is written once, in the standard configuration: alpha 1, isotropic, centred. Any other is that one
after the linear map slope = mean + L s, with L the lower triangle of the stretching matrix of eq. 88, and masking does
not change under such a map when directions are carried along (Section 5). So a `SlopeDistribution` is the formulas
of the standard configuration, a `Stretching` those of the map, and `microsurface` puts the two together. Phong's
distribution is none of that kind, and has formulas of its own.

What a bundle of formulas has not is an error that names it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

from .compiled import inlined, named
from .elementary import (
    SQRT_PI,
    exponential,
    gaussian_excess,
    inverse_error_function,
    logarithm,
    nearly_inverse_error_function,
    scaled_error_complement,
    sine_cosine,
)
from .vec import Vec, dot, unit

GGX = "ggx"
BECKMANN = "beckmann"
BECKMANN_RATIONAL = "beckmann-rational"
PHONG = "phong"

Formula = Callable[..., Any]


class Alpha(NamedTuple):
    """Slopes along the axes, about the normal: alpha along x and along y."""

    x: float
    y: float


class Slopes(NamedTuple):
    """Slopes that are correlated (eq. 88) or lie about another normal (eq. 94)."""

    x: float
    y: float
    correlation: float
    mean_x: float
    mean_y: float


class Seen(NamedTuple):
    """What a microsurface shows to a direction."""

    cosine: float
    """Of the direction with the mesosurface (Section 5.5)."""
    area: float
    """cos θ (1 + Λ), the area of all facets projected on the direction (eq. 41)."""
    sine: float
    """The roughness projected on the direction, times its sine: alpha_o sin θ (eqs. 80, 93 and 97)."""


@dataclass(frozen=True, eq=False)
class Stretching:
    """The linear map from the standard configuration, and the slopes that it is made of."""

    name: str
    slopes: type
    normal: Formula
    """(normal, slopes): the normal in the standard configuration, times the map's determinant."""
    determinant: Formula
    direction: Formula
    """(direction, slopes): Lᵀ w, of which z is the cosine with the mesosurface (eqs. 77 and 96)."""
    facet: Formula
    """(normal, slopes): back from the standard configuration (eq. 88), of any length."""


@inlined
def _straight_normal(m: Vec, a: Alpha) -> Vec:
    return Vec(m.x * a.y, m.y * a.x, m.z * (a.x * a.y))


@inlined
def _straight_determinant(a: Alpha) -> float:
    return a.x * a.y


@inlined
def _straight_direction(w: Vec, a: Alpha) -> Vec:
    return Vec(a.x * w.x, a.y * w.y, w.z)


@inlined
def _straight_facet(m: Vec, a: Alpha) -> Vec:
    return Vec(a.x * m.x, a.y * m.y, m.z)


@inlined
def _sheared_normal(m: Vec, a: Slopes) -> Vec:
    x, y = m.x + a.mean_x * m.z, m.y + a.mean_y * m.z
    root = math.sqrt(1.0 - a.correlation * a.correlation)
    return Vec(x * a.y * root, y * a.x - x * a.y * a.correlation, m.z * (a.x * a.y * root))


@inlined
def _sheared_determinant(a: Slopes) -> float:
    return a.x * a.y * math.sqrt(1.0 - a.correlation * a.correlation)


@inlined
def _sheared_direction(w: Vec, a: Slopes) -> Vec:
    root = math.sqrt(1.0 - a.correlation * a.correlation)
    x, y = a.x * w.x, a.y * w.y
    return Vec(x + a.correlation * y, root * y, w.z - a.mean_x * w.x - a.mean_y * w.y)


@inlined
def _sheared_facet(m: Vec, a: Slopes) -> Vec:
    root = math.sqrt(1.0 - a.correlation * a.correlation)
    return Vec(a.x * m.x - a.mean_x * m.z, a.y * (a.correlation * m.x + root * m.y) - a.mean_y * m.z, m.z)


STRAIGHT = Stretching(
    "straight", Alpha, _straight_normal, _straight_determinant, _straight_direction, _straight_facet
)
SHEARED = Stretching(
    "sheared", Slopes, _sheared_normal, _sheared_determinant, _sheared_direction, _sheared_facet
)


class Inversion(NamedTuple):
    """How a number is found whose distribution function has no inverse: Newton's method, kept inside a bracket.

    A lane of a block takes steps until it has settled, so that no lane's number depends on its neighbours.
    """

    begin: Formula
    """(w, u0, u1): where to begin, the bracket's ends, and the value that is looked for."""
    step: Formula
    """(w, at, low, high, target): the next `at`, `low` and `high`, and whether that has settled."""
    finish: Formula
    """(w, at, u1): the normal."""


@dataclass(frozen=True, eq=False)
class SlopeDistribution:
    """A shape-invariant distribution of slopes: its formulas in the standard configuration.

    A normal t may have any length there, and a direction w is what the map has made of one.
    """

    name: str
    normals: Formula
    """(t, size): size² P22(slope) / t.z⁴, the density of normals (eq. 4) where size is 1."""
    projected_area: Formula
    """(w): cos θ (1 + Λ) (eq. 41)."""
    slope: Formula
    """(u): the length of a slope that is drawn from the distribution."""
    visible_normal: Formula | Inversion
    """(w, u0, u1): a normal visible from w (eq. 16), of any length; or how it is found step by step."""
    fitted: str
    """The distribution by whose fit of albedo a lobe of it is compensated: its own, but of an approximation."""


# GGX


@inlined
def ggx_normals(t: Vec, size: float) -> float:
    """Eq. 85: uniform on the sphere, in the standard configuration."""
    ratio = size / dot(t, t)
    return ratio * ratio / math.pi


@inlined
def ggx_projected_area(w: Vec) -> float:
    """Eq. 86."""
    return 0.5 * (w.z + math.sqrt(dot(w, w)))


@inlined
def ggx_slope(u: float) -> float:
    return math.sqrt(u / (1.0 - u))


@inlined
def ggx_visible_normal(w: Vec, u0: float, u1: float) -> Vec:
    """A spherical cap (Dupuy and Benyoub 2023)."""
    d = unit(w)
    # At exactly 1 and normal incidence the normal would have no length.
    z = (1.0 - min(u1, 1.0 - 2.0**-53)) * (1.0 + d.z) - d.z
    sine = math.sqrt(min(max((1.0 - z) * (1.0 + z), 0.0), 1.0))
    sin_phi, cos_phi = sine_cosine(u0)
    return Vec(sine * cos_phi + d.x, sine * sin_phi + d.y, max(z + d.z, 0.0))


# Beckmann


@inlined
def beckmann_normals(t: Vec, size: float) -> float:
    """Eq. 82: cos⁴, where the extracted eq. 68 prints cos²."""
    inverse = 1.0 / (t.z * t.z)
    ratio = size * inverse
    return exponential(-(t.x * t.x + t.y * t.y) * inverse) * ratio * ratio / math.pi


@inlined
def beckmann_projected_area(w: Vec) -> float:
    """cos θ (1 + erf a) / 2 + sine e^(-a²) / (2 sqrt π), a = cos θ / sine (eq. 83)."""
    sine = math.sqrt(w.x * w.x + w.y * w.y)
    return w.z + sine * gaussian_excess(max(w.z, 0.0) / max(sine, 1e-300))


@inlined
def beckmann_rational_projected_area(w: Vec) -> float:
    """Walter's rational fit of Beckmann's Λ (the unnumbered equation after eq. 69)."""
    a = w.z / max(math.sqrt(w.x * w.x + w.y * w.y), 1e-300)
    fit = (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a)
    return w.z * (1.0 + (fit if a < 1.6 else 0.0))


@inlined
def beckmann_slope(u: float) -> float:
    return math.sqrt(-math.log1p(-u))


@inlined
def begin_beckmann(w: Vec, u0: float, u1: float) -> tuple[float, float, float, float]:
    """The slope along w, of which Jakob 2014, "An Improved Visible Normal Sampling Routine for the Beckmann
    Distribution", guesses the error function: c - (1 + c) (1 - u)^p, c being the largest that is seen and p by the
    angle from the normal."""
    sine = math.sqrt(w.x * w.x + w.y * w.y)
    high = min(w.z / max(sine, 1e-300), 9.0)
    largest = 1.0 - exponential(-high * high) * scaled_error_complement(high)
    t = math.sqrt(max(1.0 - w.z / math.sqrt(dot(w, w)), 0.0))
    power = 1.0 + t * (-1.2244 + t * (0.7622 - 0.0931 * t))
    guess = largest - (1.0 + largest) * exponential(power * logarithm(max(1.0 - u0, 1e-16)))
    # At the normal slopes are as they come: the bracket is all that they can be.
    return (
        min(nearly_inverse_error_function(guess), high),
        -9.0,
        high,
        u0 * beckmann_projected_area(w),
    )


@inlined
def step_beckmann(
    w: Vec, at: float, low: float, high: float, target: float
) -> tuple[float, float, float, bool]:
    """One step of Halley's method to where w sees `target` of slopes along it that are less."""
    sine = math.sqrt(w.x * w.x + w.y * w.y)
    falling = exponential(-at * at)
    tail = falling * scaled_error_complement(abs(at))
    below = 0.5 * w.z * (2.0 - tail if at > 0.0 else tail) + sine * falling / (2.0 * SQRT_PI)
    off = below - target
    low, high = (low, at) if off > 0.0 else (at, high)
    seen = w.z - sine * at
    slope = seen * falling / SQRT_PI
    bend = -sine / seen - 2.0 * at
    newton = off / slope
    change = newton / min(max(1.0 - 0.5 * newton * bend, 0.5), 2.0)
    # The error after a step is by its cube: of one as small as this, nothing that float64 tells.
    settles = slope > 0.0 and abs(change) * max(1.0, abs(bend)) <= 1e-6
    step = at - change
    step = step if settles or (slope > 0.0 and low < step and step < high) else 0.5 * (low + high)
    return step, low, high, settles or high - low <= 4e-15


@inlined
def finish_beckmann(w: Vec, at: float, u1: float) -> Vec:
    """From slopes along and across w, of which the latter are Gaussian, back to its azimuth."""
    across = inverse_error_function(2.0 * u1 - 1.0)
    sine = math.sqrt(w.x * w.x + w.y * w.y)
    cos_phi = w.x / sine if sine > 0.0 else 1.0
    sin_phi = w.y / sine if sine > 0.0 else 0.0
    return Vec(-(cos_phi * at - sin_phi * across), -(sin_phi * at + cos_phi * across), 1.0)


_BECKMANN_VISIBLE = Inversion(begin_beckmann, step_beckmann, finish_beckmann)

DISTRIBUTIONS = {
    GGX: SlopeDistribution(GGX, ggx_normals, ggx_projected_area, ggx_slope, ggx_visible_normal, GGX),
    BECKMANN: SlopeDistribution(
        BECKMANN, beckmann_normals, beckmann_projected_area, beckmann_slope, _BECKMANN_VISIBLE, BECKMANN
    ),
    BECKMANN_RATIONAL: SlopeDistribution(
        BECKMANN_RATIONAL,
        beckmann_normals,
        beckmann_rational_projected_area,
        beckmann_slope,
        _BECKMANN_VISIBLE,
        BECKMANN,
    ),
}

#: The names of all distributions.
NAMES = (*DISTRIBUTIONS, PHONG)


# Phong


@inlined
def phong_D(m: Vec, a: Alpha) -> float:
    """D of Blinn-Phong, (e + 2) / 2π cos^e (article 003), anisotropic as Ashikhmin and Shirley's."""
    across = m.x * m.x + m.y * m.y
    z2 = m.z * m.z
    # e cos²φ + f sin²φ, with φ of no consequence at the pole.
    mixed = (m.x * m.x / (a.x * a.x) + m.y * m.y / (a.y * a.y)) * 2.0 / across - 2.0 if across > 0.0 else 0.0
    # ln cos θ from sin²/cos², which keeps its precision near the pole.
    return math.exp(-0.5 * mixed * math.log1p(across / z2)) / (math.pi * a.x * a.y) if z2 > 0.0 else 0.0


@inlined
def phong_normal(a: Alpha, u0: float, u1: float) -> Vec:
    """Ashikhmin and Shirley: the azimuth by stretching a circle, then cos^(e + 2) uniform."""
    sin_phi, cos_phi = sine_cosine(u0)
    x, y = a.x * cos_phi, a.y * sin_phi
    scale = math.sqrt(x * x + y * y)
    x, y = x / scale, y / scale
    power = 2.0 * (x * x / (a.x * a.x) + y * y / (a.y * a.y))
    # tan² θ = u^(-2/power) - 1, without cancelling when the lobe is narrow.
    tangent = math.sqrt(math.expm1(-2.0 / power * math.log(1.0 - min(u1, 1.0 - 2.0**-53))))
    return unit(Vec(x * tangent, y * tangent, 1.0))


@dataclass(frozen=True, eq=False)
class Microsurface:
    """What a lobe asks of a distribution whose slopes it is given; None where the distribution has none of it."""

    name: str
    slopes: type
    D: Formula
    """(m, slopes): of a normal of any length, above the horizon, times its length to the fourth power."""
    normal: Formula
    """(slopes, u0, u1): a unit normal with density D(m) m.n."""
    direction: Formula
    """(direction, slopes): Lᵀ w."""
    seen: Formula | None
    """(direction, slopes): `Seen`."""
    visible_normal: Formula | Inversion | None
    """(direction, slopes, u0, u1): a unit normal visible from the direction (eq. 16)."""

    def wanted(self, field: str) -> Any:
        """A formula; `NotImplementedError` where there is none."""
        value = getattr(self, field)
        if value is None:
            what = {"seen": "projected area in closed form", "visible_normal": "way to draw visible normals"}
            raise NotImplementedError(
                f"{self.name}: there is no {what[field]}, which Smith's masking asks for"
            )
        return value


@cache
def microsurface(distribution: str, sheared: bool = False) -> Microsurface:
    """The formulas of a distribution whose slopes are `Alpha`, or `Slopes` where they are sheared.

    Raises:
        NotImplementedError: a distribution that has none.
    """
    if distribution == PHONG and not sheared:
        return Microsurface(PHONG, Alpha, phong_D, phong_normal, _straight_direction, None, None)
    if distribution not in DISTRIBUTIONS:
        what = "way to shear its slopes" if distribution == PHONG else "distribution of that name"
        raise NotImplementedError(f"{distribution}: there is no {what}")
    return _stretched(DISTRIBUTIONS[distribution], SHEARED if sheared else STRAIGHT)


def _stretched(standard: SlopeDistribution, stretching: Stretching) -> Microsurface:
    name = f"{standard.name} {stretching.name}"
    normals, projected_area, slope = standard.normals, standard.projected_area, standard.slope
    determinant, to_standard = stretching.determinant, stretching.normal
    direction, facet = stretching.direction, stretching.facet

    @inlined
    @named(name)
    def D(m: Vec, a: Any) -> float:
        det = determinant(a)
        return det * normals(to_standard(m, a), det * dot(m, m))

    @inlined
    @named(name)
    def seen(w: Vec, a: Any) -> Seen:
        d = direction(w, a)
        return Seen(d.z, projected_area(d), math.sqrt(d.x * d.x + d.y * d.y))

    @inlined
    @named(name)
    def normal(a: Any, u0: float, u1: float) -> Vec:
        sin_phi, cos_phi = sine_cosine(u0)
        # At u1 = 1 the slope would be infinite.
        size = slope(min(u1, 1.0 - 2.0**-53))
        return unit(facet(Vec(size * cos_phi, size * sin_phi, 1.0), a))

    visible = standard.visible_normal
    if isinstance(visible, Inversion):
        begin, step, finish = visible

        @inlined
        @named(name)
        def begin_stretched(w: Vec, a: Any, u0: float, u1: float) -> tuple[float, float, float, float]:
            return begin(direction(w, a), u0, u1)

        @inlined
        @named(name)
        def step_stretched(
            w: Vec, a: Any, at: float, low: float, high: float, target: float
        ) -> tuple[float, float, float, bool]:
            return step(direction(w, a), at, low, high, target)

        @inlined
        @named(name)
        def finish_stretched(w: Vec, a: Any, at: float, u1: float) -> Vec:
            return unit(facet(finish(direction(w, a), at, u1), a))

        inversion = Inversion(begin_stretched, step_stretched, finish_stretched)
        return Microsurface(name, stretching.slopes, D, normal, direction, seen, inversion)

    @inlined
    @named(name)
    def visible_normal(w: Vec, a: Any, u0: float, u1: float) -> Vec:
        return unit(facet(visible(direction(w, a), u0, u1), a))

    return Microsurface(name, stretching.slopes, D, normal, direction, seen, visible_normal)
