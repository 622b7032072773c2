"""Fresnel reflectance: dielectric, conductor, and generalised Schlick with the 82-degree tint.

The scalar formulas are compiled; the public functions below them take and return arrays.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from .checks import LARGEST_INDEX, check_shapes, numbers
from .compiled import Array, contracted, formula

DIELECTRIC = 0
CONDUCTOR = 1
SCHLICK = 2


@formula
def dielectric_reflectance(cosine: float, eta: float) -> float:
    """Unpolarised reflectance of a dielectric, `eta` = far / near (article 003, "Fresnel's Law").

    Snell gives the refracted cosine times eta: g = sqrt(eta² - 1 + cosine²); no real g is total internal
    reflection."""
    g_squared = eta * eta - 1.0 + cosine * cosine
    g = math.sqrt(max(g_squared, 0.0))
    perpendicular = (cosine - g) / (cosine + g)
    parallel = (eta * eta * cosine - g) / (eta * eta * cosine + g)
    reflectance = 0.5 * (perpendicular * perpendicular + parallel * parallel)
    return 1.0 if g_squared <= 0.0 else reflectance


@formula
def dielectric_transmittance(near: float, near_index: float, far: float, far_index: float) -> float:
    """1 - reflectance from both cosines, so that it is the same number from either side (001 eq. 11).

    1 - r² = 4ab / (a + b)² for each polarisation, with the same product ab.
    """
    perpendicular = near_index * near + far_index * far
    parallel = far_index * near + near_index * far
    product = 2.0 * near * near_index * far * far_index
    return product * (1.0 / (perpendicular * perpendicular) + 1.0 / (parallel * parallel))


@contracted
def conductor_reflectance(cosine: float, n: float, k: float) -> float:
    """Unpolarised reflectance of a conductor with index n + ik relative to the near medium.

    With a + ib = sqrt((n + ik)² - s²), Rs = |c - (a + ib)|² / |c + (a + ib)|² and Rp = Rs |a + ib - s²/c|²
    / |a + ib + s²/c|² (Born and Wolf, Principles of Optics, section 14.2). Their mean over one denominator,
    with no difference that could fall below 0."""
    c2 = cosine * cosine
    s2 = 1.0 - c2
    t0 = n * n - k * k - s2
    modulus = math.sqrt(t0 * t0 + 4.0 * n * n * k * k)
    a2 = max(0.5 * (modulus + t0), 0.0)
    b2 = max(modulus - a2, 0.0)
    a = math.sqrt(a2)
    minus, plus, product = a - cosine, a + cosine, a * cosine + s2
    above = (minus * minus + b2) * (c2 * modulus + s2 * s2)
    below = (plus * plus + b2) * (product * product + b2 * c2)
    return above / below


# The 82-degree tint acts where cos = 1/7, and is scaled to reach F82 there.
COS_82 = 1.0 / 7.0
TINT_SCALE = 1.0 / (COS_82 * (1.0 - COS_82) ** 6)


@formula
def schlick_curve(cosine: float, f0: float, f82: float, f90: float, exponent: float) -> float:
    """Generalised Schlick with the 82-degree tint (Hoffman 2023, "Generalization of Adobe's Fresnel
    Model").
    """
    away = 1.0 - min(max(cosine, 0.0), 1.0)
    base = f0 + (f90 - f0) * away**exponent
    at_82 = f0 + (f90 - f0) * (1.0 - COS_82) ** exponent
    tint = at_82 * (1.0 - f82) * TINT_SCALE
    squared = away * away
    value: float = base - tint * (1.0 - away) * squared * squared * squared
    return value


@formula
def schlick_reflectance(cosine: float, f0: float, f82: float, f90: float, exponent: float) -> float:
    """`schlick_curve` clamped to [0, 1]: with f82 = 0 it is a little negative just past cos = 1/7."""
    return min(max(schlick_curve(cosine, f0, f82, f90, exponent), 0.0), 1.0)


@formula
def schlick_reflectance_5(cosine: float, f0: float, f82: float, f90: float) -> float:
    """`schlick_reflectance` with the usual exponent, 5, in multiplications."""
    away = 1.0 - min(max(cosine, 0.0), 1.0)
    squared = away * away
    fifth = squared * squared * away
    base = f0 + (f90 - f0) * fifth
    at_82 = f0 + (f90 - f0) * (1.0 - COS_82) ** 5
    tint = at_82 * (1.0 - f82) * TINT_SCALE
    return min(max(base - tint * (1.0 - away) * fifth * away, 0.0), 1.0)


@formula
def index_from_f0(f0: float) -> float:
    """The index of refraction that a Schlick lobe refracts with, as MaterialX derives it: f0 kept to [0.01,
    0.99].
    """
    root = math.sqrt(min(max(f0, 0.01), 0.99))
    return (1.0 + root) / (1.0 - root)


def _index(name: str, value: ArrayLike, open_low: bool = False) -> Array:
    return numbers(name, value, 0.0, LARGEST_INDEX, open_low)


def fresnel_dielectric(cos_theta: ArrayLike, eta: ArrayLike) -> Array:
    """Unpolarised Fresnel reflectance of a dielectric, with total internal reflection.

    Source: Mally, The Microfacet BRDF Model, "Fresnel's Law".

    Args:
        cos_theta: cosine between direction and facet, 0 to 1: (...).
        eta: far over near index, above 0: (...).

    Returns:
        (...), 0 to 1.

    Raises:
        ValueError: an argument outside its range, or shapes that do not broadcast.
    """
    c, eta_array = numbers("cos_theta", cos_theta, 0.0, 1.0), _index("eta", eta, open_low=True)
    check_shapes(cos_theta=c.shape, eta=eta_array.shape)
    g_squared = eta_array**2 - 1.0 + c**2
    g = np.sqrt(np.maximum(g_squared, 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        rs = (c - g) / (c + g)
        rp = (eta_array**2 * c - g) / (eta_array**2 * c + g)
        return np.where(g_squared <= 0.0, 1.0, 0.5 * (rs**2 + rp**2))


def fresnel_conductor(cos_theta: ArrayLike, n: ArrayLike, k: ArrayLike) -> Array:
    """Unpolarised Fresnel reflectance of a conductor with complex index n + ik, relative to the near medium.

    Source: Born and Wolf, Principles of Optics, section 14.2.

    Args:
        cos_theta: cosine between direction and facet, 0 to 1: (...).
        n: real part of the index, above 0: (...).
        k: its imaginary part, at least 0: (...).

    Returns:
        (...), 0 to 1.

    Raises:
        ValueError: an argument outside its range, or shapes that do not broadcast.
    """
    cosine = numbers("cos_theta", cos_theta, 0.0, 1.0)
    index, extinction = _index("n", n, open_low=True), _index("k", k)
    check_shapes(cos_theta=cosine.shape, n=index.shape, k=extinction.shape)
    c2 = cosine**2
    s2 = 1.0 - c2
    t0 = index**2 - extinction**2 - s2
    modulus = np.sqrt(t0**2 + 4.0 * index**2 * extinction**2)
    cross_s = np.sqrt(np.maximum(2.0 * (modulus + t0), 0.0) * c2)
    rs = (modulus + c2 - cross_s) / (modulus + c2 + cross_s)
    sum_p = c2 * modulus + s2**2
    rp = rs * (sum_p - cross_s * s2) / (sum_p + cross_s * s2)
    return np.asarray(0.5 * (rs + rp))


def fresnel_schlick(
    cos_theta: ArrayLike,
    f0: ArrayLike,
    f82: ArrayLike = 1.0,
    f90: ArrayLike = 1.0,
    exponent: ArrayLike = 5.0,
) -> Array:
    """Generalised Schlick reflectance with the 82-degree tint, clamped to [0, 1].

    Source: Hoffman 2023, "Generalization of Adobe's Fresnel Model".

    Args:
        cos_theta: cosine between direction and facet, 0 to 1: (...).
        f0: reflectance at normal incidence, at least 0: (...).
        f82: a tint, at least 0: the reflectance at cos = 1/7 is so many times what it would be without it: (...).
        f90: reflectance at grazing incidence, at least 0: (...).
        exponent: of the curve, at least 0: (...).

    Returns:
        (...), 0 to 1.

    Raises:
        ValueError: an argument outside its range, or shapes that do not broadcast.
    """
    away = 1.0 - numbers("cos_theta", cos_theta, 0.0, 1.0)
    low, tint, high = numbers("f0", f0, 0.0), numbers("f82", f82, 0.0), numbers("f90", f90, 0.0)
    power = numbers("exponent", exponent, 0.0)
    check_shapes(cos_theta=away.shape, f0=low.shape, f82=tint.shape, f90=high.shape, exponent=power.shape)
    base = low + (high - low) * away**power
    at_82 = low + (high - low) * (1.0 - COS_82) ** power
    return np.clip(base - at_82 * (1.0 - tint) * TINT_SCALE * (1.0 - away) * away**6, 0.0, 1.0)
