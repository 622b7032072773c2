"""The loops over arrays, one for each question: evaluate, density, sample, integrate, reflectance.

Each goes through its configurations by the block: it has the lobe's parts compute what the papers say, and does what
is the same for every lobe. Equation numbers are those of 001, "The Minimal Retroreflective Microfacet Model"."""

import math
from typing import Any

import numpy as np

from . import energy_formulas as energy
from .block import (
    A0,
    A1,
    A2,
    ALBEDO,
    AX,
    AY,
    BLOCK,
    BOTH,
    CHANCE,
    COMPENSATION,
    COSINE,
    DENSITY,
    EX,
    EY,
    EZ,
    FAR_COSINE,
    FB,
    FG,
    FILM,
    FORWARD,
    FR,
    GX,
    GY,
    GZ,
    HORIZON,
    IN_L,
    IN_NODES,
    IN_TABLE,
    IN_V,
    INDEX,
    KEPT,
    KIND,
    LOBE,
    LX,
    LY,
    LZ,
    MX,
    MY,
    NX,
    NY,
    NZ,
    OB,
    OG,
    OR,
    OUTER,
    PB,
    PG,
    PR,
    QUADRATURE_NORMALS,
    REFLECT,
    REFLECTANCE,
    REFLECTED,
    REFLECTED_SHARE,
    REFLECTION,
    REFLECTION_DENSITY,
    REFRACTED,
    REFRACTED_SHARE,
    REFRACTION,
    REFRACTION_DENSITY,
    RETRO,
    RETRO_COSINE,
    RETRO_FAR_COSINE,
    RETRO_LOBE,
    RETRO_SHARE,
    RETRO_TRANSMISSION,
    RXY,
    SCATTER,
    SIDE,
    SIZE,
    T0,
    T1,
    T2,
    TRANSMIT,
    TURNS,
    VARIES,
    VISIBLE_NORMALS,
    VM,
    VX,
    VY,
    VZ,
    WEIGHT,
    Parameters,
    ask_ahead,
    load_directions,
    load_parameters,
    not_unit,
    store,
    store_colours,
)
from .compensation import compensate, finish_albedo, finish_reflection, typical_reflectance, white_albedo
from .compiled import Array, Kernel, call, formula, inlined
from .energy_formulas import compensation
from .fresnel import CONDUCTOR, DIELECTRIC, SCHLICK, dielectric_transmittance, index_from_f0, outer_cosine
from .microsurface import SHEARED, Slopes
from .vec import Vec, reflected, refracted

_standard_direction = SHEARED.direction

INPUTS = 2 + len(Parameters._fields) + 1
SMALLEST_NORMAL = float(np.finfo(np.float64).tiny)


@formula
def _derive(s: Array, modes: Any) -> None:
    """What follows from the parameters: the index of the inside, of which a conductor has none."""
    s[TURNS] = 1.0 if modes[RETRO_TRANSMISSION] != 0 else 0.0
    if modes[KIND] == SCHLICK:
        for i in range(BLOCK):
            s[INDEX + i] = index_from_f0((s[A0 + i] + s[A1 + i] + s[A2 + i]) / 3.0)
    elif modes[KIND] == DIELECTRIC:
        for i in range(BLOCK):
            s[INDEX + i] = s[A0 + i]


@inlined
def _load(s: Array, inputs: Any, modes: Any, begin: int, count: int, first: bool) -> None:
    """The parameters of a block, and what follows from them, unless the last block's are the same."""
    if first or s[VARIES] > 0.0:
        load_parameters(s, inputs, begin, count, first)
        _derive(s, modes)


@formula
def _place(s: Array, modes: Any) -> int:
    """v and l as seen from v's side; returns how many of them are not of unit length.

    Seen from inside, a surface is its own point reflection: v and l are negated, and slopes keep their
    distribution. A conductor has no inside: v stays below the surface, where nothing is lit."""
    inside = 1.0 if modes[KIND] == CONDUCTOR else -1.0
    rejected = 0
    for i in range(BLOCK):
        rejected += _see(s, i, s[VX + i], s[VY + i], s[VZ + i], s[LX + i], s[LY + i], s[LZ + i], inside)
    return rejected


@formula
def _place_view(s: Array, modes: Any) -> int:
    """`_place` of v alone."""
    inside = 1.0 if modes[KIND] == CONDUCTOR else -1.0
    rejected = 0
    for i in range(BLOCK):
        rejected += _see(s, i, s[VX + i], s[VY + i], s[VZ + i], s[VX + i], s[VY + i], s[VZ + i], inside)
    return rejected


@inlined
def _load_placed(
    s: Array,
    modes: Any,
    v: Array,
    l: Array,  # noqa: E741
    dense_v: Array,
    dense_l: Array,
    begin: int,
    count: int,
    first: bool,
) -> int:
    """Directions of a block, as seen from v's side; what `load_directions` and `_place` do, in one loop where memory
    has both in one piece."""
    if dense_v.size > 0 and dense_l.size > 0 and count == BLOCK and begin >= 0:
        return _place_dense(s, modes, dense_v, dense_l, 3 * begin)
    load_directions(s, VX, v, dense_v, begin, count, first)
    load_directions(s, LX, l, dense_l, begin, count, first)
    return _place(s, modes)


@formula
def _place_dense(s: Array, modes: Any, v: Array, l: Array, start: int) -> int:  # noqa: E741
    if start < 0:
        return 0
    inside = 1.0 if modes[KIND] == CONDUCTOR else -1.0
    rejected = 0
    ask_ahead(v, start + 3 * BLOCK)
    ask_ahead(l, start + 3 * BLOCK)
    for i in range(BLOCK):
        k = start + 3 * i
        rejected += _see(s, i, v[k], v[k + 1], v[k + 2], l[k], l[k + 1], l[k + 2], inside)
    return rejected


@inlined
def _see(
    s: Array, i: int, vx: float, vy: float, vz: float, lx: float, ly: float, lz: float, inside: float
) -> int:
    side = 1.0 if vz >= 0.0 else inside
    s[SIDE + i] = side
    s[EX + i] = side * vx
    s[EY + i] = side * vy
    s[EZ + i] = side * vz if abs(vz) > HORIZON else 0.0
    s[GX + i] = side * lx
    s[GY + i] = side * ly
    s[GZ + i] = side * lz if abs(lz) > HORIZON else 0.0
    return not_unit(vx, vy, vz) + not_unit(lx, ly, lz)


@inlined
def _reflectance(s: Array, modes: Any, cosine: int) -> None:
    """F where v meets a normal that reflects it, by the row of v.m, which may be `OUTER` itself."""
    if modes[KIND] == CONDUCTOR:
        if cosine != OUTER:
            for i in range(BLOCK):
                s[OUTER + i] = s[cosine + i]
    else:
        for i in range(BLOCK):
            s[OUTER + i] = outer_cosine(s[cosine + i], s[SIDE + i], s[INDEX + i])
    call(modes[REFLECTANCE], s)


@inlined
def _transmittance(s: Array, modes: Any, cosine: int, far_cosine: int) -> None:
    """1 - F at the refracting normal, from both cosines where they are what it is made of (eq. 11)."""
    for i in range(BLOCK):
        s[OUTER + i] = s[cosine + i] if s[SIDE + i] > 0.0 else s[far_cosine + i]
    call(modes[REFLECTANCE], s)
    for i in range(BLOCK):
        s[FR + i] = 1.0 - s[FR + i]
        s[FG + i] = 1.0 - s[FG + i]
        s[FB + i] = 1.0 - s[FB + i]
    if modes[KIND] == DIELECTRIC:
        for i in range(BLOCK):
            near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
            far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
            t = dielectric_transmittance(s[cosine + i], near, s[far_cosine + i], far)
            s[FR + i] = s[FR + i] if s[FILM + i] > 0.0 else t
            s[FG + i] = s[FG + i] if s[FILM + i] > 0.0 else t
            s[FB + i] = s[FB + i] if s[FILM + i] > 0.0 else t


@inlined
def _share(s: Array, i: int, is_retro: bool) -> float:
    share: float = s[RETRO + i] if is_retro else 1.0 - s[RETRO + i]
    return share


@inlined
def _add(s: Array, row: int, is_retro: bool, is_shared: bool) -> None:
    """Add a lobe times its factor F to the result, by its share of the blend."""
    for i in range(BLOCK):
        share = _share(s, i, is_retro) if is_shared else 1.0
        value = share * s[row + i]
        # Where nothing is scattered F may be no number.
        lit = value != 0.0
        s[OR + i] += value * s[FR + i] if lit else 0.0
        s[OG + i] += value * s[FG + i] if lit else 0.0
        s[OB + i] += value * s[FB + i] if lit else 0.0


@formula
def _any_across(s: Array) -> bool:
    found = 0
    for i in range(BLOCK):
        found += 1 if s[GZ + i] < 0.0 else 0
    return found > 0


@inlined
def _factor(s: Array, modes: Any, cosine: int) -> None:
    """What a reflection lobe is multiplied by (eq. 1), by the row of v.m."""
    _reflectance(s, modes, cosine)
    if modes[COMPENSATION] == energy.MATERIALX_1_39_5:
        compensate(s, FR)


@formula
def _reflect(s: Array, modes: Any) -> None:
    """The reflection lobes (eq. 1), each times its share of the blend, into the result."""
    call(modes[REFLECTION], s)
    if s[FORWARD] > 0.0:
        _factor(s, modes, OUTER)
        for i in range(BLOCK):
            value = (1.0 - s[RETRO + i]) * s[LOBE + i]
            s[OR + i] = value * s[FR + i]
            s[OG + i] = value * s[FG + i]
            s[OB + i] = value * s[FB + i]
    else:
        _clear(s)
    if s[RETRO_SHARE] > 0.0:
        _factor(s, modes, RETRO_COSINE)
        for i in range(BLOCK):
            value = s[RETRO + i] * s[RETRO_LOBE + i]
            s[OR + i] += value * s[FR + i]
            s[OG + i] += value * s[FG + i]
            s[OB + i] += value * s[FB + i]


@inlined
def _clear(s: Array) -> None:
    for i in range(3 * BLOCK):
        s[OR + i] = 0.0


@formula
def _refract(s: Array, modes: Any) -> None:
    """Add the transmission lobes (eq. 2), each times its share, to the result."""
    call(modes[REFRACTION], s)
    turns = s[TURNS] > 0.0
    if s[FORWARD] > 0.0 or not turns:
        _transmittance(s, modes, COSINE, FAR_COSINE)
        if turns:
            _add(s, LOBE, False, True)
        else:
            _add(s, LOBE, False, False)
    if s[RETRO_SHARE] > 0.0 and turns:
        _transmittance(s, modes, RETRO_COSINE, RETRO_FAR_COSINE)
        _add(s, RETRO_LOBE, True, True)


@formula
def _evaluate_block(s: Array, modes: Any, table: Array) -> None:
    """f(v, l) of the whole lobe into the result's rows."""
    if modes[SCATTER] != TRANSMIT:
        _reflect(s, modes)
        if modes[COMPENSATION] != energy.NONE:
            finish_reflection(s, modes, table)
    else:
        _clear(s)
    if modes[SCATTER] != REFLECT and _any_across(s):
        _refract(s, modes)
    if modes[KIND] == DIELECTRIC:
        for i in range(3 * BLOCK):
            s[OR + i] *= s[T0 + i]


def evaluate(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """f(v, l) of the whole lobe into `outputs[0]`; returns how many directions were not of unit length."""
    s = np.empty(SIZE)
    # Taken out of their tuples once: each time costs a count of references.
    v, l, dense_v, dense_l = inputs[IN_V], inputs[IN_L], dense[0], dense[1]  # noqa: E741
    table, out = inputs[IN_TABLE], outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        ask_ahead(out, 3 * begin)
        _load(s, inputs, modes, begin, count, first)
        rejected += _load_placed(s, modes, v, l, dense_v, dense_l, begin, count, first)
        if modes[COMPENSATION] != energy.NONE:
            white_albedo(s, modes, table)
        _evaluate_block(s, modes, table)
        store_colours(s, out, OR, begin, count)
    return rejected


EVALUATE = Kernel(evaluate, INPUTS, 1)


@inlined
def _add_density(s: Array, row: int, is_both: bool, is_retro: bool, is_shared: bool) -> None:
    """Add a density, by its share of the blend and, where a lobe reflects and transmits, by how probable it is."""
    for i in range(BLOCK):
        share = _share(s, i, is_retro) if is_shared else 1.0
        chance = (s[FR + i] + s[FG + i] + s[FB + i]) / 3.0 if is_both else 1.0
        density = share * s[row + i]
        s[DENSITY + i] += density * chance if density != 0.0 else 0.0


@formula
def _density_block(s: Array, modes: Any) -> None:
    """The density of `sample` into its row."""
    for i in range(BLOCK):
        s[DENSITY + i] = 0.0
    forward, retro = s[FORWARD] > 0.0, s[RETRO_SHARE] > 0.0
    both = modes[SCATTER] == BOTH
    if modes[SCATTER] != TRANSMIT:
        call(modes[REFLECTION_DENSITY], s)
        if forward:
            if both:
                _reflectance(s, modes, OUTER)
            _add_density(s, LOBE, both, False, True)
        if retro:
            if both:
                _reflectance(s, modes, RETRO_COSINE)
            _add_density(s, RETRO_LOBE, both, True, True)
    if modes[SCATTER] != REFLECT and _any_across(s):
        call(modes[REFRACTION_DENSITY], s)
        turns = s[TURNS] > 0.0
        if forward or not turns:
            if both:
                _transmittance(s, modes, COSINE, FAR_COSINE)
            if turns:
                _add_density(s, LOBE, both, False, True)
            else:
                _add_density(s, LOBE, both, False, False)
        if retro and turns:
            if both:
                _transmittance(s, modes, RETRO_COSINE, RETRO_FAR_COSINE)
            _add_density(s, RETRO_LOBE, both, True, True)
    if modes[COMPENSATION] == energy.KULLA_CONTY and modes[SCATTER] != TRANSMIT:
        for i in range(BLOCK):
            lost = 1.0 - s[ALBEDO + i]
            lit = min(s[EZ + i], s[GZ + i]) > 0.0
            diffuse = lost * s[GZ + i] / math.pi
            s[DENSITY + i] = (1.0 - lost) * s[DENSITY + i] + (diffuse if lit else 0.0)


def density(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """The density per steradian of what `sample` draws, into `outputs[0]`; returns as `evaluate` does."""
    s = np.empty(SIZE)
    v, l, dense_v, dense_l = inputs[IN_V], inputs[IN_L], dense[0], dense[1]  # noqa: E741
    table, out = inputs[IN_TABLE], outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        _load(s, inputs, modes, begin, count, first)
        rejected += _load_placed(s, modes, v, l, dense_v, dense_l, begin, count, first)
        if modes[COMPENSATION] != energy.NONE:
            white_albedo(s, modes, table)
        _density_block(s, modes)
        store(s, out, DENSITY, begin, count)
    return rejected


DENSITY_KERNEL = Kernel(density, INPUTS, 1)


@inlined
def _leave(s: Array, i: int, l: Vec, turn: float, kept: bool) -> None:  # noqa: E741
    """A direction that was drawn, as seen from outside; n where it is rejected."""
    # Rounding grows with 1 / cosine; directions leave here of unit length.
    size = math.sqrt(l.x * l.x + l.y * l.y + l.z * l.z)
    side = s[SIDE + i]
    s[LX + i] = turn * side * l.x / size if kept else 0.0
    s[LY + i] = turn * side * l.y / size if kept else 0.0
    s[LZ + i] = side * l.z / size if kept else 1.0
    s[KEPT + i] = 1.0 if kept else 0.0


@formula
def _draw_reflection(s: Array) -> None:
    """l by a visible normal, then v or v' by the blend: into the rows of l, and `KEPT`.

    The sample for v' is that for v turned about the normal: a visible normal of v' is (-mx, -my, mz) with
    the same Fresnel term, G and density."""
    for i in range(BLOCK):
        l = reflected(Vec(s[EX + i], s[EY + i], s[EZ + i]), Vec(s[NX + i], s[NY + i], s[NZ + i]))  # noqa: E741
        turn = -1.0 if s[LZ + i] < s[RETRO + i] else 1.0
        _leave(s, i, l, turn, min(s[VM + i], l.z) > 0.0)
        s[CHANCE + i] = 0.0


@formula
def _draw_any(s: Array, modes: Any) -> None:
    """`_draw_reflection` of what may transmit: reflection or refraction by F first; deltas into `CHANCE` and the
    result's rows."""
    _reflectance(s, modes, VM)
    call(modes[REFRACTED_SHARE], s)
    for i in range(BLOCK):
        v, m, vm = Vec(s[EX + i], s[EY + i], s[EZ + i]), Vec(s[NX + i], s[NY + i], s[NZ + i]), s[VM + i]
        u, chance = s[LZ + i], 1.0
        transmits = True
        if modes[SCATTER] == BOTH:
            chance = (s[FR + i] + s[FG + i] + s[FB + i]) / 3.0
            transmits = u >= chance
            u = (u - chance) / (1.0 - chance) if transmits else u / chance
            chance = 1.0 - chance if transmits else chance
        turns = u < s[RETRO + i] and (not transmits or modes[RETRO_TRANSMISSION] != 0)
        turn = -1.0 if turns else 1.0
        s[CHANCE + i] = 0.0
        if not transmits:
            l = reflected(v, m)  # noqa: E741
            _leave(s, i, l, turn, min(vm, l.z) > 0.0)
            continue
        index = s[INDEX + i]
        ratio = 1.0 / index if s[SIDE + i] > 0.0 else index
        squared = 1.0 - ratio * ratio * (1.0 - vm * vm)
        l = refracted(v, m, vm, ratio, math.sqrt(max(squared, 0.0)))  # noqa: E741
        if index == 1.0:
            l = Vec(-v.x, -v.y, -v.z)  # noqa: E741
        _leave(s, i, l, turn, min(min(vm, squared), -l.z) > 0.0)
        if index == 1.0 and s[KEPT + i] > 0.0:
            share = _share(s, i, turns) if modes[RETRO_TRANSMISSION] != 0 else 1.0
            weight = s[REFRACTED + i] / chance
            s[CHANCE + i] = chance * share
            s[PR + i] = weight * (1.0 - s[FR + i]) * s[T0 + i]
            s[PG + i] = weight * (1.0 - s[FG + i]) * s[T1 + i]
            s[PB + i] = weight * (1.0 - s[FB + i]) * s[T2 + i]


@formula
def _draw_block(s: Array, modes: Any) -> None:
    """Directions for the uniforms in the rows of l, into these."""
    mixes = modes[COMPENSATION] == energy.KULLA_CONTY and modes[SCATTER] != TRANSMIT
    if mixes:
        for i in range(BLOCK):
            # The term that gives back lost energy is nearly diffuse: a direction by the cosine, into the rows of l
            # as seen from v's side.
            lost, u, up = 1.0 - s[ALBEDO + i], s[LZ + i], s[EZ + i] > 0.0
            radius, phi = math.sqrt(s[LX + i]), 2.0 * math.pi * s[LY + i]
            s[GX + i] = radius * math.cos(phi)
            s[GY + i] = radius * math.sin(phi)
            s[GZ + i] = math.sqrt(1.0 - s[LX + i]) if up and u < lost else -1.0
            s[LZ + i] = (u - lost) / (1.0 - lost) if lost < 1.0 else u
    call(modes[VISIBLE_NORMALS], s)
    if modes[SCATTER] == REFLECT:
        _draw_reflection(s)
    else:
        _draw_any(s, modes)
    if mixes:
        for i in range(BLOCK):
            s[CHANCE + i] *= s[ALBEDO + i]
            s[PR + i] /= s[ALBEDO + i]
            s[PG + i] /= s[ALBEDO + i]
            s[PB + i] /= s[ALBEDO + i]
            if s[GZ + i] >= 0.0:
                s[LX + i], s[LY + i], s[LZ + i] = s[GX + i], s[GY + i], s[SIDE + i] * s[GZ + i]
                s[KEPT + i], s[CHANCE + i] = 1.0, 0.0


@formula
def _not_uniform(s: Array) -> int:
    rejected = 0
    for i in range(3 * BLOCK):
        rejected += 0 if s[LX + i] >= 0.0 and s[LX + i] <= 1.0 else 1
    return rejected


@formula
def sound(density: float) -> float:
    """A density; 0 below float64's normal numbers, where it has lost its digits, and one over it is infinite."""
    return density if density >= SMALLEST_NORMAL else 0.0


def sample(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """Draw l for the uniforms in `inputs[IN_L]`: l, weights f |l.n| / pdf, densities, and 1 for a delta, of which
    weight and probability; returns how many of v were not of unit length, and of the uniforms outside of [0, 1]."""
    s = np.empty(SIZE)
    v, l, dense_v, dense_l = inputs[IN_V], inputs[IN_L], dense[0], dense[1]  # noqa: E741
    table, light, weight, densities, deltas = inputs[IN_TABLE], outputs[0], outputs[1], outputs[2], outputs[3]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        first = begin == start
        load_directions(s, VX, v, dense_v, begin, count, first)
        # What is drawn goes where the uniforms were, so that they are needed anew even where they do not vary.
        load_directions(s, LX, l, dense_l, begin, count, True)
        _load(s, inputs, modes, begin, count, first)
        rejected += _place_view(s, modes) + _not_uniform(s)
        white_albedo(s, modes, table)
        _draw_block(s, modes)
        _place(s, modes)
        _density_block(s, modes)
        _evaluate_block(s, modes, table)
        for i in range(BLOCK):
            is_delta = s[CHANCE + i] > 0.0
            kept = s[CHANCE + i] if is_delta else s[KEPT + i] * s[DENSITY + i]
            kept = sound(kept)
            scale = abs(s[LZ + i]) / kept if kept > 0.0 else 0.0
            s[DENSITY + i] = kept
            s[OR + i] = s[PR + i] if is_delta else scale * s[OR + i]
            s[OG + i] = s[PG + i] if is_delta else scale * s[OG + i]
            s[OB + i] = s[PB + i] if is_delta else scale * s[OB + i]
            s[KEPT + i] = 1.0 if is_delta else 0.0
        store_colours(s, light, LX, begin, count)
        store_colours(s, weight, OR, begin, count)
        store(s, densities, DENSITY, begin, count)
        store(s, deltas, KEPT, begin, count)
    return rejected


SAMPLE = Kernel(sample, INPUTS, 4)


@formula
def _integrate_one(s: Array, modes: Any, nodes: Array, azimuth: float, out: Array) -> None:
    """RGB reflected and transmitted, averaged over the normals that are seen from v, which every lane holds."""
    total = 0.0
    out[:] = 0.0
    boosts = modes[COMPENSATION] == energy.MATERIALX_1_39_5
    for begin in range(0, nodes.shape[0], BLOCK):
        for i in range(BLOCK):
            k = min(begin + i, nodes.shape[0] - 1)
            # The nodes' azimuth starts at v's, in the stretched configuration.
            s[LX + i], s[LY + i] = nodes[k, 0] + azimuth, nodes[k, 1]
            s[LZ + i] = nodes[k, 2] if begin + i < nodes.shape[0] else 0.0
        call(modes[QUADRATURE_NORMALS], s)
        _reflectance(s, modes, VM)
        if modes[SCATTER] != TRANSMIT:
            call(modes[REFLECTED_SHARE], s)
        if modes[SCATTER] != REFLECT:
            call(modes[REFRACTED_SHARE], s)
        for i in range(BLOCK):
            weight = s[WEIGHT + i]
            total += weight
            if s[VM + i] <= 0.0:
                continue
            for c in range(3):
                f = s[FR + c * BLOCK + i]
                gain = compensation(f, s[ALBEDO + i]) if boosts else 1.0
                if modes[SCATTER] != TRANSMIT:
                    out[c] += weight * s[REFLECTED + i] * f * gain
                if modes[SCATTER] != REFLECT:
                    out[3 + c] += weight * s[REFRACTED + i] * (1.0 - f)
    # The weights' own sum: what is left of the quadrature's error makes no energy.
    for c in range(6):
        out[c] /= total


def integrate(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """The share of energy that is scattered; `inputs[IN_NODES]` is the quadrature."""
    s, parts = np.empty(SIZE), np.empty(6)
    v, table, nodes, dense_v, out = inputs[IN_V], inputs[IN_TABLE], inputs[IN_NODES], dense[0], outputs[0]
    rejected = 0
    for begin in range(start, stop):
        # One view fills a block, of which the lanes are its nodes.
        first = begin == start
        load_directions(s, VX, v, dense_v, begin, 1, first)
        _load(s, inputs, modes, begin, 1, first)
        rejected += 1 if _place_view(s, modes) > 0 else 0
        white_albedo(s, modes, table)
        standard = _standard_direction(Vec(s[EX], s[EY], s[EZ]), Slopes(s[AX], s[AY], s[RXY], s[MX], s[MY]))
        parts[:] = 0.0
        if s[EZ] > 0.0 and standard.z > 0.0:
            _integrate_one(s, modes, nodes, math.atan2(standard.y, standard.x) / (2.0 * math.pi), parts)
        for i in range(BLOCK):
            s[OR + i], s[OG + i], s[OB + i] = parts[0], parts[1], parts[2]
            s[GZ + i] = 1.0
        if modes[SCATTER] != TRANSMIT:
            finish_albedo(s, modes, table)
        for c in range(3):
            out[3 * begin + c] = (s[OR + c * BLOCK] + parts[3 + c]) * s[T0 + c * BLOCK]
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
            typical_reflectance(s, modes)
        else:
            for i in range(BLOCK):
                s[OUTER + i] = s[LX + i]
            call(modes[REFLECTANCE], s)
        store_colours(s, out, FR, begin, count)
    return 0


REFLECTANCE_KERNEL = Kernel(reflectance, INPUTS, 1)
