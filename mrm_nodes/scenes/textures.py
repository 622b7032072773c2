"""Textures of the scenes, all of them computed. Arrays (h, w) or (h, w, 3), row 0 at the top, linear colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def noise(size: tuple[int, int], grain: float | tuple[float, float], seed: int) -> Array:
    """Return noise that tiles, of mean 0 and deviation 1, with features `grain` pixels wide (height, width)."""
    white = np.random.default_rng(seed).normal(size=size)
    fy, fx = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])[None, :]
    gy, gx = (grain, grain) if isinstance(grain, int | float) else grain
    soft: Array = np.fft.irfft2(
        np.fft.rfft2(white) * np.exp(-2.0 * ((fy * gy) ** 2 + (fx * gx) ** 2) * np.pi), s=size
    )
    soft -= soft.mean()
    soft /= soft.std()
    return soft


def step(value: Array, low: float, high: float) -> Array:
    """Return 0 below low, 1 above high, smooth between; reversed where low is above high."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def mix(share: Array, under: Array | tuple[float, ...], over: Array | tuple[float, ...]) -> Array:
    """Return a colour where share is 0, another where it is 1."""
    s = share[..., None]
    return np.asarray(under) * (1.0 - s) + np.asarray(over) * s


def asphalt(size: int = 1024) -> tuple[Array, Array]:
    """Return colour and roughness of worn asphalt."""
    stones = noise((size, size), 3.0, 1) + 0.6 * noise((size, size), 1.2, 2)
    patches = noise((size, size), 90.0, 3)
    bright = step(stones, 0.7, 2.2)
    value = 0.055 + 0.009 * stones + 0.004 * patches + 0.13 * bright**2
    pits = step(stones, -0.6, -2.0)
    color = np.clip(value * (1.0 - 0.6 * pits), 0.006, 1.0)[..., None] * np.array([1.0, 0.97, 0.93])
    return color, np.clip(0.82 - 0.16 * bright + 0.03 * patches, 0.4, 1.0)


def paint(height: int, width: int, seed: int, wear: float) -> tuple[Array, Array]:
    """Return cover of road paint, 0 or 1, and the strength of the beads in it."""
    stones = noise((height, width), 2.2, seed)
    patches = noise((height, width), (60.0, 14.0), seed + 1)
    worn = step(0.55 * stones + 0.8 * patches, 2.6 - 2.4 * wear, 3.0 - 2.4 * wear)
    beads = step(noise((height, width), 1.0, seed + 2), -0.4, 0.9)
    traffic = 0.75 + 0.25 * np.clip(noise((height, width), (40.0, 20.0), seed + 3), -1.0, 1.0)
    return 1.0 - worn, beads * traffic


def sheeting(height: int, width: int, cell: int) -> Array:
    """Return the strength of bead sheeting, sealed in a grid of hexagon-like cells `cell` pixels wide."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    u, v = 2.0 * np.pi * x / cell, 2.0 * np.pi * y / (cell * 0.866)
    ridge = np.abs(np.cos(u / 2.0 + v / 2.0)) * np.abs(np.cos(u / 2.0 - v / 2.0))
    seal = step(ridge, 0.02, 0.12)
    return (0.35 + 0.65 * seal) * (0.88 + 0.12 * np.clip(noise((height, width), 1.3, 7), -1.5, 1.5))


def segment_distance(x: Array, y: Array, start: tuple[float, float], end: tuple[float, float]) -> Array:
    """Return the distance of each point from a line segment."""
    (ax, ay), (bx, by) = start, end
    t = np.clip(((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2), 0.0, 1.0)
    return np.hypot(x - ax - t * (bx - ax), y - ay - t * (by - ay))
