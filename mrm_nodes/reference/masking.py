"""Masking and shadowing: which facets are seen from a direction, and which from two.

Equation numbers are those of Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based
BRDFs", unless another source is named. G is never met alone: G1 comes over the direction's cosine, and G2 over both
cosines, the form in which nothing divides by a vanishing cosine. For slopes off the normal the cosines are those with
the mesosurface (Section 5.5)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

from .compiled import formula, inlined
from .elementary import SQRT_PI
from .microsurface import Formula, Seen
from .vec import Vec, length

SMITH = "smith"
VCAVITY = "vcavity"
IMPLICIT = "implicit"
SCHLICK_SMITH = "schlick-smith"
KELEMEN = "kelemen"

HEIGHT = "height"
SEPARABLE = "separable"
DIRECTION = "direction"
HEIGHT_DIRECTION = "height_direction"


@dataclass(frozen=True, eq=False)
class Masking:
    """The formulas of one masking. Normals m may have any length; vm and lm are cosines with them, above 0."""

    name: str
    masked: Formula
    """(w, m, wm, seen): G1(w, m) / cos w."""
    same_side: Formula
    """(v, l, m, vm, lm, seen from v, seen from l): G2(v, l, m) / (cos v cos l)."""
    across: Formula | None
    """The same with l on the other side than v, -l.m for lm and seen from -l; None where it has no meaning."""
    asks: str | None
    """What it asks of the microsurface: the name of a field of `Seen`, or nothing."""
    is_physical: bool
    """Whether there is a microsurface that is masked so."""


# Smith's masking


@inlined
def smith_masking(w: Vec, m: Vec, wm: float, seen: Seen) -> float:
    """Eq. 43: 1 / (1 + Λ)."""
    return 1.0 / seen.area


@inlined
def height_correlated(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """1 / (1 + Λv + Λl), height-correlated (eq. 99)."""
    return 1.0 / (p.area * q.cosine + q.area * p.cosine - p.cosine * q.cosine)


@inlined
def separable(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """G1 G1 (eq. 98)."""
    return 1.0 / (p.area * q.area)


@inlined
def ginneken(v: Vec, l: Vec) -> float:  # noqa: E741
    """van Ginneken's λ = 4.41 φ / (4.41 φ + 1), φ the azimuth between two directions (below eq. 101)."""
    azimuth = math.atan2(abs(v.x * l.y - v.y * l.x), v.x * l.x + v.y * l.y)
    return 4.41 * azimuth / (4.41 * azimuth + 1.0)


@inlined
def direction_correlated(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """λ G1 G1 + (1 - λ) min(G1, G1) (eq. 100)."""
    apart = ginneken(v, l)
    return apart / (p.area * q.area) + (1.0 - apart) / max(p.area * q.cosine, q.area * p.cosine)


@inlined
def height_direction_correlated(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """1 / (1 + max(Λv, Λl) + λ min(Λv, Λl)) (eq. 101)."""
    both = p.cosine * q.cosine
    lambda_v, lambda_l = p.area * q.cosine - both, q.area * p.cosine - both
    return 1.0 / (both + max(lambda_v, lambda_l) + ginneken(v, l) * min(lambda_v, lambda_l))


@inlined
def separable_across(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    return 1.0 / (p.area * q.area)


@formula
def beta(cv: float, cl: float, area_v: float, area_l: float) -> float:
    """B(1 + Λv, 1 + Λl): height correlation where the two directions are on opposite sides.

    Below the surface a point at height h is unmasked with probability (1 - C)^Λ instead of C^Λ (eq. 128),
    and the average over C of the product is the Beta function."""
    a = area_v / cv
    b = area_l / cl
    return math.exp(math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)) / (cv * cl)


@inlined
def beta_across(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    # Three logarithms of the Gamma function: only where they are asked for.
    if l.z < 0.0 and p.cosine > 0.0 and q.cosine > 0.0:
        return beta(p.cosine, q.cosine, p.area, q.area)
    return 0.0


# V-cavities


@inlined
def vcavity_g1(w: Vec, m: Vec, wm: float) -> float:
    """Eq. 49."""
    return min(1.0, 2.0 * m.z / length(m) * abs(w.z) / wm)


@inlined
def vcavity_masking(w: Vec, m: Vec, wm: float, seen: Seen) -> float:
    return vcavity_g1(w, m, wm) / w.z


@inlined
def vcavity(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """min(G1, G1), which is Cook and Torrance's min(1, M, S)."""
    return min(vcavity_g1(v, m, vm), vcavity_g1(l, m, lm)) / (v.z * l.z)


@inlined
def vcavity_across(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """max(0, G1 + G1 - 1): of a facet, what is hidden from above and what from below lie at opposite ends."""
    return max(0.0, vcavity_g1(v, m, vm) + vcavity_g1(l, m, lm) - 1.0) / (v.z * abs(l.z))


# What belongs to no microsurface


@inlined
def implicit_masking(w: Vec, m: Vec, wm: float, seen: Seen) -> float:
    return 1.0


@inlined
def implicit(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """G2 = cos v cos l (eq. 56)."""
    return 1.0


@inlined
def kelemen_masking(w: Vec, m: Vec, wm: float, seen: Seen) -> float:
    return 1.0 / wm


@inlined
def kelemen(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    """G2 = cos v cos l / (v.m l.m) (eq. 59)."""
    return 1.0 / (vm * lm)


@inlined
def schlick_smith_area(w: Vec, seen: Seen) -> float:
    """cos θ / G1 of Schlick's rational masking (Schlick 1994, eq. 19): k is sqrt(2/π) times the RMS slope."""
    k = seen.sine / math.sqrt(max(1.0 - w.z * w.z, 1e-300)) / SQRT_PI
    return w.z * (1.0 - k) + k


@inlined
def schlick_smith_masking(w: Vec, m: Vec, wm: float, seen: Seen) -> float:
    return 1.0 / schlick_smith_area(w, seen)


@inlined
def schlick_smith(v: Vec, l: Vec, m: Vec, vm: float, lm: float, p: Seen, q: Seen) -> float:  # noqa: E741
    return 1.0 / (schlick_smith_area(v, p) * schlick_smith_area(l, q))


_SMITH = {
    HEIGHT: (height_correlated, beta_across),
    SEPARABLE: (separable, separable_across),
    DIRECTION: (direction_correlated, separable_across),
    HEIGHT_DIRECTION: (height_direction_correlated, beta_across),
}
_OTHERS = {
    VCAVITY: Masking(VCAVITY, vcavity_masking, vcavity, vcavity_across, None, True),
    IMPLICIT: Masking(IMPLICIT, implicit_masking, implicit, None, None, False),
    KELEMEN: Masking(KELEMEN, kelemen_masking, kelemen, None, None, False),
    SCHLICK_SMITH: Masking(SCHLICK_SMITH, schlick_smith_masking, schlick_smith, None, "sine", False),
}


@cache
def masking_of(masking: str, correlation: str) -> Masking:
    """The formulas of a masking; only Smith's knows a correlation.

    Raises:
        NotImplementedError: a masking or a correlation that has none.
    """
    if masking in _OTHERS:
        return _OTHERS[masking]
    if masking != SMITH:
        raise NotImplementedError(f"{masking}: there is no masking of that name")
    if correlation not in _SMITH:
        raise NotImplementedError(f"smith, {correlation}: there is no correlation of that name")
    same_side, across = _SMITH[correlation]
    return Masking(f"{masking} {correlation}", smith_masking, same_side, across, "area", True)
