"""Named values of one configuration, and what geometry makes of them.

Compiled formulas take them as they are: a named tuple costs nothing there."""

import math
from typing import NamedTuple

from .compiled import inlined


class Vec(NamedTuple):
    """A direction or a normal, away from the surface, whose normal is +z."""

    x: float
    y: float
    z: float


@inlined
def dot(a: Vec, b: Vec) -> float:
    """The scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


@inlined
def length(a: Vec) -> float:
    """The length."""
    return math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)


@inlined
def unit(a: Vec) -> Vec:
    """The same direction with length 1."""
    size = math.sqrt(a.x * a.x + a.y * a.y + a.z * a.z)
    return Vec(a.x / size, a.y / size, a.z / size)


@inlined
def half_vector(v: Vec, l: Vec) -> Vec:  # noqa: E741
    """v + l: twice v.m long, where m is the normal that reflects one to the other."""
    return Vec(v.x + l.x, v.y + l.y, v.z + l.z)


@inlined
def turned(v: Vec) -> Vec:
    """v' = reflect(v, n) (001 eq. 3)."""
    return Vec(-v.x, -v.y, v.z)


@inlined
def reflected(v: Vec, m: Vec) -> Vec:
    """v mirrored at the unit normal m."""
    twice = 2.0 * (v.x * m.x + v.y * m.y + v.z * m.z)
    return Vec(twice * m.x - v.x, twice * m.y - v.y, twice * m.z - v.z)


@inlined
def refracted(v: Vec, m: Vec, cosine: float, ratio: float, far: float) -> Vec:
    """v refracted at the unit normal m (Snell's law).

    cosine: v.m; ratio: the near index over the far one; far: the cosine on the other side.
    """
    along = ratio * cosine - far
    return Vec(along * m.x - ratio * v.x, along * m.y - ratio * v.y, along * m.z - ratio * v.z)
