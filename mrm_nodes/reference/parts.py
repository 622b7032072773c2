"""What is compiled of formulas for a block of configurations: for each question a loop over lanes that is made from the
lobe's formula, and the list of those that are compiled ahead.

A part takes named values from rows, and leaves what a formula says in rows. It is compiled for one kind of facets, or
for one interface, and a kernel calls it by its address: so what these may be adds up and does not multiply."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from numba import carray  # type: ignore[attr-defined]

from . import lobe
from .block import (
    A0,
    A1,
    A2,
    AT,
    AX,
    AY,
    B0,
    B1,
    B2,
    BLOCK,
    BOTH,
    C0,
    C1,
    C2,
    COATED,
    COSINE,
    EX,
    EXPONENT,
    EY,
    EZ,
    FAR_COSINE,
    FB,
    FG,
    FILM,
    FILM_INDEX,
    FORWARD,
    FR,
    GX,
    GY,
    GZ,
    HIGH,
    INDEX,
    LOBE,
    LOW,
    LX,
    LY,
    LZ,
    MX,
    MY,
    NX,
    NY,
    NZ,
    OUTER,
    REFLECT,
    REFLECTED,
    REFRACTED,
    RETRO_COSINE,
    RETRO_FAR_COSINE,
    RETRO_LOBE,
    RETRO_SHARE,
    RXY,
    SETTLED,
    SIDE,
    SIZE,
    TARGET,
    TRANSMIT,
    TURNS,
    VM,
    WEIGHT,
    Modes,
)
from .checks import PAIRS
from .compiled import KERNELS, KernelPart, inlined, named
from .fresnel import INTERFACES, Interface, interface
from .lobe import Facets, facets, seen_by
from .masking import HEIGHT, Masking
from .microsurface import Alpha, Formula, Inversion, Slopes
from .thinfilm import film_reflectance
from .vec import Vec, dot, turned

#: Most steps that a lane takes to settle.
STEPS = 60


@inlined
def view_at(s: Any, i: int) -> Vec:
    return Vec(s[EX + i], s[EY + i], s[EZ + i])


@inlined
def _light_at(s: Any, i: int) -> Vec:
    return Vec(s[GX + i], s[GY + i], s[GZ + i])


@inlined
def normal_at(s: Any, i: int) -> Vec:
    return Vec(s[NX + i], s[NY + i], s[NZ + i])


@inlined
def _alpha(s: Any, i: int) -> Alpha:
    return Alpha(s[AX + i], s[AY + i])


@inlined
def _slopes(s: Any, i: int) -> Slopes:
    return Slopes(s[AX + i], s[AY + i], s[RXY + i], s[MX + i], s[MY + i])


def slopes_of(of: Facets) -> Formula:
    return _slopes if of.micro.slopes is Slopes else _alpha


def _reflecting(formula: Formula, masking: Masking, of: Facets, question: str) -> KernelPart:
    """A lobe's value and v.m: forward into `LOBE` and `OUTER`, where what reflects looks for it, retro into
    `RETRO_LOBE` and `RETRO_COSINE`; 0 where v or l is below."""
    slopes, seen = slopes_of(of), seen_by(of.micro, masking)

    @named(question, of.name)
    def part(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        if s[RETRO_SHARE] == 0.0:
            for i in range(BLOCK):
                v, l, a = view_at(s, i), _light_at(s, i), slopes(s, i)  # noqa: E741
                value, cosine = formula(v, l, a, seen(v, a), seen(l, a))
                # What does not reflect may not even have a half vector: nothing computed from it is kept.
                s[LOBE + i] = value if min(v.z, l.z) > 0.0 else 0.0
                s[OUTER + i] = cosine
        else:
            for i in range(BLOCK):
                v, l, a = view_at(s, i), _light_at(s, i), slopes(s, i)  # noqa: E741
                p, q = seen(v, a), seen(l, a)
                value, cosine = formula(v, l, a, p, q)
                retro, retro_cosine = formula(turned(v), l, a, p, q)
                is_lit = min(v.z, l.z) > 0.0
                s[LOBE + i] = value if is_lit else 0.0
                s[OUTER + i] = cosine
                s[RETRO_LOBE + i] = retro if is_lit else 0.0
                s[RETRO_COSINE + i] = retro_cosine

    return KernelPart(part)


def _refracting(formula: Formula, of: Facets, question: str) -> KernelPart:
    """A lobe's value, v.m and -l.m, forward and, where a retro share refracts by itself, retro."""
    slopes = slopes_of(of)

    @named(question, of.name)
    def part(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        if s[FORWARD] > 0.0 or s[TURNS] == 0.0:
            for i in range(BLOCK):
                near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
                far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
                value, cosine, far_cosine = formula(view_at(s, i), _light_at(s, i), near, far, slopes(s, i))
                s[LOBE + i] = value
                s[COSINE + i] = cosine
                s[FAR_COSINE + i] = far_cosine
        if s[RETRO_SHARE] > 0.0 and s[TURNS] > 0.0:
            for i in range(BLOCK):
                near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
                far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
                value, cosine, far_cosine = formula(
                    turned(view_at(s, i)), _light_at(s, i), near, far, slopes(s, i)
                )
                s[RETRO_LOBE + i] = value
                s[RETRO_COSINE + i] = cosine
                s[RETRO_FAR_COSINE + i] = far_cosine

    return KernelPart(part)


@inlined
def _keep_normal(s: Any, i: int, v: Vec, m: Vec, is_seen: bool) -> None:
    cosine = min(dot(v, m), 1.0)
    s[NX + i], s[NY + i], s[NZ + i] = m.x, m.y, m.z
    s[VM + i] = cosine if is_seen and cosine > 0.0 else 0.0


def _visible_normals(of: Facets) -> KernelPart:
    """Unit normals visible from v for the uniforms in the rows of l, and v.m, 0 where none is seen."""
    slopes, name = slopes_of(of), named("visible_normals", of.micro.name, of.drawn.name)
    if of.drawn.asks is None:
        normal = of.micro.normal

        @name
        def cavities(scratch: Any) -> None:
            """A cavity by the area of the geometric surface that it covers, then one of its two facets by how much of
            each is seen (Heitz and d'Eon 2014); what is left of the third uniform stays in its row."""
            s = carray(scratch, (SIZE,))
            for i in range(BLOCK):
                v, m = view_at(s, i), normal(slopes(s, i), s[LX + i], s[LY + i])
                near, other = max(dot(v, m), 0.0), max(dot(turned(v), m), 0.0)
                chance = other / (near + other) if near + other > 0.0 else 0.0
                u = s[LZ + i]
                is_other = u < chance
                s[LZ + i] = u / chance if is_other else (u - chance) / (1.0 - chance)
                _keep_normal(s, i, v, turned(m) if is_other else m, v.z > 0.0)

        return KernelPart(cavities)
    visible, direction = of.micro.wanted("visible_normal"), of.micro.direction
    if isinstance(visible, Inversion):
        begin, step, finish = visible

        @name
        def invert(scratch: Any) -> None:
            s = carray(scratch, (SIZE,))
            for i in range(BLOCK):
                s[AT + i], s[LOW + i], s[HIGH + i], s[TARGET + i] = begin(
                    view_at(s, i), slopes(s, i), s[LX + i], s[LY + i]
                )
                s[SETTLED + i] = 0.0
            for _ in range(STEPS):
                settled = 0
                for i in range(BLOCK):
                    is_settled = s[SETTLED + i] > 0.0
                    at, low, high, settles = step(
                        view_at(s, i), slopes(s, i), s[AT + i], s[LOW + i], s[HIGH + i], s[TARGET + i]
                    )
                    s[AT + i] = s[AT + i] if is_settled else at
                    s[LOW + i] = s[LOW + i] if is_settled else low
                    s[HIGH + i] = s[HIGH + i] if is_settled else high
                    is_settled = is_settled or settles
                    s[SETTLED + i] = 1.0 if is_settled else 0.0
                    settled += 1 if is_settled else 0
                if settled == BLOCK:
                    break
            for i in range(BLOCK):
                v, a = view_at(s, i), slopes(s, i)
                is_seen = v.z > 0.0 and direction(v, a).z > 0.0
                _keep_normal(s, i, v, finish(v, a, s[AT + i], s[LY + i]), is_seen)

        return KernelPart(invert)

    @name
    def draw(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            v, a = view_at(s, i), slopes(s, i)
            is_seen = v.z > 0.0 and direction(v, a).z > 0.0
            _keep_normal(s, i, v, visible(v, a, s[LX + i], s[LY + i]), is_seen)

    return KernelPart(draw)


def _quadrature_normals(of: Facets) -> KernelPart:
    """Unit normals, v.m and weights for averages over those that are seen from v, by nodes in the rows of l: u0, u1
    and a weight.

    Where visible normals need an equation solved for each, they are drawn from all normals, and weighed."""
    slopes, name = slopes_of(of), named("quadrature_normals", of.micro.name, of.drawn.name)
    normal, visible = of.micro.normal, of.micro.visible_normal
    if of.drawn.asks is None:

        @name
        def cavities(scratch: Any) -> None:
            s = carray(scratch, (SIZE,))
            for i in range(BLOCK):
                v, m = view_at(s, i), normal(slopes(s, i), s[LX + i], s[LY + i])
                # The nodes hold both facets of each cavity, so each stands for itself by how much of it is seen.
                near, other = max(dot(v, m), 0.0), max(dot(turned(v), m), 0.0)
                s[WEIGHT + i] = s[LZ + i] * (near / (near + other)) if near > 0.0 else 0.0
                _keep_normal(s, i, v, m, True)

        return KernelPart(cavities)
    if visible is None or isinstance(visible, Inversion):

        @name
        def weigh(scratch: Any) -> None:
            s = carray(scratch, (SIZE,))
            for i in range(BLOCK):
                v, m = view_at(s, i), normal(slopes(s, i), s[LX + i], s[LY + i])
                s[WEIGHT + i] = s[LZ + i] * (max(dot(v, m), 0.0) / m.z)
                _keep_normal(s, i, v, m, True)

        return KernelPart(weigh)

    @name
    def draw(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            v = view_at(s, i)
            s[WEIGHT + i] = s[LZ + i]
            _keep_normal(s, i, v, visible(v, slopes(s, i), s[LX + i], s[LY + i]), True)

    return KernelPart(draw)


def _reflected_share(of: Facets) -> KernelPart:
    share, slopes = lobe.reflected_share(of), slopes_of(of)

    @named("reflected_share", of.name)
    def part(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            s[REFLECTED + i] = share(view_at(s, i), normal_at(s, i), s[VM + i], slopes(s, i))

    return KernelPart(part)


def _refracted_share(of: Facets) -> KernelPart:
    share, slopes = lobe.refracted_share(of), slopes_of(of)

    @named("refracted_share", of.name)
    def part(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            ratio = 1.0 / s[INDEX + i] if s[SIDE + i] > 0.0 else s[INDEX + i]
            s[REFRACTED + i] = share(view_at(s, i), normal_at(s, i), s[VM + i], ratio, slopes(s, i))

    return KernelPart(part)


@cache
def reflectance(of: Interface) -> KernelPart:
    """Reflectance of an interface at its outer cosine, the same from either side, or of its film: `OUTER` into `FR`,
    `FG`, `FB`."""
    reflects, kind, is_grey = of.reflectance, of.kind, of.is_grey

    @named("reflectance", of.name)
    def part(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        if is_grey:
            for i in range(BLOCK):
                f = reflects(s[OUTER + i], s[A0 + i], s[B0 + i], s[C0 + i], s[EXPONENT + i])
                s[FR + i] = f
                s[FG + i] = f
                s[FB + i] = f
        else:
            for i in range(BLOCK):
                s[FR + i] = reflects(s[OUTER + i], s[A0 + i], s[B0 + i], s[C0 + i], s[EXPONENT + i])
                s[FG + i] = reflects(s[OUTER + i], s[A1 + i], s[B1 + i], s[C1 + i], s[EXPONENT + i])
                s[FB + i] = reflects(s[OUTER + i], s[A2 + i], s[B2 + i], s[C2 + i], s[EXPONENT + i])
        if s[COATED] > 0.0:
            for i in range(BLOCK):
                if s[FILM + i] > 0.0 and s[OUTER + i] > 0.0:
                    s[FR + i], s[FG + i], s[FB + i] = film_reflectance(
                        min(s[OUTER + i], 1.0), kind,
                        s[A0 + i], s[A1 + i], s[A2 + i], s[B0 + i], s[B1 + i], s[B2 + i],
                        s[C0 + i], s[C1 + i], s[C2 + i], s[EXPONENT + i], s[FILM + i], s[FILM_INDEX + i],
                    )  # fmt: skip

    return KernelPart(part)


_MAKE: dict[str, Callable[[Facets], KernelPart]] = {
    "reflection": lambda of: _reflecting(lobe.reflection(of), of.masking, of, "reflection"),
    "refraction": lambda of: _refracting(lobe.refraction(of), of, "refraction"),
    "reflection_density": lambda of: _reflecting(
        lobe.reflection_density(of), of.drawn, of, "reflection_density"
    ),
    "refraction_density": lambda of: _refracting(lobe.refraction_density(of), of, "refraction_density"),
    "visible_normals": _visible_normals,
    "quadrature_normals": _quadrature_normals,
    "reflected_share": _reflected_share,
    "refracted_share": _refracted_share,
}
#: The parts that a question needs of what reflects, and of what refracts.
QUESTIONS = {
    "eval": (("reflection",), ("refraction",)),
    "pdf": (("reflection_density",), ("refraction_density",)),
    "sample": (
        ("visible_normals", "reflection", "reflection_density"),
        ("visible_normals", "refraction", "refraction_density", "refracted_share"),
    ),
    "albedo": (("quadrature_normals", "reflected_share"), ("quadrature_normals", "refracted_share")),
    "reflectance": ((), ()),
}


@cache
def part(name: str, of: Facets) -> KernelPart:
    """One of the parts of a kind of facets.

    Raises:
        NotImplementedError: the facets have not the formulas that it takes.
    """
    return _MAKE[name](of)


def names_of(question: str, scatter: int) -> list[str]:
    """The parts that answer a question of a lobe that reflects, transmits or does both."""
    reflects, refracts = QUESTIONS[question]
    asked = (reflects if scatter != TRANSMIT else ()) + (refracts if scatter != REFLECT else ())
    return list(dict.fromkeys(asked))


def answering(question: str, modes: Modes, of: Facets, is_fifth: bool) -> Modes:
    """What a kernel is told to answer a question: the addresses of the parts, compiled where they were not yet.

    Raises:
        NotImplementedError: as `part`.
    """
    made = {name: part(name, of) for name in names_of(question, modes.scatter)}
    addresses = {name: each.address for name, each in made.items()}
    return modes._replace(reflectance=reflectance(interface(modes.kind, is_fifth)).address, **addresses)


def _ahead() -> list[KernelPart]:
    """What is compiled ahead: what evaluates every pair of distribution and masking that a MaterialX node may be, with
    alphas along the axes. Any other is compiled on its first use."""
    made = [reflectance(each) for each in INTERFACES.values()]
    for distribution, masking in PAIRS:
        of = facets(distribution, masking, HEIGHT, False)
        made += [part(name, of) for name in names_of("eval", BOTH)]
    return made


KERNELS.extend(_ahead())
