"""A case's files: EXR for data, PNG pictures of the render, the reference and the error, and all of it for the page."""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mrm_nodes.files import write_text
from mrm_nodes.render.exposure import auto_exposure
from mrm_nodes.render.images import write_exr, write_png
from mrm_nodes.render.tonemap import find_tonemap

Array = NDArray[np.float64]

HEAT_DECADES = 4
"""The heat map's scale spans this many decades up to the bound."""
HEAT_STOPS = ("#10142b", "#23346e", "#1f6f8b", "#2fa36b", "#b8cf3c", "#ffd23f")
"""From an error of bound / 10^HEAT_DECADES and less to one at the bound."""
HEAT_OVER = "#ff1f5a"
"""Above the bound, or not finite."""

SHOWN = find_tonemap("neutral")
"""What pictures are tone-mapped by, as `mrm-nodes render` does it, and the page's own too: for eyes only, verdicts are
on the numbers."""

HALF_MOST = 65504.0
"""The largest that the page's 16 bits hold; what is finite and larger is kept at it."""


def write_pictures(
    folder: Path,
    image: ArrayLike,
    reference: ArrayLike | None,
    mask: ArrayLike,
    used: ArrayLike | None = None,
    flip: ArrayLike | None = None,
    source: str | None = None,
) -> dict[str, str | float]:
    """Write the files of one case into an existing folder.

    Args:
        image, reference: `(h, w, 3)`, linear; a case that has no reference yet has None.
        mask: `(h, w)`, true where the mesh is.
        used: `(h, w)`, error as a share of its bound, or None where no bound is one on pixels.
        flip: `(h, w)`, 0 to 1, where it was asked for.
        source: the material, as a MaterialX document.

    Returns:
        The file names by what they hold, and `exposure`, the stops by which both pictures were brightened.
    """
    mask = np.asarray(mask, bool)
    covered = mask[..., None]
    pixels = {
        name: np.where(covered, values, 0.0).astype(np.float32)
        for name, values in (("render", image), ("reference", reference))
        if values is not None
    }
    exposure = _shared_exposure(pixels, mask)
    files: dict[str, str | float] = {"exposure": exposure}
    for name, shown in pixels.items():
        write_exr(folder / f"{name}.exr", shown)
        # Covered pixels are opaque, so that the page's own background shows around the mesh.
        write_png(folder / f"{name}.png", _with_alpha(SHOWN(shown * np.float32(2.0**exposure)), mask))
        files |= {name: f"{name}.png", f"{name}_data": f"{name}.exr"}
    maps = {
        name: np.where(mask, values, 0.0)
        for name, values in (("used", used), ("flip", flip))
        if values is not None
    }
    if maps:
        pictured = heat_map(maps["used"], mask) if "used" in maps else flip_picture(maps["flip"], mask)
        write_png(folder / "error.png", pictured)
        files["error"] = "error.png"
    if source is not None:
        write_text(folder / "material.mtlx", source)
        files["source"] = "material.mtlx"
    write_text(folder / "data.js", f"mrmCase({json.dumps(page_data(pixels, maps, mask, source))});\n")
    return {**files, "data": "data.js"}


def page_data(
    pixels: Mapping[str, NDArray[np.float32]],
    maps: Mapping[str, ArrayLike],
    mask: NDArray[np.bool_],
    source: str | None = None,
) -> dict[str, Any]:
    """What the page's script loads of a case: every float32 of its images, packed, and the material's text.

    A page from a disk may run scripts and may not read files, so the numbers come as a script. They are packed as
    float image formats do it: the reference as its bits' difference from the render's, bytes of one weight side by
    side, then zlib. Maps have 16 bits, as they are shown with two digits.

    Args:
        pixels: `render`, and `reference` if there is one, `(h, w, 3)`.
        maps: `used`, `flip` or both, `(h, w)`.
    """
    bits = {name: np.ascontiguousarray(values).view(np.uint32) for name, values in pixels.items()}
    with np.errstate(over="ignore"):
        halves = {name: _halved(np.asarray(values)) for name, values in maps.items()}
    parts: dict[str, NDArray[Any]] = {
        "render": bits["render"],
        **({"reference": bits["render"] ^ bits["reference"]} if "reference" in bits else {}),
        **halves,
        "mask": mask.astype(np.uint8),
    }
    packed = zlib.compress(b"".join(_shuffled(part) for part in parts.values()), level=1)
    height, width = mask.shape
    return {
        "width": width,
        "height": height,
        "parts": [[name, part.itemsize, part.size // mask.size] for name, part in parts.items()],
        "packed": base64.b64encode(packed).decode("ascii"),
        "source": source,
    }


def _halved(values: NDArray[Any]) -> NDArray[np.float16]:
    """In 16 bits; only what is not finite is not finite there."""
    return np.where(np.isfinite(values), np.minimum(values, HALF_MOST), values).astype(np.float16)


def _shuffled(values: NDArray[Any]) -> bytes:
    """The first bytes of all values, then the second ones, and so on; little-endian."""
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return little.view(np.uint8).reshape(-1, values.itemsize).T.tobytes()


def _shared_exposure(pixels: Mapping[str, NDArray[np.float32]], mask: NDArray[np.bool_]) -> float:
    """Stops at which render and reference are shown, both alike: those that the reference asks for, where it is lit."""
    for name in ("reference", "render"):
        if name in pixels:
            stops = auto_exposure(pixels[name], mask.astype(np.float32), SHOWN.headroom)
            if stops is not None:
                return stops
    return 0.0


def heat_map(used: ArrayLike, mask: ArrayLike) -> Array:
    """Linear RGBA `(h, w, 4)` of an error given as a share of its bound, on a logarithmic scale."""
    used = np.asarray(used, np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.clip(1.0 + np.log10(used) / HEAT_DECADES, 0.0, 1.0)
    colors = _colors(height)
    over = ~(used <= 1.0)
    colors[over] = _linear(HEAT_OVER)
    return _with_alpha(colors, mask)


def flip_picture(flip: ArrayLike, mask: ArrayLike) -> Array:
    """Linear RGBA `(h, w, 4)` of FLIP in the heat map's colours, evenly from 0 to 1."""
    return _with_alpha(_colors(np.asarray(flip, np.float64)), mask)


def _colors(height: Array) -> Array:
    stops = np.array([_linear(stop) for stop in HEAT_STOPS])
    at = np.linspace(0.0, 1.0, len(stops))
    return np.stack([np.interp(height, at, stops[:, channel]) for channel in range(3)], -1)


def _with_alpha(colors: NDArray[Any], mask: ArrayLike) -> Array:
    return np.concatenate([colors, np.asarray(mask, bool)[..., None]], -1)


def _linear(color: str) -> Array:
    """Linear RGB of an sRGB colour written as #rrggbb."""
    encoded = np.array([int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
