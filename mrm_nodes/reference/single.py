"""One configuration at a time: drawing a direction, and what a visible normal does with the energy.

Here the work branches from lane to lane, so there is nothing for vector instructions to gain. Equation
numbers are those of Heitz 2014; 001 is "The Minimal Retroreflective Microfacet Model"."""

import math
from typing import Any

from . import energy_formulas as energy
from . import microsurface as surface
from .block import (
    A0,
    A1,
    A2,
    ALBEDO,
    AX,
    AY,
    B0,
    B1,
    B2,
    BOTH,
    C0,
    C1,
    C2,
    COMPENSATION,
    CORRELATION,
    DISTRIBUTION,
    EXPONENT,
    FILM,
    FILM_INDEX,
    INDEX,
    KIND,
    MASKING,
    MX,
    MY,
    REFLECT,
    RETRO,
    RETRO_TRANSMISSION,
    RXY,
    SCATTER,
    T0,
    T1,
    T2,
    TRANSMIT,
    VX,
    VY,
    VZ,
)
from .compiled import Array, formula
from .fresnel import CONDUCTOR, DIELECTRIC, conductor_reflectance, dielectric_reflectance, schlick_reflectance
from .passes import outer_cosine
from .sampling import sample_visible_smith, sample_visible_vcavity
from .thinfilm import film_reflectance


@formula
def reflectance_at(s: Array, i: int, cosine: float, side: float, kind: int) -> tuple[float, float, float]:
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
            min(outer, 1.0), kind,
            s[A0 + i], s[A1 + i], s[A2 + i], s[B0 + i], s[B1 + i], s[B2 + i],
            s[C0 + i], s[C1 + i], s[C2 + i], s[EXPONENT + i], s[FILM + i], s[FILM_INDEX + i],
        )  # fmt: skip
    if kind == DIELECTRIC:
        f = dielectric_reflectance(outer, index)
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
def _mesosurface(s: Array, i: int, x: float, y: float, z: float, distribution: int) -> tuple[float, float]:
    """The cosine of a direction with the mesosurface, and the area of all facets projected on it."""
    cosine = z - s[MX + i] * x - s[MY + i] * y
    squared = surface.stretched_sine_squared(x, y, s[AX + i], s[AY + i], s[RXY + i])
    return cosine, surface.projected_area(distribution, cosine, squared)


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
        sine_v = math.sqrt(surface.stretched_sine_squared(ex, ey, s[AX + i], s[AY + i], s[RXY + i]))
        sine_l = math.sqrt(surface.stretched_sine_squared(gx, gy, s[AX + i], s[AY + i], s[RXY + i]))
        return area_v * cl / (surface.schlick_smith_area(cv, sine_v) * surface.schlick_smith_area(cl, sine_l))
    if masking != surface.SMITH:
        raise NotImplementedError("G2 of this masking")
    correlation = modes[CORRELATION]
    return area_v * cl * surface.smith_visibility(correlation, across, cv, cl, area_v, area_l, ex, ey, gx, gy)


@formula
def draw_one(s: Array, i: int, modes: Any, u0: float, u1: float, u2: float, out: Array, row: int) -> None:
    """Draw l for one v into columns l, delta flag, chance and delta weight: a visible normal, then
    reflection or refraction by F, then v or v' by the blend.

    The sample for v' is that for v turned about the normal: a visible normal of v' is (-mx, -my, mz) with
    the same Fresnel term, G and density. A rejected sample leaves l = n and weight 0."""
    out[row] = 0.0
    out[row + 1] = 0.0
    out[row + 2] = 1.0
    for c in range(3, 8):
        out[row + c] = 0.0
    side = 1.0 if s[VZ + i] >= 0.0 else -1.0
    ex, ey, ez = side * s[VX + i], side * s[VY + i], side * s[VZ + i]
    kind = modes[KIND]
    if ez <= 0.0 or (kind == CONDUCTOR and side < 0.0):
        return
    ax, ay, rxy = s[AX + i], s[AY + i], s[RXY + i]
    mixture = 1.0
    distribution = modes[DISTRIBUTION]
    scatter = modes[SCATTER]
    if modes[COMPENSATION] == energy.KULLA_CONTY and scatter != TRANSMIT:
        lost = 1.0 - s[ALBEDO + i]
        if u2 < lost:
            # The term that gives back lost energy is nearly diffuse.
            radius, phi = math.sqrt(u0), 2.0 * math.pi * u1
            out[row] = radius * math.cos(phi)
            out[row + 1] = radius * math.sin(phi)
            out[row + 2] = side * math.sqrt(1.0 - u0)
            out[row + 4] = 1.0
            return
        u2 = (u2 - lost) / (1.0 - lost)
        mixture = 1.0 - lost
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
    chance = 1.0
    transmit = scatter == TRANSMIT
    red, green, blue = 0.0, 0.0, 0.0
    if scatter != REFLECT:
        red, green, blue = reflectance_at(s, i, cosine, side, kind)
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
            weight = shadowing_ratio(s, i, modes, ex, ey, ez, x, y, z, mz, cosine, cosine) / (
                chance * mixture
            )
            out[row + 3] = 1.0
            out[row + 4] = chance * share * mixture
            out[row + 5] = weight * (1.0 - red) * s[T0 + i]
            out[row + 6] = weight * (1.0 - green) * s[T1 + i]
            out[row + 7] = weight * (1.0 - blue) * s[T2 + i]
    else:
        x, y, z = 2.0 * cosine * mx - ex, 2.0 * cosine * my - ey, 2.0 * cosine * mz - ez
        if z <= 0.0:
            return
    # Rounding grows with 1 / cosine; directions leave here of unit length.
    length = math.sqrt(x * x + y * y + z * z)
    turn = -side if turned else side
    out[row] = turn * x / length
    out[row + 1] = turn * y / length
    out[row + 2] = side * z / length
    if out[row + 3] == 0.0:
        out[row + 4] = 1.0


@formula
def scattered(
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
    red, green, blue = reflectance_at(s, i, cosine, side, modes[KIND])
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
