"""Fresnel reflectance: dielectric, conductor, and generalised Schlick with the 82-degree tint.

The scalar formulas are compiled; the public functions below them take and return arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .checks import LARGEST_INDEX, check_shapes, numbers
from .compiled import Array, Kernel, contracted, formula, inlined, run

DIELECTRIC = 0
CONDUCTOR = 1
SCHLICK = 2


# Of a smaller squared index, sin² is known better than index² - 1.
_THIN = 0.5


@formula
def dielectric_reflectance(cosine: float, eta: float) -> float:
    """Unpolarised reflectance of a dielectric, `eta` = far / near (article 003, "Fresnel's Law").

    Snell gives the refracted cosine times eta: g = sqrt(eta² - s²); no real g is total internal reflection. With
    c² - g² = 1 - eta², Rs = (c - g)² / (c + g)² is (eta² - 1)² / (c + g)⁴, where an index near 1 cancels nothing, and
    Rp is Rs (g c - s²)² / (g c + s²)²."""
    c2, s2 = cosine * cosine, (1.0 - cosine) * (1.0 + cosine)
    over_1 = (eta - 1.0) * (eta + 1.0)
    g2 = eta * eta - s2 if eta * eta < _THIN else over_1 + c2
    g = math.sqrt(max(g2, 0.0))
    # (c + g)²: at c = 0 just what stands above.
    perpendicular = over_1 + 2.0 * cosine * (cosine + g)
    parallel = g * cosine + s2
    below = perpendicular * parallel
    reflectance = over_1 * over_1 * (g2 * c2 + s2 * s2) / (below * below)
    return 1.0 if g2 <= 0.0 else min(reflectance, 1.0)


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
    """Unpolarised reflectance of a conductor with index m = n + ik relative to the near medium.

    With g = a + ib = sqrt(m² - s²), Rs = |c - g|² / |c + g|² and Rp = Rs |g c - s²|² / |g c + s²|² (Born and Wolf,
    Principles of Optics, section 14.2). As in `dielectric_reflectance`, |c - g| is |m² - 1| / |c + g|; and |c + g|² is
    c² + |g|² + 2 c a."""
    c2, s2 = cosine * cosine, (1.0 - cosine) * (1.0 + cosine)
    n2, k2, imaginary = n * n, k * k, n * k
    over_1 = (n - 1.0) * (n + 1.0) - k2
    real = n2 - k2 - s2 if n2 + k2 < _THIN else over_1 + c2
    modulus = math.sqrt(real * real + 4.0 * imaginary * imaginary)
    # a or b, whichever is the root of a sum. Where it is b, a = nk / b, and what is divided by is multiplied by b.
    root = math.sqrt(0.5 * (modulus + abs(real)))
    a, b = (root, 1.0) if real >= 0.0 else (imaginary, root)
    perpendicular = (c2 + modulus) * b + 2.0 * cosine * a
    both = c2 * modulus + s2 * s2
    above = (over_1 * over_1 + 4.0 * imaginary * imaginary) * both * (b * b * b)
    below = perpendicular * perpendicular * (both * b + 2.0 * cosine * a * s2)
    return min(above / below, 1.0) if below > 0.0 else 1.0


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


@formula
def outer_cosine(cosine: float, side: float, index: float) -> float:
    """The cosine on the outside of an interface, -1 where there is none: total internal reflection."""
    squared = 1.0 - index * index * (1.0 - cosine * cosine)
    outer = math.sqrt(max(squared, 0.0))
    return cosine if side > 0.0 else (outer if squared > 0.0 else -1.0)


@dataclass(frozen=True, eq=False)
class Interface:
    """What reflects at a facet."""

    name: str
    kind: int
    reflectance: Callable[..., Any]
    """(outer cosine, a, b, c, exponent): of one colour, and 1 where there is no such cosine."""
    is_grey: bool
    """Whether all colours are reflected alike."""


@inlined
def _dielectric(cosine: float, a: float, b: float, c: float, exponent: float) -> float:
    return dielectric_reflectance(cosine, a) if cosine > 0.0 else 1.0


@inlined
def _conductor(cosine: float, a: float, b: float, c: float, exponent: float) -> float:
    return conductor_reflectance(cosine, a, b)


@inlined
def _schlick(cosine: float, a: float, b: float, c: float, exponent: float) -> float:
    return 1.0 if cosine < 0.0 else schlick_reflectance(cosine, a, b, c, exponent)


@inlined
def _schlick_5(cosine: float, a: float, b: float, c: float, exponent: float) -> float:
    return 1.0 if cosine < 0.0 else schlick_reflectance_5(cosine, a, b, c)


INTERFACES = {
    each.name: each
    for each in (
        Interface("dielectric", DIELECTRIC, _dielectric, True),
        Interface("conductor", CONDUCTOR, _conductor, False),
        Interface("schlick", SCHLICK, _schlick, False),
        Interface("schlick 5", SCHLICK, _schlick_5, False),
    )
}


def interface(kind: int, is_fifth: bool) -> Interface:
    """What reflects by a kind's equation; `is_fifth`: whether each exponent of Schlick's is 5."""
    names = {
        DIELECTRIC: "dielectric",
        CONDUCTOR: "conductor",
        SCHLICK: "schlick 5" if is_fifth else "schlick",
    }
    return INTERFACES[names[kind]]


def _fresnel(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    cosine, x, y, z, exponent = inputs[0], inputs[1], inputs[2], inputs[3], inputs[4]
    out, kind = outputs[0], modes[0]
    for i in range(start, stop):
        c = cosine[i, 0]
        if kind == DIELECTRIC:
            out[i] = dielectric_reflectance(c, x[i, 0])
        elif kind == CONDUCTOR:
            out[i] = conductor_reflectance(c, x[i, 0], y[i, 0])
        elif exponent[i, 0] == 5.0:
            out[i] = schlick_reflectance_5(c, x[i, 0], y[i, 0], z[i, 0])
        else:
            out[i] = schlick_reflectance(c, x[i, 0], y[i, 0], z[i, 0], exponent[i, 0])
    return 0


#: Reflectance for cosines and the parameters of a kind: the formulas of the lobes, over arrays.
FRESNEL = Kernel(_fresnel, 5, 1)

_ONE = np.ones(())


def _reflectance(
    kind: int, cosine: Array, x: Array, y: Array = _ONE, z: Array = _ONE, exponent: Array = _ONE
) -> Array:
    columns = [each[..., np.newaxis] for each in (cosine, x, y, z, exponent)]
    (result,), _ = run(FRESNEL, columns, [kind], [1])
    return result[..., 0]


def _index(name: str, value: ArrayLike, open_low: bool = False) -> Array:
    return numbers(name, value, 0.0, LARGEST_INDEX, open_low)


def fresnel_dielectric(cos_theta: ArrayLike, eta: ArrayLike) -> Array:
    """Unpolarised Fresnel reflectance of a dielectric, with total internal reflection: `dielectric_reflectance`.

    Source: Mally, The Microfacet BRDF Model, "Fresnel's Law".

    Args:
        cos_theta: cosine between direction and facet, 0 to 1: (...).
        eta: far over near index, above 0: (...).

    Returns:
        (...), 0 to 1.

    Raises:
        ValueError: an argument outside its range, or shapes that do not broadcast.
    """
    cosine, index = numbers("cos_theta", cos_theta, 0.0, 1.0), _index("eta", eta, open_low=True)
    check_shapes(cos_theta=cosine.shape, eta=index.shape)
    return _reflectance(DIELECTRIC, cosine, index)


def fresnel_conductor(cos_theta: ArrayLike, n: ArrayLike, k: ArrayLike) -> Array:
    """Unpolarised Fresnel reflectance of a conductor with complex index n + ik, relative to the near medium:
    `conductor_reflectance`. Where k is 0 it is the dielectric's.

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
    return _reflectance(CONDUCTOR, cosine, index, extinction)


def fresnel_schlick(
    cos_theta: ArrayLike,
    f0: ArrayLike,
    f82: ArrayLike = 1.0,
    f90: ArrayLike = 1.0,
    exponent: ArrayLike = 5.0,
) -> Array:
    """Generalised Schlick reflectance with the 82-degree tint, clamped to [0, 1]: `schlick_reflectance`.

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
    cosine = numbers("cos_theta", cos_theta, 0.0, 1.0)
    low, tint, high = numbers("f0", f0, 0.0), numbers("f82", f82, 0.0), numbers("f90", f90, 0.0)
    power = numbers("exponent", exponent, 0.0)
    check_shapes(cos_theta=cosine.shape, f0=low.shape, f82=tint.shape, f90=high.shape, exponent=power.shape)
    return _reflectance(SCHLICK, cosine, low, tint, high, power)
