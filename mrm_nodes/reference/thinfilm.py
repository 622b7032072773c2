"""Thin-film reflectance as MaterialX's nodes have it.

Belcour and Barla 2017, "A Practical Extension to Microfacet Theory for the Modeling of Varying
Iridescence", in MaterialX 1.39's form: two terms of the series, vacuum outside, and its rule for what lies
under a Schlick film. The constants of the colour-matching fit and of the change to RGB are those of that
paper and of MaterialX."""

import math

from .compiled import formula
from .fresnel import SCHLICK, index_from_f0, schlick_curve

# Gaussian fits of the colour-matching functions: value, position, variance; X has a second lobe.
VALUE = (5.4856e-13, 4.4201e-13, 5.2481e-13)
POSITION = (1.6810e06, 1.7953e06, 2.2084e06)
VARIANCE = (4.3278e09, 9.3046e09, 6.6121e09)
VALUE_X2, POSITION_X2, VARIANCE_X2 = 9.7470e-14, 2.2399e06, 4.5282e09
NORMALISATION = 1.0685e-7

# XYZ to CIE 1931 RGB, equal-energy white, by columns of the shader's matrix.
RGB_X = (2.3706743, -0.5138850, 0.0052982)
RGB_Y = (-0.9000405, 1.4253036, -0.0146949)
RGB_Z = (-0.4706338, 0.0885814, 1.0093968)

SERIES_TERMS = 2


@formula
def sensitivity(path: float, shift: float, channel: int) -> float:
    """The colour-matching function's Fourier transform at an optical path difference (Belcour and Barla,
    eq. 10).
    """
    phase = 2.0 * math.pi * path
    squared = phase * phase
    result = (
        VALUE[channel]
        * math.sqrt(2.0 * math.pi * VARIANCE[channel])
        * math.cos(POSITION[channel] * phase + shift)
        * math.exp(-VARIANCE[channel] * squared)
    )
    if channel == 0:
        result += (
            VALUE_X2
            * math.sqrt(2.0 * math.pi * VARIANCE_X2)
            * math.cos(POSITION_X2 * phase + shift)
            * math.exp(-VARIANCE_X2 * squared)
        )
    return result / NORMALISATION


@formula
def polarised(cosine: float, n: float, k: float) -> tuple[float, float]:
    """Reflectance (parallel, perpendicular) of an interface with relative index n + ik."""
    c2 = min(max(cosine, 0.0), 1.0) ** 2
    s2 = 1.0 - c2
    t0 = n * n - k * k - s2
    modulus = math.sqrt(t0 * t0 + 4.0 * n * n * k * k)
    twice_a = math.sqrt(max(2.0 * (modulus + t0), 0.0))
    cross = twice_a * cosine
    rs = (modulus + c2 - cross) / (modulus + c2 + cross)
    sum_p = c2 * modulus + s2 * s2
    rp = rs * (sum_p - cross * s2) / (sum_p + cross * s2)
    return rp, rs


@formula
def phase_shifts(cosine: float, near: float, n: float, k: float) -> tuple[float, float]:
    """Phase change (parallel, perpendicular) on reflection from n + ik below a medium of index `near`."""
    ratio = k / n
    s2 = 1.0 - cosine * cosine
    a = n * n * (1.0 - ratio * ratio) - near * near * s2
    b = math.sqrt(a * a + (2.0 * n * n * ratio) ** 2)
    u = math.sqrt(max((a + b) / 2.0, 0.0))
    v = math.sqrt(max((b - a) / 2.0, 0.0))
    perpendicular = math.atan2(2.0 * near * v * cosine, u * u + v * v - (near * cosine) ** 2)
    parallel = math.atan2(
        2.0 * near * n * n * cosine * (2.0 * ratio * u - (1.0 - ratio * ratio) * v),
        (n * n * (1.0 + ratio * ratio) * cosine) ** 2 - near * near * (u * u + v * v),
    )
    return parallel, perpendicular


@formula
def _series(reflectance: float, under: float, path: float, phase: float, channel: int) -> float:
    """One polarisation of the Airy sum: its mean and the first terms of its oscillation (eqs. 3 and 11)."""
    through = 1.0 - reflectance
    # Where both interfaces reflect all, nothing is through the first.
    mean = through * through * under / max(1.0 - reflectance * under, 1e-300)
    amplitude = math.sqrt(max(reflectance * under, 0.0))
    total = reflectance + mean
    factor = mean - through
    for m in range(1, SERIES_TERMS + 1):
        factor *= amplitude
        total += factor * 2.0 * sensitivity(m * path, m * phase, channel)
    return total


@formula
def film_reflectance(
    cosine: float,
    kind: int,
    a0: float,
    a1: float,
    a2: float,
    b0: float,
    b1: float,
    b2: float,
    c0: float,
    c1: float,
    c2: float,
    exponent: float,
    thickness: float,
    film_index: float,
) -> tuple[float, float, float]:
    """RGB reflectance of a film of `thickness` nanometres on a substrate, in [0, 1].

    a, b, c are the substrate's colours: index and extinction for a dielectric or conductor, f0, f82 and f90
    for Schlick."""
    film = max(film_index, 1.0)
    inside = math.sqrt(1.0 - (1.0 - cosine * cosine) / (film * film))
    outer_p, outer_s = polarised(cosine, film, 0.0)
    brewster = math.cos(math.atan(film))
    phase_p = 0.0 if cosine < brewster else math.pi
    path = 2.0 * film * inside * thickness * 1.0e-9
    x = y = z = 0.0
    for channel in range(3):
        a = a0 if channel == 0 else (a1 if channel == 1 else a2)
        b = b0 if channel == 0 else (b1 if channel == 1 else b2)
        c = c0 if channel == 0 else (c1 if channel == 1 else c2)
        if kind == SCHLICK:
            # Unclamped, as MaterialX has it: a dark tint leaves a film a slightly negative substrate, which
            # reflects once but does not interfere.
            under_p = 0.5 * schlick_curve(inside, a, b, c, exponent)
            under_s = under_p
            shift_p = math.pi if index_from_f0(a) < film else 0.0
            shift_s = shift_p
        else:
            under_p, under_s = polarised(inside, a / film, b / film)
            shift_p, shift_s = phase_shifts(inside, film, a, b)
        value = 0.5 * (
            _series(outer_p, under_p, path, shift_p + phase_p, channel)
            + _series(outer_s, under_s, path, shift_s + math.pi, channel)
        )
        if channel == 0:
            x = value
        elif channel == 1:
            y = value
        else:
            z = value
    red = RGB_X[0] * x + RGB_Y[0] * y + RGB_Z[0] * z
    green = RGB_X[1] * x + RGB_Y[1] * y + RGB_Z[1] * z
    blue = RGB_X[2] * x + RGB_Y[2] * y + RGB_Z[2] * z
    return min(max(red, 0.0), 1.0), min(max(green, 0.0), 1.0), min(max(blue, 0.0), 1.0)
