"""Scalar formulas of energy compensation and of directional albedo as MaterialX's nodes have them."""

import math

import numpy as np

from .compiled import Array, formula
from .microsurface import SHEARED, Slopes
from .vec import Vec

NONE = 0
MATERIALX_1_39_5 = 1
MATERIALX_1_39_6 = 2
TURQUIN = 3
KULLA_CONTY = 4

# A table of E: ROWS directions by COLUMNS roughnesses along them, ACROSS times FREE times, and AVERAGES² averages,
# cut into rows of COLUMNS.
ROWS = 48
COLUMNS = 24
ACROSS = 32
FREE = 6
AVERAGES = 4 * COLUMNS
#: The largest alpha along any axis, where both are at most 1: slopes that are correlated add theirs up.
WIDEST = math.sqrt(2.0)
#: An alpha from which on the averages' nodes are even in its logarithm, and how far apart the first and last are: what
#: is lost on average falls by many orders of magnitude.
NARROW = 1e-6
WIDTHS = math.log1p(WIDEST / NARROW)


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
def _cell(value: float, count: int) -> tuple[int, float]:
    """Where a coordinate in [0, 1] lies between `count` even nodes: the node below, and how far beyond it."""
    x = min(max(value, 0.0), 1.0) * (count - 1)
    i = min(int(x), count - 2)
    return i, x - i


@formula
def _bilinear(table: Array, i: int, x: float, j: int, y: float) -> float:
    low = table[i, j] + (table[i, j + 1] - table[i, j]) * y
    high = table[i + 1, j] + (table[i + 1, j + 1] - table[i + 1, j]) * y
    value: float = low + (high - low) * x
    return value


_standard_direction = SHEARED.direction


@formula
def _stretched_sine_squared(x: float, y: float, ax: float, ay: float, correlation: float) -> float:
    """alpha_o² sin² θ (Heitz 2014, eq. 93)."""
    d = _standard_direction(Vec(x, y, 0.0), Slopes(ax, ay, correlation, 0.0, 0.0))
    return d.x * d.x + d.y * d.y


@formula
def albedo_lookup(
    x: float, y: float, z: float, ax: float, ay: float, correlation: float, table: Array
) -> float:
    """E at a direction: linear in its cosine in the standard configuration, in the roughness along it and
    across it, and in how little the slopes along and across are correlated."""
    sine_squared = x * x + y * y
    stretched = _stretched_sine_squared(x, y, ax, ay, correlation)
    # At the normal every azimuth is as good.
    along, across = max(ax, ay), min(ax, ay)
    if sine_squared > 0.0:
        along = math.sqrt(stretched / sine_squared)
        across = math.sqrt(_stretched_sine_squared(-y, x, ax, ay, correlation) / sine_squared)
    free = ax * ay * math.sqrt(1.0 - correlation * correlation) / max(along * across, 1e-300)
    up = max(z, 0.0)
    i, a = _cell(up / math.sqrt(max(up * up + stretched, 1e-300)), ROWS)
    j, b = _cell(math.sqrt(along / WIDEST), COLUMNS)
    k, c = _cell(across / WIDEST, ACROSS)
    m, d = _cell(free, FREE)
    row = (k * FREE + m) * ROWS + i
    near = _bilinear(table, row, a, j, b) * (1.0 - d) + _bilinear(table, row + ROWS, a, j, b) * d
    row += FREE * ROWS
    far = _bilinear(table, row, a, j, b) * (1.0 - d) + _bilinear(table, row + ROWS, a, j, b) * d
    return near + (far - near) * c


@formula
def _root_of_lost(i: int, j: int, table: Array) -> float:
    start = table.shape[0] - AVERAGES * AVERAGES // COLUMNS
    k = i * AVERAGES + j
    value: float = table[start + k // COLUMNS, k % COLUMNS]
    return value


@formula
def average_lookup(ax: float, ay: float, correlation: float, table: Array) -> float:
    """E_avg, from the table's last rows by the alphas along the principal axes of the slopes."""
    half = 0.5 * (ax * ax - ay * ay)
    apart = math.sqrt(half * half + (correlation * ax * ay) ** 2)
    major = math.sqrt(0.5 * (ax * ax + ay * ay) + apart)
    minor = ax * ay * math.sqrt(1.0 - correlation * correlation) / major
    i, x = _cell(math.log1p(major / NARROW) / WIDTHS, AVERAGES)
    j, y = _cell(math.log1p(minor / NARROW) / WIDTHS, AVERAGES)
    near = _root_of_lost(i, j, table) * (1.0 - y) + _root_of_lost(i, j + 1, table) * y
    far = _root_of_lost(i + 1, j, table) * (1.0 - y) + _root_of_lost(i + 1, j + 1, table) * y
    root = near + (far - near) * x
    return 1.0 - root * root * root * root


@formula
def multiple_scattering(fresnel: float, average: float) -> float:
    """F² E / (1 - F (1 - E)), then over 1 - E: the size of Kulla and Conty's term for mean reflectance F
    and albedo E.

    Source: Kulla and Conty 2017, "Revisiting Physically Based Shading at Imageworks".
    """
    lost = 1.0 - average
    share = fresnel * fresnel * average / (1.0 - fresnel * lost)
    return share / max(lost, 1e-12)
