"""Nodes and weights on the unit square for averages over visible normals."""

from functools import lru_cache

import numpy as np

from .compiled import Array

RESOLUTION = 128


@lru_cache(maxsize=8)
def quadrature_nodes(resolution: int = RESOLUTION) -> Array:
    """Rows (azimuth from v, radius, weight), about `resolution`² of them; the weights sum to 1.

    Gauss-Legendre with the cubic 3t² - 2t³ put in for t, which softens the ends of an interval, where a
    sampler's map is singular or, between quarters of the azimuth, a grazing v stops seeing facets."""
    quarter, quarter_weight = _softened(max(resolution // 4, 2))
    azimuth = np.concatenate([(k + quarter) / 4.0 for k in range(4)])
    radius, radius_weight = _softened(resolution)
    u0, u1 = np.meshgrid(azimuth, radius, indexing="ij")
    weights = np.outer(np.tile(quarter_weight / 4.0, 4), radius_weight)
    return np.stack([u0.ravel(), u1.ravel(), weights.ravel()], axis=1)


def _softened(count: int) -> tuple[Array, Array]:
    t, w = np.polynomial.legendre.leggauss(count)
    t, w = 0.5 * (t + 1.0), 0.5 * w
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) * w
