"""The coefficients by which retroreflectors are specified, of anything that scatters.

A BSDF here is any object with `eval(v, l)`, f in 1/sr without the cosine, shape (..., 3) or, for one channel, (...):
the lobes and closures of `mrm_nodes.reference`, a document's material, a measured table. Results have three channels;
`luminance` makes one of them. Angles are in degrees. What broadcasts its own n points with directions (..., 1, 3) has n
of each quantity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError
from mrm_nodes.photometry.colour import luminance
from mrm_nodes.photometry.geometry import ROAD_ELEVATION, ROAD_ENTRANCE, ROAD_OBSERVATION, around, directions
from mrm_nodes.reference.polar import Scatterer

Array = NDArray[np.float64]


def retroreflection(
    bsdf: Scatterer,
    observation: ArrayLike,
    beta1: ArrayLike,
    beta2: ArrayLike = 0.0,
    rotation: ArrayLike = 0.0,
) -> Array:
    """The coefficient of retroreflection R_A in cd/(lx m²), (..., 3): f cosβ_l cosβ_v.

    Luminous intensity per area of the sheet and illuminance on a plane that faces the source (ASTM E808).

    Args:
        bsdf: what has `eval(v, l)`: f in 1/sr without the cosine, (..., 3) or, of one channel, (...).
        observation: angle between receiver and source, in degrees: (...).
        beta1: first component of the entrance angle, in degrees: (...).
        beta2: second component, in degrees: (...).
        rotation: of the sheet about its normal, in degrees: (...).

    Raises:
        MrmError: as `directions`.
    """
    v, l = directions(observation, beta1, beta2, rotation)  # noqa: E741
    return _evaluated(bsdf, v, l) * l[..., 2:] * v[..., 2:]


def luminance_coefficient(
    bsdf: Scatterer,
    observation: ArrayLike = ROAD_OBSERVATION,
    beta1: ArrayLike = ROAD_ENTRANCE,
    beta2: ArrayLike = 0.0,
    rotation: ArrayLike = 0.0,
) -> Array:
    """The coefficient of retroreflected luminance R_L in cd/(lx m²), (..., 3): f cosβ_l, which is R_A / cosβ_v.

    Luminance per illuminance on a plane that faces the source; by default of a road, as its driver sees it 30 m
    ahead. Tables of road markings have mcd/(lx m²): a thousand times this. Arguments as for `retroreflection`.

    Raises:
        MrmError: as `directions`.
    """
    v, l = directions(observation, beta1, beta2, rotation)  # noqa: E741
    return _evaluated(bsdf, v, l) * l[..., 2:]


def diffuse_luminance(bsdf: Scatterer, elevation: float = ROAD_ELEVATION) -> Array:
    """The luminance coefficient under diffuse light Q_d in cd/(lx m²), (3,) or (n, 3): ∫ f cosθ_l dω_l / π.

    Luminance towards an eye per illuminance of the road by an even sky, by quadrature. Tables of road markings have
    mcd/(lx m²): a thousand times this.

    Args:
        bsdf: as in `retroreflection`.
        elevation: of the eye above the road, in degrees.

    Raises:
        MrmError: an elevation outside of 0 to 90.
    """
    if not 0.0 < elevation <= 90.0:
        raise MrmError(f"the eye's elevation is above 0 and at most 90 degrees, not {elevation:g}")
    angle = np.radians(elevation)
    v = np.array([0.0, np.cos(angle), np.sin(angle)])
    back = v * (-1.0, -1.0, 1.0)
    total = np.zeros((1, 3))
    for axis, other in ((v, back), (back, v)):
        l, solid_angle = _about_lobe(axis)  # noqa: E741
        # Each direction belongs to the lobe that it is nearer to, whose nodes are the denser ones there.
        near, far = (_slope(each, l) for each in (axis, other))
        share = far**2 / (near**2 + far**2)
        f = _evaluated(bsdf, v, l[:, None])
        total = total + np.tensordot(l[:, 2] * solid_angle * share, f, axes=1) / np.pi
    return _unless_one(total)


def total_retroreflectance(
    bsdf: Scatterer, max_observation: float = 4.0, beta1: float = 0.0, beta2: float = 0.0
) -> Array:
    """The share R_T of the light on the sheet that comes back within an observation angle, ∫ R_A / cosβ_l dω_v.

    By quadrature over the cone about the source; (3,) or (n, 3). Source: ASTM E808. The others as for
    `retroreflection`.

    Args:
        max_observation: half the angle of that cone, in degrees.

    Raises:
        MrmError: an observation angle outside of 0 to 180; as `directions`.
    """
    if not 0.0 < max_observation <= 180.0:
        raise MrmError(
            f"the largest observation angle is above 0 and at most 180 degrees, not {max_observation:g}"
        )
    directions(0.0, beta1, beta2)
    angle, weight = _logarithmic(np.radians(max_observation))
    azimuth = (np.arange(_AROUND) + 0.5) * (360.0 / _AROUND)
    v, l = around(np.degrees(angle)[:, None], azimuth, beta1, beta2)  # noqa: E741
    share = v[..., 2] * (np.sin(angle) * weight)[:, None] * (2.0 * np.pi / _AROUND)
    seen = share > 0.0
    f = _evaluated(bsdf, v[seen][:, None], l[seen][:, None])
    return _unless_one(np.tensordot(share[seen], f, axes=1))


def half_width(bsdf: Scatterer, beta1: float = 5.0, beta2: float = 0.0) -> float:
    """The observation angle in degrees at which the luminance of R_A under illuminant A is half of that at 0.

    Of several points their mean. NaN where there is none within 60°: nothing comes back, or as much everywhere.
    Arguments as for `retroreflection`.

    Raises:
        MrmError: as `directions`.
    """
    low = high = 0.0
    peak = np.mean(luminance(retroreflection(bsdf, 0.0, beta1, beta2)))
    angles = np.concatenate([[0.0], np.geomspace(1e-4, 60.0, 241)])
    for _ in range(3):
        seen = around(angles, 0.0, beta1, beta2)[0][:, 2] > 1e-9
        angles = angles[seen]
        value = np.mean(luminance(retroreflection(bsdf, angles[:, None], beta1, beta2)), axis=-1)
        below = np.flatnonzero(value < 0.5 * peak)
        if not (peak > 0.0 and len(below)):
            return float("nan")
        low, high = angles[below[0] - 1], angles[below[0]]
        angles = np.linspace(low, high, 129)
    return float(0.5 * (low + high))


_AROUND = 32
"""Azimuths of the quadratures."""
_RINGS = 192
_INNERMOST = 1e-6
"""Radians, or slope, within which a lobe is taken for constant."""


def _evaluated(bsdf: Scatterer, v: Array, l: Array) -> Array:  # noqa: E741
    """f at directions, (..., 3)."""
    f = np.asarray(bsdf.eval(v, l), np.float64)
    shape = np.broadcast_shapes(v.shape, l.shape)
    if f.ndim < len(shape):
        f = f[..., None]
    return np.broadcast_to(f, np.broadcast_shapes(f.shape, shape))


def _unless_one(points: Array) -> Array:
    """Values of n points (n, 3), or (3,) of one."""
    return points[0] if len(points) == 1 else points


def _logarithmic(largest: float) -> tuple[Array, Array]:
    """Angles or slopes up to a largest one, as dense near 0 as lobes are narrow, and their weights."""
    t, w = np.polynomial.legendre.leggauss(_RINGS)
    span = np.log(largest / _INNERMOST)
    angle = _INNERMOST * np.exp(0.5 * (t + 1.0) * span)
    first = np.array([0.5 * _INNERMOST])
    return np.concatenate([first, angle]), np.concatenate([2.0 * first, 0.5 * w * span * angle])


def _about_lobe(axis: Array) -> tuple[Array, Array]:
    """Light directions (n, 3) of the upper hemisphere and their solid angles (n), dense about a direction's mirror.

    They are placed by the slopes of their half vectors, in which a lobe is as round at grazing angles as elsewhere.
    """
    sine, cosine = float(np.linalg.norm(axis[:2])), float(axis[2])
    slope, weight = _logarithmic((sine + 1.0) / cosine)
    # Of each ring of slopes, the azimuths whose light is above the horizon.
    half = np.arccos(np.clip(cosine * (slope**2 - 1.0) / (2.0 * slope * max(sine, 1e-300)), -1.0, 1.0))
    t, w = np.polynomial.legendre.leggauss(2 * _AROUND)
    azimuth = half[:, None] * t + (np.arctan2(axis[1], axis[0]) if sine else 0.0)
    m = np.stack(
        [slope[:, None] * np.cos(azimuth), slope[:, None] * np.sin(azimuth), np.ones_like(azimuth)], -1
    )
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    facing = m @ axis
    l = 2.0 * facing[..., None] * m - axis  # noqa: E741
    solid_angle = 4.0 * facing * m[..., 2] ** 3 * (slope * weight * half)[:, None] * w
    above = l[..., 2] > 0.0
    return l[above] / np.linalg.norm(l[above], axis=-1, keepdims=True), solid_angle[above]


def _slope(axis: Array, l: Array) -> Array:  # noqa: E741
    """The slopes (n) of half vectors."""
    half = axis + l
    result: Array = np.linalg.norm(half[:, :2], axis=-1) / half[:, 2]
    return result
