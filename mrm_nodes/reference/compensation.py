"""The energy that multiple scattering loses, given back: over a block, by each scheme of `energy_formulas`."""

import math
from typing import Any

from . import energy_formulas as energy
from .block import (
    ALBEDO,
    AX,
    AY,
    BLOCK,
    C0,
    C1,
    C2,
    COMPENSATION,
    EX,
    EZ,
    FB,
    FG,
    FILM,
    FR,
    GX,
    GZ,
    INDEX,
    KIND,
    OB,
    OG,
    OR,
    OTHER_ALBEDO,
    OUTER,
    REFLECTANCE,
    RXY,
    SIDE,
    TB,
    TG,
    TR,
)
from .compiled import Array, call, formula, inlined
from .energy_formulas import compensation, rational_albedo
from .fresnel import CONDUCTOR, SCHLICK, outer_cosine


@formula
def white_albedo(s: Array, modes: Any, table: Array) -> None:
    """E at v: MaterialX's fit, by the mean alpha, or the exact table."""
    scheme = modes[COMPENSATION]
    if scheme == energy.MATERIALX_1_39_5 or scheme == energy.MATERIALX_1_39_6:
        for i in range(BLOCK):
            a, b = rational_albedo(min(max(s[EZ + i], 1e-8), 1.0), math.sqrt(s[AX + i] * s[AY + i]), table)
            s[ALBEDO + i] = a + b
    elif scheme != energy.NONE:
        _look_up(s, EX, ALBEDO, table)


@inlined
def _look_up(s: Array, direction: int, row: int, table: Array) -> None:
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
    call(modes[REFLECTANCE], s)
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
def _multiple_reflectance(s: Array, modes: Any, table: Array) -> None:
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
            s[OUTER + i] = node
        if modes[KIND] != CONDUCTOR:
            for i in range(BLOCK):
                s[OUTER + i] = outer_cosine(node, s[SIDE + i], s[INDEX + i])
        call(modes[REFLECTANCE], s)
        for i in range(BLOCK):
            s[TR + i] += weight * s[FR + i]
            s[TG + i] += weight * s[FG + i]
            s[TB + i] += weight * s[FB + i]
    for i in range(BLOCK):
        average = energy.average_lookup(min(s[AX + i], 1.0), min(s[AY + i], 1.0), s[RXY + i], table)
        s[OTHER_ALBEDO + i] = average
        s[TR + i] = energy.multiple_scattering(s[TR + i], average)
        s[TG + i] = energy.multiple_scattering(s[TG + i], average)
        s[TB + i] = energy.multiple_scattering(s[TB + i], average)


@inlined
def _give_back(s: Array, i: int, lost: float) -> None:
    s[OR + i] += lost * s[TR + i]
    s[OG + i] += lost * s[TG + i]
    s[OB + i] += lost * s[TB + i]


@formula
def finish_reflection(s: Array, modes: Any, table: Array) -> None:
    """The compensations that are the same for both lobes, in the result's rows."""
    scheme = modes[COMPENSATION]
    if scheme == energy.MATERIALX_1_39_6 or scheme == energy.TURQUIN:
        typical_reflectance(s, modes)
        compensate(s, OR)
    elif scheme == energy.KULLA_CONTY:
        _multiple_reflectance(s, modes, table)
        _look_up(s, GX, OTHER_ALBEDO, table)
        for i in range(BLOCK):
            lit = min(s[EZ + i], s[GZ + i]) > 0.0
            lost = (1.0 - s[ALBEDO + i]) * (1.0 - s[OTHER_ALBEDO + i]) / math.pi
            _give_back(s, i, lost if lit else 0.0)


@formula
def finish_albedo(s: Array, modes: Any, table: Array) -> None:
    """`finish_reflection` of an albedo: Kulla and Conty's term reflects into every direction what it takes from v."""
    if modes[COMPENSATION] == energy.KULLA_CONTY:
        _multiple_reflectance(s, modes, table)
        for i in range(BLOCK):
            lost = (1.0 - s[ALBEDO + i]) * (1.0 - s[OTHER_ALBEDO + i])
            _give_back(s, i, lost if s[EZ + i] > 0.0 else 0.0)
    else:
        finish_reflection(s, modes, table)
