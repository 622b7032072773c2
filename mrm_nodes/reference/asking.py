"""What is asked of a distribution by itself: the symbols of Heitz 2014, over arrays."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from numba import carray  # type: ignore[attr-defined]

from . import parts
from .block import AX, BLOCK, EX, GX, GY, GZ, LOBE, LX, MX, NX, RXY, SIZE, load, store, store_colours
from .compiled import Array, Kernel, KernelPart, call, inlined, named, run
from .lobe import Facets, facets, seen_by
from .parts import normal_at, slopes_of, view_at
from .vec import Vec, dot

D, LAMBDA, G1, G2, PDF, VISIBLE_NORMAL = "D", "Lambda", "G1", "G2", "pdf_visible", "sample_visible"


def _answer(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """Have a part, whose address is the only mode, answer for v, l (or uniforms) and m: numbers, or unit normals."""
    s = np.empty(SIZE)
    v, l, m, alpha, correlation, mean = inputs[0], inputs[1], inputs[2], inputs[3], inputs[4], inputs[5]  # noqa: E741
    numbers, normals = outputs[0], outputs[1]
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        load(s, EX, v, begin, count, first)
        load(s, GX, l, begin, count, first)
        # A part that draws leaves normals, and what is left of a uniform, where these were.
        load(s, LX, l, begin, count, True)
        load(s, NX, m, begin, count, True)
        load(s, AX, alpha, begin, count, first)
        load(s, RXY, correlation, begin, count, first)
        load(s, MX, mean, begin, count, first)
        call(modes[0], s)
        store(s, numbers, LOBE, begin, count)
        store_colours(s, normals, NX, begin, count)
    return 0


ANSWER = Kernel(_answer, 6, 2)


@cache
def part(question: str, distribution: str, masking: str, correlation: str, is_sheared: bool) -> KernelPart:
    """What answers a question, compiled on its first use.

    Raises:
        NotImplementedError: there are no formulas of what is named.
    """
    of = facets(distribution, masking, correlation, is_sheared)
    if question == VISIBLE_NORMAL:
        return parts.part("visible_normals", of)
    return {D: _normals, LAMBDA: _lambda, G1: _masked, G2: _lit, PDF: _density}[question](of)


def _normals(of: Facets) -> KernelPart:
    density, slopes = of.micro.D, slopes_of(of)

    @named("D", of.micro.name)
    def answer(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            m = normal_at(s, i)
            d = density(m, slopes(s, i))
            s[LOBE + i] = d if m.z > 0.0 else 0.0

    return KernelPart(answer)


def _lambda(of: Facets) -> KernelPart:
    """Λ (eqs. 83, 86, 96); infinite where the mesosurface is seen from behind."""
    seen, slopes = of.micro.wanted("seen"), slopes_of(of)

    @named("Lambda", of.micro.name)
    def answer(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            w = seen(view_at(s, i), slopes(s, i))
            s[LOBE + i] = w.area / w.cosine - 1.0 if w.cosine > 0.0 else math.inf

    return KernelPart(answer)


def _g1(of: Facets) -> Any:
    """(w, m, slopes): G1 (eqs. 43, 49, 56, 59)."""
    seen, masked, is_physical = seen_by(of.micro, of.masking), of.masking.masked, of.masking.is_physical

    @named("G1", of.name)
    def g1(w: Vec, m: Vec, a: Any) -> float:
        wm, p = dot(w, m), seen(w, a)
        cosine = p.cosine if is_physical else w.z
        g = masked(w, m, wm, p) * cosine
        return g if min(min(wm, w.z), cosine) > 0.0 else 0.0

    return inlined(g1)


def _masked(of: Facets) -> KernelPart:
    g1, slopes = _g1(of), slopes_of(of)

    @named("G1", of.name)
    def answer(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            s[LOBE + i] = g1(view_at(s, i), normal_at(s, i), slopes(s, i))

    return KernelPart(answer)


def _density(of: Facets) -> KernelPart:
    """Eq. 16, over the mesosurface's cosine, which is the normal's where slopes are centred."""
    g1, density, slopes, direction = _g1(of), of.micro.D, slopes_of(of), of.micro.direction

    @named("pdf", of.name)
    def answer(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            v, m, a = view_at(s, i), normal_at(s, i), slopes(s, i)
            cosine = direction(v, a).z
            p = g1(v, m, a) * max(dot(v, m), 0.0) * density(m, a) / cosine
            s[LOBE + i] = p if min(cosine, m.z) > 0.0 else 0.0

    return KernelPart(answer)


def _lit(of: Facets) -> KernelPart:
    g1, seen, slopes = _g1(of), seen_by(of.micro, of.masking), slopes_of(of)
    same_side, is_physical = of.masking.same_side, of.masking.is_physical
    # What belongs to no microsurface is the product of both maskings on either side.
    across = same_side if of.masking.across is None else of.masking.across

    @named("G2", of.name)
    def answer(scratch: Any) -> None:
        s = carray(scratch, (SIZE,))
        for i in range(BLOCK):
            v, m, a = view_at(s, i), normal_at(s, i), slopes(s, i)
            l = Vec(s[GX + i], s[GY + i], s[GZ + i])  # noqa: E741
            up = -1.0 if l.z < 0.0 else 1.0
            turned = Vec(up * l.x, up * l.y, up * l.z)
            s[LOBE + i] = 0.0
            if g1(v, m, a) > 0.0 and g1(turned, m, a) > 0.0:
                p, q, vm, lm = seen(v, a), seen(turned, a), dot(v, m), dot(turned, m)
                cosines = p.cosine * q.cosine if is_physical else v.z * turned.z
                if l.z < 0.0:
                    s[LOBE + i] = across(v, l if is_physical else turned, m, vm, lm, p, q) * cosines
                else:
                    s[LOBE + i] = same_side(v, l, m, vm, lm, p, q) * cosines

    return KernelPart(answer)


def ask(
    of: KernelPart,
    v: Array,
    l: Array,  # noqa: E741
    m: Array,
    alpha: Array,
    correlation: Array,
    mean: Array,
) -> tuple[Array, Array]:
    """What a part says of arrays that broadcast: numbers (...), and, for uniforms in place of l, normals (..., 3)."""
    (numbers, normals), _ = run(ANSWER, [v, l, m, alpha, correlation, mean], [of.address], [1, 3])
    return numbers[..., 0], normals
