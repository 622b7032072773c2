"""A block of configurations in registers' order, and what a kernel is told beside it.

Inputs are copied, a block at a time, into rows of one scratch array; a pass over the block is then one
formula in a loop of constant length over rows, which the compiler turns into vector instructions. A row is
named by the offset of its first element."""

from typing import Any, NamedTuple

from .compiled import Array, formula, inlined, prefetch

BLOCK = 64

# Directions as given; where one is drawn, uniforms in place of l, then l.
VX, VY, VZ, LX, LY, LZ = (BLOCK * k for k in range(6))
# Parameters: colours A, B, C are index and extinction, or f0, f82 and f90; T is the tint.
AX, AY, RETRO, A0, A1, A2, B0, B1, B2, C0, C1, C2 = (BLOCK * k for k in range(6, 18))
EXPONENT, FILM, FILM_INDEX, RXY, MX, MY, T0, T1, T2 = (BLOCK * k for k in range(18, 27))
# v and l as seen from v's side.
SIDE, EX, EY, EZ, GX, GY, GZ = (BLOCK * k for k in range(27, 34))
# A lobe without its reflectance, forward and retro, and the cosines of v and of l with its normal.
LOBE, COSINE, FAR_COSINE, RETRO_LOBE, RETRO_COSINE, RETRO_FAR_COSINE = (BLOCK * k for k in range(34, 40))
# A visible normal, v.m (0 where there is none), and its weight in a quadrature.
NX, NY, NZ, VM, WEIGHT = (BLOCK * k for k in range(40, 45))
# What of its reflection and of its refraction is not shadowed; what a lane that is inverted is at.
REFLECTED, REFRACTED, AT, LOW, HIGH, TARGET, SETTLED = (BLOCK * k for k in range(45, 52))
# Reflectance or transmittance, another colour, and the result.
FR, FG, FB, TR, TG, TB, OR, OG, OB = (BLOCK * k for k in range(52, 61))
# White albedo at n.v, another albedo, index of the inside, cosine on the outside of the selected normal.
ALBEDO, OTHER_ALBEDO, INDEX, OUTER = (BLOCK * k for k in range(61, 65))
# What an integral finds to go through; of what is drawn: whether it is kept, its probability where it is a delta (else
# 0) and its density.
PR, PG, PB, KEPT, CHANCE, DENSITY = (BLOCK * k for k in range(65, 71))
# Whether any lane has a film, a forward share, a retro share; whether a retro share refracts by itself, and whether
# any parameter varies: what can be skipped.
COATED, FORWARD, RETRO_SHARE, TURNS, VARIES = (BLOCK * 71 + k for k in range(5))
SIZE = BLOCK * 72


class Parameters(NamedTuple):
    """What a lobe is made of, in the order in which kernels take it; each (..., 1), (..., 2) or (..., 3)."""

    alpha: Array
    retroreflectivity: Array
    a: Array
    """The index of a dielectric or conductor, or F0; b: extinction, or F82; c: F90."""
    b: Array
    c: Array
    exponent: Array
    thinfilm_thickness: Array
    thinfilm_ior: Array
    slope_correlation: Array
    mean_slope: Array
    tint: Array


class Modes(NamedTuple):
    """What is decided for all of a call, in the order in which kernels take it: codes, flags, and the addresses of the
    parts that it needs."""

    kind: int
    compensation: int
    scatter: int
    retro_transmission: int
    reflectance: int = 0
    reflection: int = 0
    refraction: int = 0
    reflection_density: int = 0
    refraction_density: int = 0
    visible_normals: int = 0
    quadrature_normals: int = 0
    reflected_share: int = 0
    refracted_share: int = 0


# Positions in `Modes`.
(
    KIND,
    COMPENSATION,
    SCATTER,
    RETRO_TRANSMISSION,
    REFLECTANCE,
    REFLECTION,
    REFRACTION,
    REFLECTION_DENSITY,
    REFRACTION_DENSITY,
    VISIBLE_NORMALS,
    QUADRATURE_NORMALS,
    REFLECTED_SHARE,
    REFRACTED_SHARE,
) = range(13)
REFLECT, TRANSMIT, BOTH = 0, 1, 2

# Positions in `inputs`: two directions, `Parameters`, tables.
IN_V, IN_L, IN_ALPHA, IN_RETRO, IN_A, IN_B, IN_C, IN_EXPONENT, IN_FILM, IN_FILM_INDEX = range(10)
IN_RXY, IN_MEAN, IN_TINT, IN_TABLE, IN_NODES = range(10, 15)

# Doubles that memory hands over together.
CACHE_LINE = 8

# A cosine below this is 0, where nothing is lit: its fourth power, with those of the alphas, would underflow.
HORIZON = 1e-60

# Twice the deviation of a length from 1 is that of its square.
UNIT_TOLERANCE = 2e-6


@formula
def load(s: Array, row: int, source: Array, start: int, count: int, first: bool) -> None:
    """Fill a row for each component of `source` with `count` configurations from `start` on."""
    # A value that does not vary stays where the first block put it.
    if not first and source.strides[0] == 0 and count == BLOCK:
        return
    for component in range(source.shape[1]):
        begin = row + component * BLOCK
        for i in range(count):
            s[begin + i] = source[start + i, component]
        # Lanes past the end repeat the last configuration.
        for i in range(count, BLOCK):
            s[begin + i] = source[start + count - 1, component]


@inlined
def ask_ahead(dense: Array, start: int) -> None:
    """Have memory bring the three components of a block that begins at `start`, which may lie past the end."""
    for k in range(start, start + 3 * BLOCK, CACHE_LINE):
        prefetch(dense, k)


@inlined
def load_directions(
    s: Array, row: int, source: Array, dense: Array, start: int, count: int, first: bool
) -> None:
    """Fill three rows with `count` directions from `start` on; `dense` is `source` in one piece, or empty."""
    # The compiler makes vector loads only where it can rule out an index counted from the end.
    if dense.size > 0 and count == BLOCK and start >= 0:
        ask_ahead(dense, 3 * (start + BLOCK))
        for i in range(BLOCK):
            s[row + i] = dense[3 * (start + i)]
            s[row + BLOCK + i] = dense[3 * (start + i) + 1]
            s[row + 2 * BLOCK + i] = dense[3 * (start + i) + 2]
    else:
        load(s, row, source, start, count, first)


@formula
def load_parameters(s: Array, inputs: Any, start: int, count: int, first: bool) -> None:
    """Fill the rows of parameters with `count` configurations from `start` on; the first time, see what
    varies.
    """
    if first:
        s[VARIES] = 0.0
        for k in range(IN_ALPHA, IN_TABLE):
            s[VARIES] += 1.0 if inputs[k].strides[0] != 0 else 0.0
    load(s, AX, inputs[IN_ALPHA], start, count, first)
    load(s, RETRO, inputs[IN_RETRO], start, count, first)
    load(s, A0, inputs[IN_A], start, count, first)
    load(s, B0, inputs[IN_B], start, count, first)
    load(s, C0, inputs[IN_C], start, count, first)
    load(s, EXPONENT, inputs[IN_EXPONENT], start, count, first)
    load(s, FILM, inputs[IN_FILM], start, count, first)
    load(s, FILM_INDEX, inputs[IN_FILM_INDEX], start, count, first)
    load(s, RXY, inputs[IN_RXY], start, count, first)
    load(s, MX, inputs[IN_MEAN], start, count, first)
    load(s, T0, inputs[IN_TINT], start, count, first)
    if first or inputs[IN_FILM].strides[0] != 0:
        s[COATED] = 0.0
        for i in range(BLOCK):
            s[COATED] += 1.0 if s[FILM + i] > 0.0 else 0.0
    if first or inputs[IN_RETRO].strides[0] != 0:
        s[FORWARD] = 0.0
        s[RETRO_SHARE] = 0.0
        for i in range(BLOCK):
            s[FORWARD] += 1.0 if s[RETRO + i] < 1.0 else 0.0
            s[RETRO_SHARE] += 1.0 if s[RETRO + i] > 0.0 else 0.0


@formula
def not_unit(x: float, y: float, z: float) -> int:
    """1 for a direction that is not of unit length, or not a number; else 0."""
    return 0 if abs(x * x + y * y + z * z - 1.0) <= UNIT_TOLERANCE else 1


@inlined
def store(s: Array, out: Array, row: int, start: int, count: int) -> None:
    """Write one row to a flat output of one component."""
    for i in range(count):
        out[start + i] = s[row + i]


@inlined
def store_colours(s: Array, out: Array, row: int, start: int, count: int) -> None:
    """Write three rows to a flat output of three components."""
    if count == BLOCK and start >= 0:
        for i in range(BLOCK):
            out[3 * (start + i)] = s[row + i]
            out[3 * (start + i) + 1] = s[row + BLOCK + i]
            out[3 * (start + i) + 2] = s[row + 2 * BLOCK + i]
    else:
        for i in range(count):
            for c in range(3):
                out[3 * (start + i) + c] = s[row + c * BLOCK + i]


@inlined
def clear(s: Array, row: int) -> None:
    """Set one row to 0."""
    for i in range(BLOCK):
        s[row + i] = 0.0
