"""Image light as MaterialX's shaders sum it: the very samples and the very texels, in float64, with what float32 may
make of the sum.

[FIS] Krivanek and Colbert 2008, "Real-time Shading with Filtered Importance Sampling"
[Cap] Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps"
[Heitz] Heitz 2014, "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs"

An integral over the map is none of this: see the `albedo` of a lobe, and whoever integrates `eval` over a map.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .albedo_fit import split_sum
from .bsdf import Lobe
from .compiled import Array, Kernel, formula, inlined, named, run
from .diffuse import C1, C2, fujii_albedo
from .fresnel import (
    CONDUCTOR,
    DIELECTRIC,
    SCHLICK,
    conductor_reflectance,
    dielectric_reflectance,
    schlick_curve,
)
from .masking import SMITH, VCAVITY
from .microsurface import DISTRIBUTIONS, GGX, NAMES, Alpha, Formula, microsurface
from .thinfilm import film_reflectance
from .vec import Vec

UNIT = 2.0**-24
"""Half a unit in the last place of a float32 below 1: one rounding."""

VIEW = 12 * UNIT
"""Error of the view in the shading frame, an angle. A unit vector of a difference has four and a half roundings, as
have the frame's, and their product two and a half."""

AXES = 8 * UNIT
"""Of a sample's direction in the map, but for that in the shading frame: the frame's turned axes have five roundings,
the sum of three products with them two and a half."""

USUAL = 0.5
"""Share of VIEW and AXES that 999 of 1000 values keep: 11.5 roundings are 6.6 in 999 of 1000 sums of as many."""

DEVIATIONS = 3.3 / math.sqrt(3.0)
"""Times the root of a sum of squares: what 999 of 1000 sums of so many independent uniform errors keep."""

OTHER_ARITHMETIC = 16 * UNIT
"""Relative error of a sample's masking and its share, each of some products and quotients."""

SMALLEST = 1e-8
"""MaterialX's M_FLOAT_EPS, below which it takes no cosine to be."""

LEVEL_OFFSET = 1.5
"""Mip levels by which MaterialX reads a sharper map than a sample's solid angle would have it."""


class Map(NamedTuple):
    """A latitude-longitude map with its mip levels."""

    texels: Array
    """`(t, 3)`: all levels, one after another, each row by row from +y down."""
    levels: Array
    """`(n, 3)`: where each level begins, its height and its width."""


class Driver(NamedTuple):
    """What a driver's own functions and its texture units make of their arguments."""

    arcs: Array
    """`(k, 2)`: error of the arc sine, by the angle from -π/2 to π/2, and of the arc tangent, by that from -π to π."""
    circle: float
    """Largest error of sine and cosine."""
    logarithm: float
    """Of the binary logarithm."""
    texel: float
    """The step in which a texture unit reads between two texels, as a share of their distance."""
    level: float
    """Likewise between two mip levels."""


EXACT = Driver(np.zeros((2, 2)), 0.0, 0.0, 0.0, 0.0)
"""No driver: mathematics."""


class Sum(NamedTuple):
    """A sum, the errors that float32 may give it anywhere and in 999 of 1000 values, and what it would be of a lobe
    whose Fresnel factor is 1: each `(n, 3)`."""

    value: Array
    most: Array
    usual: Array
    white: Array


def spherical_fibonacci(count: int) -> Array:
    """MaterialX's points of the unit square, `(count, 2)` (Marques et al. 2013).

    They are float32's: (i + 1) times the golden ratio has lost most digits of its fraction, which is data here.
    """
    index = np.arange(count, dtype=np.float32)
    turns = (index + np.float32(1.0)) * np.float32((1.0 + math.sqrt(5.0)) / 2.0)
    along = (index + np.float32(0.5)) / np.float32(count)
    points: Array = np.stack([along, turns - np.floor(turns)], axis=-1).astype(np.float64)
    return points


@formula
def _error_at(arcs: Array, column: int, share: float) -> float:
    """A tabulated error, at a share of the table's length."""
    place = min(max(share, 0.0), 1.0) * (arcs.shape[0] - 1)
    k = min(int(place), arcs.shape[0] - 2)
    value: float = arcs[k, column] + (arcs[k + 1, column] - arcs[k, column]) * (place - k)
    return value


@formula
def _read_level(
    texels: Array,
    begin: int,
    height: int,
    width: int,
    u: float,
    v: float,
    reach_u: float,
    reach_v: float,
    out: Array,
) -> None:
    """Bilinear filtering of one level: columns repeat, rows end at the poles.

    u, v: texture coordinates; reach_u, reach_v: their errors, in texels.
    out: the value, and the largest difference of two texels across and down in the cells within reach, each (3).
    """
    x, y = u * width - 0.5, min(max(v * height - 0.5, 0.0), height - 1.0)
    column, row = math.floor(x), min(math.floor(y), max(height - 2, 0))
    across, down = x - column, y - row
    left, right = int(column) % width, (int(column) + 1) % width
    top, bottom = int(row), min(int(row) + 1, height - 1)
    for c in range(3):
        a, b = texels[begin + top * width + left, c], texels[begin + top * width + right, c]
        d, e = texels[begin + bottom * width + left, c], texels[begin + bottom * width + right, c]
        out[c] = (a * (1.0 - across) + b * across) * (1.0 - down) + (d * (1.0 - across) + e * across) * down
        out[3 + c] = max(abs(b - a), abs(e - d))
        out[6 + c] = max(abs(d - a), abs(e - b))
    if reach_u > 1.0:
        # So near a pole any column may be meant.
        for c in range(3):
            low, high = (
                min(out[c], texels[begin + top * width, c]),
                max(out[c], texels[begin + top * width, c]),
            )
            for r in (top, bottom):
                for k in range(width):
                    low, high = (
                        min(low, texels[begin + r * width + k, c]),
                        max(high, texels[begin + r * width + k, c]),
                    )
            out[3 + c] = (high - low) / reach_u
        reach_u = 0.0
    before, after = 1 if across < reach_u else 0, 1 if across > 1.0 - reach_u else 0
    above, below = 1 if down < reach_v else 0, 1 if down > 1.0 - reach_v else 0
    if before + after + above + below > 0:
        for r in range(max(top - above, 0), min(top + 1 + below, height - 1) + 1):
            for k in range(-before, 2 + after):
                here = begin + r * width + (int(column) + k) % width
                beside = begin + r * width + (int(column) + k + 1) % width
                under = begin + min(r + 1, height - 1) * width + (int(column) + k) % width
                for c in range(3):
                    if k < 1 + after:
                        out[3 + c] = max(out[3 + c], abs(texels[beside, c] - texels[here, c]))
                    if r < top + 1 + below:
                        out[6 + c] = max(out[6 + c], abs(texels[under, c] - texels[here, c]))


@formula
def _read(
    texels: Array,
    levels: Array,
    arcs: Array,
    limits: Array,
    x: float,
    y: float,
    z: float,
    error: float,
    level: float,
    level_error: float,
    out: Array,
    other: Array,
) -> None:
    """The map in a direction, between two mip levels.

    error: of the direction, an angle. other: room for a level.
    out: the value (3); by how much the direction's error and the level's may change it (3); by how much the texture
    unit's steps may (3).
    """
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    latitude, longitude = math.asin(min(max(y, -1.0), 1.0)), math.atan2(x, -z)
    cosine = math.sqrt(max(x * x + z * z, 0.0))
    # What rounding makes of y is more of an angle near the poles.
    of_latitude = min(error + 2.0 * UNIT / max(cosine, 1e-12), error + 2.0 * math.sqrt(UNIT)) + 2.0 * UNIT
    of_longitude = min((error + 2.0 * UNIT) / max(cosine, 1e-12), math.pi)
    latitude += _error_at(arcs, 0, latitude / math.pi + 0.5)
    longitude += _error_at(arcs, 1, longitude / (2.0 * math.pi) + 0.5)
    u, v = 0.5 * longitude / math.pi + 0.5, 0.5 - latitude / math.pi
    du, dv = 0.5 * of_longitude / math.pi + 2.0 * UNIT, of_latitude / math.pi + 2.0 * UNIT

    level = min(max(level, 0.0), levels.shape[0] - 1.0)
    whole = min(int(level), max(levels.shape[0] - 2, 0))
    between = level - whole
    step, level_step = limits[0, 3], limits[0, 4]
    for k in range(2):
        share = between if k == 1 else 1.0 - between
        if k == 1 and whole + 1 >= levels.shape[0]:
            break
        begin, height, width = int(levels[whole + k, 0]), int(levels[whole + k, 1]), int(levels[whole + k, 2])
        _read_level(texels, begin, height, width, u, v, du * width + step, dv * height + step, other)
        for c in range(3):
            moved = share * (other[3 + c] * du * width + other[6 + c] * dv * height)
            stepped = share * (other[3 + c] + other[6 + c]) * step
            if k == 0:
                out[c], out[3 + c], out[6 + c] = other[c], moved, stepped
            else:
                apart = other[c] - out[c]
                out[c] += apart * between
                out[3 + c] += moved + abs(apart) * level_error
                out[6 + c] += stepped + abs(apart) * level_step
    reach = level_error + level_step
    if between < reach and whole > 0:
        # The error may lead to a sharper level than this one.
        begin, height, width = int(levels[whole - 1, 0]), int(levels[whole - 1, 1]), int(levels[whole - 1, 2])
        _read_level(texels, begin, height, width, u, v, du * width + step, dv * height + step, other)
        for c in range(3):
            out[3 + c] += abs(other[c] - out[c]) * level_error
            out[6 + c] += abs(other[c] - out[c]) * level_step


@formula
def _add_filtered(
    texels: Array,
    levels: Array,
    arcs: Array,
    limits: Array,
    x: float,
    y: float,
    z: float,
    error: float,
    of_length: float,
    density: float,
    of_density: float,
    share: float,
    light: Array,
    moved: Array,
    stepped: Array,
    seen: Array,
    other: Array,
    elsewhere: Array,
) -> None:
    """Add a share of the map in a sample's direction, at the level whose texels have the sample's solid angle
    ([FIS] eq. 11).

    error, of_length: of the direction, an angle, and of its length, which is taken for 1. density: of all samples, per
    steradian; of_density: its relative error.
    seen, other, elsewhere: room for what is read.
    light, moved, stepped: `_read`'s three results are added to these.
    """
    sine2 = max(1.0 - y * y, 1e-30)
    of_sine2 = 2.0 * (error * math.sqrt(sine2) + of_length)
    level = limits[0, 0] - 1.0 - LEVEL_OFFSET - 0.5 * math.log2(density * math.sqrt(sine2))
    of_level = 0.5 * of_density / math.log(2.0) + limits[0, 2] + 16.0 * UNIT
    near_pole = of_sine2 > 0.1 * sine2
    if not near_pole:
        of_level += 0.25 * of_sine2 / (0.9 * sine2 * math.log(2.0))
    _read(texels, levels, arcs, limits, x, y, z, error, level, of_level, seen, other)
    for j in range(3):
        light[j] += share * seen[j]
        moved[j] += share * seen[3 + j]
        stepped[j] += share * seen[6 + j]
    if not near_pole:
        return
    # Rounding may take any part of the sine, and so lead to any coarser level, or to the root of a negative number
    # and so to any level.
    here = min(max(level, 0.0), levels.shape[0] - 1.0)
    place, most_far = 0.0, levels.shape[0] - 1.0
    if of_sine2 < sine2:
        place = max(here + 0.25 * math.log2(sine2 / (sine2 + of_sine2)), 0.0)
        most_far = min(here + 0.25 * math.log2(sine2 / (sine2 - of_sine2)), most_far)
    most_0, most_1, most_2 = 0.0, 0.0, 0.0
    while place <= most_far:
        _read(texels, levels, arcs, limits, x, y, z, error, place, of_level, elsewhere, other)
        most_0 = max(most_0, abs(elsewhere[0] - seen[0]) + elsewhere[3])
        most_1 = max(most_1, abs(elsewhere[1] - seen[1]) + elsewhere[4])
        most_2 = max(most_2, abs(elsewhere[2] - seen[2]) + elsewhere[5])
        place = most_far if place < most_far < math.floor(place) + 1.0 else math.floor(place) + 1.0
    moved[0] += share * most_0
    moved[1] += share * most_1
    moved[2] += share * most_2


@formula
def _visible_normal(
    u0: float,
    u1: float,
    ux: float,
    uy: float,
    uz: float,
    ax: float,
    ay: float,
    of_view: float,
    of_circle: float,
) -> tuple[float, float, float, float, float, float]:
    """A normal h that is seen ([Cap] section 3), from the view in the configuration where alpha is 1.

    of_view: what that view is off by; of_circle: a driver's sine and cosine.

    Returns:
        h; what turns it in this sample alone, and in all alike; the relative error of GGX's D there.
    """
    azimuth, height = 2.0 * math.pi * u0, (1.0 - u1) * (1.0 + uz) - uz
    radius = math.sqrt(min(max(1.0 - height * height, 0.0), 1.0))
    of_cap = radius * of_circle + 8.0 * UNIT + 5.0 * UNIT / max(radius, 2.0 * math.sqrt(UNIT))
    sx, sy, sz = radius * math.cos(azimuth) + ux, radius * math.sin(azimuth) + uy, max(height + uz, 0.0)
    unstretched = math.sqrt(sx * sx + sy * sy + sz * sz)
    hx, hy, hz = ax * sx, ay * sy, sz
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    # An angle is the length of a cross product, and that of two stretched vectors at most the larger alpha times
    # that of the vectors.
    turning = max(ax, ay) * unstretched / (length * length)
    # D is 1/q² of the squared length q of the half vector once it is stretched back.
    of_normals = 4.0 * (of_cap + of_view) * (1.0 / unstretched + 1.0 / length)
    own, shared = turning * of_cap + 3.0 * UNIT, turning * of_view
    return hx / length, hy / length, hz / length, own, shared, of_normals


@formula
def _reflectance(
    kind: int,
    cosine: float,
    a: Array,
    b: Array,
    c: Array,
    i: int,
    exponent: float,
    film: float,
    film_index: float,
    is_clamped: bool,
) -> tuple[float, float, float]:
    """RGB reflectance of one configuration; Schlick's curve is clamped to [0, 1] where that is asked for."""
    if film > 0.0:
        return film_reflectance(
            cosine, kind, a[i, 0], a[i, 1], a[i, 2], b[i, 0], b[i, 1], b[i, 2], c[i, 0], c[i, 1], c[i, 2],
            exponent, film, film_index,
        )  # fmt: skip
    if kind == DIELECTRIC:
        f = dielectric_reflectance(cosine, a[i, 0])
        return f, f, f
    if kind == CONDUCTOR:
        return (
            conductor_reflectance(cosine, a[i, 0], b[i, 0]),
            conductor_reflectance(cosine, a[i, 1], b[i, 1]),
            conductor_reflectance(cosine, a[i, 2], b[i, 2]),
        )
    red = schlick_curve(cosine, a[i, 0], b[i, 0], c[i, 0], exponent)
    green = schlick_curve(cosine, a[i, 1], b[i, 1], c[i, 1], exponent)
    blue = schlick_curve(cosine, a[i, 2], b[i, 2], c[i, 2], exponent)
    if is_clamped:
        return min(max(red, 0.0), 1.0), min(max(green, 0.0), 1.0), min(max(blue, 0.0), 1.0)
    return red, green, blue


@formula
def _fresnel(
    kind: int,
    cosine: float,
    turned: float,
    a: Array,
    b: Array,
    c: Array,
    i: int,
    exponent: float,
    film: float,
    film_index: float,
    is_clamped: bool,
) -> tuple[float, float, float, float, float, float]:
    """`_reflectance`, and by how much turning the half vector changes it: not of a film, which has its own bound."""
    f0, f1, f2 = _reflectance(kind, cosine, a, b, c, i, exponent, film, film_index, is_clamped)
    of_cosine = math.sqrt(max(1.0 - cosine * cosine, 0.0)) * (turned + VIEW) + 4.0 * UNIT
    d0, d1, d2 = 0.0, 0.0, 0.0
    if film <= 0.0:
        for sign in (-1.0, 1.0):
            near = min(max(cosine + sign * of_cosine, 0.0), 1.0)
            e0, e1, e2 = _reflectance(kind, near, a, b, c, i, exponent, film, film_index, is_clamped)
            d0, d1, d2 = max(d0, abs(e0 - f0)), max(d1, abs(e1 - f1)), max(d2, abs(e2 - f2))
    return f0, f1, f2, d0, d1, d2


_CODES = {name: code for code, name in enumerate(NAMES)}
_GGX = _CODES[GGX]
ggx_normals = microsurface(GGX).D


def _of_any(formulas: dict[str, Formula]) -> Formula:
    """(direction or normal, slopes, code): the formula of the distribution of that code."""

    chosen: Formula = _none
    for name, own in formulas.items():
        chosen = _or_else(_CODES[name], own, chosen, name)
    return chosen


@formula
def _none(m: Vec, a: Alpha, distribution: int) -> float:
    raise NotImplementedError("no formula of this distribution")


def _or_else(code: int, own: Formula, other: Formula, name: str) -> Formula:
    @formula
    @named(name, own.__name__)
    def chosen(m: Vec, a: Alpha, distribution: int) -> float:
        return own(m, a) if distribution == code else other(m, a, distribution)

    return chosen


def _area(name: str) -> Formula:
    seen = microsurface(name).wanted("seen")

    @inlined
    @named(name)
    def area(w: Vec, a: Alpha) -> float:
        return seen(w, a).area

    return area


_projected_area = _of_any({name: _area(name) for name in DISTRIBUTIONS})
_any_normals = _of_any({name: microsurface(name).D for name in NAMES})


@formula
def _smith(x: float, y: float, z: float, ax: float, ay: float, distribution: int) -> float:
    """1 + 2 Λ ([Heitz] eqs. 72 and 83)."""
    return 2.0 * _projected_area(Vec(x, y, z), Alpha(ax, ay), distribution) / z - 1.0


@formula
def _normals(x: float, y: float, z: float, ax: float, ay: float, distribution: int) -> float:
    """D of a unit normal, 0 where it lies flat."""
    if z <= 0.0:
        return 0.0
    return _any_normals(Vec(x, y, z), Alpha(ax, ay), distribution)


def _sum_samples(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """[FIS] of a microfacet lobe and its retro twin, by samples of one set of visible normals of GGX."""
    views, axes, alphas, shares = inputs[0], inputs[1], inputs[2], inputs[3]
    a, b, c, exponents, films, film_indices = inputs[4], inputs[5], inputs[6], inputs[7], inputs[8], inputs[9]
    samples, texels, levels, arcs, limits = inputs[10], inputs[11], inputs[12], inputs[13], inputs[14]
    kind, distribution, is_vcavity = modes[0], modes[1], modes[2] != 0
    value, most, usual, white = outputs[0], outputs[1], outputs[2], outputs[3]
    count = samples.shape[0]
    total, shared, own, squares, bare = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    seen, other, light, moved, stepped = np.zeros(9), np.zeros(9), np.zeros(3), np.zeros(3), np.zeros(3)
    elsewhere = np.zeros(9)
    for i in range(start, stop):
        vx, vy, vz = views[i, 0], views[i, 1], min(max(views[i, 2], SMALLEST), 1.0)
        ax, ay, retro = alphas[i, 0], alphas[i, 1], shares[i, 0]
        widest = max(ax, ay)
        exponent, film, film_index = exponents[i, 0], films[i, 0], film_indices[i, 0]
        stretched = math.sqrt(ax * ax * vx * vx + ay * ay * vy * vy + vz * vz)
        drawn_v = _smith(vx, vy, vz, ax, ay, _GGX)
        masked_v = drawn_v if is_vcavity else _smith(vx, vy, vz, ax, ay, distribution)
        g1 = 2.0 / (1.0 + drawn_v)
        # The view in the configuration where alpha is 1 ([Cap] section 3).
        ux, uy, uz = ax * vx / stretched, ay * vy / stretched, vz / stretched
        of_view = widest * VIEW / (stretched * stretched) + 2.0 * UNIT
        along_v = 1.0 - 1.0 / (drawn_v * drawn_v)
        total[:], shared[:], own[:], squares[:], bare[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            hx, hy, hz, own_half, shared_half, of_normals = _visible_normal(
                samples[k, 0], samples[k, 1], ux, uy, uz, ax, ay, of_view, limits[0, 1]
            )
            cosine = min(max(vx * hx + vy * hy + vz * hz, SMALLEST), 1.0)
            lx, ly, lz = 2.0 * cosine * hx - vx, 2.0 * cosine * hy - vy, 2.0 * cosine * hz - vz
            own_light, shared_light = 2.0 * own_half + 6.0 * UNIT, 2.0 * shared_half + VIEW + AXES
            normals = ggx_normals(Vec(hx, hy, hz), Alpha(ax, ay))
            density = normals * g1 / (4.0 * vz)
            of_density = of_normals + along_v * VIEW / vz + 16.0 * UNIT

            lit = max(lz, SMALLEST)
            if is_vcavity:
                g = min(1.0, 2.0 * hz * min(vz, lit) / cosine)
                of_g = (
                    (own_half + shared_half) / max(hz, SMALLEST)
                    + (own_light + shared_light) / lit
                    + VIEW / vz
                )
            else:
                masked_l = _smith(lx, ly, lit, ax, ay, distribution)
                g = 2.0 / (masked_v + masked_l)
                along_l = max(1.0 - 1.0 / (masked_l * masked_l), 0.0)
                of_g = (
                    along_l * masked_l * (own_light + shared_light) / lit + along_v * masked_v * VIEW / vz
                ) / (masked_v + masked_l)
            if distribution != _GGX:
                g *= _normals(hx, hy, hz, ax, ay, distribution) / normals
                slope = math.sqrt(max(1.0 - hz * hz, 0.0)) / max(hz, SMALLEST)
                # An exponential of the slope's square over alpha's.
                power = slope * slope / min(ax, ay) ** 2
                turned = 2.0 * slope * (own_half + shared_half) / (min(ax, ay) * max(hz, SMALLEST)) ** 2
                of_g += 2.0 * of_density + turned + 2.0 * UNIT * (3.0 + 4.0 * power)
            of_g = min(of_g, 1.0) + along_v * VIEW / vz

            f0, f1, f2, d0, d1, d2 = _fresnel(
                kind, cosine, own_half + shared_half, a, b, c, i, exponent, film, film_index, True
            )

            light[:], moved[:], stepped[:] = 0.0, 0.0, 0.0
            for side in range(2):
                share = retro if side == 1 else 1.0 - retro
                if share <= 0.0:
                    continue
                sx = -lx if side == 1 else lx
                sy = -ly if side == 1 else ly
                x = axes[i, 0] * sx + axes[i, 3] * sy + axes[i, 6] * lz
                y = axes[i, 1] * sx + axes[i, 4] * sy + axes[i, 7] * lz
                z = axes[i, 2] * sx + axes[i, 5] * sy + axes[i, 8] * lz
                _add_filtered(
                    texels, levels, arcs, limits, x, y, z, own_light + shared_light, 6.0 * UNIT, count * density,
                    of_density, share, light, moved, stepped, seen, other, elsewhere,
                )  # fmt: skip
            whole = own_light + shared_light
            for j in range(3):
                f = f0 if j == 0 else (f1 if j == 1 else f2)
                of_f = d0 if j == 0 else (d1 if j == 1 else d2)
                part = f * light[j] * g
                total[j] += part
                bare[j] += light[j] * g
                wrong = f * g * moved[j] + part * of_g + of_f * light[j] * g
                independent = wrong * (own_light / whole) + part * OTHER_ARITHMETIC + f * g * stepped[j]
                shared[j] += wrong * (shared_light / whole)
                own[j] += independent
                squares[j] += independent * independent
        scale = 1.0 / (g1 * count)
        for j in range(3):
            value[3 * i + j] = total[j] * scale
            white[3 * i + j] = bare[j] * scale
            # A running sum is rounded once a sample, to half a unit of what it has come to.
            most[3 * i + j] = (shared[j] + own[j] + count * UNIT * total[j]) * scale
            usual[3 * i + j] = (
                USUAL * shared[j]
                + min(DEVIATIONS * math.sqrt(squares[j]), own[j])
                + DEVIATIONS * math.sqrt(count) * UNIT * total[j]
            ) * scale
    return 0


SUM_SAMPLES = Kernel(_sum_samples, 15, 4)


def _look_up(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """The map in given directions, at given levels."""
    directions, errors, places = inputs[0], inputs[1], inputs[2]
    texels, levels, arcs, limits = inputs[3], inputs[4], inputs[5], inputs[6]
    value, most, usual = outputs[0], outputs[1], outputs[2]
    seen, other = np.zeros(9), np.zeros(9)
    for i in range(start, stop):
        x, y, z = directions[i, 0], directions[i, 1], directions[i, 2]
        _read(texels, levels, arcs, limits, x, y, z, errors[i, 0], places[i, 0], errors[i, 1], seen, other)
        for j in range(3):
            value[3 * i + j] = seen[j]
            most[3 * i + j] = seen[3 + j] + seen[6 + j]
            usual[3 * i + j] = USUAL * seen[3 + j] + seen[6 + j]
    return 0


LOOK_UP = Kernel(_look_up, 7, 3)


def _limits(levels: int, driver: Driver) -> Array:
    return np.array([[levels, driver.circle, driver.logarithm, driver.texel, driver.level]], np.float64)


def filtered_samples(
    lobe: Lobe, v: Array, axes: Array, around: Map, samples: int, levels: int, driver: Driver
) -> Sum:
    """What a lobe shows of a map by MaterialX's filtered importance sampling, without compensation or tint.

    Visible normals of GGX are drawn, whatever the lobe's distribution, and the retro part reads the map in the same
    directions turned about the normal (Portsmouth et al. 2026, eq. 3).

    Args:
        lobe: its parameters of shape (), (n,) or (n, 3); reflection only.
        v: `(n, 3)`, in the shading frame.
        axes: `(n, 3, 3)`, rows tangent, bitangent and normal in the space of the map.
        samples: how many.
        levels: how many mip levels the host says that the map has.
    """
    made_of, modes = lobe._parameters, lobe._modes
    inputs = [
        *(v, axes.reshape(-1, 9), made_of.alpha, made_of.retroreflectivity),
        *(
            made_of.a,
            made_of.b,
            made_of.c,
            made_of.exponent,
            made_of.thinfilm_thickness,
            made_of.thinfilm_ior,
        ),
    ]
    tables = [
        spherical_fibonacci(samples),
        around.texels,
        around.levels,
        driver.arcs,
        _limits(levels, driver),
    ]
    inputs = [np.broadcast_to(each, (len(v), each.shape[-1])) for each in inputs]
    if lobe._distribution not in _CODES or lobe._masking not in (SMITH, VCAVITY):
        raise NotImplementedError(f"{lobe._distribution}, {lobe._masking}: there is no image light of it")
    decided = [modes.kind, _CODES[lobe._distribution], int(lobe._masking == VCAVITY)]
    (value, most, usual, white), _ = run(SUM_SAMPLES, inputs, decided, [3, 3, 3, 3], tables)
    return Sum(value, most, usual, white)


def look_up(
    around: Map, direction: Array, error: float, level: Array, level_error: float, driver: Driver
) -> Sum:
    """A map in directions `(n, 3)` at mip levels `(n,)`, and what their errors and the texture unit's steps change."""
    errors = np.broadcast_to(np.array([error, level_error]), (len(direction), 2))
    inputs = [direction, errors, np.broadcast_to(level, len(direction))[:, None]]
    tables = [around.texels, around.levels, driver.arcs, _limits(0, driver)]
    (value, most, usual), _ = run(LOOK_UP, inputs, [0], [3, 3, 3], tables)
    return Sum(value, most, usual, value)


def split_sum_albedo(lobe: Lobe, v: Array) -> Array:
    """The directional albedo `(n, 3)` by which MaterialX's prefiltered method scales what it reads: GGX's with Smith.

    F0 A + F90 B of its fit; with a film, a blend between that and Fresnel at n.v, by the root of alpha.
    """
    cosine = np.clip(v[..., 2:], SMALLEST, 1.0)
    alpha = np.sqrt(lobe._alpha[..., :1] * lobe._alpha[..., 1:])
    a, b = split_sum(("ggx", "smith"), cosine, alpha)
    f0 = lobe._reflectance(np.ones(1), lobe._compensation)
    film = lobe._parameters.thinfilm_thickness > 0.0
    f90 = np.where(film, 1.0, lobe._parameters.c) if lobe._kind == SCHLICK else np.ones(3)
    fitted = f0 * a + f90 * b
    if not film.any():
        return np.asarray(fitted)
    mirror, share = lobe._reflectance(cosine, lobe._compensation), np.sqrt(alpha)
    return np.asarray(np.where(film, mirror + (fitted - mirror) * share, fitted))


def oren_nayar_albedo(color: Array, roughness: Array, cosine: Array, energy_compensation: bool) -> Array:
    """The directional albedo `(n, 3)` that MaterialX's `oren_nayar_diffuse_bsdf` has in an environment.

    Its fit to the qualitative model; with energy compensation that of EON (Portsmouth, Kutz and Hill 2025, eq. 14).

    Args:
        color: `(n, 3)`; roughness and cosine with the view: `(n, 1)`.
    """
    if not energy_compensation:
        squared = roughness * roughness
        above = 1.0 - 0.4297 * roughness - 0.7632 * cosine * roughness + 1.4385 * squared
        below = 1.0 - 0.6076 * roughness - 0.4993 * cosine * roughness + 2.0315 * squared
        return np.asarray(color * np.clip(above / below, 0.0, 1.0))
    multiple = scattered_color(color, roughness)
    return np.asarray(multiple + (color - multiple) * fujii_albedo(cosine, roughness))


def scattered_color(color: Array, roughness: Array) -> Array:
    """The colour `(n, 3)` of what a rough diffuse surface scatters more than once (EON, eq. 20)."""
    average = (1.0 + C2 * roughness) / (1.0 + C1 * roughness)
    return np.asarray(color * color * average / (1.0 - color * np.maximum(1.0 - average, 0.0)))
