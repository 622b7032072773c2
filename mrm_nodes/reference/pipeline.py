"""The evaluator's passes over a block of configurations.

Inputs are copied, a block at a time, into rows of one scratch array, in the order in which registers want them; a
pass is then one formula in a loop of constant length over rows, which the compiler turns into vector instructions. A
row is named by the offset of its first element. Equation numbers without a paper are those of Heitz 2014; 001 is
"The Minimal Retroreflective Microfacet Model".
"""

import math
from typing import Any

import numpy as np

from . import energy_formulas as energy
from . import microsurface as surface
from .compiled import Array, Kernel, formula
from .energy_formulas import compensation, rational_albedo
from .fresnel import (
    CONDUCTOR,
    DIELECTRIC,
    SCHLICK,
    conductor_reflectance,
    dielectric_reflectance,
    dielectric_transmittance,
    index_from_f0,
    schlick_reflectance,
    schlick_reflectance_5,
)
from .sampling import sample_normal, sample_visible_smith, sample_visible_vcavity
from .thinfilm import film_reflectance

BLOCK = 128

# Directions.
VX, VY, VZ, LX, LY, LZ = (BLOCK * k for k in range(6))
# Parameters: colours A, B, C are index and extinction, or f0, f82 and f90; T is the tint.
AX, AY, RETRO, A0, A1, A2, B0, B1, B2, C0, C1, C2 = (BLOCK * k for k in range(6, 18))
EXPONENT, FILM, FILM_INDEX, RXY, MX, MY, T0, T1, T2 = (BLOCK * k for k in range(18, 27))
# v' and l on the near side, the selected normal before normalisation and its squared length, its cosines with both.
SIDE, EX, EY, EZ, GX, GY, GZ, HX, HY, HZ, HH, VH, LH = (BLOCK * k for k in range(27, 40))
# Cosines with the mesosurface, stretched sines, projected areas, and G2 / (cos v cos l).
D, CV, CL, SINE_V, SINE_L, AREA_V, AREA_L, VISIBLE = (BLOCK * k for k in range(40, 48))
# Reflectance, the lobe's share, the result, and what energy compensation and refraction need.
FR, FG, FB, TR, TG, TB, SHARE, OR, OG, OB, ALBEDO, INDEX, OUTER = (BLOCK * k for k in range(48, 61))
SIZE = BLOCK * 61

# Positions in `modes`.
KIND, DISTRIBUTION, MASKING, CORRELATION, COMPENSATION, SCATTER, RETRO_TRANSMISSION, SKEWED, FIFTH = range(9)
REFLECT, TRANSMIT, BOTH = 0, 1, 2

# Positions in `inputs`, and the components of each.
IN_V, IN_L, IN_ALPHA, IN_RETRO, IN_A, IN_B, IN_C, IN_EXPONENT, IN_FILM, IN_FILM_INDEX = range(10)
IN_RXY, IN_MEAN, IN_TINT, IN_FIT = range(10, 14)
INPUTS = 14

UNIT_TOLERANCE = 2e-6


@formula
def _load(s: Array, row: int, source: Array, component: int, start: int, count: int, first: bool) -> None:
    # A value that does not vary stays where the first block put it.
    if not first and source.strides[0] == 0 and count == BLOCK:
        return
    for i in range(count):
        s[row + i] = source[start + i, component]
    # Lanes past the end repeat the last configuration.
    for i in range(count, BLOCK):
        s[row + i] = source[start + count - 1, component]


@formula
def load(s: Array, inputs: Any, start: int, count: int, first: bool) -> None:
    for c in range(3):
        _load(s, VX + c * BLOCK, inputs[IN_V], c, start, count, first)
        _load(s, LX + c * BLOCK, inputs[IN_L], c, start, count, first)
        _load(s, A0 + c * BLOCK, inputs[IN_A], c, start, count, first)
        _load(s, B0 + c * BLOCK, inputs[IN_B], c, start, count, first)
        _load(s, C0 + c * BLOCK, inputs[IN_C], c, start, count, first)
        _load(s, T0 + c * BLOCK, inputs[IN_TINT], c, start, count, first)
    _load(s, AX, inputs[IN_ALPHA], 0, start, count, first)
    _load(s, AY, inputs[IN_ALPHA], 1, start, count, first)
    _load(s, RETRO, inputs[IN_RETRO], 0, start, count, first)
    _load(s, EXPONENT, inputs[IN_EXPONENT], 0, start, count, first)
    _load(s, FILM, inputs[IN_FILM], 0, start, count, first)
    _load(s, FILM_INDEX, inputs[IN_FILM_INDEX], 0, start, count, first)
    _load(s, RXY, inputs[IN_RXY], 0, start, count, first)
    _load(s, MX, inputs[IN_MEAN], 0, start, count, first)
    _load(s, MY, inputs[IN_MEAN], 1, start, count, first)


@formula
def count_not_unit(s: Array, x: int, y: int, z: int, count: int) -> int:
    bad = 0
    for i in range(count):
        squared = s[x + i] * s[x + i] + s[y + i] * s[y + i] + s[z + i] * s[z + i]
        bad += 0 if abs(squared - 1.0) <= UNIT_TOLERANCE else 1
    return bad


@formula
def _place(s: Array, turn: float) -> None:
    """Both directions as seen from v's side; `turn` = -1 takes v' = reflect(v, n) for v (001 eq. 3).

    Seen from inside, a surface is its own point reflection: slopes keep their distribution when v and l are negated.
    """
    for i in range(BLOCK):
        side = 1.0 if s[VZ + i] >= 0.0 else -1.0
        s[SIDE + i] = side
        s[EX + i] = side * turn * s[VX + i]
        s[EY + i] = side * turn * s[VY + i]
        s[EZ + i] = side * s[VZ + i]
        s[GX + i] = side * s[LX + i]
        s[GY + i] = side * s[LY + i]
        s[GZ + i] = side * s[LZ + i]


@formula
def _reflecting_normal(s: Array) -> None:
    """The half vector of v' and l: the half vector, or for v' the back vector (001 eq. 3)."""
    for i in range(BLOCK):
        x = s[EX + i] + s[GX + i]
        y = s[EY + i] + s[GY + i]
        z = s[EZ + i] + s[GZ + i]
        hh = x * x + y * y + z * z
        s[HX + i] = x
        s[HY + i] = y
        s[HZ + i] = z
        s[HH + i] = hh
        # Half the length of v + l is the cosine with either.
        s[VH + i] = 0.5 * math.sqrt(hh)


@formula
def _refracting_normal(s: Array) -> None:
    """h_t = -(ηv v + ηl l), turned to the near side (001, above eq. 2), and its cosines with both directions."""
    for i in range(BLOCK):
        near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
        far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
        x = near * s[EX + i] + far * s[GX + i]
        y = near * s[EY + i] + far * s[GY + i]
        z = near * s[EZ + i] + far * s[GZ + i]
        up = 1.0 if z >= 0.0 else -1.0
        x, y, z = up * x, up * y, up * z
        hh = x * x + y * y + z * z
        s[HX + i] = x
        s[HY + i] = y
        s[HZ + i] = z
        s[HH + i] = hh
        length = math.sqrt(hh) if hh > 0.0 else 1.0
        s[VH + i] = (x * s[EX + i] + y * s[EY + i] + z * s[EZ + i]) / length
        s[LH + i] = -(x * s[GX + i] + y * s[GY + i] + z * s[GZ + i]) / length


@formula
def _normals(s: Array, distribution: int, skewed: bool) -> None:
    """D at the selected normal."""
    if distribution == surface.PHONG:
        for i in range(BLOCK):
            s[D + i] = surface.phong_normals(s[HX + i], s[HY + i], s[HZ + i], s[HH + i], s[AX + i], s[AY + i])
        return
    if skewed:
        for i in range(BLOCK):
            s[D + i] = surface.slope_norm_squared(
                s[HX + i], s[HY + i], s[HZ + i], s[AX + i], s[AY + i], s[RXY + i], s[MX + i], s[MY + i]
            )
    else:
        for i in range(BLOCK):
            x = s[HX + i] / s[AX + i]
            y = s[HY + i] / s[AY + i]
            s[D + i] = x * x + y * y
    if skewed:
        for i in range(BLOCK):
            s[SHARE + i] = s[AX + i] * s[AY + i] * math.sqrt(1.0 - s[RXY + i] * s[RXY + i])
    else:
        for i in range(BLOCK):
            s[SHARE + i] = s[AX + i] * s[AY + i]
    if distribution == surface.GGX:
        for i in range(BLOCK):
            s[D + i] = surface.ggx_normals(s[HZ + i] * s[HZ + i], s[D + i], s[HH + i], s[SHARE + i])
    else:
        for i in range(BLOCK):
            s[D + i] = surface.beckmann_normals(s[HZ + i] * s[HZ + i], s[D + i], s[HH + i], s[SHARE + i])


@formula
def _areas(s: Array, distribution: int, skewed: bool) -> None:
    """Cosines with the mesosurface (Section 5.5) and projected areas, of v' and of l or, below, of -l."""
    if skewed:
        for i in range(BLOCK):
            s[CV + i] = s[EZ + i] - s[MX + i] * s[EX + i] - s[MY + i] * s[EY + i]
            s[SINE_V + i] = surface.stretched_sine(s[EX + i], s[EY + i], s[AX + i], s[AY + i], s[RXY + i])
            up = 1.0 if s[GZ + i] >= 0.0 else -1.0
            s[CL + i] = up * (s[GZ + i] - s[MX + i] * s[GX + i] - s[MY + i] * s[GY + i])
            s[SINE_L + i] = surface.stretched_sine(s[GX + i], s[GY + i], s[AX + i], s[AY + i], s[RXY + i])
    else:
        for i in range(BLOCK):
            s[CV + i] = s[EZ + i]
            x = s[AX + i] * s[EX + i]
            y = s[AY + i] * s[EY + i]
            s[SINE_V + i] = math.sqrt(x * x + y * y)
            s[CL + i] = abs(s[GZ + i])
            x = s[AX + i] * s[GX + i]
            y = s[AY + i] * s[GY + i]
            s[SINE_L + i] = math.sqrt(x * x + y * y)
    if distribution == surface.GGX:
        for i in range(BLOCK):
            s[AREA_V + i] = surface.ggx_projected_area(s[CV + i], s[SINE_V + i])
            s[AREA_L + i] = surface.ggx_projected_area(s[CL + i], s[SINE_L + i])
    elif distribution == surface.BECKMANN:
        for i in range(BLOCK):
            s[AREA_V + i] = surface.beckmann_projected_area(s[CV + i], s[SINE_V + i])
            s[AREA_L + i] = surface.beckmann_projected_area(s[CL + i], s[SINE_L + i])
    else:
        for i in range(BLOCK):
            s[AREA_V + i] = surface.beckmann_rational_projected_area(s[CV + i], s[SINE_V + i])
            s[AREA_L + i] = surface.beckmann_rational_projected_area(s[CL + i], s[SINE_L + i])


@formula
def _cosines(s: Array) -> None:
    for i in range(BLOCK):
        s[CV + i] = s[EZ + i]
        s[CL + i] = abs(s[GZ + i])


@formula
def _visibility(s: Array, distribution: int, masking: int, correlation: int, skewed: bool) -> None:
    """G2 / (cos v cos l) where v' and l are on one side."""
    if masking == surface.SMITH:
        _areas(s, distribution, skewed)
        if correlation == surface.HEIGHT:
            for i in range(BLOCK):
                s[VISIBLE + i] = surface.height_visibility(s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i])
        elif correlation == surface.SEPARABLE:
            for i in range(BLOCK):
                s[VISIBLE + i] = surface.separable_visibility(s[AREA_V + i], s[AREA_L + i])
        else:
            for i in range(BLOCK):
                s[VISIBLE + i] = surface.ginneken(s[EX + i], s[EY + i], s[GX + i], s[GY + i])
            if correlation == surface.DIRECTION:
                for i in range(BLOCK):
                    s[VISIBLE + i] = surface.direction_visibility(
                        s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i], s[VISIBLE + i]
                    )
            else:
                for i in range(BLOCK):
                    s[VISIBLE + i] = surface.height_direction_visibility(
                        s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i], s[VISIBLE + i]
                    )
        if skewed:
            # The lit area is the mesosurface's; the caller's cosine is the geometric surface's.
            for i in range(BLOCK):
                lit = s[CV + i] > 0.0 and s[CL + i] > 0.0
                s[VISIBLE + i] = s[VISIBLE + i] * s[CL + i] / s[GZ + i] if lit else 0.0
    elif masking == surface.VCAVITY:
        _cosines(s)
        for i in range(BLOCK):
            hz = s[HZ + i] / math.sqrt(s[HH + i])
            g = surface.vcavity_masking(hz, min(s[CV + i], s[CL + i]), s[VH + i])
            s[VISIBLE + i] = g / (s[CV + i] * s[CL + i])
    else:
        _unphysical_visibility(s, masking, skewed)


@formula
def _unphysical_visibility(s: Array, masking: int, skewed: bool) -> None:
    """The three functions of Table 3 that no microsurface has (eqs. 55-60)."""
    _areas(s, surface.GGX, skewed)
    if masking == surface.IMPLICIT:
        for i in range(BLOCK):
            s[VISIBLE + i] = 1.0
    elif masking == surface.KELEMEN:
        for i in range(BLOCK):
            s[VISIBLE + i] = 1.0 / (s[VH + i] * s[VH + i])
    else:
        for i in range(BLOCK):
            kv = surface.schlick_smith_k(s[SINE_V + i], s[CV + i])
            kl = surface.schlick_smith_k(s[SINE_L + i], s[CL + i])
            s[VISIBLE + i] = 1.0 / ((s[CV + i] * (1.0 - kv) + kv) * (s[CL + i] * (1.0 - kl) + kl))


@formula
def _visibility_across(s: Array, distribution: int, masking: int, correlation: int, skewed: bool) -> None:
    """G2 / (cos v cos l) where v' and l are on opposite sides."""
    if masking == surface.SMITH:
        _areas(s, distribution, skewed)
        if correlation == surface.HEIGHT or correlation == surface.HEIGHT_DIRECTION:
            for i in range(BLOCK):
                lit = s[CV + i] > 0.0 and s[CL + i] > 0.0
                s[VISIBLE + i] = (
                    surface.beta_visibility(s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i])
                    if lit
                    else 0.0
                )
        else:
            for i in range(BLOCK):
                s[VISIBLE + i] = surface.separable_visibility(s[AREA_V + i], s[AREA_L + i])
        if skewed:
            for i in range(BLOCK):
                lit = s[CV + i] > 0.0 and s[CL + i] > 0.0
                s[VISIBLE + i] = s[VISIBLE + i] * s[CL + i] / abs(s[GZ + i]) if lit else 0.0
    else:
        _cosines(s)
        for i in range(BLOCK):
            hz = s[HZ + i] / math.sqrt(s[HH + i])
            gv = surface.vcavity_masking(hz, s[CV + i], s[VH + i])
            gl = surface.vcavity_masking(hz, s[CL + i], s[LH + i])
            s[VISIBLE + i] = max(0.0, gv + gl - 1.0) / (s[CV + i] * s[CL + i])


@formula
def indices(s: Array, kind: int) -> None:
    """The index of refraction of the inside."""
    if kind == SCHLICK:
        for i in range(BLOCK):
            s[INDEX + i] = index_from_f0((s[A0 + i] + s[A1 + i] + s[A2 + i]) / 3.0)
    else:
        for i in range(BLOCK):
            s[INDEX + i] = s[A0 + i]


@formula
def outer_cosine(cosine: float, side: float, index: float) -> float:
    """The cosine on the outside of the interface, -1 where there is none: total internal reflection."""
    squared = 1.0 - index * index * (1.0 - cosine * cosine)
    return cosine if side > 0.0 else (math.sqrt(squared) if squared > 0.0 else -1.0)


@formula
def fresnel(s: Array, kind: int, fifth: bool) -> None:
    """Reflectance at v'.m (001, "Microfacet BSDF terms"), for v on either side."""
    if kind == DIELECTRIC:
        for i in range(BLOCK):
            eta = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0 / s[INDEX + i]
            s[FR + i] = dielectric_reflectance(s[VH + i], eta)
        for i in range(BLOCK):
            s[FG + i] = s[FR + i]
            s[FB + i] = s[FR + i]
    elif kind == CONDUCTOR:
        for i in range(BLOCK):
            s[FR + i] = conductor_reflectance(s[VH + i], s[A0 + i], s[B0 + i])
        for i in range(BLOCK):
            s[FG + i] = conductor_reflectance(s[VH + i], s[A1 + i], s[B1 + i])
        for i in range(BLOCK):
            s[FB + i] = conductor_reflectance(s[VH + i], s[A2 + i], s[B2 + i])
    else:
        for i in range(BLOCK):
            s[OUTER + i] = outer_cosine(s[VH + i], s[SIDE + i], s[INDEX + i])
        if fifth:
            for i in range(BLOCK):
                s[FR + i] = schlick_reflectance_5(s[OUTER + i], s[A0 + i], s[B0 + i], s[C0 + i])
                s[FG + i] = schlick_reflectance_5(s[OUTER + i], s[A1 + i], s[B1 + i], s[C1 + i])
                s[FB + i] = schlick_reflectance_5(s[OUTER + i], s[A2 + i], s[B2 + i], s[C2 + i])
        else:
            for i in range(BLOCK):
                p = s[EXPONENT + i]
                s[FR + i] = schlick_reflectance(s[OUTER + i], s[A0 + i], s[B0 + i], s[C0 + i], p)
                s[FG + i] = schlick_reflectance(s[OUTER + i], s[A1 + i], s[B1 + i], s[C1 + i], p)
                s[FB + i] = schlick_reflectance(s[OUTER + i], s[A2 + i], s[B2 + i], s[C2 + i], p)
        for i in range(BLOCK):
            inside = s[OUTER + i] < 0.0
            s[FR + i] = 1.0 if inside else s[FR + i]
            s[FG + i] = 1.0 if inside else s[FG + i]
            s[FB + i] = 1.0 if inside else s[FB + i]
    coated = False
    for i in range(BLOCK):
        coated |= s[FILM + i] > 0.0
    if coated:
        _film(s, kind)


@formula
def _film(s: Array, kind: int) -> None:
    for i in range(BLOCK):
        if s[FILM + i] > 0.0:
            cosine = outer_cosine(s[VH + i], s[SIDE + i], s[INDEX + i])
            if cosine < 0.0:
                continue
            s[FR + i], s[FG + i], s[FB + i] = film_reflectance(
                min(cosine, 1.0), kind, s[A0 + i], s[A1 + i], s[A2 + i], s[B0 + i], s[B1 + i], s[B2 + i],
                s[C0 + i], s[C1 + i], s[C2 + i], s[EXPONENT + i], s[FILM + i], s[FILM_INDEX + i],
            )  # fmt: skip


@formula
def _normal_incidence(s: Array, kind: int, fifth: bool) -> None:
    """Overwrite the reflectance with that at normal incidence."""
    for i in range(BLOCK):
        s[VH + i] = 1.0
    fresnel(s, kind, fifth)


@formula
def _average_reflectance(s: Array, kind: int, fifth: bool) -> None:
    """F0 + (F90 - F0) / 21, Schlick's reflectance averaged over the cosine-weighted hemisphere."""
    _normal_incidence(s, kind, fifth)
    for i in range(BLOCK):
        bare = kind == SCHLICK and s[FILM + i] <= 0.0
        r90 = s[C0 + i] if bare else 1.0
        g90 = s[C1 + i] if bare else 1.0
        b90 = s[C2 + i] if bare else 1.0
        s[FR + i] += (r90 - s[FR + i]) / 21.0
        s[FG + i] += (g90 - s[FG + i]) / 21.0
        s[FB + i] += (b90 - s[FB + i]) / 21.0


@formula
def _albedo_from_fit(s: Array, fit: Array) -> None:
    for i in range(BLOCK):
        a, b = rational_albedo(min(max(abs(s[VZ + i]), 1e-8), 1.0), math.sqrt(s[AX + i] * s[AY + i]), fit)
        s[ALBEDO + i] = a + b


@formula
def _albedo_from_table(s: Array, table: Array) -> None:
    for i in range(BLOCK):
        s[ALBEDO + i] = energy.table_lookup(abs(s[VZ + i]), math.sqrt(s[AX + i] * s[AY + i]), table)


@formula
def _compensate(s: Array) -> None:
    """Multiply the lobe (kept in SHARE) by 1 + F (1 - E) / E."""
    for i in range(BLOCK):
        s[TR + i] *= compensation(s[FR + i], s[ALBEDO + i])
        s[TG + i] *= compensation(s[FG + i], s[ALBEDO + i])
        s[TB + i] *= compensation(s[FB + i], s[ALBEDO + i])


@formula
def _reflect(s: Array, turn: float, modes: Any) -> None:
    """Add one reflection lobe (001 eq. 1), times its share of the blend."""
    _place(s, turn)
    _reflecting_normal(s)
    _normals(s, modes[DISTRIBUTION], modes[SKEWED] != 0)
    _visibility(s, modes[DISTRIBUTION], modes[MASKING], modes[CORRELATION], modes[SKEWED] != 0)
    fresnel(s, modes[KIND], modes[FIFTH] != 0)
    for i in range(BLOCK):
        share = s[RETRO + i] if turn < 0.0 else 1.0 - s[RETRO + i]
        lit = s[EZ + i] > 0.0 and s[GZ + i] > 0.0 and share > 0.0
        lobe = 0.25 * share * s[D + i] * s[VISIBLE + i] if lit else 0.0
        s[TR + i] = lobe * s[FR + i]
        s[TG + i] = lobe * s[FG + i]
        s[TB + i] = lobe * s[FB + i]
    scheme = modes[COMPENSATION]
    if scheme == energy.MATERIALX_1_39_5:
        _compensate(s)
    elif scheme == energy.MATERIALX_1_39_6:
        _average_reflectance(s, modes[KIND], modes[FIFTH] != 0)
        _compensate(s)
    elif scheme == energy.TURQUIN:
        _normal_incidence(s, modes[KIND], modes[FIFTH] != 0)
        _compensate(s)
    for i in range(BLOCK):
        s[OR + i] += s[TR + i]
        s[OG + i] += s[TG + i]
        s[OB + i] += s[TB + i]


@formula
def _transmittance(s: Array, kind: int, fifth: bool) -> None:
    """1 - F at the refracting normal: 0 where one of the two directions is behind it."""
    if kind != DIELECTRIC:
        fresnel(s, kind, fifth)
        for i in range(BLOCK):
            s[FR + i] = 1.0 - s[FR + i]
            s[FG + i] = 1.0 - s[FG + i]
            s[FB + i] = 1.0 - s[FB + i]
        return
    for i in range(BLOCK):
        near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
        far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
        t = dielectric_transmittance(s[VH + i], near, s[LH + i], far)
        s[FR + i] = t
        s[FG + i] = t
        s[FB + i] = t
    for i in range(BLOCK):
        if s[FILM + i] > 0.0 and s[VH + i] > 0.0 and s[LH + i] > 0.0:
            cosine = s[VH + i] if s[SIDE + i] > 0.0 else s[LH + i]
            red, green, blue = film_reflectance(
                min(cosine, 1.0), kind, s[A0 + i], s[A1 + i], s[A2 + i], s[B0 + i], s[B1 + i], s[B2 + i],
                s[C0 + i], s[C1 + i], s[C2 + i], s[EXPONENT + i], s[FILM + i], s[FILM_INDEX + i],
            )  # fmt: skip
            s[FR + i] = 1.0 - red
            s[FG + i] = 1.0 - green
            s[FB + i] = 1.0 - blue


@formula
def _refract(s: Array, turn: float, modes: Any) -> None:
    """Add one transmission lobe (001 eq. 2), times its share."""
    _place(s, turn)
    _refracting_normal(s)
    _normals(s, modes[DISTRIBUTION], modes[SKEWED] != 0)
    _visibility_across(s, modes[DISTRIBUTION], modes[MASKING], modes[CORRELATION], modes[SKEWED] != 0)
    _transmittance(s, modes[KIND], modes[FIFTH] != 0)
    for i in range(BLOCK):
        share = 1.0
        if modes[RETRO_TRANSMISSION] != 0:
            share = s[RETRO + i] if turn < 0.0 else 1.0 - s[RETRO + i]
        near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
        facing = s[VH + i] > 0.0 and s[LH + i] > 0.0 and s[HZ + i] > 0.0
        lit = s[EZ + i] > 0.0 and s[GZ + i] < 0.0 and facing and s[INDEX + i] != 1.0 and share > 0.0
        # (ηv v.h + ηl l.h)² is the squared length of the vector that h was normalised from.
        lobe = share * s[D + i] * s[VISIBLE + i] * s[VH + i] * s[LH + i] * near * near / s[HH + i]
        lobe = lobe if lit else 0.0
        s[OR + i] += lobe * s[FR + i]
        s[OG + i] += lobe * s[FG + i]
        s[OB + i] += lobe * s[FB + i]


@formula
def _lobes(s: Array) -> tuple[bool, bool]:
    """Whether a block holds any forward share, and any retro share."""
    forward = False
    retro = False
    for i in range(BLOCK):
        forward |= s[RETRO + i] < 1.0
        retro |= s[RETRO + i] > 0.0
    return forward, retro


@formula
def _any_across(s: Array) -> bool:
    found = False
    for i in range(BLOCK):
        found |= s[VZ + i] * s[LZ + i] < 0.0
    return found


def evaluate(start: int, stop: int, inputs: Any, modes: Any, outputs: Any) -> int:
    """f(v, l) of the whole lobe into `outputs[0]`; returns how many directions were not of unit length."""
    s = np.empty(SIZE)
    out = outputs[0]
    fit = inputs[IN_FIT]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        load(s, inputs, begin, count, begin == start)
        rejected += count_not_unit(s, VX, VY, VZ, count) + count_not_unit(s, LX, LY, LZ, count)
        indices(s, modes[KIND])
        for i in range(BLOCK):
            s[OR + i] = 0.0
            s[OG + i] = 0.0
            s[OB + i] = 0.0
        scheme = modes[COMPENSATION]
        if scheme == energy.MATERIALX_1_39_5 or scheme == energy.MATERIALX_1_39_6:
            _albedo_from_fit(s, fit)
        elif scheme == energy.TURQUIN or scheme == energy.KULLA_CONTY:
            _albedo_from_table(s, fit)
        forward, retro = _lobes(s)
        if modes[SCATTER] != TRANSMIT:
            if forward:
                _reflect(s, 1.0, modes)
            if retro:
                _reflect(s, -1.0, modes)
        if modes[SCATTER] != REFLECT and _any_across(s):
            if forward or modes[RETRO_TRANSMISSION] == 0:
                _refract(s, 1.0, modes)
            if retro and modes[RETRO_TRANSMISSION] != 0:
                _refract(s, -1.0, modes)
        opaque = modes[KIND] == CONDUCTOR
        for i in range(BLOCK):
            hidden = opaque and s[VZ + i] <= 0.0
            s[OR + i] = 0.0 if hidden else s[OR + i] * s[T0 + i]
            s[OG + i] = 0.0 if hidden else s[OG + i] * s[T1 + i]
            s[OB + i] = 0.0 if hidden else s[OB + i] * s[T2 + i]
        for i in range(count):
            out[begin + i, 0] = s[OR + i]
            out[begin + i, 1] = s[OG + i]
            out[begin + i, 2] = s[OB + i]
    return rejected


EVALUATE = Kernel(evaluate, INPUTS, 1)


@formula
def _visible_density(s: Array, modes: Any) -> None:
    """D_v(m) / (v.m), the density of normals seen from v' (eqs. 16 and 50), into VISIBLE."""
    if modes[MASKING] == surface.VCAVITY:
        _cosines(s)
        for i in range(BLOCK):
            hz = s[HZ + i] / math.sqrt(s[HH + i])
            s[VISIBLE + i] = s[D + i] * surface.vcavity_masking(hz, s[CV + i], s[VH + i]) / s[CV + i]
    else:
        _areas(s, modes[DISTRIBUTION], modes[SKEWED] != 0)
        for i in range(BLOCK):
            s[VISIBLE + i] = s[D + i] / s[AREA_V + i] if s[CV + i] > 0.0 else 0.0


@formula
def _reflection_density(s: Array, turn: float, modes: Any) -> None:
    """Density of l where the visible normal reflects v' (001 Section 4 and eq. 4)."""
    _place(s, turn)
    _reflecting_normal(s)
    _normals(s, modes[DISTRIBUTION], modes[SKEWED] != 0)
    _visible_density(s, modes)
    both = modes[SCATTER] == BOTH
    if both:
        fresnel(s, modes[KIND], modes[FIFTH] != 0)
    for i in range(BLOCK):
        share = s[RETRO + i] if turn < 0.0 else 1.0 - s[RETRO + i]
        lit = s[EZ + i] > 0.0 and s[GZ + i] > 0.0 and share > 0.0
        chance = (s[FR + i] + s[FG + i] + s[FB + i]) / 3.0 if both else 1.0
        s[OR + i] += 0.25 * share * chance * s[VISIBLE + i] if lit else 0.0


@formula
def _refraction_density(s: Array, turn: float, modes: Any) -> None:
    """Density of l where the visible normal refracts v': the Jacobian is eq. 5 of 001 with ηl² above."""
    _place(s, turn)
    _refracting_normal(s)
    _normals(s, modes[DISTRIBUTION], modes[SKEWED] != 0)
    _visible_density(s, modes)
    both = modes[SCATTER] == BOTH
    if both:
        _transmittance(s, modes[KIND], modes[FIFTH] != 0)
    for i in range(BLOCK):
        share = 1.0
        if modes[RETRO_TRANSMISSION] != 0:
            share = s[RETRO + i] if turn < 0.0 else 1.0 - s[RETRO + i]
        far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
        facing = s[VH + i] > 0.0 and s[LH + i] > 0.0 and s[HZ + i] > 0.0
        lit = s[EZ + i] > 0.0 and s[GZ + i] < 0.0 and facing and s[INDEX + i] != 1.0 and share > 0.0
        chance = (s[FR + i] + s[FG + i] + s[FB + i]) / 3.0 if both else 1.0
        density = share * chance * s[VISIBLE + i] * s[VH + i] * s[LH + i] * far * far / s[HH + i]
        s[OR + i] += density if lit else 0.0


def density(start: int, stop: int, inputs: Any, modes: Any, outputs: Any) -> int:
    """The density per steradian of what `draw` draws, into `outputs[0]`; returns as `evaluate` does."""
    s = np.empty(SIZE)
    out = outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        load(s, inputs, begin, count, begin == start)
        rejected += count_not_unit(s, VX, VY, VZ, count) + count_not_unit(s, LX, LY, LZ, count)
        indices(s, modes[KIND])
        for i in range(BLOCK):
            s[OR + i] = 0.0
        forward, retro = _lobes(s)
        if modes[SCATTER] != TRANSMIT:
            if forward:
                _reflection_density(s, 1.0, modes)
            if retro:
                _reflection_density(s, -1.0, modes)
        if modes[SCATTER] != REFLECT and _any_across(s):
            if forward or modes[RETRO_TRANSMISSION] == 0:
                _refraction_density(s, 1.0, modes)
            if retro and modes[RETRO_TRANSMISSION] != 0:
                _refraction_density(s, -1.0, modes)
        opaque = modes[KIND] == CONDUCTOR
        for i in range(count):
            hidden = opaque and s[VZ + i] <= 0.0
            out[begin + i, 0] = 0.0 if hidden else s[OR + i]
    return rejected


DENSITY = Kernel(density, INPUTS, 1)


@formula
def _reflectance_at(s: Array, i: int, cosine: float, side: float, kind: int) -> tuple[float, float, float]:
    """RGB reflectance of one configuration."""
    index = s[INDEX + i]
    if kind == CONDUCTOR:
        outer = cosine
    else:
        outer = outer_cosine(cosine, side, index)
        if outer < 0.0:
            return 1.0, 1.0, 1.0
    if s[FILM + i] > 0.0:
        return film_reflectance(
            min(outer, 1.0), kind, s[A0 + i], s[A1 + i], s[A2 + i], s[B0 + i], s[B1 + i], s[B2 + i],
            s[C0 + i], s[C1 + i], s[C2 + i], s[EXPONENT + i], s[FILM + i], s[FILM_INDEX + i],
        )  # fmt: skip
    if kind == DIELECTRIC:
        f = dielectric_reflectance(cosine, index if side > 0.0 else 1.0 / index)
        return f, f, f
    if kind == CONDUCTOR:
        return (
            conductor_reflectance(cosine, s[A0 + i], s[B0 + i]),
            conductor_reflectance(cosine, s[A1 + i], s[B1 + i]),
            conductor_reflectance(cosine, s[A2 + i], s[B2 + i]),
        )
    p = s[EXPONENT + i]
    return (
        schlick_reflectance(outer, s[A0 + i], s[B0 + i], s[C0 + i], p),
        schlick_reflectance(outer, s[A1 + i], s[B1 + i], s[C1 + i], p),
        schlick_reflectance(outer, s[A2 + i], s[B2 + i], s[C2 + i], p),
    )


@formula
def projected_area(distribution: int, cosine: float, sine: float) -> float:
    """cos θ (1 + Λ) of the named distribution."""
    if distribution == surface.GGX:
        return surface.ggx_projected_area(cosine, sine)
    if distribution == surface.BECKMANN:
        return surface.beckmann_projected_area(cosine, sine)
    return surface.beckmann_rational_projected_area(cosine, sine)


@formula
def _mesosurface(s: Array, i: int, x: float, y: float, z: float, distribution: int) -> tuple[float, float]:
    """The cosine of a direction with the mesosurface, and the area of all facets projected on it."""
    cosine = z - s[MX + i] * x - s[MY + i] * y
    sine = surface.stretched_sine(x, y, s[AX + i], s[AY + i], s[RXY + i])
    return cosine, projected_area(distribution, cosine, sine)


@formula
def shadowing_ratio(
    s: Array,
    i: int,
    modes: Any,
    ex: float,
    ey: float,
    ez: float,
    gx: float,
    gy: float,
    gz: float,
    mz: float,
    vm: float,
    lm: float,
) -> float:
    """G2 / G1(v), what a visible normal's sample is weighted with; l may be on either side."""
    across = gz < 0.0
    if modes[MASKING] == surface.VCAVITY:
        gv = surface.vcavity_masking(mz, ez, vm)
        gl = surface.vcavity_masking(mz, abs(gz), abs(lm))
        return max(0.0, gv + gl - 1.0) / gv if across else min(gv, gl) / gv
    cv, area_v = _mesosurface(s, i, ex, ey, ez, modes[DISTRIBUTION])
    turn = -1.0 if across else 1.0
    cl, area_l = _mesosurface(s, i, turn * gx, turn * gy, turn * gz, modes[DISTRIBUTION])
    if cv <= 0.0 or cl <= 0.0:
        return 0.0
    masking = modes[MASKING]
    if masking == surface.IMPLICIT:
        return area_v * cl
    if masking == surface.KELEMEN:
        return area_v * cl / (vm * lm)
    if masking == surface.SCHLICK_SMITH:
        kv = surface.schlick_smith_k(surface.stretched_sine(ex, ey, s[AX + i], s[AY + i], s[RXY + i]), cv)
        kl = surface.schlick_smith_k(surface.stretched_sine(gx, gy, s[AX + i], s[AY + i], s[RXY + i]), cl)
        return area_v * cl / ((cv * (1.0 - kv) + kv) * (cl * (1.0 - kl) + kl))
    correlation = modes[CORRELATION]
    if across:
        if correlation == surface.HEIGHT or correlation == surface.HEIGHT_DIRECTION:
            return area_v * cl * surface.beta_visibility(cv, cl, area_v, area_l)
        return cl / area_l
    if correlation == surface.HEIGHT:
        return area_v * cl * surface.height_visibility(cv, cl, area_v, area_l)
    if correlation == surface.SEPARABLE:
        return cl / area_l
    decorrelation = surface.ginneken(ex, ey, gx, gy)
    if correlation == surface.DIRECTION:
        return area_v * cl * surface.direction_visibility(cv, cl, area_v, area_l, decorrelation)
    return area_v * cl * surface.height_direction_visibility(cv, cl, area_v, area_l, decorrelation)


@formula
def _draw_one(s: Array, i: int, modes: Any, u0: float, u1: float, u2: float, out: Array, row: int) -> None:
    """Draw l for one v: a visible normal, then reflection or refraction by F, then v or v' by the blend.

    The sample for v' is that for v turned about the normal: a visible normal of v' is (-mx, -my, mz) with the same
    Fresnel term, G and density. A rejected sample leaves l = n and weight 0.
    """
    out[row, 0] = 0.0
    out[row, 1] = 0.0
    out[row, 2] = 1.0
    for c in range(3, 8):
        out[row, c] = 0.0
    side = 1.0 if s[VZ + i] >= 0.0 else -1.0
    ex, ey, ez = side * s[VX + i], side * s[VY + i], side * s[VZ + i]
    kind = modes[KIND]
    if ez <= 0.0 or (kind == CONDUCTOR and side < 0.0):
        return
    ax, ay, rxy = s[AX + i], s[AY + i], s[RXY + i]
    distribution = modes[DISTRIBUTION]
    if modes[MASKING] == surface.VCAVITY:
        mx, my, mz, u2 = sample_visible_vcavity(distribution, ex, ey, ez, ax, ay, rxy, u0, u1, u2)
    else:
        if ez - s[MX + i] * ex - s[MY + i] * ey <= 0.0:
            return
        mx, my, mz = sample_visible_smith(distribution, ex, ey, ez, ax, ay, rxy, s[MX + i], s[MY + i], u0, u1)
    cosine = ex * mx + ey * my + ez * mz
    if cosine <= 0.0:
        return
    cosine = min(cosine, 1.0)
    scatter = modes[SCATTER]
    chance = 1.0
    transmit = scatter == TRANSMIT
    red, green, blue = 0.0, 0.0, 0.0
    if scatter != REFLECT:
        red, green, blue = _reflectance_at(s, i, cosine, side, kind)
    if scatter == BOTH:
        chance = (red + green + blue) / 3.0
        transmit = u2 >= chance
        u2 = (u2 - chance) / (1.0 - chance) if transmit else u2 / chance
        chance = 1.0 - chance if transmit else chance
    turned = u2 < s[RETRO + i] and (not transmit or modes[RETRO_TRANSMISSION] != 0)
    if transmit:
        index = s[INDEX + i]
        ratio = 1.0 / index if side > 0.0 else index
        squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
        if squared <= 0.0:
            return
        along = ratio * cosine - math.sqrt(squared)
        x, y, z = along * mx - ratio * ex, along * my - ratio * ey, along * mz - ratio * ez
        if index == 1.0:
            x, y, z = -ex, -ey, -ez
        if z >= 0.0:
            return
        if index == 1.0:
            share = 1.0
            if modes[RETRO_TRANSMISSION] != 0:
                share = s[RETRO + i] if turned else 1.0 - s[RETRO + i]
            weight = shadowing_ratio(s, i, modes, ex, ey, ez, x, y, z, mz, cosine, cosine) / chance
            out[row, 3] = 1.0
            out[row, 4] = chance * share
            out[row, 5] = weight * (1.0 - red) * s[T0 + i]
            out[row, 6] = weight * (1.0 - green) * s[T1 + i]
            out[row, 7] = weight * (1.0 - blue) * s[T2 + i]
    else:
        x, y, z = 2.0 * cosine * mx - ex, 2.0 * cosine * my - ey, 2.0 * cosine * mz - ez
        if z <= 0.0:
            return
    # Rounding grows with 1 / cosine; directions leave here of unit length.
    length = math.sqrt(x * x + y * y + z * z)
    turn = -side if turned else side
    out[row, 0] = turn * x / length
    out[row, 1] = turn * y / length
    out[row, 2] = side * z / length
    if out[row, 3] == 0.0:
        out[row, 4] = 1.0


def draw(start: int, stop: int, inputs: Any, modes: Any, outputs: Any) -> int:
    """Directions for uniforms, where `inputs[IN_L]` holds the uniforms: l, delta flag, chance and delta weight."""
    s = np.empty(SIZE)
    out = outputs[0]
    rejected = 0
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        load(s, inputs, begin, count, begin == start)
        rejected += count_not_unit(s, VX, VY, VZ, count)
        indices(s, modes[KIND])
        for i in range(count):
            _draw_one(s, i, modes, s[LX + i], s[LY + i], s[LZ + i], out, begin + i)
    return rejected


DRAW = Kernel(draw, INPUTS, 1)


@formula
def _scattered(
    s: Array,
    i: int,
    modes: Any,
    ex: float,
    ey: float,
    ez: float,
    side: float,
    mx: float,
    my: float,
    mz: float,
) -> tuple[float, float, float, float, float]:
    """What one visible normal does: RGB reflectance, and G2 / G1 of its reflection and of its refraction."""
    cosine = ex * mx + ey * my + ez * mz
    if cosine <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    cosine = min(cosine, 1.0)
    red, green, blue = _reflectance_at(s, i, cosine, side, modes[KIND])
    reflected = 0.0
    transmitted = 0.0
    if modes[SCATTER] != TRANSMIT:
        x, y, z = 2.0 * cosine * mx - ex, 2.0 * cosine * my - ey, 2.0 * cosine * mz - ez
        if z > 0.0:
            reflected = shadowing_ratio(s, i, modes, ex, ey, ez, x, y, z, mz, cosine, cosine)
    if modes[SCATTER] != REFLECT:
        index = s[INDEX + i]
        ratio = 1.0 / index if side > 0.0 else index
        squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
        if squared > 0.0:
            far = math.sqrt(squared)
            along = ratio * cosine - far
            x, y, z = along * mx - ratio * ex, along * my - ratio * ey, along * mz - ratio * ez
            if z < 0.0:
                transmitted = shadowing_ratio(s, i, modes, ex, ey, ez, x, y, z, mz, cosine, far)
    return red, green, blue, reflected, transmitted


def albedo(start: int, stop: int, inputs: Any, modes: Any, outputs: Any) -> int:
    """Reflected and transmitted share of the energy that arrives along v, before the tint.

    The average over visible normals; `inputs[INPUTS]` holds the quadrature's nodes (u0, u1, weight).
    """
    s = np.empty(SIZE)
    out = outputs[0]
    nodes = inputs[INPUTS]
    rejected = 0
    distribution = modes[DISTRIBUTION]
    scheme = modes[COMPENSATION]
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        load(s, inputs, begin, count, begin == start)
        rejected += count_not_unit(s, VX, VY, VZ, count)
        indices(s, modes[KIND])
        if scheme == energy.MATERIALX_1_39_5 or scheme == energy.MATERIALX_1_39_6:
            _albedo_from_fit(s, inputs[IN_FIT])
        elif scheme == energy.TURQUIN:
            _albedo_from_table(s, inputs[IN_FIT])
        for i in range(count):
            for c in range(6):
                out[begin + i, c] = 0.0
            side = 1.0 if s[VZ + i] >= 0.0 else -1.0
            ex, ey, ez = side * s[VX + i], side * s[VY + i], side * s[VZ + i]
            boost = (1.0 - s[ALBEDO + i]) / s[ALBEDO + i] if scheme == energy.MATERIALX_1_39_5 else 0.0
            if ez - s[MX + i] * ex - s[MY + i] * ey <= 0.0 or (modes[KIND] == CONDUCTOR and side < 0.0):
                continue
            for k in range(nodes.shape[0]):
                u0, u1, weight = nodes[k, 0], nodes[k, 1], nodes[k, 2]
                if modes[MASKING] == surface.VCAVITY:
                    mx, my, mz = sample_normal(distribution, s[AX + i], s[AY + i], s[RXY + i], u0, u1)
                    length = math.sqrt(mx * mx + my * my + mz * mz)
                    mx, my, mz = mx / length, my / length, mz / length
                    # The azimuth covers both facets of each cavity, so each normal stands for itself.
                    cosine = max(ex * mx + ey * my + ez * mz, 0.0)
                    other = max(-ex * mx - ey * my + ez * mz, 0.0)
                    weight *= 2.0 * cosine / (cosine + other) if cosine > 0.0 else 0.0
                else:
                    mx, my, mz = sample_visible_smith(
                        distribution,
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
                red, green, blue, reflected, transmitted = _scattered(
                    s, i, modes, ex, ey, ez, side, mx, my, mz
                )
                out[begin + i, 0] += weight * reflected * red * (1.0 + red * boost)
                out[begin + i, 1] += weight * reflected * green * (1.0 + green * boost)
                out[begin + i, 2] += weight * reflected * blue * (1.0 + blue * boost)
                out[begin + i, 3] += weight * transmitted * (1.0 - red)
                out[begin + i, 4] += weight * transmitted * (1.0 - green)
                out[begin + i, 5] += weight * transmitted * (1.0 - blue)
        # The schemes whose factor depends on v alone.
        if scheme == energy.MATERIALX_1_39_6 or scheme == energy.TURQUIN:
            _place(s, 1.0)
            if scheme == energy.TURQUIN:
                _normal_incidence(s, modes[KIND], modes[FIFTH] != 0)
            else:
                _average_reflectance(s, modes[KIND], modes[FIFTH] != 0)
            for i in range(count):
                out[begin + i, 0] *= compensation(s[FR + i], s[ALBEDO + i])
                out[begin + i, 1] *= compensation(s[FG + i], s[ALBEDO + i])
                out[begin + i, 2] *= compensation(s[FB + i], s[ALBEDO + i])
    return rejected


INTEGRATE = Kernel(albedo, INPUTS + 1, 1)


def reflectance(start: int, stop: int, inputs: Any, modes: Any, outputs: Any) -> int:
    """RGB reflectance seen from outside at the cosines in `inputs[IN_L]`, or its average over the hemisphere."""
    s = np.empty(SIZE)
    out = outputs[0]
    for begin in range(start, stop, BLOCK):
        count = min(BLOCK, stop - begin)
        load(s, inputs, begin, count, begin == start)
        indices(s, modes[KIND])
        for i in range(BLOCK):
            s[SIDE + i] = 1.0
            s[VH + i] = s[LX + i]
        if modes[COMPENSATION] == energy.MATERIALX_1_39_6:
            _average_reflectance(s, modes[KIND], modes[FIFTH] != 0)
        else:
            fresnel(s, modes[KIND], modes[FIFTH] != 0)
        for i in range(count):
            out[begin + i, 0] = s[FR + i]
            out[begin + i, 1] = s[FG + i]
            out[begin + i, 2] = s[FB + i]
    return 0


REFLECTANCE = Kernel(reflectance, INPUTS, 1)
