"""The loops over arrays: evaluate, density, draw, integrate, reflectance.

Equation numbers are those of 001, "The Minimal Retroreflective Microfacet Model".
"""

import math
from typing import Any

import numpy as np

from . import energy_formulas as energy
from . import microsurface as surface
from . import passes
from .block import (
    ALBEDO,
    AX,
    AY,
    BLOCK,
    BOTH,
    COMPENSATION,
    DISTRIBUTION,
    EX,
    EY,
    EZ,
    FB,
    FG,
    FORWARD,
    FR,
    GX,
    GZ,
    HH,
    HZ,
    IN_L,
    IN_NODES,
    IN_TABLE,
    IN_V,
    INDEX,
    KIND,
    LH,
    LX,
    LY,
    LZ,
    MASKING,
    MX,
    MY,
    OB,
    OG,
    OR,
    OUTER,
    PB,
    PG,
    PR,
    REFLECT,
    RETRO,
    RETRO_SHARE,
    RETRO_TRANSMISSION,
    RXY,
    SCATTER,
    SIDE,
    SIZE,
    T0,
    TB,
    TG,
    TR,
    TRANSMIT,
    VARIES,
    VH,
    VISIBLE,
    VX,
    D,
    Parameters,
    ask_ahead,
    clear,
    load_directions,
    load_parameters,
    store,
    store_colours,
)
from .compiled import Array, Kernel, formula, inlined
from .fresnel import CONDUCTOR, DIELECTRIC
from .sampling import sample_normal, sample_visible_smith
from .single import draw_one, scattered

INPUTS = 2 + len(Parameters._fields) + 1
SMALLEST_NORMAL = float(np.finfo(np.float64).tiny)


@inlined
def _load(s: Array, inputs: Any, modes: Any, begin: int, count: int, first: bool) -> None:
    """The parameters of a block, and the index that follows from them, unless the last block's are the same."""
    if first or s[VARIES] > 0.0:
        load_parameters(s, inputs, begin, count, first)
        passes.indices(s, modes)


@formula
def _reflect(s: Array, modes: Any, retro: bool) -> None:
    """Add one reflection lobe (eq. 1), times its share of the blend."""
    passes.reflecting_normal(s, modes)
    passes.visibility(s, modes)
    passes.reflecting_cosine(s, modes)
    passes.fresnel(s, modes)
    if modes[COMPENSATION] == energy.MATERIALX_1_39_5:
        passes.compensate(s, FR)
    for i in range(BLOCK):
        share = s[RETRO + i] if retro else 1.0 - s[RETRO + i]
        lit = min(min(s[EZ + i], s[GZ + i]), share) > 0.0
        lobe = 0.25 * share * s[D + i] * s[VISIBLE + i]
        red, green, blue = lobe * s[FR + i], lobe * s[FG + i], lobe * s[FB + i]
        # What does not reflect may not even have a half vector: nothing computed from it is kept.
        s[OR + i] += red if lit else 0.0
        s[OG + i] += green if lit else 0.0
        s[OB + i] += blue if lit else 0.0


@formula
def _finish_reflection(s: Array, modes: Any, table: Array) -> None:
    """The compensations that are the same for both lobes."""
    scheme = modes[COMPENSATION]
    if scheme == energy.MATERIALX_1_39_6 or scheme == energy.TURQUIN:
        passes.typical_reflectance(s, modes)
        passes.compensate(s, OR)
    elif scheme == energy.KULLA_CONTY:
        passes.multiple_reflectance(s, modes, table)
        passes.look_up(s, GX, LH, table)
        for i in range(BLOCK):
            lit = min(s[EZ + i], s[GZ + i]) > 0.0
            lost = (1.0 - s[ALBEDO + i]) * (1.0 - s[LH + i]) / math.pi if lit else 0.0
            s[OR + i] += lost * s[TR + i]
            s[OG + i] += lost * s[TG + i]
            s[OB + i] += lost * s[TB + i]


@formula
def _refract(s: Array, modes: Any, retro: bool) -> None:
    """Add one transmission lobe (eq. 2), times its share."""
    passes.refracting_normal(s)
    passes.normals(s, modes)
    passes.visibility_across(s, modes)
    passes.transmittance(s, modes)
    for i in range(BLOCK):
        share = s[RETRO + i] if retro else 1.0 - s[RETRO + i]
        share = share if modes[RETRO_TRANSMISSION] != 0 else 1.0
        near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
        # (ηv v.h + ηl l.h)² is the squared length of the vector that h was normalised from.
        lobe = share * s[D + i] * s[VISIBLE + i] * s[VH + i] * s[LH + i] * near * near / s[HH + i]
        red, green, blue = lobe * s[FR + i], lobe * s[FG + i], lobe * s[FB + i]
        lit = min(_refracts(s, i), share) > 0.0
        s[OR + i] += red if lit else 0.0
        s[OG + i] += green if lit else 0.0
        s[OB + i] += blue if lit else 0.0


@formula
def _refracts(s: Array, i: int) -> float:
    """Above 0 where l is across, both directions face the normal, and the index is not 1, where refraction
    is a delta.
    """
    facing = min(min(s[VH + i], s[LH + i]), s[HZ + i])
    across = min(s[EZ + i], -s[GZ + i])
    all_of: float = min(min(facing, across), abs(s[INDEX + i] - 1.0))
    return all_of


@formula
def _any_across(s: Array) -> bool:
    found = 0.0
    for i in range(BLOCK):
        found += 1.0 if s[GZ + i] < 0.0 else 0.0
    return found > 0.0


@formula
def _evaluate_block(s: Array, modes: Any, table: Array) -> None:
    """f(v, l) of the whole lobe into the result's rows."""
    for i in range(3 * BLOCK):
        s[OR + i] = 0.0
    if modes[MASKING] != surface.VCAVITY:
        passes.areas(s, modes)
    forward, retro = s[FORWARD] > 0.0, s[RETRO_SHARE] > 0.0
    if modes[SCATTER] != TRANSMIT:
        for lobe in range(2):
            if (lobe == 1 and not retro) or (lobe == 0 and not forward):
                continue
            if lobe == 1:
                passes.turn(s)
            _reflect(s, modes, lobe == 1)
            if lobe == 1:
                passes.turn(s)
        _finish_reflection(s, modes, table)
    if modes[SCATTER] != REFLECT and _any_across(s):
        turned = modes[RETRO_TRANSMISSION] != 0
        for lobe in range(2):
            if (lobe == 1 and not (turned and retro)) or (lobe == 0 and turned and not forward):
                continue
            if lobe == 1:
                passes.turn(s)
            _refract(s, modes, lobe == 1)
    if modes[KIND] == DIELECTRIC:
        for i in range(3 * BLOCK):
            s[OR + i] *= s[T0 + i]


@formula
def _plain_colours(s: Array, modes: Any) -> None:
    """The tinted reflectance at OUTER, which holds v.h, times VISIBLE."""
    if modes[KIND] != CONDUCTOR:
        for i in range(BLOCK):
            s[OUTER + i] = passes.outer_cosine(s[OUTER + i], s[SIDE + i], s[INDEX + i])
    passes.fresnel(s, modes)
    if modes[KIND] == DIELECTRIC:
        for i in range(3 * BLOCK):
            s[FR + i] *= s[T0 + i]


@formula
def _evaluate_plain(s: Array, modes: Any, v: Array, l: Array, out: Array, start: int) -> int:  # noqa: E741
    """`_evaluate_block` of what is `passes.plain`, from directions in one piece straight to the result."""
    if start < 0:
        return 0
    forward, retro = s[FORWARD] > 0.0, s[RETRO_SHARE] > 0.0
    rejected = 0
    if forward:
        rejected = passes.plain_lobe(s, modes, v, l, start, 1.0)
        _plain_colours(s, modes)
        if retro:
            for i in range(BLOCK):
                s[OR + i] = s[VISIBLE + i] * s[FR + i]
                s[OG + i] = s[VISIBLE + i] * s[FG + i]
                s[OB + i] = s[VISIBLE + i] * s[FB + i]
    if retro:
        rejected = passes.plain_lobe(s, modes, v, l, start, -1.0)
        _plain_colours(s, modes)
    if forward and retro:
        for i in range(BLOCK):
            out[start + 3 * i] = s[OR + i] + s[VISIBLE + i] * s[FR + i]
            out[start + 3 * i + 1] = s[OG + i] + s[VISIBLE + i] * s[FG + i]
            out[start + 3 * i + 2] = s[OB + i] + s[VISIBLE + i] * s[FB + i]
    else:
        for i in range(BLOCK):
            out[start + 3 * i] = s[VISIBLE + i] * s[FR + i]
            out[start + 3 * i + 1] = s[VISIBLE + i] * s[FG + i]
            out[start + 3 * i + 2] = s[VISIBLE + i] * s[FB + i]
    return rejected


def evaluate(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """f(v, l) of the whole lobe into `outputs[0]`; returns how many directions were not of unit length."""
    s = np.empty(SIZE)
    # Taken out of their tuples once: each time costs a count of references.
    v, l, dense_v, dense_l = inputs[IN_V], inputs[IN_L], dense[0], dense[1]  # noqa: E741
    table, out = inputs[IN_TABLE], outputs[0]
    plain = passes.plain(modes) and dense_v.size > 0 and dense_l.size > 0
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        ask_ahead(out, 3 * begin)
        _load(s, inputs, modes, begin, count, first)
        if plain and count == BLOCK:
            ask_ahead(dense_v, 3 * (begin + BLOCK))
            ask_ahead(dense_l, 3 * (begin + BLOCK))
            rejected += _evaluate_plain(s, modes, dense_v, dense_l, out, 3 * begin)
            continue
        load_directions(s, VX, v, dense_v, begin, count, first)
        load_directions(s, LX, l, dense_l, begin, count, first)
        rejected += passes.place(s, modes, True)
        passes.white_albedo(s, modes, table)
        _evaluate_block(s, modes, table)
        store_colours(s, out, OR, begin, count)
    return rejected


EVALUATE = Kernel(evaluate, INPUTS, 1)


@formula
def _reflection_density(s: Array, modes: Any, retro: bool) -> None:
    """Add the density of l where a visible normal reflects v (Section 4, with the Jacobian of eq. 4)."""
    passes.reflecting_normal(s, modes)
    passes.visible_density(s, modes)
    both = modes[SCATTER] == BOTH
    if both:
        passes.reflecting_cosine(s, modes)
        passes.fresnel(s, modes)
    for i in range(BLOCK):
        share = s[RETRO + i] if retro else 1.0 - s[RETRO + i]
        lit = min(min(s[EZ + i], s[GZ + i]), share) > 0.0
        chance = (s[FR + i] + s[FG + i] + s[FB + i]) / 3.0 if both else 1.0
        density = 0.25 * share * chance * s[VISIBLE + i]
        s[OR + i] += density if lit else 0.0


@formula
def _refraction_density(s: Array, modes: Any, retro: bool) -> None:
    """Add the density of l where a visible normal refracts v: the Jacobian is eq. 5 with ηl² above."""
    passes.refracting_normal(s)
    passes.normals(s, modes)
    passes.visible_density(s, modes)
    both = modes[SCATTER] == BOTH
    if both:
        passes.transmittance(s, modes)
    for i in range(BLOCK):
        share = s[RETRO + i] if retro else 1.0 - s[RETRO + i]
        share = share if modes[RETRO_TRANSMISSION] != 0 else 1.0
        far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
        chance = (s[FR + i] + s[FG + i] + s[FB + i]) / 3.0 if both else 1.0
        density = share * chance * s[VISIBLE + i] * s[VH + i] * s[LH + i] * far * far / s[HH + i]
        s[OR + i] += density if min(_refracts(s, i), share) > 0.0 else 0.0


@formula
def _density_block(s: Array, modes: Any) -> None:
    """The density of `draw` into the result's first row."""
    clear(s, OR)
    if modes[MASKING] != surface.VCAVITY:
        passes.areas(s, modes)
    forward, retro = s[FORWARD] > 0.0, s[RETRO_SHARE] > 0.0
    if modes[SCATTER] != TRANSMIT:
        for lobe in range(2):
            if (lobe == 1 and not retro) or (lobe == 0 and not forward):
                continue
            if lobe == 1:
                passes.turn(s)
            _reflection_density(s, modes, lobe == 1)
            if lobe == 1:
                passes.turn(s)
    if modes[SCATTER] != REFLECT and _any_across(s):
        turned = modes[RETRO_TRANSMISSION] != 0
        for lobe in range(2):
            if (lobe == 1 and not (turned and retro)) or (lobe == 0 and turned and not forward):
                continue
            if lobe == 1:
                passes.turn(s)
            _refraction_density(s, modes, lobe == 1)
    if modes[COMPENSATION] == energy.KULLA_CONTY and modes[SCATTER] != TRANSMIT:
        for i in range(BLOCK):
            lost = 1.0 - s[ALBEDO + i]
            lit = min(s[EZ + i], s[GZ + i]) > 0.0
            diffuse = lost * s[GZ + i] / math.pi
            s[OR + i] = (1.0 - lost) * s[OR + i] + (diffuse if lit else 0.0)


def density(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """The density per steradian of what `draw` draws, into `outputs[0]`; returns as `evaluate` does."""
    s = np.empty(SIZE)
    v, l, dense_v, dense_l = inputs[IN_V], inputs[IN_L], dense[0], dense[1]  # noqa: E741
    table, out = inputs[IN_TABLE], outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        load_directions(s, VX, v, dense_v, begin, count, first)
        load_directions(s, LX, l, dense_l, begin, count, first)
        _load(s, inputs, modes, begin, count, first)
        rejected += passes.place(s, modes, True)
        passes.white_albedo(s, modes, table)
        _density_block(s, modes)
        store(s, out, OR, begin, count)
    return rejected


DENSITY = Kernel(density, INPUTS, 1)


def draw(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """Directions for the uniforms in `inputs[IN_L]`: the columns of `draw_one`."""
    s = np.empty(SIZE)
    v, l, dense_v, dense_l = inputs[IN_V], inputs[IN_L], dense[0], dense[1]  # noqa: E741
    table, out = inputs[IN_TABLE], outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        load_directions(s, VX, v, dense_v, begin, count, first)
        load_directions(s, LX, l, dense_l, begin, count, first)
        _load(s, inputs, modes, begin, count, first)
        rejected += passes.place(s, modes, False)
        passes.white_albedo(s, modes, table)
        for i in range(count):
            draw_one(s, i, modes, s[LX + i], s[LY + i], s[LZ + i], out, 8 * (begin + i))
    return rejected


DRAW = Kernel(draw, INPUTS, 1)


def weigh(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """Weights f |l.n| / pdf and densities of what `draw` drew (its columns, f, pdf); of a delta, what it
    says itself.
    """
    drawn, value, densities = inputs[0], inputs[1], inputs[2]
    weight, density = outputs[0], outputs[1]
    for i in range(start, stop):
        delta = drawn[i, 3] > 0.0
        kept = drawn[i, 4] if delta else (densities[i, 0] if drawn[i, 4] > 0.0 else 0.0)
        # Below float64's normal numbers a density has lost its digits, and one over it is infinite: rejected.
        kept = kept if kept >= SMALLEST_NORMAL else 0.0
        density[i] = kept
        scale = abs(drawn[i, 2]) / kept if kept > 0.0 else 0.0
        for c in range(3):
            weight[3 * i + c] = drawn[i, 5 + c] if delta else scale * value[i, c]
    return 0


WEIGH = Kernel(weigh, 3, 2)


@formula
def _integrate_one(
    s: Array, i: int, modes: Any, nodes: Array
) -> tuple[float, float, float, float, float, float]:
    """RGB reflected and transmitted, averaged over the normals that are seen from v."""
    r0 = r1 = r2 = t0 = t1 = t2 = 0.0
    ex, ey, ez = s[EX + i], s[EY + i], s[EZ + i]
    side = s[SIDE + i]
    if ez - s[MX + i] * ex - s[MY + i] * ey <= 0.0 or (modes[KIND] == CONDUCTOR and side < 0.0):
        return r0, r1, r2, t0, t1, t2
    boost = 0.0
    if modes[COMPENSATION] == energy.MATERIALX_1_39_5:
        boost = (1.0 - s[ALBEDO + i]) / s[ALBEDO + i]
    vcavity = modes[MASKING] == surface.VCAVITY
    # Beckmann's visible normals need an equation solved for each; its slopes fall off fast enough to do
    # without.
    by_normals = vcavity or modes[DISTRIBUTION] != surface.GGX
    total = 0.0
    # The nodes' azimuth starts at v's, in the stretched configuration.
    along, across = surface.stretched_azimuth(ex, ey, s[AX + i], s[AY + i], s[RXY + i])
    start = math.atan2(across, along) / (2.0 * math.pi)
    for k in range(nodes.shape[0]):
        u0, u1, weight = nodes[k, 0] + start, nodes[k, 1], nodes[k, 2]
        if by_normals:
            mx, my, mz = sample_normal(modes[DISTRIBUTION], s[AX + i], s[AY + i], s[RXY + i], u0, u1)
            mx, my = mx - s[MX + i] * mz, my - s[MY + i] * mz
            length = math.sqrt(mx * mx + my * my + mz * mz)
            mx, my, mz = mx / length, my / length, mz / length
            cosine = max(ex * mx + ey * my + ez * mz, 0.0)
            if vcavity:
                # The nodes hold both facets of each cavity, so each stands for itself by how much of it is
                # seen.
                other = max(-ex * mx - ey * my + ez * mz, 0.0)
                weight *= cosine / (cosine + other) if cosine > 0.0 else 0.0
            else:
                weight *= cosine / mz
        else:
            mx, my, mz = sample_visible_smith(
                modes[DISTRIBUTION],
                ex,
                ey,
                ez,
                s[AX + i],
                s[AY + i],
                s[RXY + i],
                s[MX + i],
                s[MY + i],
                u0,
                u1,
            )
        total += weight
        red, green, blue, reflected, transmitted = scattered(s, i, modes, ex, ey, ez, side, mx, my, mz)
        r0 += weight * reflected * red * (1.0 + red * boost)
        r1 += weight * reflected * green * (1.0 + green * boost)
        r2 += weight * reflected * blue * (1.0 + blue * boost)
        t0 += weight * transmitted * (1.0 - red)
        t1 += weight * transmitted * (1.0 - green)
        t2 += weight * transmitted * (1.0 - blue)
    # The weights' own sum: what is left of the quadrature's error makes no energy.
    return r0 / total, r1 / total, r2 / total, t0 / total, t1 / total, t2 / total


def integrate(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """The share of energy that is reflected and transmitted, before the tint; `inputs[IN_NODES]` is the
    quadrature.
    """
    s = np.empty(SIZE)
    v, table, nodes, dense_v, out = inputs[IN_V], inputs[IN_TABLE], inputs[IN_NODES], dense[0], outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        load_directions(s, VX, v, dense_v, begin, count, first)
        _load(s, inputs, modes, begin, count, first)
        rejected += passes.place(s, modes, False)
        passes.white_albedo(s, modes, table)
        for i in range(count):
            parts = _integrate_one(s, i, modes, nodes)
            s[OR + i], s[OG + i], s[OB + i] = parts[0], parts[1], parts[2]
            s[PR + i], s[PG + i], s[PB + i] = parts[3], parts[4], parts[5]
        if modes[SCATTER] != TRANSMIT:
            # The term of Kulla and Conty reflects into every direction what it takes from v.
            for i in range(BLOCK):
                s[GZ + i] = 1.0
            if modes[COMPENSATION] == energy.KULLA_CONTY:
                passes.multiple_reflectance(s, modes, table)
                for i in range(BLOCK):
                    ax, ay = min(s[AX + i], 1.0), min(s[AY + i], 1.0)
                    average = energy.average_lookup(ax, ay, s[RXY + i], table)
                    lost = (1.0 - s[ALBEDO + i]) * (1.0 - average)
                    lost = lost if s[EZ + i] > 0.0 else 0.0
                    s[OR + i] += lost * s[TR + i]
                    s[OG + i] += lost * s[TG + i]
                    s[OB + i] += lost * s[TB + i]
            else:
                _finish_reflection(s, modes, table)
        for i in range(3 * BLOCK):
            s[OR + i] = (s[OR + i] + s[PR + i]) * s[T0 + i]
        store_colours(s, out, OR, begin, count)
    return rejected


INTEGRATE = Kernel(integrate, INPUTS + 1, 1)


def reflectance(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """RGB reflectance from outside at the cosines in `inputs[IN_L]`; the average that 1.39.6 uses for its
    mode.
    """
    s = np.empty(SIZE)
    cosines, dense_l, out = inputs[IN_L], dense[1], outputs[0]
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        load_directions(s, LX, cosines, dense_l, begin, count, first)
        _load(s, inputs, modes, begin, count, first)
        if modes[COMPENSATION] == energy.MATERIALX_1_39_6:
            passes.typical_reflectance(s, modes)
        else:
            for i in range(BLOCK):
                s[OUTER + i] = s[LX + i]
            passes.fresnel(s, modes)
        store_colours(s, out, FR, begin, count)
    return 0


REFLECTANCE = Kernel(reflectance, INPUTS, 1)
