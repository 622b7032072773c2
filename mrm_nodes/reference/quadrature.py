"""Nodes and weights on the unit square for averages over visible normals."""

from functools import lru_cache

import numpy as np

from . import microsurface as surface
from .compiled import Array

RESOLUTION = 128


@lru_cache(maxsize=8)
def quadrature_nodes(distribution: int, masking: int, resolution: int = RESOLUTION) -> Array:
    """Rows (u0, u1, weight); the weights sum to 1.

    Gauss-Legendre with the cubic 3t² - 2t³ put in for t, which softens the ends of the interval where a sampler's map
    is singular; an azimuth is periodic and takes equal steps instead.
    """
    t, w = np.polynomial.legendre.leggauss(resolution)
    t, w = 0.5 * (t + 1.0), 0.5 * w
    smooth, smooth_weight = t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t) * w
    beckmann = distribution in (surface.BECKMANN, surface.BECKMANN_RATIONAL)
    if beckmann and masking != surface.VCAVITY:
        first, first_weight = smooth, smooth_weight
    else:
        first = (np.arange(resolution) + 0.5) / resolution
        first_weight = np.full(resolution, 1.0 / resolution)
    u0, u1 = np.meshgrid(first, smooth, indexing="ij")
    return np.stack([u0.ravel(), u1.ravel(), np.outer(first_weight, smooth_weight).ravel()], axis=1)
