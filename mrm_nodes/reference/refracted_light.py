"""What MaterialX's shaders show of a map through a surface, in float64, with what float32 may make of it.

MaterialX takes the surface for that of a solid sphere: a view is refracted at each visible normal, and once more where
it leaves the sphere. What comes from there is weighed by 1 - F alone, whatever the masking. So this is no BTDF: see
`bsdf` for that of the papers.

[FIS] Krivanek and Colbert 2008, "Real-time Shading with Filtered Importance Sampling"
[Cap] Dupuy and Benyoub 2023, "Sampling Visible GGX Normals with Spherical Caps"
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from .albedo_fit import split_sum
from .bsdf import Lobe
from .compiled import Array, Kernel, formula, run
from .fresnel import DIELECTRIC, SCHLICK, schlick_curve
from .image_light import (
    AXES,
    DEVIATIONS,
    LEVEL_OFFSET,
    LOOK_UP,
    OTHER_ARITHMETIC,
    SMALLEST,
    UNIT,
    USUAL,
    VIEW,
    Driver,
    Map,
    Sum,
    _add_filtered,
    _fresnel,
    _limits,
    _read,
    _visible_normal,
    ggx_normals,
    spherical_fibonacci,
)
from .microsurface import Alpha
from .vec import Vec

LENGTH = 6 * UNIT
"""Error of the lengths of view and half vector: of a frame's axes and of a normalised vector two roundings each, of the
products between them two more."""

MORE_AXES = AXES + 6 * UNIT
"""Of a direction in the map, where the host turns it into the world first, and from there into the map."""

ROUNDING = 4.4e-7
"""Absolute error of a fitted albedo, but for its Fresnel factor and its cosine: measured, as that of a throughput."""


@formula
def _refracted(
    vx: float, vy: float, vz: float, hx: float, hy: float, hz: float, index: float
) -> tuple[float, float, float, float, float, float]:
    """Where a view goes through a solid sphere whose normal at the entry is h, as MaterialX computes it.

    Returns:
        the direction, not of unit length where nothing enters, and zero where nothing leaves; what rounding turns it
        by, infinite where it decides whether anything enters or leaves; by how much an angle of h turns it, and a
        relative error of the index.
    """
    cosine = vx * hx + vy * hy + vz * hz
    eta, sine2 = 1.0 / index, max(1.0 - cosine * cosine, 0.0)
    sine = math.sqrt(sine2)
    # Snell's law: the square of the cosine inside.
    k = 1.0 - eta * eta * sine2
    of_k = eta * eta * (2.0 * abs(cosine) * (3.0 * UNIT + LENGTH * abs(cosine)) + 5.0 * UNIT) + 2.0 * UNIT
    if k < 0.0:
        # `refract` gives no direction, and the second one makes of it one along the normal.
        along = math.sqrt(max(1.0 - index * index, 0.0))
        turned = math.inf if -k <= of_k else 3.0 * UNIT
        return along * hx, along * hy, along * hz, turned, 1.0, 0.0
    inside = math.sqrt(k)
    of_inside = min(of_k / (2.0 * max(inside, 1e-30)), math.sqrt(of_k))
    bend = eta * cosine - inside
    rx, ry, rz = bend * hx - eta * vx, bend * hy - eta * vy, bend * hz - eta * vz
    of_r = eta * sine * LENGTH + of_inside + 3.0 * UNIT * (eta + abs(bend))
    chord = rx * hx + ry * hy + rz * hz
    nx, ny, nz = rx * chord - 0.5 * hx, ry * chord - 0.5 * hy, rz * chord - 0.5 * hz
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    # Its length is one half.
    of_n = 2.0 * (2.0 * inside * of_r + 5.0 * UNIT) + 3.0 * UNIT
    across = rx * nx + ry * ny + rz * nz
    of_across = of_r + eta * sine * of_n + 3.0 * UNIT
    leaving = 1.0 - index * index * (1.0 - across * across)
    of_leaving = index * index * (2.0 * inside * of_across + 5.0 * UNIT) + 2.0 * UNIT
    if leaving < 0.0:
        return 0.0, 0.0, 0.0, math.inf, 0.0, 0.0
    outside = math.sqrt(leaving)
    of_outside = min(of_leaving / (2.0 * max(outside, 1e-30)), math.sqrt(of_leaving))
    bend = index * across + outside
    turned = index * (of_r + of_across) + of_outside + abs(bend) * of_n + 3.0 * UNIT * (index + abs(bend))
    if leaving <= of_leaving or k <= of_k:
        turned = math.inf
    # The deflection is twice what both angles differ by. In the plane of v and h it changes with that of h as
    # 2 (1 - dt/di), across it by the part that h has of the direction.
    within = 2.0 * abs(1.0 - eta * cosine / max(inside, 1e-30))
    difference = sine * inside - cosine * eta * sine
    beside = 2.0 * abs(1.0 - eta)
    if sine > 1e-6:
        beside = 2.0 * abs(difference) * (cosine * inside + eta * sine2) / sine
    return (
        index * rx - bend * nx,
        index * ry - bend * ny,
        index * rz - bend * nz,
        turned,
        max(within, beside),
        2.0 * eta * sine / max(inside, 1e-30),
    )


@formula
def _masking(cosine: float, alpha: float) -> float:
    """Masking of GGX with one alpha in every direction, by its cosine."""
    return 2.0 / (1.0 + math.sqrt(cosine * cosine + alpha * alpha * (1.0 - cosine * cosine)) / cosine)


def _sum_refracted(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """[FIS] through a surface and, for the retro share, through it as the mirrored view sees it."""
    views, axes, alphas, shares = inputs[0], inputs[1], inputs[2], inputs[3]
    a, b, c, exponents, films, film_indices = inputs[4], inputs[5], inputs[6], inputs[7], inputs[8], inputs[9]
    indices, index_errors, samples, texels = inputs[10], inputs[11], inputs[12], inputs[13]
    levels, ranges, arcs, limits = inputs[14], inputs[15], inputs[16], inputs[17]
    kind = modes[0]
    value, most, usual, white = outputs[0], outputs[1], outputs[2], outputs[3]
    count = samples.shape[0]
    sharpest = limits[0, 0] - 1.0 - LEVEL_OFFSET
    total, shared, own, squares, bare = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    seen, other, elsewhere = np.zeros(9), np.zeros(9), np.zeros(9)
    light, moved, stepped = np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(start, stop):
        vz = min(max(views[i, 2], SMALLEST), 1.0)
        ax, ay, index = alphas[i, 0], alphas[i, 1], indices[i, 0]
        widest, mean = max(ax, ay), math.sqrt(ax * ay)
        exponent, film, film_index = exponents[i, 0], films[i, 0], film_indices[i, 0]
        g1 = _masking(vz, mean)
        masked = 2.0 / g1 - 1.0
        of_g1 = (1.0 - 1.0 / (masked * masked)) * VIEW / vz + 8.0 * UNIT
        total[:], shared[:], own[:], squares[:], bare[:] = 0.0, 0.0, 0.0, 0.0, 0.0
        for side in range(2):
            share = shares[i, 0] if side == 1 else 1.0 - shares[i, 0]
            if share <= 0.0:
                continue
            vx = -views[i, 0] if side == 1 else views[i, 0]
            vy = -views[i, 1] if side == 1 else views[i, 1]
            stretched = math.sqrt(ax * ax * vx * vx + ay * ay * vy * vy + vz * vz)
            # The view in the configuration where alpha is 1 ([Cap] section 3).
            ux, uy, uz = ax * vx / stretched, ay * vy / stretched, vz / stretched
            of_view = widest * VIEW / (stretched * stretched) + 2.0 * UNIT
            for s in range(count):
                hx, hy, hz, own_half, shared_half, of_normals = _visible_normal(
                    samples[s, 0], samples[s, 1], ux, uy, uz, ax, ay, of_view, limits[0, 1]
                )
                lx, ly, lz, rounding, by_half, by_index = _refracted(vx, vy, vz, hx, hy, hz, index)
                own_light = by_half * own_half + rounding
                shared_light = (
                    by_half * shared_half + (1.0 + by_half) * VIEW + by_index * index_errors[i, 0] + MORE_AXES
                )
                error = own_light + shared_light
                # The host takes the density of a reflection for that of what is refracted.
                density = count * ggx_normals(Vec(hx, hy, hz), Alpha(ax, ay)) * g1 / (4.0 * vz)
                of_density = of_normals + of_g1 + VIEW / vz + 16.0 * UNIT
                x = axes[i, 0] * lx + axes[i, 3] * ly + axes[i, 6] * lz
                y = axes[i, 1] * lx + axes[i, 4] * ly + axes[i, 7] * lz
                z = axes[i, 2] * lx + axes[i, 5] * ly + axes[i, 8] * lz
                light[:], moved[:], stepped[:] = 0.0, 0.0, 0.0
                level = sharpest - 0.5 * math.log2(density * math.sqrt(max(1.0 - y * y, 1e-30)))
                whole = int(min(max(level, 0.0), levels.shape[0] - 1.0))
                if rounding < math.inf and error * levels[whole, 1] < math.pi:
                    _add_filtered(
                        texels, levels, arcs, limits, x, y, z, error, rounding + LENGTH, density, of_density,
                        share, light, moved, stepped, seen, other, elsewhere,
                    )  # fmt: skip
                else:
                    # It may come from anywhere; and of no direction, which is what `refract` gives where rounding
                    # makes its root one of a negative number, a texture unit may make what it likes.
                    lost = rounding == math.inf
                    if x * x + y * y + z * z == 0.0:
                        x, y, z = axes[i, 6], axes[i, 7], axes[i, 8]
                    _read(texels, levels, arcs, limits, x, y, z, 0.0, level, 0.0, seen, other)
                    sharper = 0 if lost else max(whole - 1, 0)
                    for j in range(3):
                        least = 0.0 if lost else ranges[sharper, j]
                        light[j] = share * seen[j]
                        moved[j] = share * max(ranges[sharper, 3 + j] - seen[j], seen[j] - least)
                    own_light, shared_light = (1.0, 0.0) if lost else (own_light, shared_light)

                cosine = min(max(vx * hx + vy * hy + vz * hz, SMALLEST), 1.0)
                # Not clamped: what it lacks of 1 may exceed 1.
                f0, f1, f2, d0, d1, d2 = _fresnel(
                    kind, cosine, own_half + shared_half, a, b, c, i, exponent, film, film_index, False
                )
                of_own = own_light / (own_light + shared_light)
                for j in range(3):
                    f = f0 if j == 0 else (f1 if j == 1 else f2)
                    of_f = d0 if j == 0 else (d1 if j == 1 else d2)
                    part = (1.0 - f) * light[j]
                    total[j] += part
                    bare[j] += light[j]
                    wrong = abs(1.0 - f) * moved[j] + of_f * light[j]
                    independent = wrong * of_own + abs(part) * OTHER_ARITHMETIC + abs(1.0 - f) * stepped[j]
                    shared[j] += wrong * (1.0 - of_own)
                    own[j] += independent
                    squares[j] += independent * independent
        scale = 1.0 / (g1 * count)
        for j in range(3):
            size = abs(total[j])
            value[3 * i + j] = total[j] * scale
            white[3 * i + j] = bare[j] * scale
            most[3 * i + j] = (shared[j] + own[j] + (count * UNIT + of_g1) * size) * scale
            usual[3 * i + j] = (
                USUAL * (shared[j] + of_g1 * size)
                + min(DEVIATIONS * math.sqrt(squares[j]), own[j])
                + DEVIATIONS * math.sqrt(count) * UNIT * size
            ) * scale
    return 0


SUM_REFRACTED = Kernel(_sum_refracted, 18, 4)


def _refract(start: int, stop: int, inputs: Any, dense: Any, modes: Any, outputs: Any) -> int:
    """A view that is refracted at the normal, and what float32 may turn it by."""
    views, indices, index_errors = inputs[0], inputs[1], inputs[2]
    direction, error = outputs[0], outputs[1]
    for i in range(start, stop):
        lx, ly, lz, rounding, by_half, by_index = _refracted(
            views[i, 0], views[i, 1], views[i, 2], 0.0, 0.0, 1.0, indices[i, 0]
        )
        direction[3 * i], direction[3 * i + 1], direction[3 * i + 2] = lx, ly, lz
        error[i] = (
            rounding
            + by_half * 3.0 * UNIT
            + (1.0 + by_half) * VIEW
            + by_index * index_errors[i, 0]
            + MORE_AXES
        )
    return 0


REFRACT = Kernel(_refract, 3, 2)


class HostIndex(NamedTuple):
    """An index of refraction, and its relative error: each `(n, 1)` or `(1,)`."""

    value: Array
    error: Array


def host_index(lobe: Lobe) -> HostIndex:
    """The index that MaterialX refracts with."""
    if lobe._kind == DIELECTRIC:
        return HostIndex(lobe._parameters.a[..., :1], np.zeros(1))
    # Of the mean of the three colours, three roundings, and a root; what it lacks of 1 divides.
    mean = np.mean(lobe._parameters.a, axis=-1, keepdims=True)
    root = np.sqrt(np.clip(mean, 0.01, 0.99))
    return HostIndex((1.0 + root) / (1.0 - root), 4.0 * UNIT + 4.0 * UNIT / (1.0 - root))


def _ranges(around: Map) -> Array:
    """The least and the largest texel of each level, `(levels, 6)`."""
    begins = around.levels[:, 0].astype(int)
    parts = np.split(around.texels, begins[1:])
    return np.array([np.concatenate([part.min(axis=0), part.max(axis=0)]) for part in parts])


def refracted_samples(
    lobe: Lobe,
    index: HostIndex,
    retro: Array,
    v: Array,
    axes: Array,
    around: Map,
    samples: int,
    levels: int,
    driver: Driver,
) -> Sum:
    """What is seen of a map through a lobe by MaterialX's filtered importance sampling, without a tint.

    Args:
        lobe: its parameters of shape (), (n,) or (n, 3); GGX, whatever its distribution.
        index: that of its `host_index`, or another.
        retro: the share `(n, 1)` or `(1,)` of the mirrored view.
        v, axes, samples, levels: as `image_light.filtered_samples` has them.
    """
    made_of = lobe._parameters
    inputs = [
        *(v, axes.reshape(-1, 9), made_of.alpha, retro, made_of.a, made_of.b, made_of.c),
        *(made_of.exponent, made_of.thinfilm_thickness, made_of.thinfilm_ior, *index),
    ]
    tables = [
        spherical_fibonacci(samples),
        around.texels,
        around.levels,
        _ranges(around),
        driver.arcs,
        _limits(levels, driver),
    ]
    inputs = [np.broadcast_to(each, (len(v), each.shape[-1])) for each in inputs]
    (value, most, usual, white), _ = run(SUM_REFRACTED, inputs, [lobe._modes.kind], [3, 3, 3, 3], tables)
    return Sum(value, most, usual, white)


def refracted_look_up(
    index: HostIndex,
    retro: Array,
    v: Array,
    frame: Array,
    around: Map,
    level: Array,
    level_error: float,
    driver: Driver,
) -> Sum:
    """What MaterialX's prefiltered method reads of a map behind a surface, not weighed by anything.

    Args:
        index, retro, v: as `refracted_samples` has them.
        frame: `(n, 3, 3)`, rows tangent, bitangent and normal in the space of the map.
        level: the mip level, `(n,)`; level_error: what rounding makes of it.
    """
    indices = [np.broadcast_to(each, (len(v), 1)) for each in index]
    found = [np.zeros(v.shape) for _ in range(3)]
    span = _ranges(around)[0]
    for share, view in ((1.0 - retro, v), (retro, v * (-1.0, -1.0, 1.0))):
        (local, error), _ = run(REFRACT, [view, *indices], [0], [3, 1])
        error = error.reshape(-1, 1)
        gone = np.linalg.norm(local, axis=-1, keepdims=True) == 0.0
        toward = np.einsum("nji,nj->ni", frame, np.where(gone, (0.0, 0.0, 1.0), local))
        at = np.clip(np.floor(level), 0, len(around.levels) - 1).astype(int)
        anywhere = error * around.levels[at, 1][..., None] >= math.pi
        errors = np.concatenate([np.where(anywhere, 0.0, error), np.full_like(error, level_error)], axis=-1)
        inputs = [toward, errors, np.broadcast_to(level, len(v))[:, None]]
        tables = [around.texels, around.levels, driver.arcs, _limits(0, driver)]
        read, _ = run(LOOK_UP, inputs, [0], [3, 3, 3], tables)
        most_far = np.maximum(span[3:] - read[0], read[0])
        for k, each in enumerate((read[0], *(np.where(anywhere, most_far, bound) for bound in read[1:]))):
            found[k] = found[k] + share * each
    return Sum(found[0], found[1], found[2], found[0])


def transmitted_share(lobe: Lobe, v: Array, by_albedo: bool) -> tuple[Array, Array]:
    """By what MaterialX's prefiltered method weighs what it reads behind a surface: 1 less an albedo, and its error,
    each `(n, 3)`.

    by_albedo: whether that is the directional albedo, GGX's with Smith, as from 1.39.5 on; else it is F G at n.v, G
    being that of a light that comes along the view.
    """
    alpha = np.sqrt(lobe._alpha[..., :1] * lobe._alpha[..., 1:])

    def reflected(cosine: Array) -> Array:
        cosine = np.clip(cosine, SMALLEST, 1.0)
        mirror = unclamped_reflectance(lobe, cosine)
        if not by_albedo:
            return np.asarray(mirror * cosine / np.sqrt(alpha**2 + (1.0 - alpha**2) * cosine**2))
        a, b = split_sum(("ggx", "smith"), cosine, alpha)
        f0, film = unclamped_reflectance(lobe, np.ones(1)), lobe._parameters.thinfilm_thickness > 0.0
        f90 = np.where(film, 1.0, lobe._parameters.c) if lobe._kind == SCHLICK else np.ones(3)
        fitted = f0 * a + f90 * b
        return np.asarray(np.where(film, mirror + (fitted - mirror) * np.sqrt(alpha), fitted))

    exact = reflected(v[..., 2:])
    moved = [np.abs(reflected(v[..., 2:] + sign * VIEW) - exact) for sign in (1.0, -1.0)]
    return 1.0 - exact, np.maximum(*moved) + ROUNDING * np.maximum(np.abs(exact), 1.0)


def unclamped_reflectance(lobe: Lobe, cosine: Array) -> Array:
    """RGB reflectance, `(n, 3)` by the cosine `(n, 1)` or `(1,)`; Schlick's curve without a film is not clamped."""
    clamped = lobe._reflectance(cosine, lobe._compensation)
    if lobe._kind != SCHLICK:
        return np.asarray(clamped)
    made_of = lobe._parameters
    curve = np.vectorize(schlick_curve)(cosine, made_of.a, made_of.b, made_of.c, made_of.exponent)
    return np.asarray(np.where(made_of.thinfilm_thickness > 0.0, clamped, curve))
