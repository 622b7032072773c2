"""How bright a picture is shown: stops that bring what is lit to where a screen shows it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mrm_nodes.errors import MrmError

Floats = NDArray[np.float32]

BRIGHT, TARGET = 0.9, 0.98
"""Automatic exposure: the share of lit pixels that is to be no brighter than this, in exposed radiance."""
BEHIND = 2.0
"""How much brighter than that half of what is behind may be."""
NEARLY_ALL = 0.99
"""The share of lit pixels that is not to be clipped, however bright."""

LIMIT = 64.0
"""Stops: beyond that float32 holds neither the bright nor the dark."""

DARKEST = 1e-6
"""A pixel is lit from here on, as a share of the brightest."""

WHITE = 254.5 / 255.0
"""Display values from here on are the brightest that 8 bits have."""


def parse_exposure(text: str | float) -> float | None:
    """Return stops; None for `auto`.

    Raises:
        MrmError: neither, not finite, or beyond `LIMIT`.
    """
    if text == "auto":
        return None
    try:
        stops = float(text)
    except ValueError:
        stops = math.nan
    if not abs(stops) <= LIMIT:
        raise MrmError(f"exposure {text}: write auto, or stops from {-LIMIT:g} to {LIMIT:g} such as -1.5")
    return stops


def lit_pixels(image: Floats, alpha: Floats) -> NDArray[np.bool_]:
    """Where there is light, (h, w): on the mesh, and not black beside the brightest.

    image: (h, w, 3), linear, multiplied with `alpha`, (h, w).
    """
    peak = np.nan_to_num(image.max(axis=-1), nan=0.0, posinf=0.0)
    return np.asarray((alpha > 0.0) & (peak > DARKEST * peak.max(initial=0.0)))


def auto_exposure(
    image: Floats, alpha: Floats, headroom: float, behind: Floats | None = None
) -> float | None:
    """Return the stops at which nine of ten lit pixels are below white, and 99 of 100 are not clipped.

    A pixel is as bright as its largest channel. In hundredths of a stop, rounded down: what is printed gives the same
    picture again. None where nothing is lit, neither the mesh nor half of what is behind.

    Args:
        image: (h, w, 3), linear, multiplied with `alpha`, (h, w).
        headroom: exposed radiance up to which a tone mapping clips nothing.
        behind: (h, w, 3), what is seen where nothing is: half of that is to be less than a stop above white.
    """
    limits = []
    lit = lit_pixels(image, alpha)
    if lit.any():
        bright, brighter = np.quantile(image[lit].max(axis=-1) / alpha[lit], (BRIGHT, NEARLY_ALL))
        limits += [TARGET / bright, headroom / brighter]
    if behind is not None and (alpha == 0.0).any():
        half = float(np.median(behind[alpha == 0.0].max(axis=-1)))
        if half > 0.0:
            limits.append(TARGET * BEHIND / half)
    if not limits:
        return None
    stops = math.log2(min(limits))
    return float(np.clip(math.floor(100.0 * stops) / 100.0, -LIMIT, LIMIT))


def stops_text(stops: float, sign: str = "") -> str:
    """Stops as they are, with two decimals where that is exact; `+` as the sign writes it for positive ones, too."""
    short = f"{stops:{sign}.2f}"
    return short if float(short) == stops else f"{stops:{sign}}"


def clipped_share(encoded: Floats, lit: NDArray[np.bool_]) -> float:
    """Return the share of lit pixels of which a channel is shown as the brightest that 8 bits have.

    encoded: (h, w, 3), display values from 0 to 1 as a PNG has them, not multiplied with alpha.
    """
    return float((encoded[lit].max(axis=-1) >= WHITE).mean()) if lit.any() else 0.0
