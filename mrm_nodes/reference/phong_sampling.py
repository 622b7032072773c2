"""Smith's masking of the Phong distribution: what is hidden from a direction, and normals of what is not.

With t the stretched azimuth, tan φ = ay sin t / (ax cos t), p = 2 / (ax² cos² t + ay² sin² t) and w = cos^p θ,
D(m) m.n dm is dw dt / 2π on the unit square. What is visible is that times v.m / m.n = B + A tan θ, where A and B
are the parts of v along the azimuth and along the normal, as far as it is positive. Its integral over w is an
incomplete beta function; its distributions over t and then over w are inverted with Newton's method."""

import math
from typing import Any

import numpy as np

from .compiled import Array, Kernel, formula

# Pieces of each half circle, on whose edges v faces the azimuth or not, and points of a Gauss rule in each.
PIECES = 64
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)


@formula
def incomplete_beta(x: float, rest: float, a: float, b: float) -> float:
    """The regularised incomplete beta function I_x(a, b), `rest` = 1 - x, by its continued fraction.

    Source: Press et al., Numerical Recipes, section 6.4 (modified Lentz).
    """
    if x <= 0.0 or rest <= 0.0:
        return 0.0 if x <= 0.0 else 1.0
    front = math.exp(
        a * math.log(x) + b * math.log(rest) + math.lgamma(a + b) - math.lgamma(a) - math.lgamma(b)
    )
    direct = x < (a + 1.0) / (a + b + 2.0)
    p, q, z = (a, b, x) if direct else (b, a, rest)
    tiny = 1e-300
    c = 1.0
    d = 1.0 - (p + q) * z / (p + 1.0)
    d = 1.0 / (tiny if abs(d) < tiny else d)
    result = d
    for m in range(1, 400):
        before = result
        for odd in range(2):
            if odd == 0:
                numerator = m * (q - m) * z / ((p + 2 * m - 1.0) * (p + 2 * m))
            else:
                numerator = -(p + m) * (p + q + m) * z / ((p + 2 * m) * (p + 2 * m + 1.0))
            d = 1.0 + numerator * d
            d = 1.0 / (tiny if abs(d) < tiny else d)
            c = 1.0 + numerator / (tiny if abs(c) < tiny else c)
            result *= c * d
        if abs(result - before) <= 1e-16 * abs(result):
            break
    value = front * result / p
    return value if direct else 1.0 - value


@formula
def _tangent(w: float, power: float) -> float:
    """tan θ where w = cos^power θ."""
    return math.sqrt(math.expm1(-2.0 / power * math.log(w)))


@formula
def _tangents_above(w: float, power: float) -> float:
    """∫ tan θ dw from w to 1."""
    a = 0.5 * (power - 1.0)
    whole = 0.5 * power * math.exp(math.lgamma(a) + math.lgamma(1.5) - math.lgamma(a + 1.5))
    if w <= 0.0:
        return whole
    rest = -math.expm1(2.0 / power * math.log(w))
    return whole * incomplete_beta(rest, 1.0 - rest, 1.5, a)


@formula
def _azimuth(vx: float, vy: float, ax: float, ay: float, t: float) -> tuple[float, float]:
    """A and p at a stretched azimuth."""
    x, y = ax * math.cos(t), ay * math.sin(t)
    squared = x * x + y * y
    return (vx * x + vy * y) / math.sqrt(squared), 2.0 / squared


@formula
def _first_visible(along: float, up: float, power: float) -> float:
    """The w from which facets of an azimuth are seen."""
    if along >= 0.0:
        return 0.0
    return math.exp(-0.5 * power * math.log1p((up / along) ** 2))


@formula
def _seen(vx: float, vy: float, vz: float, ax: float, ay: float, t: float) -> float:
    """The marginal density of t, but for a factor."""
    along, power = _azimuth(vx, vy, ax, ay, t)
    w = _first_visible(along, vz, power)
    return max(vz * (1.0 - w) + along * _tangents_above(w, power), 0.0)


@formula
def _seen_between(vx: float, vy: float, vz: float, ax: float, ay: float, start: float, stop: float) -> float:
    middle, half = 0.5 * (start + stop), 0.5 * (stop - start)
    total = 0.0
    for k in range(8):
        total += WEIGHTS[k] * _seen(vx, vy, vz, ax, ay, middle + half * NODES[k])
    return half * total


@formula
def hidden(vx: float, vy: float, vz: float, ax: float, ay: float) -> float:
    """Λ of a direction above the surface: the area of facets that face away from it over its cosine (eqs. 41
    and 43 of Heitz 2014), by quadrature over the half circle of azimuths that face away.
    """
    start = math.atan2(vy * ay, vx * ax) + 0.5 * math.pi
    total = 0.0
    for k in range(PIECES):
        x, y = k / PIECES, (k + 1) / PIECES
        x, y = x * x * (3.0 - 2.0 * x), y * y * (3.0 - 2.0 * y)
        for j in range(8):
            t = start + math.pi * (0.5 * (x + y) + 0.5 * (y - x) * NODES[j])
            along, power = _azimuth(vx, vy, ax, ay, t)
            if along < 0.0:
                a = 0.5 * (power - 1.0)
                whole = 0.5 * power * math.exp(math.lgamma(a) + math.lgamma(1.5) - math.lgamma(a + 1.5))
                squared = along * along + vz * vz
                below = whole * incomplete_beta(along * along / squared, vz * vz / squared, a, 1.5)
                away = -along * below - vz * _first_visible(along, vz, power)
                total += 0.5 * math.pi * (y - x) * WEIGHTS[j] * max(away, 0.0)
    return total / (2.0 * math.pi * vz)


@formula
def _tabulate(vx: float, vy: float, vz: float, ax: float, ay: float, edges: Array, cumulative: Array) -> None:
    """The marginal distribution of t at the edges of pieces, which shrink towards azimuths across v."""
    start = math.atan2(vy * ay, vx * ax) - 0.5 * math.pi
    for k in range(2 * PIECES + 1):
        half, x = k // PIECES, (k % PIECES) / PIECES
        edges[k] = start + math.pi * (half + x * x * (3.0 - 2.0 * x))
    cumulative[0] = 0.0
    for k in range(2 * PIECES):
        cumulative[k + 1] = cumulative[k] + _seen_between(vx, vy, vz, ax, ay, edges[k], edges[k + 1])


@formula
def _draw_azimuth(
    vx: float, vy: float, vz: float, ax: float, ay: float, edges: Array, cumulative: Array, u: float
) -> float:
    target = u * cumulative[2 * PIECES]
    k = 0
    while k < 2 * PIECES - 1 and cumulative[k + 1] < target:
        k += 1
    low, high = edges[k], edges[k + 1]
    inside = max(cumulative[k + 1] - cumulative[k], 1e-300)
    t: float = low + (high - low) * min(max((target - cumulative[k]) / inside, 0.0), 1.0)
    for _ in range(60):
        off = cumulative[k] + _seen_between(vx, vy, vz, ax, ay, edges[k], t) - target
        if off > 0.0:
            high = t
        else:
            low = t
        slope = _seen(vx, vy, vz, ax, ay, t)
        step = t - off / slope if slope > 0.0 else low
        if not (low <= step <= high):
            step = 0.5 * (low + high)
        done = abs(step - t) <= 1e-14
        t = step
        if done:
            break
    return t


@formula
def _draw_radius(along: float, up: float, power: float, u: float) -> float:
    """w where the share 1 - u of what is visible at this azimuth lies above."""
    low, high = _first_visible(along, up, power), 1.0
    target = (1.0 - u) * (up * (1.0 - low) + along * _tangents_above(low, power))
    w = max(low + u * (1.0 - low), 1e-300)
    for _ in range(100):
        off = target - (up * (1.0 - w) + along * _tangents_above(w, power))
        if off > 0.0:
            high = w
        else:
            low = w
        slope = up + along * _tangent(w, power)
        step = w - off / slope if slope > 0.0 else low
        if not (low < step < high):
            step = 0.5 * (low + high)
        done = abs(step - w) <= 1e-15 * w
        w = step
        if done:
            break
    return max(w, 1e-300)


def _lambda(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    view, alpha, out = inputs[0], inputs[1], outputs[0]
    for i in range(start, stop):
        vx, vy, vz = view[i, 0], view[i, 1], view[i, 2]
        out[i] = hidden(vx, vy, vz, alpha[i, 0], alpha[i, 1]) if vz > 0.0 else math.inf
    return 0


#: Λ for directions (3) and alphas (2).
LAMBDA = Kernel(_lambda, 2, 1)


def _draw(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    view, uniforms, alpha, out = inputs[0], inputs[1], inputs[2], outputs[0]
    edges, cumulative = np.empty(2 * PIECES + 1), np.empty(2 * PIECES + 1)
    for i in range(start, stop):
        vx, vy, vz = view[i, 0], view[i, 1], view[i, 2]
        ax, ay = alpha[i, 0], alpha[i, 1]
        k = max(i - 1, start)
        same = vx == view[k, 0] and vy == view[k, 1] and vz == view[k, 2]
        same = same and ax == alpha[k, 0] and ay == alpha[k, 1]
        # The table serves for as long as the view stays.
        if i == start or not same:
            _tabulate(vx, vy, vz, ax, ay, edges, cumulative)
        t = _draw_azimuth(vx, vy, vz, ax, ay, edges, cumulative, uniforms[i, 0])
        along, power = _azimuth(vx, vy, ax, ay, t)
        tangent = _tangent(_draw_radius(along, vz, power, uniforms[i, 1]), power)
        x, y = ax * math.cos(t), ay * math.sin(t)
        across = tangent / math.sqrt(x * x + y * y)
        length = math.sqrt(1.0 + tangent * tangent)
        out[3 * i], out[3 * i + 1], out[3 * i + 2] = across * x / length, across * y / length, 1.0 / length
    return 0


#: Normals (3) for views (3), uniforms (2 or 3) and alphas (2).
DRAW_VISIBLE = Kernel(_draw, 3, 1)
