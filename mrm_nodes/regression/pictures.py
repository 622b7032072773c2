"""A case's files: EXR for data, and PNG pictures of the render, the reference and the error."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.render.images import write_exr, write_png

Array = NDArray[np.float64]

HEAT_DECADES = 4
"""The heat map's scale spans this many decades up to the bound."""
HEAT_STOPS = ("#10142b", "#23346e", "#1f6f8b", "#2fa36b", "#b8cf3c", "#ffd23f")
"""From an error of bound / 10^HEAT_DECADES and less to one at the bound."""
HEAT_OVER = "#ff1f5a"
"""Above the bound, or not finite."""

BRIGHTEST = 0.995
"""Share of the lit values that a picture shows without clipping."""


def write_pictures(
    folder: Path, image: ArrayLike, reference: ArrayLike, mask: ArrayLike, used: ArrayLike
) -> dict[str, str | float]:
    """Write the files of one case into an existing folder.

    Args:
        image, reference: `(h, w, 3)`, linear.
        mask: `(h, w)`, true where the mesh is.
        used: `(h, w)`, error as a share of its bound.

    Returns:
        The file names by what they hold, and `exposure`, the stops by which both pictures were brightened.
    """
    mask = np.asarray(mask, bool)
    pixels = {"render": np.asarray(image), "reference": np.asarray(reference)}
    exposure = exposure_for(pixels["reference"][mask])
    files: dict[str, str | float] = {"exposure": exposure}
    for name, values in pixels.items():
        shown = np.where(mask[..., None], values, 0.0)
        write_exr(folder / f"{name}.exr", shown)
        # Covered pixels are opaque, so that the page's own background shows around the mesh.
        write_png(folder / f"{name}.png", np.concatenate([shown, _alpha(mask, exposure)], -1), exposure)
        files |= {name: f"{name}.png", f"{name}_data": f"{name}.exr"}
    write_png(folder / "error.png", heat_map(used, mask))
    return {**files, "error": "error.png"}


def exposure_for(values: ArrayLike) -> float:
    """Whole stops that bring the brightest values, outliers aside, to just below white."""
    lit = np.asarray(values)[np.asarray(values) > 1e-6]
    if lit.size == 0:
        return 0.0
    return float(math.floor(-math.log2(float(np.quantile(lit, BRIGHTEST)))))


def heat_map(used: ArrayLike, mask: ArrayLike) -> Array:
    """Linear RGBA `(h, w, 4)` of an error given as a share of its bound, on a logarithmic scale."""
    used = np.asarray(used, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.clip(1.0 + np.log10(used) / HEAT_DECADES, 0.0, 1.0)
    stops = np.array([_linear(stop) for stop in HEAT_STOPS])
    at = np.linspace(0.0, 1.0, len(stops))
    colors = np.stack([np.interp(height, at, stops[:, channel]) for channel in range(3)], -1)
    over = ~(used <= 1.0)
    colors[over] = _linear(HEAT_OVER)
    return np.concatenate([colors, _alpha(np.asarray(mask, bool), 0.0)], -1)


def _alpha(mask: NDArray[np.bool_], exposure: float) -> Array:
    """An alpha channel that survives `write_png`'s exposure."""
    return np.where(mask, 2.0**-exposure, 0.0)[..., None]


def _linear(color: str) -> Array:
    """Linear RGB of an sRGB colour written as #rrggbb."""
    encoded = np.array([int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
