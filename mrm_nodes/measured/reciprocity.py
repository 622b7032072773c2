"""Which cosine a table's values are multiplied by: f(v, l) = f(l, v) tells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.measured.angles import Array
from mrm_nodes.measured.measurement import isotropic

FEWEST = 12
"""Pairs without which nothing is said."""
NEAREST = np.radians(1.6)
"""How near, in radians, the other of a pair must lie to where it belongs."""
SURE = 0.3
"""How near to a whole power the pairs must be."""


def exchanged(v: Array, l: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:  # noqa: E741
    """Indices, each (p), of the samples and of those that have their directions exchanged, as near as `NEAREST`."""
    from scipy.spatial import cKDTree

    distance, index = cKDTree(isotropic(v, l)).query(isotropic(l, v), distance_upper_bound=NEAREST)
    found = np.flatnonzero(np.isfinite(distance))
    return found, np.asarray(index)[found]


def cosine_power(v: Array, l: Array, value: Array) -> int | None:  # noqa: E741  the field's own name
    """The power of cos θ_v / cos θ_l by which the values of a pair differ: 1 for f cos θ_v, 0 for plain f, -1 for
    f cos θ_l; None where too few pairs are there, or they say no whole power.

    The median over the pairs is taken, which no peak that falls between the samples moves.
    """
    good = (value > 0.0) & (v[:, 2] > 0.17) & (l[:, 2] > 0.17)
    v, l, value = v[good], l[good], value[good]  # noqa: E741
    if len(v) < FEWEST:
        return None
    slope = np.log(v[:, 2] / l[:, 2])
    paired, other = exchanged(v, l)
    slanted = np.abs(slope[paired]) > 0.08
    paired, other = paired[slanted], other[slanted]
    if len(paired) < FEWEST:
        return None
    ratio = np.log(value[paired] / value[other])
    # Exactly what p does to the pair as it was found, not as it should have been.
    found = slope[paired] - slope[other]
    power = float(np.median(2.0 * ratio / np.where(np.abs(found) > 0.08, found, np.nan)))
    nearest = int(np.clip(round(power), -1, 1))
    return nearest if np.isfinite(power) and abs(power - nearest) < SURE else None
