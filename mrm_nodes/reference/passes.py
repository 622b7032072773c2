"""The passes: each equation of the model over a block.

Equation numbers without a paper are those of Heitz 2014; 001 is "The Minimal Retroreflective Microfacet
Model"."""

import math
from typing import Any

from . import energy_formulas as energy
from . import microsurface as surface
from .block import (
    A0,
    A1,
    A2,
    ALBEDO,
    AREA_L,
    AREA_V,
    AX,
    AY,
    B0,
    B1,
    B2,
    BLOCK,
    C0,
    C1,
    C2,
    CL,
    COATED,
    COMPENSATION,
    CORRELATION,
    CV,
    DISTRIBUTION,
    EX,
    EXPONENT,
    EY,
    EZ,
    FB,
    FG,
    FIFTH,
    FILM,
    FILM_INDEX,
    FR,
    GX,
    GY,
    GZ,
    HH,
    HORIZON,
    HX,
    HY,
    HZ,
    INDEX,
    KIND,
    LH,
    LX,
    LY,
    LZ,
    MASKING,
    MX,
    MY,
    OUTER,
    REFLECT,
    RETRO,
    RXY,
    SCATTER,
    SIDE,
    SINE_L,
    SINE_V,
    SKEWED,
    TB,
    TG,
    TR,
    VH,
    VISIBLE,
    VX,
    VY,
    VZ,
    D,
    not_unit,
)
from .compiled import Array, formula, inlined
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
from .thinfilm import film_reflectance


@formula
def place(s: Array, modes: Any, lit: bool) -> int:
    """v, and if `lit` l, as seen from v's side; returns how many of them are not of unit length.

    Seen from inside, a surface is its own point reflection: v and l are negated, and slopes keep their
    distribution. A conductor has no inside: v stays below the surface, where nothing is lit."""
    inside = 1.0 if modes[KIND] == CONDUCTOR else -1.0
    rejected = 0
    for i in range(BLOCK):
        x, y, z = s[VX + i], s[VY + i], s[VZ + i]
        rejected += not_unit(x, y, z)
        side = 1.0 if z >= 0.0 else inside
        s[SIDE + i] = side
        s[EX + i] = side * x
        s[EY + i] = side * y
        s[EZ + i] = side * z if abs(z) > HORIZON else 0.0
    if lit:
        for i in range(BLOCK):
            x, y, z = s[LX + i], s[LY + i], s[LZ + i]
            rejected += not_unit(x, y, z)
            s[GX + i] = s[SIDE + i] * x
            s[GY + i] = s[SIDE + i] * y
            s[GZ + i] = s[SIDE + i] * z if abs(z) > HORIZON else 0.0
    return rejected


@formula
def turn(s: Array) -> None:
    """v' = reflect(v, n) for v (001 eq. 3), or back."""
    for i in range(BLOCK):
        s[EX + i] = -s[EX + i]
        s[EY + i] = -s[EY + i]


@formula
def reflecting_normal(s: Array, modes: Any) -> None:
    """h_r of v and l, the back vector where v is v' (001 eq. 3), its cosine with either, and D of it."""
    plain = modes[DISTRIBUTION] == surface.GGX and modes[SKEWED] == 0
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
        if plain:
            s[D + i] = surface.ggx_normals(x, y, z, hh, s[AX + i], s[AY + i])
    if not plain:
        normals(s, modes)


@formula
def plain(modes: Any) -> bool:
    """Whether `plain_lobe` is the whole lobe: reflection by GGX about the normal, with Smith's masking of
    heights or separable, and no compensation.
    """
    ggx = modes[DISTRIBUTION] == surface.GGX and modes[SKEWED] == 0 and modes[MASKING] == surface.SMITH
    masked = modes[CORRELATION] == surface.HEIGHT or modes[CORRELATION] == surface.SEPARABLE
    alone: bool = modes[SCATTER] == REFLECT and modes[COMPENSATION] == energy.NONE
    return ggx and masked and alone


@inlined
def plain_lobe(s: Array, modes: Any, v: Array, l: Array, start: int, turn: float) -> int:  # noqa: E741
    """D G2 / (4 cos v cos l) times the lobe's share into VISIBLE, 0 where nothing is lit, and v.h into OUTER;
    `turn` is 1, or -1 for the retro lobe.

    What `place`, `areas`, `reflecting_normal` and `visibility` do, in one loop: the same formulas, with
    nothing stored between them."""
    inside = 1.0 if modes[KIND] == CONDUCTOR else -1.0
    rejected = 0
    if start < 0:
        return 0
    if modes[CORRELATION] == surface.HEIGHT:
        for i in range(BLOCK):
            rejected += _plain_at(s, i, v, l, start + 3 * i, inside, turn, surface.height_visibility)
    else:
        for i in range(BLOCK):
            rejected += _plain_at(s, i, v, l, start + 3 * i, inside, turn, _separable)
    return rejected


@inlined
def _separable(_: float, __: float, area_v: float, area_l: float) -> float:
    return surface.separable_visibility(area_v, area_l)


@inlined
def _plain_at(
    s: Array,
    i: int,
    v: Array,
    l: Array,  # noqa: E741
    k: int,
    inside: float,
    turn: float,
    visibility: Any,
) -> int:
    vx, vy, vz = v[k], v[k + 1], v[k + 2]
    lx, ly, lz = l[k], l[k + 1], l[k + 2]
    side = 1.0 if vz >= 0.0 else inside
    s[SIDE + i] = side
    cv, cl = side * vz, side * lz
    ax, ay = s[AX + i], s[AY + i]
    across, along = ax * vx, ay * vy
    area_v = surface.ggx_projected_area(cv, across * across + along * along)
    across, along = ax * lx, ay * ly
    area_l = surface.ggx_projected_area(cl, across * across + along * along)
    x, y, z = turn * vx + lx, turn * vy + ly, vz + lz
    hh = x * x + y * y + z * z
    # Half the length of v + l is the cosine with either.
    s[OUTER + i] = 0.5 * math.sqrt(hh)
    lobe = surface.ggx_normals(x, y, z, hh, ax, ay) * visibility(cv, cl, area_v, area_l)
    share = 1.0 - s[RETRO + i] if turn > 0.0 else s[RETRO + i]
    lit = min(min(cv, cl) - HORIZON, share) > 0.0
    s[VISIBLE + i] = 0.25 * share * lobe if lit else 0.0
    return not_unit(vx, vy, vz) + not_unit(lx, ly, lz)


@formula
def refracting_normal(s: Array) -> None:
    """h_t = -(ηv v + ηl l), turned to the near side (001, above eq. 2), and its cosines with both
    directions.
    """
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
def normals(s: Array, modes: Any) -> None:
    """D at the selected normal."""
    distribution = modes[DISTRIBUTION]
    if distribution == surface.PHONG:
        for i in range(BLOCK):
            s[D + i] = surface.phong_normals(s[HX + i], s[HY + i], s[HZ + i], s[HH + i], s[AX + i], s[AY + i])
    elif distribution == surface.GGX and modes[SKEWED] == 0:
        for i in range(BLOCK):
            s[D + i] = surface.ggx_normals(s[HX + i], s[HY + i], s[HZ + i], s[HH + i], s[AX + i], s[AY + i])
    elif distribution == surface.GGX:
        for i in range(BLOCK):
            norm = surface.slope_norm_squared(
                s[HX + i], s[HY + i], s[HZ + i], s[AX + i], s[AY + i], s[RXY + i], s[MX + i], s[MY + i]
            )
            s[D + i] = surface.ggx_skewed_normals(
                s[HZ + i], norm, s[HH + i], s[AX + i], s[AY + i], s[RXY + i]
            )
    elif distribution == surface.BECKMANN or distribution == surface.BECKMANN_RATIONAL:
        for i in range(BLOCK):
            norm = surface.slope_norm_squared(
                s[HX + i], s[HY + i], s[HZ + i], s[AX + i], s[AY + i], s[RXY + i], s[MX + i], s[MY + i]
            )
            s[D + i] = surface.beckmann_normals(s[HZ + i], norm, s[HH + i], s[AX + i], s[AY + i], s[RXY + i])
    else:
        raise NotImplementedError("D of this distribution")


@formula
def areas(s: Array, modes: Any) -> None:
    """Cosines with the mesosurface (Section 5.5) and projected areas (eq. 41), of v and of l or, below, of
    -l.

    Turning v about the normal changes none of them unless slopes are shifted, and then there is no retro
    lobe."""
    if modes[SKEWED] == 0:
        for i in range(BLOCK):
            s[CV + i] = s[EZ + i]
            s[CL + i] = abs(s[GZ + i])
            x, y = s[AX + i] * s[EX + i], s[AY + i] * s[EY + i]
            s[SINE_V + i] = x * x + y * y
            x, y = s[AX + i] * s[GX + i], s[AY + i] * s[GY + i]
            s[SINE_L + i] = x * x + y * y
    else:
        _skewed_sines(s)
    distribution = modes[DISTRIBUTION]
    if distribution == surface.BECKMANN:
        for i in range(BLOCK):
            s[AREA_V + i] = surface.beckmann_projected_area(s[CV + i], math.sqrt(s[SINE_V + i]))
            s[AREA_L + i] = surface.beckmann_projected_area(s[CL + i], math.sqrt(s[SINE_L + i]))
    elif distribution == surface.BECKMANN_RATIONAL:
        for i in range(BLOCK):
            s[AREA_V + i] = surface.beckmann_rational_projected_area(s[CV + i], math.sqrt(s[SINE_V + i]))
            s[AREA_L + i] = surface.beckmann_rational_projected_area(s[CL + i], math.sqrt(s[SINE_L + i]))
    elif distribution == surface.GGX:
        for i in range(BLOCK):
            s[AREA_V + i] = surface.ggx_projected_area(s[CV + i], s[SINE_V + i])
            s[AREA_L + i] = surface.ggx_projected_area(s[CL + i], s[SINE_L + i])
    else:
        raise NotImplementedError("a projected area of this distribution")


@formula
def _skewed_sines(s: Array) -> None:
    for i in range(BLOCK):
        up = 1.0 if s[GZ + i] >= 0.0 else -1.0
        s[CV + i] = s[EZ + i] - s[MX + i] * s[EX + i] - s[MY + i] * s[EY + i]
        s[CL + i] = up * (s[GZ + i] - s[MX + i] * s[GX + i] - s[MY + i] * s[GY + i])
        s[SINE_V + i] = surface.stretched_sine_squared(s[EX + i], s[EY + i], s[AX + i], s[AY + i], s[RXY + i])
        s[SINE_L + i] = surface.stretched_sine_squared(s[GX + i], s[GY + i], s[AX + i], s[AY + i], s[RXY + i])


@formula
def _off_the_normal(s: Array) -> None:
    """The lit area is the mesosurface's; the caller's cosine is the geometric surface's (Section 5.5)."""
    for i in range(BLOCK):
        visible = s[VISIBLE + i] * s[CL + i] / abs(s[GZ + i])
        s[VISIBLE + i] = visible if min(s[CV + i], s[CL + i]) > 0.0 else 0.0


@formula
def visibility(s: Array, modes: Any) -> None:
    """G2 / (cos v cos l) where v and l are on one side."""
    masking, correlation = modes[MASKING], modes[CORRELATION]
    if masking == surface.VCAVITY:
        for i in range(BLOCK):
            hz = s[HZ + i] / math.sqrt(s[HH + i])
            g = surface.vcavity_masking(hz, min(s[EZ + i], s[GZ + i]), s[VH + i])
            s[VISIBLE + i] = g / (s[EZ + i] * s[GZ + i])
    elif masking == surface.IMPLICIT:
        for i in range(BLOCK):
            s[VISIBLE + i] = 1.0
    elif masking == surface.KELEMEN:
        for i in range(BLOCK):
            s[VISIBLE + i] = 1.0 / (s[VH + i] * s[VH + i])
    elif masking == surface.SCHLICK_SMITH:
        for i in range(BLOCK):
            v = surface.schlick_smith_area(s[EZ + i], math.sqrt(s[SINE_V + i]))
            l = surface.schlick_smith_area(s[GZ + i], math.sqrt(s[SINE_L + i]))  # noqa: E741
            s[VISIBLE + i] = 1.0 / (v * l)
    elif masking != surface.SMITH:
        raise NotImplementedError("G2 of this masking")
    elif correlation == surface.HEIGHT:
        for i in range(BLOCK):
            s[VISIBLE + i] = surface.height_visibility(s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i])
    elif correlation == surface.SEPARABLE:
        for i in range(BLOCK):
            s[VISIBLE + i] = surface.separable_visibility(s[AREA_V + i], s[AREA_L + i])
    elif correlation == surface.DIRECTION:
        for i in range(BLOCK):
            apart = surface.ginneken(s[EX + i], s[EY + i], s[GX + i], s[GY + i])
            s[VISIBLE + i] = surface.direction_visibility(
                s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i], apart
            )
    elif correlation == surface.HEIGHT_DIRECTION:
        for i in range(BLOCK):
            apart = surface.ginneken(s[EX + i], s[EY + i], s[GX + i], s[GY + i])
            s[VISIBLE + i] = surface.height_direction_visibility(
                s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i], apart
            )
    else:
        raise NotImplementedError("masking of this correlation")
    if modes[SKEWED] != 0 and masking == surface.SMITH:
        _off_the_normal(s)


@formula
def visibility_across(s: Array, modes: Any) -> None:
    """G2 / (cos v cos l) where v and l are on opposite sides."""
    correlation = modes[CORRELATION]
    if modes[MASKING] == surface.VCAVITY:
        for i in range(BLOCK):
            hz = s[HZ + i] / math.sqrt(s[HH + i])
            gv = surface.vcavity_masking(hz, s[EZ + i], s[VH + i])
            gl = surface.vcavity_masking(hz, abs(s[GZ + i]), s[LH + i])
            s[VISIBLE + i] = max(0.0, gv + gl - 1.0) / (s[EZ + i] * abs(s[GZ + i]))
        return
    if correlation == surface.HEIGHT or correlation == surface.HEIGHT_DIRECTION:
        for i in range(BLOCK):
            # Three logarithms of the Gamma function: not for lanes that reflect.
            across = s[GZ + i] < 0.0 and s[CV + i] > 0.0 and s[CL + i] > 0.0
            s[VISIBLE + i] = (
                surface.beta_visibility(s[CV + i], s[CL + i], s[AREA_V + i], s[AREA_L + i]) if across else 0.0
            )
    elif correlation == surface.SEPARABLE or correlation == surface.DIRECTION:
        for i in range(BLOCK):
            s[VISIBLE + i] = surface.separable_visibility(s[AREA_V + i], s[AREA_L + i])
    else:
        raise NotImplementedError("masking of this correlation")
    if modes[SKEWED] != 0:
        _off_the_normal(s)


@formula
def visible_density(s: Array, modes: Any) -> None:
    """D_v(m) / (v.m), the density of the normals that are seen from v (eqs. 16 and 50), into VISIBLE."""
    if modes[MASKING] == surface.VCAVITY:
        for i in range(BLOCK):
            hz = s[HZ + i] / math.sqrt(s[HH + i])
            s[VISIBLE + i] = s[D + i] * surface.vcavity_masking(hz, s[EZ + i], s[VH + i]) / s[EZ + i]
    else:
        for i in range(BLOCK):
            visible = s[D + i] / s[AREA_V + i]
            s[VISIBLE + i] = visible if s[CV + i] > 0.0 else 0.0


@formula
def indices(s: Array, modes: Any) -> None:
    """The index of refraction of the inside; a conductor has none."""
    if modes[KIND] == SCHLICK:
        for i in range(BLOCK):
            s[INDEX + i] = index_from_f0((s[A0 + i] + s[A1 + i] + s[A2 + i]) / 3.0)
    elif modes[KIND] == DIELECTRIC:
        for i in range(BLOCK):
            s[INDEX + i] = s[A0 + i]


@formula
def outer_cosine(cosine: float, side: float, index: float) -> float:
    """The cosine on the outside of an interface, -1 where there is none: total internal reflection."""
    squared = 1.0 - index * index * (1.0 - cosine * cosine)
    outer = math.sqrt(max(squared, 0.0))
    return cosine if side > 0.0 else (outer if squared > 0.0 else -1.0)


@formula
def reflecting_cosine(s: Array, modes: Any) -> None:
    """The outer cosine where v.m is known; a conductor has no inside."""
    if modes[KIND] == CONDUCTOR:
        for i in range(BLOCK):
            s[OUTER + i] = s[VH + i]
    else:
        for i in range(BLOCK):
            s[OUTER + i] = outer_cosine(s[VH + i], s[SIDE + i], s[INDEX + i])


@formula
def refracting_cosine(s: Array) -> None:
    """The outer cosine where both are known."""
    for i in range(BLOCK):
        s[OUTER + i] = s[VH + i] if s[SIDE + i] > 0.0 else s[LH + i]


@formula
def fresnel(s: Array, modes: Any) -> None:
    """Reflectance of the interface at its outer cosine, the same from either side; 1 where there is none."""
    kind = modes[KIND]
    if kind == DIELECTRIC:
        for i in range(BLOCK):
            f = dielectric_reflectance(s[OUTER + i], s[INDEX + i])
            f = f if s[OUTER + i] > 0.0 else 1.0
            s[FR + i] = f
            s[FG + i] = f
            s[FB + i] = f
    elif kind == CONDUCTOR:
        for i in range(BLOCK):
            s[FR + i] = conductor_reflectance(s[OUTER + i], s[A0 + i], s[B0 + i])
            s[FG + i] = conductor_reflectance(s[OUTER + i], s[A1 + i], s[B1 + i])
            s[FB + i] = conductor_reflectance(s[OUTER + i], s[A2 + i], s[B2 + i])
    else:
        if modes[FIFTH] != 0:
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
            total = s[OUTER + i] < 0.0
            s[FR + i] = 1.0 if total else s[FR + i]
            s[FG + i] = 1.0 if total else s[FG + i]
            s[FB + i] = 1.0 if total else s[FB + i]
    if s[COATED] > 0.0:
        for i in range(BLOCK):
            if s[FILM + i] > 0.0 and s[OUTER + i] > 0.0:
                s[FR + i], s[FG + i], s[FB + i] = film_reflectance(
                    min(s[OUTER + i], 1.0), kind,
                    s[A0 + i], s[A1 + i], s[A2 + i], s[B0 + i], s[B1 + i], s[B2 + i],
                    s[C0 + i], s[C1 + i], s[C2 + i], s[EXPONENT + i], s[FILM + i], s[FILM_INDEX + i],
                )  # fmt: skip


@formula
def transmittance(s: Array, modes: Any) -> None:
    """1 - F at the refracting normal, from both cosines where they are what it is made of (001 eq. 11)."""
    refracting_cosine(s)
    fresnel(s, modes)
    for i in range(BLOCK):
        s[FR + i] = 1.0 - s[FR + i]
        s[FG + i] = 1.0 - s[FG + i]
        s[FB + i] = 1.0 - s[FB + i]
    if modes[KIND] == DIELECTRIC:
        for i in range(BLOCK):
            near = 1.0 if s[SIDE + i] > 0.0 else s[INDEX + i]
            far = s[INDEX + i] if s[SIDE + i] > 0.0 else 1.0
            t = dielectric_transmittance(s[VH + i], near, s[LH + i], far)
            s[FR + i] = s[FR + i] if s[FILM + i] > 0.0 else t
            s[FG + i] = s[FG + i] if s[FILM + i] > 0.0 else t
            s[FB + i] = s[FB + i] if s[FILM + i] > 0.0 else t


@formula
def white_albedo(s: Array, modes: Any, table: Array) -> None:
    """E at v: MaterialX's fit, by the mean alpha, or the exact table."""
    scheme = modes[COMPENSATION]
    if scheme == energy.MATERIALX_1_39_5 or scheme == energy.MATERIALX_1_39_6:
        for i in range(BLOCK):
            a, b = rational_albedo(min(max(s[EZ + i], 1e-8), 1.0), math.sqrt(s[AX + i] * s[AY + i]), table)
            s[ALBEDO + i] = a + b
    elif scheme != energy.NONE:
        look_up(s, EX, ALBEDO, table)


@inlined
def look_up(s: Array, direction: int, row: int, table: Array) -> None:
    """E at the direction in three rows, by the exact table, into one; alpha above 1 is taken as 1."""
    for i in range(BLOCK):
        x, y, z = s[direction + i], s[direction + BLOCK + i], s[direction + 2 * BLOCK + i]
        ax, ay = min(s[AX + i], 1.0), min(s[AY + i], 1.0)
        s[row + i] = energy.albedo_lookup(x, y, z, ax, ay, s[RXY + i], table)


@formula
def typical_reflectance(s: Array, modes: Any) -> None:
    """The reflectance of the schemes that take one for all directions: at the normal, or F0 + (F90 - F0) /
    21.
    """
    for i in range(BLOCK):
        s[OUTER + i] = 1.0
    fresnel(s, modes)
    if modes[COMPENSATION] == energy.MATERIALX_1_39_6:
        for i in range(BLOCK):
            bare = modes[KIND] == SCHLICK and s[FILM + i] <= 0.0
            s[FR + i] += ((s[C0 + i] if bare else 1.0) - s[FR + i]) / 21.0
            s[FG + i] += ((s[C1 + i] if bare else 1.0) - s[FG + i]) / 21.0
            s[FB + i] += ((s[C2 + i] if bare else 1.0) - s[FB + i]) / 21.0


@inlined
def compensate(s: Array, row: int) -> None:
    """Multiply three rows of colours by 1 + F (1 - E) / E."""
    for i in range(BLOCK):
        s[row + i] *= compensation(s[FR + i], s[ALBEDO + i])
        s[row + BLOCK + i] *= compensation(s[FG + i], s[ALBEDO + i])
        s[row + 2 * BLOCK + i] *= compensation(s[FB + i], s[ALBEDO + i])


@formula
def multiple_reflectance(s: Array, modes: Any, table: Array) -> None:
    """RGB share of the lost energy that Kulla and Conty's term gives back, over 1 - E_avg, into TR, TG, TB.

    F_avg² E_avg / (1 - F_avg (1 - E_avg)), with the cosine-weighted mean of F by Gauss-Legendre quadrature.
    """
    for i in range(BLOCK):
        s[TR + i] = 0.0
        s[TG + i] = 0.0
        s[TB + i] = 0.0
    for k in range(len(energy.AVERAGE_NODES)):
        node, weight = energy.AVERAGE_NODES[k]
        for i in range(BLOCK):
            s[VH + i] = node
        reflecting_cosine(s, modes)
        fresnel(s, modes)
        for i in range(BLOCK):
            s[TR + i] += weight * s[FR + i]
            s[TG + i] += weight * s[FG + i]
            s[TB + i] += weight * s[FB + i]
    for i in range(BLOCK):
        average = energy.average_lookup(min(s[AX + i], 1.0), min(s[AY + i], 1.0), s[RXY + i], table)
        s[TR + i] = energy.multiple_scattering(s[TR + i], average)
        s[TG + i] = energy.multiple_scattering(s[TG + i], average)
        s[TB + i] = energy.multiple_scattering(s[TB + i], average)
