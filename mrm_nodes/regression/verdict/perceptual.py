"""FLIP: the difference that a person sees when two images alternate, 0 (none) to 1, through `flip-evaluator`.

Andersson et al., FLIP: A Difference Evaluator for Alternating Images (2020), and Visualizing Errors in Rendered
High Dynamic Range Images (2021). A pixel counts for a person who sees 67 of them in a degree, FLIP's own default.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.errors import MrmError

Array = NDArray[np.float64]

BRIGHTEST = 0.995
"""Share of the lit values that FLIP, which knows no tone mapping, sees without clipping."""

LUMINANCE = (0.2126, 0.7152, 0.0722)
DARKEST = 2.0**-20
"""Brightest luminance of a reference below which no exposure shows anything: the library ends the process there."""


def flip_map(image: ArrayLike, reference: ArrayLike, mask: ArrayLike) -> Array:
    """FLIP at the reference's own exposure (`exposure_for`), `(h, w)`: not tone-mapped, clipped to what a screen shows.

    image, reference: `(h, w, 3)`, linear; mask: `(h, w)`, outside of which both are taken as black.

    A pixel of the image that is not finite differs by 1.
    """
    exposure = exposure_for(np.asarray(reference)[np.asarray(mask, bool)])
    return _flip(image, reference, mask, "LDR", 2.0**exposure, {})


def exposure_for(values: ArrayLike) -> float:
    """Whole stops that bring the brightest values, outliers aside, to just below white."""
    values = np.asarray(values)
    lit = values[(values > 1e-6) & np.isfinite(values)]
    if lit.size == 0:
        return 0.0
    return float(math.floor(-math.log2(float(np.quantile(lit, BRIGHTEST)))))


def hdr_flip_map(image: ArrayLike, reference: ArrayLike, mask: ArrayLike) -> Array:
    """HDR-FLIP, `(h, w)`: the largest FLIP over all exposures that show something of the reference.

    As `flip_map`; a reference that is black is looked at as it is.
    """
    shown = np.where(np.asarray(mask, bool)[..., None], np.maximum(reference, 0.0), 0.0)
    dark = float(np.max(shown @ LUMINANCE)) < DARKEST
    return _flip(
        image, reference, mask, "HDR", 1.0, {"startExposure": 0.0, "stopExposure": 0.0} if dark else {}
    )


def _flip(
    image: ArrayLike,
    reference: ArrayLike,
    mask: ArrayLike,
    dynamic_range: str,
    scale: float,
    parameters: dict[str, float],
) -> Array:
    try:
        import flip_evaluator
    except ImportError:
        raise MrmError(
            "FLIP needs the package flip-evaluator: pip install flip-evaluator, or ask for no flip"
        ) from None
    covered = np.asarray(mask, bool)
    broken = ~np.isfinite(np.asarray(image)).all(axis=-1) & covered
    top = 1.0 if dynamic_range == "LDR" else math.inf
    test, truth = (
        np.ascontiguousarray(
            np.where((covered & ~broken)[..., None], np.clip(np.asarray(each) * scale, 0.0, top), 0.0),
            np.float32,
        )
        for each in (image, reference)
    )
    seen, _, _ = flip_evaluator.evaluate(
        truth,
        test,
        dynamic_range,
        inputsRGB=False,
        applyMagma=False,
        computeMeanError=False,
        parameters=parameters,
    )
    difference: Array = np.asarray(seen, np.float64)[..., 0]
    difference[broken] = 1.0
    return np.where(covered, difference, 0.0)
