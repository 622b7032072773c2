"""What environment light truly gives: the evaluator integrated over the same map, with a known standard error.

A shader's sum is compared with the very sum (`image_sum`); how far that is from the integral is a figure beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.regression.truth.material import as_float32
from mrm_nodes.regression.truth.reference_image import evaluator
from mrm_nodes.render.environment import Environment, directions, solid_angles

Array = NDArray[np.float64]

#: Generalised golden ratios: the additive sequences of least discrepancy in two and three dimensions (Roberts 2018).
_STEPS_2 = 1.0 / 1.32471795724474602596 ** np.arange(1, 3)
_STEPS_3 = 1.0 / 1.22074408460575947536 ** np.arange(1, 4)

#: Evaluations at a time: bounds the memory.
_BLOCK = 1 << 20


class Estimate(NamedTuple):
    """A mean and its standard error, each (n, 3)."""

    mean: Array
    standard_error: Array


INTEGRATED = 64
"""Points of an image whose integrals are sampled: each takes milliseconds."""


SAMPLES = 256
"""Of each replicate at a point."""


def some_of(count: int) -> NDArray[np.intp]:
    """Indices of at most INTEGRATED of so many points, evenly."""
    chosen: NDArray[np.intp] = np.arange(min(count, INTEGRATED)) * count // max(min(count, INTEGRATED), 1)
    return chosen


def beside_integral(seen: Array, truth: Estimate, samples: int) -> dict[str, float | int]:
    """How far a sum `(n, 3)` over `samples` samples of a map is from the integral, as shares of the integral's size.

    `mean` is the difference of the means, `rms` the root mean square of the differences, freed of the integral's own
    noise; each with its standard error.
    """
    found: dict[str, float | int] = {"samples": samples, "points": len(seen)}
    whole, size = float(np.mean(truth.mean)), math.sqrt(float(np.mean(truth.mean**2)))
    if whole == 0.0:
        return found
    difference, noise = seen - truth.mean, truth.standard_error
    cleared = difference**2 - noise**2
    # With d = δ + s ε, ε normal: Var[d²] = 2 s⁴ + 4 δ² s². A point's channels share their samples.
    scatter = np.sqrt(2 * noise**4 + 4 * np.maximum(cleared, 0.0) * noise**2)
    of_mean, of_square = (
        math.sqrt(float(np.sum(np.sum(each, axis=-1) ** 2))) / noise.size for each in (noise, scatter)
    )
    square = max(float(np.mean(cleared)), 0.0)
    of_rms = of_square / (2.0 * math.sqrt(square)) if square > of_square else math.sqrt(of_square)
    return found | {
        "mean": float(np.mean(difference)) / whole,
        "mean_error": of_mean / whole,
        "rms": math.sqrt(square) / size,
        "rms_error": of_rms / size,
    }


def is_constant(environment: Environment) -> bool:
    """Whether the same comes from everywhere."""
    return not bool(np.ptp(environment.radiance, axis=(0, 1)).any())


def radiance_from(environment: Environment, direction: Array) -> Array:
    """Radiance (..., 3) from directions (..., 3) in world space: the map read bilinearly, as a GPU reads it.

    Columns repeat; rows end at the poles.
    """
    height, width, _ = environment.radiance.shape
    u, v = _texture_coordinates(environment, direction)
    x, y = u * width - 0.5, np.clip(v * height - 0.5, 0.0, height - 1.0)
    column, row = np.floor(x).astype(int), np.minimum(np.floor(y).astype(int), max(height - 2, 0))
    across, down = (x - column)[..., None], (y - row)[..., None]
    left, right, below = column % width, (column + 1) % width, np.minimum(row + 1, height - 1)
    texels = environment.radiance
    top = texels[row, left] * (1.0 - across) + texels[row, right] * across
    bottom = texels[below, left] * (1.0 - across) + texels[below, right] * across
    result: Array = (top * (1.0 - down) + bottom * down) * environment.intensity
    return result


def _texture_coordinates(environment: Environment, direction: Array) -> tuple[Array, Array]:
    """MaterialX's `mx_latlong_projection`, in the space of the map."""
    x, y, z = np.moveaxis(direction @ environment.matrix[:3, :3].T, -1, 0)
    return np.arctan2(x, -z) / (2.0 * math.pi) + 0.5, 0.5 - np.arcsin(np.clip(y, -1.0, 1.0)) / math.pi


class _MapSampler:
    """Directions drawn from a map: a texel by its brightness and solid angle, then a point in it."""

    def __init__(self, environment: Environment) -> None:
        self._environment = environment
        # Interpolation carries a texel's light into its neighbours.
        bright = environment.radiance.max(axis=2).astype(np.float64)
        for axis in (0, 1):
            bright = np.maximum(bright, np.maximum(np.roll(bright, 1, axis), np.roll(bright, -1, axis)))
        self._height, self._width = bright.shape
        angles = solid_angles(self._height, self._width)
        chance = (bright + 1e-3 * bright.mean() + 1e-30) * angles[:, None]
        chance /= chance.sum()
        self._density = chance / angles[:, None]
        self._rows = np.concatenate([[0.0], np.cumsum(chance.sum(axis=1))])
        self._columns = np.concatenate(
            [np.zeros((self._height, 1)), np.cumsum(chance, axis=1) / chance.sum(axis=1, keepdims=True)],
            axis=1,
        )

    def draw(self, u: Array) -> Array:
        """Directions (..., 3) in world space from uniforms (..., 2)."""
        first, second = u[..., 0] * self._rows[-1], u[..., 1]
        row = np.clip(np.searchsorted(self._rows, first, side="right") - 1, 0, self._height - 1)
        down = (first - self._rows[row]) / (self._rows[row + 1] - self._rows[row])
        # All rows' cumulative shares in one increasing list.
        stacked = (self._columns + np.arange(self._height)[:, None]).ravel()
        column = np.searchsorted(stacked, second + row, side="right") - 1 - row * (self._width + 1)
        column = np.clip(column, 0, self._width - 1)
        low, high = self._columns[row, column], self._columns[row, column + 1]
        across = np.clip((second - low) / np.maximum(high - low, 1e-300), 0.0, 1.0)

        edges = np.cos(math.pi * np.arange(self._height + 1) / self._height)
        y = edges[row] + (edges[row + 1] - edges[row]) * down
        longitude = 2.0 * math.pi * ((column + across) / self._width - 0.5)
        radius = np.sqrt(np.maximum(1.0 - y * y, 0.0))
        in_map = np.stack([radius * np.sin(longitude), y, -radius * np.cos(longitude)], axis=-1)
        result: Array = in_map @ self._environment.matrix[:3, :3]
        return result

    def pdf(self, direction: Array) -> Array:
        """Density per steradian of `draw`."""
        u, v = _texture_coordinates(self._environment, direction)
        row = np.clip((v * self._height).astype(int), 0, self._height - 1)
        column = np.floor(u * self._width).astype(int) % self._width
        density: Array = self._density[row, column]
        return density


def reflected_radiance(
    bsdf: Any,
    view: Array,
    frame: Array,
    environment: Environment,
    samples: int = 4096,
    replicates: int = 8,
    seed: int = 0,
) -> Estimate:
    """Integrate bsdf · map · cosine over the hemisphere at n points, uncompensated if the BSDF is.

    Half of the directions come from the BSDF and half from the map, weighed by the balance heuristic (Veach 1997).
    Each replicate is a low-discrepancy sequence with a random shift, so that their spread is the standard error.

    Args:
        bsdf: parameters of shape (), (n,) or (n, 3).
        view: (n, 3), and frame: (n, 3, 3) with rows tangent, bitangent, normal, as `shading_frame` gives them.
        samples: of each replicate and point, both kinds together.
    """
    rng = np.random.default_rng(seed)
    sampler = _MapSampler(environment)
    v = view_in(frame, view)
    count = max(samples // 2, 1)
    at_once = max(_BLOCK // (2 * len(v)), 1)
    means = []
    for _ in range(replicates):
        shift_2, shift_3 = rng.random((len(v), 2)), rng.random((len(v), 3))
        total = np.zeros((len(v), 3))
        for first in range(0, count, at_once):
            index = np.arange(first, min(first + at_once, count))[:, None, None]
            sample = bsdf.sample(v, (shift_3 + index * _STEPS_3) % 1.0)
            # A rejected sample counts for nothing, as whatever lies below the horizon.
            drawn = np.where(np.asarray(sample.pdf)[..., None] > 0.0, sample.l, (0.0, 0.0, -1.0))
            world = np.einsum("nij,kni->knj", frame, drawn)
            from_map = sampler.draw((shift_2 + index * _STEPS_2) % 1.0)
            local = np.einsum("nij,knj->kni", frame, from_map)
            total += _contributions(bsdf, v, drawn, world, environment, sampler)
            total += _contributions(bsdf, v, local, from_map, environment, sampler)
        means.append(total / (2 * count))
    spread = np.std(means, axis=0, ddof=1) / math.sqrt(replicates)
    return Estimate(np.mean(means, axis=0), spread)


def view_in(frame: Array, view: Array) -> Array:
    """The view (n, 3) in the shading frame, a unit vector."""
    v: Array = np.einsum("nij,nj->ni", frame, view)
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    return v


def _contributions(
    bsdf: Any, v: Array, light: Array, world: Array, environment: Environment, sampler: _MapSampler
) -> Array:
    light = light / np.linalg.norm(light, axis=-1, keepdims=True)
    above = light[..., 2] > 0.0
    density = 0.5 * np.asarray(bsdf.pdf(v, light)) + 0.5 * sampler.pdf(world)
    weight = np.where(above, light[..., 2] / density, 0.0)[..., None]
    total: Array = np.sum(
        np.asarray(bsdf.eval(v, light)) * radiance_from(environment, world) * weight, axis=0
    )
    return total


def compensation(node: str, values: Mapping[str, Any], view: Array, frame: Array) -> Array:
    """The factor (n, 3) that the host's energy compensation puts on environment light: with Fresnel at n.v."""
    v = view_in(frame, view)
    # The half vector of a mirrored pair is the normal, so that direct light has the same factor there.
    mirrored = v * (-1.0, -1.0, 1.0)
    forward = {**values, "retroreflectivity": 0.0}
    with_it, without = (
        evaluator(node, forward, compensated).eval(v, mirrored) for compensated in (True, False)
    )
    return np.asarray(np.divide(with_it, without, out=np.ones_like(with_it), where=without > 0.0))


def environment_image(
    node: str,
    values: Mapping[str, Any],
    view: Array,
    frame: Array,
    environment: Environment,
    samples: int = SAMPLES,
    replicates: int = 8,
    seed: int = 0,
) -> Estimate:
    """What a node shows under an environment at n points: integral, compensation and weight.

    In an environment that is the same all around the integral is the directional albedo, without an error.
    """
    bsdf = evaluator(node, values, compensated=False)
    factor = compensation(node, values, view, frame) * np.asarray(as_float32(values["weight"]))[..., None]
    if is_constant(environment):
        seen = bsdf.albedo(view_in(frame, view)) * environment.radiance[0, 0] * environment.intensity
        return Estimate(seen * factor, np.zeros_like(view))
    integral = reflected_radiance(bsdf, view, frame, environment, samples, replicates, seed)
    return Estimate(integral.mean * factor, integral.standard_error * factor)


def irradiance(environment: Environment, normal: Array) -> Array:
    """Irradiance over π, (n, 3), of surfaces with the normals (n, 3): the sum over the map's texels."""
    height, width, _ = environment.radiance.shape
    toward = directions(height, width) @ environment.matrix[:3, :3]
    total = np.zeros(normal.shape)
    for row, angle, texels in zip(toward, solid_angles(height, width), environment.radiance, strict=True):
        total += np.maximum(normal @ row.T, 0.0) @ texels.astype(np.float64) * angle
    return total * (environment.intensity / math.pi)
