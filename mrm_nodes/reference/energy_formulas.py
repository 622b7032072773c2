"""Scalar formulas of energy compensation and of directional albedo as MaterialX's nodes have them."""

import math

from .compiled import Array, formula

NONE = 0
MATERIALX_1_39_5 = 1
MATERIALX_1_39_6 = 2
TURQUIN = 3
KULLA_CONTY = 4


@formula
def rational_albedo(cosine: float, alpha: float, terms: Array) -> tuple[float, float]:
    """The split-sum terms (A, B) at (n.v, alpha): albedo = F0 A + F90 B, each a ratio of biquadratics in [0, 1].

    `terms` is (9, 4): for 1, x, y, xy, x², y², x²y, xy², x²y² the numerators of A and B and their denominators.
    """
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


@formula
def table_lookup(cosine: float, alpha: float, table: Array) -> float:
    """Bilinear look-up in a table whose rows are sqrt(n.v) and whose columns are sqrt(alpha), both over [0, 1]."""
    rows, columns = table.shape
    x = math.sqrt(min(max(cosine, 0.0), 1.0)) * (rows - 1)
    y = math.sqrt(min(max(alpha, 0.0), 1.0)) * (columns - 1)
    i = min(int(x), rows - 2)
    j = min(int(y), columns - 2)
    x -= i
    y -= j
    low = table[i, j] + (table[i, j + 1] - table[i, j]) * y
    high = table[i + 1, j] + (table[i + 1, j + 1] - table[i + 1, j]) * y
    return low + (high - low) * x
