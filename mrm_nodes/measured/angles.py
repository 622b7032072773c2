"""Directions of angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def directions(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Unit vectors (..., 3) from radians."""
    polar, azimuth = np.broadcast_arrays(np.asarray(theta, np.float64), np.asarray(phi, np.float64))
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1)
