"""Scalar formulas of energy compensation and of directional albedo as MaterialX's nodes have them."""

import math

import numpy as np

from .compiled import Array, formula

NONE = 0
MATERIALX_1_39_5 = 1
MATERIALX_1_39_6 = 2
TURQUIN = 3
KULLA_CONTY = 4


@formula
def rational_albedo(cosine: float, alpha: float, terms: Array) -> tuple[float, float]:
    """The split-sum terms (A, B) at (n.v, alpha): albedo = F0 A + F90 B, each a ratio of biquadratics in
    [0, 1].

    `terms` is (9, 4): for 1, x, y, xy, x², y², x²y, xy², x²y² the numerators of A and B and their
    denominators."""
    x, y = cosine, alpha
    x2, y2 = x * x, y * y
    a = terms[0, 0] + terms[1, 0] * x + terms[2, 0] * y + terms[3, 0] * x * y
    a += terms[4, 0] * x2 + terms[5, 0] * y2 + terms[6, 0] * x2 * y + terms[7, 0] * x * y2
    a += terms[8, 0] * x2 * y2
    b = terms[0, 1] + terms[1, 1] * x + terms[2, 1] * y + terms[3, 1] * x * y
    b += terms[4, 1] * x2 + terms[5, 1] * y2 + terms[6, 1] * x2 * y + terms[7, 1] * x * y2
    b += terms[8, 1] * x2 * y2
    c = terms[0, 2] + terms[1, 2] * x + terms[2, 2] * y + terms[3, 2] * x * y
    c += terms[4, 2] * x2 + terms[5, 2] * y2 + terms[6, 2] * x2 * y + terms[7, 2] * x * y2
    c += terms[8, 2] * x2 * y2
    d = terms[0, 3] + terms[1, 3] * x + terms[2, 3] * y + terms[3, 3] * x * y
    d += terms[4, 3] * x2 + terms[5, 3] * y2 + terms[6, 3] * x2 * y + terms[7, 3] * x * y2
    d += terms[8, 3] * x2 * y2
    return min(max(a / c, 0.0), 1.0), min(max(b / d, 0.0), 1.0)


@formula
def compensation(fresnel: float, albedo: float) -> float:
    """1 + F (1 - E) / E (Turquin 2019, eqs. 14 and 16)."""
    return 1.0 + fresnel * (1.0 - albedo) / albedo


# Gauss-Legendre on x = cos², over which 2 cos dcos = dx: pairs of cosine and weight.
_X, _W = np.polynomial.legendre.leggauss(12)
AVERAGE_NODES = tuple(
    (float(math.sqrt(0.5 * (x + 1.0))), float(0.5 * w)) for x, w in zip(_X, _W, strict=True)
)


@formula
def table_lookup(cosine: float, alpha: float, table: Array) -> float:
    """Bilinear look-up of E in sqrt(n.v) (rows) and sqrt(alpha) (columns), both over [0, 1].

    The table has one row more: the average over the hemisphere.
    """
    rows, columns = table.shape[0] - 1, table.shape[1]
    x = math.sqrt(min(max(cosine, 0.0), 1.0)) * (rows - 1)
    y = math.sqrt(min(max(alpha, 0.0), 1.0)) * (columns - 1)
    i = min(int(x), rows - 2)
    j = min(int(y), columns - 2)
    x -= i
    y -= j
    low = table[i, j] + (table[i, j + 1] - table[i, j]) * y
    high = table[i + 1, j] + (table[i + 1, j + 1] - table[i + 1, j]) * y
    value: float = low + (high - low) * x
    return value


@formula
def average_lookup(alpha: float, table: Array) -> float:
    """E_avg at alpha: the last row of the table."""
    rows, columns = table.shape[0] - 1, table.shape[1]
    y = math.sqrt(min(max(alpha, 0.0), 1.0)) * (columns - 1)
    j = min(int(y), columns - 2)
    average: float = table[rows, j] + (table[rows, j + 1] - table[rows, j]) * (y - j)
    return average


@formula
def multiple_scattering(fresnel: float, average: float) -> float:
    """F² E / (1 - F (1 - E)), then over 1 - E: the size of Kulla and Conty's term for mean reflectance F
    and albedo E.

    Source: Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks".
    """
    lost = 1.0 - average
    share = fresnel * fresnel * average / (1.0 - fresnel * lost)
    return share / max(lost, 1e-12)
