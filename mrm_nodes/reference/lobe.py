"""The lobes of the papers, written once each: what reflects and what refracts, forward or, with v' for v, retro.

Equation numbers are those of 001, Portsmouth et al. 2026, "The Minimal Retroreflective Microfacet Model". A `Facets`
is a distribution with a masking; each function here makes of one a compiled formula of named values, without the
reflectance, which is a factor of its own."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

from .compiled import inlined, named
from .masking import SEPARABLE, SMITH, Masking, masking_of
from .microsurface import Formula, Microsurface, Seen, microsurface
from .vec import Vec, dot, half_vector, length, reflected, refracted


@dataclass(frozen=True, eq=False)
class Facets:
    """A microsurface and how it is masked: all that decides about the shape of a lobe."""

    micro: Microsurface
    masking: Masking
    is_sheared: bool

    @property
    def name(self) -> str:
        """What it is called in an error, and where its machine code is kept."""
        return f"{self.micro.name}, {self.masking.name}"

    @property
    def drawn(self) -> Masking:
        """The masking by which normals are drawn: Smith's where its own belongs to no microsurface."""
        return self.masking if self.masking.is_physical else masking_of(SMITH, SEPARABLE)


@cache
def facets(distribution: str, masking: str, correlation: str, is_sheared: bool) -> Facets:
    """The formulas of what a lobe's arguments name.

    Raises:
        NotImplementedError: a name that has no formulas.
    """
    try:
        return Facets(microsurface(distribution, is_sheared), masking_of(masking, correlation), is_sheared)
    except NotImplementedError as error:
        raise NotImplementedError(f"{distribution}, {masking}, {correlation}: {error}") from None


@inlined
def _not_asked(w: Vec, a: Any) -> Seen:
    return Seen(w.z, 0.0, 0.0)


def seen_by(micro: Microsurface, masking: Masking) -> Formula:
    """(direction, slopes): what a masking asks for of `Seen`."""
    if masking.asks == "area":
        return micro.wanted("seen")
    if masking.asks is None:
        return _not_asked
    direction = micro.direction

    @inlined
    @named(micro.name)
    def sine_seen(w: Vec, a: Any) -> Seen:
        d = direction(w, a)
        return Seen(w.z, 0.0, math.sqrt(d.x * d.x + d.y * d.y))

    return sine_seen


def _visible(of: Facets) -> Formula:
    """(v, m, vm, seen from v): G1(v, m) / (v.n) of the normals that are drawn; 0 where v sees none."""
    masked = of.drawn.masked

    @inlined
    @named(of.micro.name, of.drawn.name)
    def visible(v: Vec, m: Vec, vm: float, p: Seen) -> float:
        g = masked(v, m, vm, p)
        return g if p.cosine > 0.0 else 0.0

    return visible


def _lit(of: Facets) -> Formula:
    """(v, l, m, vm, seen from v, seen from l): G2(v, l, m) / (|v.n| |l.n|) with v and l on one side."""
    same_side = of.masking.same_side
    if not (of.is_sheared and of.masking.asks == "area"):

        @inlined
        @named(of.name)
        def lit(v: Vec, l: Vec, m: Vec, vm: float, p: Seen, q: Seen) -> float:  # noqa: E741
            return same_side(v, l, m, vm, vm, p, q)

        return lit

    @inlined
    @named(of.name)
    def lit_off_the_normal(v: Vec, l: Vec, m: Vec, vm: float, p: Seen, q: Seen) -> float:  # noqa: E741
        # The lit area is the mesosurface's; the caller's cosine is the geometric surface's (Heitz 2014, Section 5.5).
        g = same_side(v, l, m, vm, vm, p, q) * q.cosine / l.z
        return g if min(p.cosine, q.cosine) > 0.0 else 0.0

    return lit_off_the_normal


def _lit_across(of: Facets) -> Formula:
    """(v, l, m, vm, lm, slopes): G2(v, l, m) / (|v.n| |l.n|) with l on the other side than v."""
    seen, across = seen_by(of.micro, of.masking), of.masking.across
    if across is None:
        raise NotImplementedError(f"{of.name}: there is no G2 of v and l on opposite sides")

    @inlined
    @named(of.name)
    def lit(v: Vec, l: Vec, m: Vec, vm: float, lm: float, a: Any) -> float:  # noqa: E741
        p, q = seen(v, a), seen(Vec(-l.x, -l.y, -l.z), a)
        g = across(v, l, m, vm, lm, p, q) * q.cosine / abs(l.z)
        return g if min(p.cosine, q.cosine) > 0.0 else 0.0

    return lit


def reflection(of: Facets) -> Formula:
    """(v, l, slopes, seen from v, seen from l): D(m) G2(v, l, m) / (4 |v.n| |l.n|) at the half vector m (eq. 1), and
    v.m.

    Slopes about the normal are as many as their opposites: what is seen from v is seen from v'."""
    D, lit = of.micro.D, _lit(of)

    @inlined
    @named(of.name)
    def lobe(v: Vec, l: Vec, a: Any, p: Seen, q: Seen) -> tuple[float, float]:  # noqa: E741
        m = half_vector(v, l)
        vm = 0.5 * length(m)
        return 0.25 * D(m, a) * lit(v, l, m, vm, p, q), vm

    return lobe


def reflection_density(of: Facets) -> Formula:
    """(v, l, slopes, seen from v, seen from l): D_v(m) / (4 v.m), the density of l where a visible normal reflects v
    (Section 4, with the Jacobian of eq. 4), and v.m."""
    D, visible = of.micro.D, _visible(of)

    @inlined
    @named(of.name)
    def density(v: Vec, l: Vec, a: Any, p: Seen, q: Seen) -> tuple[float, float]:  # noqa: E741
        m = half_vector(v, l)
        vm = 0.5 * length(m)
        # D_v(m) = G1(v, m) (v.m) D(m) / (v.n) (Heitz 2014, eq. 16).
        return 0.25 * D(m, a) * visible(v, m, vm, p), vm

    return density


@inlined
def _refracting_normal(v: Vec, l: Vec, near: float, far: float) -> tuple[Vec, float, float, float]:  # noqa: E741
    """h_t = -(ηv v + ηl l), turned to the near side (above eq. 2), its squared length, v.m and -l.m."""
    x, y, z = near * v.x + far * l.x, near * v.y + far * l.y, near * v.z + far * l.z
    up = 1.0 if z >= 0.0 else -1.0
    m = Vec(up * x, up * y, up * z)
    mm = dot(m, m)
    size = math.sqrt(mm) if mm > 0.0 else 1.0
    return m, mm, dot(m, v) / size, -dot(m, l) / size


@inlined
def _refracts(v: Vec, l: Vec, m: Vec, vm: float, lm: float, near: float, far: float) -> bool:  # noqa: E741
    """Whether l is across, both directions face the normal, and the index is not 1, where refraction is a delta."""
    return min(min(min(vm, lm), m.z), min(v.z, -l.z)) > 0.0 and near != far


def refraction(of: Facets) -> Formula:
    """(v, l, near index, far index, slopes): eq. 2 without 1 - F, v.m and -l.m; 0 where nothing refracts."""
    D, lit = of.micro.D, _lit_across(of)

    @inlined
    @named(of.name)
    def lobe(v: Vec, l: Vec, near: float, far: float, a: Any) -> tuple[float, float, float]:  # noqa: E741
        m, mm, vm, lm = _refracting_normal(v, l, near, far)
        # (ηv v.h + ηl l.h)² is the squared length of the vector that h was normalised from.
        f = D(m, a) * lit(v, l, m, vm, lm, a) * vm * lm * near * near / mm
        return f if _refracts(v, l, m, vm, lm, near, far) else 0.0, vm, lm

    return lobe


def refraction_density(of: Facets) -> Formula:
    """(v, l, near index, far index, slopes): the density of l where a visible normal refracts v, by the Jacobian of
    eq. 5 with ηl² above; v.m and -l.m."""
    D, visible, seen = of.micro.D, _visible(of), seen_by(of.micro, of.drawn)

    @inlined
    @named(of.name)
    def density(v: Vec, l: Vec, near: float, far: float, a: Any) -> tuple[float, float, float]:  # noqa: E741
        m, mm, vm, lm = _refracting_normal(v, l, near, far)
        p = D(m, a) * visible(v, m, vm, seen(v, a)) * vm * lm * far * far / mm
        return p if _refracts(v, l, m, vm, lm, near, far) else 0.0, vm, lm

    return density


def reflected_share(of: Facets) -> Formula:
    """(v, m, vm, slopes): G2 / G1(v), what of a visible normal's reflection is not shadowed."""
    lit, visible = _lit(of), _visible(of)
    seen, seen_by_drawn = seen_by(of.micro, of.masking), seen_by(of.micro, of.drawn)

    @inlined
    @named(of.name)
    def share(v: Vec, m: Vec, vm: float, a: Any) -> float:
        l = reflected(v, m)  # noqa: E741
        ratio = lit(v, l, m, vm, seen(v, a), seen(l, a)) * l.z / visible(v, m, vm, seen_by_drawn(v, a))
        return ratio if min(vm, l.z) > 0.0 else 0.0

    return share


def refracted_share(of: Facets) -> Formula:
    """(v, m, vm, near index over far index, slopes): G2 / G1(v), what of a visible normal's refraction is not
    shadowed."""
    lit, visible, seen = _lit_across(of), _visible(of), seen_by(of.micro, of.drawn)

    @inlined
    @named(of.name)
    def share(v: Vec, m: Vec, vm: float, ratio: float, a: Any) -> float:
        squared = 1.0 - ratio * ratio * (1.0 - vm * vm)
        lm = math.sqrt(max(squared, 0.0))
        l = refracted(v, m, vm, ratio, lm)  # noqa: E741
        if min(min(vm, squared), -l.z) > 0.0:
            return lit(v, l, m, vm, lm, a) * -l.z / visible(v, m, vm, seen(v, a))
        return 0.0

    return share
